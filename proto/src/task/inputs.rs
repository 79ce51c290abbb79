//! What the network is given of a record: the task's observations.

use super::channel::{Channel, Dtype, Role};
use super::error::SpecError;
use super::image::Image;
use super::layout::{Field, Layout};
use super::spec::Spec;
use crate::camera::{FRAME_SIDE, WINDOW};
use std::ops::Range;

/// Numbers of all observations beside the frame at most.
const NUMBERS_MOST: usize = 1 << 16;

/// What becomes of an observation's numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Coding {
    /// They are `f32`, and stay as they are.
    Plain,
    /// Each whole number becomes so many, all 0 but one: that of its distance from `least`.
    OneHot { least: i64, count: usize },
}

/// The numbers of an observation.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Numbers {
    name: String,
    field: Field,
    coding: Coding,
}

/// An observation among the numbers that the policy is given.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place<'a> {
    pub name: &'a str,
    pub range: Range<usize>,
    /// Where each whole number is a one-hot code: the least one, and how many there are.
    pub one_hot: Option<(i64, usize)>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Inputs {
    pub frame: Option<Field>,
    /// All other images, in the order of their names.
    pub images: Vec<Image>,
    /// Those that the policy is given, too, come first.
    numbers: Vec<Numbers>,
    /// How many of these the critic alone is given.
    privileged: usize,
}

impl Inputs {
    /// Bytes of a row of all images but the frame: one behind the other, with gaps before some.
    pub fn image_bytes(&self) -> usize {
        self.images.last().map_or(0, Image::end)
    }

    /// How many numbers the network is given beside frame and images: the policy's, then those of the critic alone.
    pub fn width(&self) -> usize {
        width(&self.numbers)
    }

    /// How many of these the policy is given.
    pub fn policy_width(&self) -> usize {
        width(self.of_policy())
    }

    fn of_policy(&self) -> &[Numbers] {
        &self.numbers[..self.numbers.len() - self.privileged]
    }

    /// Where each observation lies among the policy's numbers, in their order.
    pub fn places(&self) -> impl Iterator<Item = Place<'_>> {
        self.of_policy().iter().scan(0, |end, numbers| {
            let begin = *end;
            *end += numbers.count();
            let one_hot = match numbers.coding {
                Coding::Plain => None,
                Coding::OneHot { least, count } => Some((least, count)),
            };
            Some(Place { name: &numbers.name, range: begin..*end, one_hot })
        })
    }

    /// The same of what was seen last of a truncated episode; none in a task with images.
    pub fn last(&self, layout: &Layout) -> Option<Self> {
        let last = |numbers: &Numbers| Some(Numbers { field: layout.last(numbers.field)?, ..numbers.clone() });
        let numbers = self.numbers.iter().map(last);
        let numbers = numbers.collect::<Option<_>>()?;
        self.images.is_empty().then_some(Self { frame: None, images: vec![], numbers, ..*self })
    }

    /// Of each number, whether it is one as the task declares it, and not a place of a one-hot code.
    pub fn are_plain(&self) -> impl Iterator<Item = bool> {
        self.numbers.iter().flat_map(|numbers| std::iter::repeat_n(numbers.coding == Coding::Plain, numbers.count()))
    }

    /// Whether the numbers begin with a vector in space, or could.
    pub(crate) fn are_coordinates(&self) -> bool {
        self.policy_width() >= 3 && self.are_plain().take(3).all(|is_plain| is_plain)
    }

    /// Appends a record's numbers: one observation behind the other, as the task declares them, then what the critic alone
    /// is given. Panics if the record is shorter than its layout, or was not checked.
    pub fn read(&self, record: &[u8], numbers: &mut Vec<f32>) {
        for &Numbers { field, coding, .. } in &self.numbers {
            match coding {
                Coding::Plain => numbers.extend_from_slice(field.of(record)),
                Coding::OneHot { least, count } => {
                    for number in field.numbers(record) {
                        let begin = numbers.len();
                        numbers.resize(begin + count, 0.0);
                        // Exact: its range has no more numbers than there are places.
                        numbers[begin + (number as i64 - least) as usize] = 1.0;
                    }
                }
            }
        }
    }
}

impl Spec {
    /// Its observations, if networks can take them.
    pub fn inputs(&self) -> Result<Inputs, SpecError> {
        let refuse = |what: String| Err(SpecError::Input { task: self.name.clone(), what });
        let mut inputs = Inputs { frame: None, images: vec![], numbers: vec![], privileged: 0 };
        let of_role = |role: Role| {
            let pairs = self.channels.iter().zip(&self.layout.fields);
            pairs.filter(move |(channel, _)| channel.role == role)
        };
        for (channel, &field) in of_role(Role::Observation) {
            let is_frame = channel.dtype == Dtype::U16 && channel.shape == [FRAME_SIDE; 2];
            if is_frame && channel.sums == Some(WINDOW) && inputs.frame.is_none() {
                inputs.frame = Some(field);
            } else if let Some(image) = Image::of(channel, field) {
                inputs.images.push(image);
            } else if channel.is_bulk() {
                return refuse(format!("its image `{}` of the shape {:?}", channel.name, channel.shape));
            } else {
                inputs.numbers.push(self.numbers(channel, field)?);
            }
        }
        for (channel, &field) in of_role(Role::Privileged) {
            inputs.numbers.push(self.numbers(channel, field)?);
            inputs.privileged += 1;
        }
        inputs.images.sort_by(|one, other| one.name.cmp(&other.name));
        let mut begin = 0;
        for image in &mut inputs.images {
            image.begin = begin;
            begin = image.end();
        }
        match inputs.width() {
            _ if inputs.policy_width() == 0 && (inputs.images.is_empty() || inputs.frame.is_some()) => {
                refuse("its observations: there are no numbers".to_owned())
            }
            0..=NUMBERS_MOST => Ok(inputs),
            width => refuse(format!("its observations: {width} numbers")),
        }
    }

    fn numbers(&self, channel: &Channel, field: Field) -> Result<Numbers, SpecError> {
        let what = |problem| format!("its channel `{}`: {problem}", channel.name);
        let refuse = |problem| SpecError::Input { task: self.name.clone(), what: what(problem) };
        Ok(Numbers { name: channel.name.clone(), field, coding: coding(channel).map_err(refuse)? })
    }
}

impl Numbers {
    /// How many the network is given.
    fn count(&self) -> usize {
        match self.coding {
            Coding::Plain => self.field.count,
            Coding::OneHot { count, .. } => self.field.count * count,
        }
    }
}

fn width(numbers: &[Numbers]) -> usize {
    numbers.iter().map(Numbers::count).sum()
}

fn coding(channel: &Channel) -> Result<Coding, &'static str> {
    match channel.dtype {
        Dtype::F32 => return Ok(Coding::Plain),
        Dtype::F64 => return Err("it is f64"),
        Dtype::U8 | Dtype::U16 | Dtype::I32 | Dtype::U32 | Dtype::U64 => {}
    }
    let [least, most] = channel.bounds().ok_or("a whole number has a range, or names")?;
    let whole = |number: f64| number.fract() == 0.0 && number.abs() < 9e15;
    if !(whole(least) && whole(most)) {
        return Err("its range is not of whole numbers");
    }
    let count = (most - least) as usize + 1;
    // Many of them at once are refused by their sum.
    if count > NUMBERS_MOST {
        Err("its range is too large for a number for each")
    } else {
        Ok(Coding::OneHot { least: least as i64, count })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::task::LINE_BYTES;

    fn inputs(channels: &str) -> Result<(Spec, Inputs), String> {
        let text = format!(
            "name = \"a\"\n[actions]\nkind = \"discrete\"\nnames = [\"left\", \"right\"]\n[[channels]]\nname = \"gain\"\n\
             role = \"part\"\ndtype = \"f32\"\nrange = [0, 1]\ndoc = \"\"\n{channels}"
        );
        let spec = Spec::parse(&text).map_err(|error| error.to_string())?;
        let inputs = spec.inputs().map_err(|error| error.to_string())?;
        Ok((spec, inputs))
    }

    fn channel(name: &str, rest: &str) -> String {
        format!("[[channels]]\nname = \"{name}\"\nrole = \"observation\"\ndoc = \"\"\n{rest}\n")
    }

    #[test]
    fn vectors_stay_and_whole_numbers_become_one_hot_in_the_declarations_order() {
        let text = channel("speed", "dtype = \"f32\"\nshape = [2]\nrange = [-9, 9]")
            + &channel("door", "dtype = \"i32\"\nrange = [-1, 1]")
            + &channel("goal", "dtype = \"u8\"\nnames = [\"near\", \"far\"]").replace("observation", "privileged")
            + &channel("rooms", "dtype = \"u8\"\nshape = [2]\nnames = [\"kitchen\", \"hall\"]")
            + &channel("angle", "dtype = \"f32\"\nrange = [-9, 9]");
        let (spec, inputs) = inputs(&text).unwrap();
        assert_eq!((inputs.width(), inputs.policy_width(), inputs.frame), (2 + 3 + 4 + 1 + 2, 2 + 3 + 4 + 1, None));
        assert!(!inputs.are_coordinates());
        let places: Vec<_> = inputs.places().map(|place| (place.name, place.range, place.one_hot)).collect();
        assert_eq!(
            places,
            [
                ("speed", 0..2, None),
                ("door", 2..5, Some((-1, 3))),
                ("rooms", 5..9, Some((0, 2))),
                ("angle", 9..10, None),
            ]
        );
        // Records begin on a cache line.
        let mut lines = vec![[0u64; LINE_BYTES / 8]; spec.layout().bytes / LINE_BYTES];
        let record: &mut [u8] = bytemuck::cast_slice_mut(&mut lines);
        let place = |name: &str| spec.channel(name).unwrap().1;
        place("speed").of_mut(record).copy_from_slice(&[0.5f32, -1.5]);
        place("door").of_mut(record)[0] = -1i32;
        place("goal").of_mut(record)[0] = 1u8;
        place("rooms").of_mut(record).copy_from_slice(&[1u8, 0]);
        place("angle").of_mut(record)[0] = 7.0f32;
        let mut numbers = vec![3.0];
        inputs.read(record, &mut numbers);
        assert_eq!(numbers, [3.0, 0.5, -1.5, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 7.0, 0.0, 1.0]);
    }

    #[test]
    fn images_lie_one_behind_the_other_with_channels_where_they_are_declared() {
        let text = channel("screen", "dtype = \"u8\"\nshape = [37, 41, 3]")
            + &channel("speed", "dtype = \"f32\"\nrange = [-9, 9]")
            + &channel("heat", "dtype = \"f32\"\nshape = [2, 36, 36]\nrange = [0, 1]")
            + &channel("matrix", "dtype = \"f32\"\nshape = [36, 36]\nrange = [0, 1]")
            + &channel("depth", "dtype = \"u16\"\nshape = [63, 47]");
        let (spec, inputs) = inputs(&text).unwrap();
        let found: Vec<_> = inputs.images.iter().map(|image| (&*image.name, image.shape(), image.bytes())).collect();
        let (depth, screen) = (63 * 47 * 2, 37 * 41 * 3);
        let heat = depth + 2;
        let begin = heat + 2 * 36 * 36 * 4;
        assert_eq!(
            found,
            [
                ("depth", [1, 63, 47], 0..depth),
                ("heat", [2, 36, 36], heat..begin),
                ("screen", [37, 41, 3], begin..begin + screen),
            ]
        );
        assert_eq!((inputs.image_bytes(), inputs.frame), (begin + screen + 1, None));
        assert_eq!(inputs.width(), 1 + 36 * 36, "a matrix is numbers");
        assert_eq!(inputs.images[0].field, spec.channel("depth").unwrap().1);
        assert_eq!(inputs.last(spec.layout()), None, "what was seen last would double a record");
    }

    #[test]
    fn what_no_network_takes_is_named() {
        for (text, problem) in [
            (String::new(), "there are no numbers"),
            (channel("x", "dtype = \"f64\"\nrange = [0, 1]"), "its channel `x`: it is f64"),
            (channel("x", "dtype = \"u32\""), "`x`: a whole number has a range, or names"),
            (channel("x", "dtype = \"u32\"\nrange = [0, 1e6]"), "`x`: its range is too large"),
            (channel("x", "dtype = \"u32\"\nrange = [0, 1.5]"), "`x`: its range is not of whole numbers"),
            (channel("x", "dtype = \"f32\"\nshape = [70000]\nrange = [0, 1]"), "its observations: 70000 numbers"),
            (
                channel("x", "dtype = \"f32\"\nrange = [0, 1]").replace("observation", "privileged"),
                "there are no numbers",
            ),
            (
                channel("x", "dtype = \"u8\"\nshape = [9, 9]").replace("observation", "privileged"),
                "`x`: the critic alone",
            ),
            (channel("x", "dtype = \"u8\"\nshape = [84, 84, 13]"), "its image `x` of the shape [84, 84, 13]"),
            (channel("x", "dtype = \"u8\"\nshape = [3, 31, 84]"), "its image `x` of the shape [3, 31, 84]"),
            (channel("x", "dtype = \"u16\"\nshape = [2, 3, 84, 84]"), "its image `x` of the shape [2, 3, 84, 84]"),
        ] {
            let error = inputs(&text).unwrap_err();
            assert!(error.contains(problem), "{error}");
        }
    }

    #[test]
    fn built_in_tasks_have_a_frame_and_a_vector_in_space() {
        for spec in Spec::built_in() {
            let inputs = spec.inputs().unwrap();
            assert!(inputs.frame.is_some() && inputs.are_coordinates(), "{}", spec.name);
        }
    }
}
