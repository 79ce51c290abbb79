//! What the learner reads in a record: places of channels, looked up by name once.

use proto::camera::{DepthFrame, WINDOW};
use proto::config::Config;
use proto::record::{End, RecordHeader, flag};
use proto::task::{Field, LINE_BYTES, Spec};
use std::sync::Arc;

#[cfg(test)]
pub(crate) fn named(task: &Spec, name: &str) -> Field {
    task.channel(name).unwrap_or_else(|| panic!("task `{}` has no channel `{name}`", task.name)).1
}

/// What the policy is given beside the frame.
#[derive(Debug, Clone)]
pub(crate) struct Inputs {
    previous_action: Field,
    observations: proto::task::Inputs,
    mask: Option<Field>,
    /// What was seen last of a truncated episode; none in a task with images.
    last: Option<proto::task::Inputs>,
}

impl Inputs {
    pub fn of(task: &Spec) -> Self {
        let observations = inputs(task);
        let last = observations.last(task.layout());
        Self { previous_action: task.layout().previous_action, observations, mask: task.mask(), last }
    }

    pub fn width(&self) -> usize {
        self.observations.width()
    }

    pub fn read(&self, record: &[u8], numbers: &mut Vec<f32>) {
        self.observations.read(record, numbers);
    }

    /// Appends which options may be chosen; nothing in a task without masks.
    pub fn read_mask(&self, record: &[u8], mask: &mut Vec<bool>) {
        let numbers = self.mask.map_or(&[][..], |field| &record[field.range()]);
        mask.extend(numbers.iter().map(|&number| number == 1));
    }

    /// The numbers that were seen last of the episode that the last action truncated, if it did and they are there.
    pub(crate) fn read_last(&self, record: &[u8]) -> Option<Vec<f32>> {
        let last = self.last.as_ref().filter(|_| RecordHeader::of(record).end() == Some(End::Truncated))?;
        let mut numbers = Vec::with_capacity(self.width());
        last.read(record, &mut numbers);
        Some(numbers)
    }

    /// The action before what is seen; meaningless at an episode's start.
    pub fn previous_action(&self, record: &[u8]) -> u8 {
        record[self.previous_action.offset]
    }
}

fn inputs(task: &Spec) -> proto::task::Inputs {
    task.inputs().expect("a validated configuration's task has what networks take")
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FramePart {
    Whole,
    Sums,
}

#[derive(Debug, Clone)]
pub struct Frame {
    /// None in a task without a frame.
    image: Option<Image>,
    images: Arc<[proto::task::Image]>,
    /// Bits of [`RecordHeader::bulk`] that those of whole numbers have.
    images_bits: u32,
    record_lines: usize,
    small_lines: usize,
}

#[derive(Debug, Clone, Copy)]
struct Image {
    whole: Field,
    sums: Field,
    /// Bits of [`RecordHeader::bulk`].
    whole_bit: u32,
    sums_bit: u32,
    /// Whether the network averages over the windows that sums are of.
    averages: bool,
}

impl Frame {
    pub fn of(config: &Config) -> Self {
        let layout = config.spec().layout();
        let inputs = inputs(config.spec());
        let place = |field: Field| layout.images.iter().position(|&image| image == field);
        let image = inputs.frame.map(|whole| {
            let place = place(whole).expect("a frame is an image");
            let averages = config.network.input_pool as usize == WINDOW;
            let (whole_bit, sums_bit) = (1 << place, 1 << (place + 1));
            Image { whole, sums: layout.images[place + 1], whole_bit, sums_bit, averages }
        });
        let images_bits = inputs.images.iter().filter_map(|image| place(image.field)).map(|place| 1 << place).sum();
        Self {
            image,
            images_bits,
            images: inputs.images.into(),
            record_lines: layout.bytes / LINE_BYTES,
            small_lines: layout.small_bytes / LINE_BYTES,
        }
    }

    /// Cache lines of a record, and of its beginning: all but images.
    pub fn lines(&self) -> [usize; 2] {
        [self.record_lines, self.small_lines]
    }

    pub fn is_there(&self, header: &RecordHeader) -> bool {
        let images = header.bulk & self.images_bits == self.images_bits;
        images && self.image.is_none_or(|image| image.part(header).is_some())
    }

    /// What the network reads of a record with this header, where it lies; none in a task without a frame. Nobody asks for
    /// one that is not there, and any pixels are sound.
    pub fn read<'a>(&self, record: &'a [u8], header: &RecordHeader) -> Option<DepthFrame<'a>> {
        self.image.map(|image| image.read(record, image.part(header).unwrap_or(FramePart::Whole)))
    }

    /// The images but the frame, where they lie. `small` is the beginning of the record as it was checked: images of whole
    /// numbers, of which any are sound, lie behind it.
    pub fn images<'a>(&self, small: &'a [u8], record: &'a [u8]) -> impl Iterator<Item = &'a [u8]> {
        self.images.iter().map(move |image| {
            let bytes = image.field.range();
            let checked = if bytes.end <= small.len() { small } else { record };
            &checked[bytes]
        })
    }
}

impl Image {
    /// What is read of a record with this header: the sums only if the network averages over such windows. None if what it
    /// would read is not there, or if the whole frame is to be recorded and is not there.
    fn part(&self, header: &RecordHeader) -> Option<FramePart> {
        let has_whole = header.bulk & self.whole_bit != 0;
        if header.has(flag::RECORD_BULK) && !has_whole {
            return None;
        }
        if self.averages && header.bulk & self.sums_bit != 0 {
            Some(FramePart::Sums)
        } else {
            has_whole.then_some(FramePart::Whole)
        }
    }

    fn read(self, record: &[u8], part: FramePart) -> DepthFrame<'_> {
        let long = "the declared image has a frame's size";
        match part {
            FramePart::Whole => DepthFrame::Whole(self.whole.of(record).try_into().expect(long)),
            FramePart::Sums => DepthFrame::Sums(self.sums.of(record).try_into().expect(long)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wire::message::Line;

    /// Of the part that is not there the record has what an earlier one left.
    #[test]
    fn only_what_is_there_of_a_frame_is_read() {
        let read = |bulk: u32, flags: u32, averages| {
            let image = Frame::of(&Config::default()).image.expect("the task has a frame");
            Image { averages, ..image }.part(&RecordHeader { bulk, flags, ..Default::default() })
        };
        let (whole, sums) = (1, 2);
        for flags in [0, flag::RECORD_BULK] {
            assert_eq!(read(0, flags, true), None);
            assert_eq!(read(0, flags, false), None);
            assert_eq!(read(whole, flags, true), Some(FramePart::Whole), "a sum exceeded 16 bits");
            assert_eq!(read(whole, flags, false), Some(FramePart::Whole));
            assert_eq!(read(whole | sums, flags, true), Some(FramePart::Sums));
            assert_eq!(read(whole | sums, flags, false), Some(FramePart::Whole));
            assert_eq!(read(sums, flags, false), None, "this network reads no sums");
        }
        assert_eq!(read(sums, 0, true), Some(FramePart::Sums));
        assert_eq!(read(sums, flag::RECORD_BULK, true), None, "the recorder has nothing to record");
    }

    /// Images of `f32` were copied and checked; images of whole numbers lie where they came.
    #[test]
    fn images_are_taken_from_where_they_are_sound() {
        let task = Spec::declare(include_str!("../tests/support/images.toml")).expect("a sound task");
        let config = Config::resolve_with("gym", Some(("task = \"images\"", "a test"))).expect("it fits");
        let (frame, layout) = (Frame::of(&config), task.layout());
        let header = |bulk: u32| RecordHeader { bulk, ..Default::default() };
        assert_eq!([0, 1, 2, 3].map(|bulk| frame.is_there(&header(bulk))), [false, false, false, true]);
        let mut lines = vec![Line([0; LINE_BYTES]); layout.bytes / LINE_BYTES];
        let record = Line::bytes_mut(&mut lines);
        named(task, "screen").of_mut::<u8>(record).fill(7);
        named(task, "depth").of_mut::<u16>(record).fill(0x0908);
        let mut small = record[..layout.small_bytes].to_vec();
        small[named(task, "heat").range()].fill(5);
        let images: Vec<&[u8]> = frame.images(&small, record).collect();
        let [depth, heat, screen] = [41 * 36, 2 * 45 * 36 * 4, 36 * 40 * 3];
        assert_eq!(images, [[8, 9].repeat(depth), vec![5; heat], vec![7; screen]]);
    }
}
