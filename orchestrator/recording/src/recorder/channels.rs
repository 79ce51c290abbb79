//! What the recorder asks a task for by name: its images, and where the robot is.

use crate::recorder::camera::Places;
use crate::schema::foxglove::RawImage;
use prost_types::Timestamp;
use proto::task::{Channel, Dtype, Field, Spec};

pub struct Images(Vec<Image>);

struct Image {
    field: Field,
    name: String,
    bit: u32,
    message: RawImage,
}

impl Images {
    pub fn of(spec: &Spec) -> Self {
        let images = spec.channels.iter().zip(&spec.layout().fields).filter(|(channel, _)| channel.is_bulk());
        Self(images.filter_map(|(channel, &field)| Image::of(spec, channel, field)).collect())
    }

    pub fn count(&self) -> usize {
        self.0.len()
    }

    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.0.iter().map(|image| &*image.name)
    }

    pub fn is_there(&self, image: usize, bulk: u32) -> bool {
        bulk & self.0[image].bit != 0
    }

    pub fn message(&mut self, image: usize, timestamp: Timestamp, frame_id: &str, record: &[u8]) -> &RawImage {
        let Image { field, message, .. } = &mut self.0[image];
        message.timestamp = Some(timestamp);
        frame_id.clone_into(&mut message.frame_id);
        message.data.clear();
        message.data.extend_from_slice(&record[field.range()]);
        message
    }
}

impl Image {
    fn of(spec: &Spec, channel: &Channel, field: Field) -> Option<Self> {
        let (encoding, pixel_bytes) = match (channel.dtype, channel.shape.as_slice()) {
            (Dtype::U16, [_, _]) => ("16UC1", 2),
            (Dtype::U8, [_, _]) => ("mono8", 1),
            (Dtype::U8, [_, _, 3]) => ("rgb8", 3),
            _ => return None,
        };
        let bit = 1 << spec.layout().images.iter().position(|&image| image == field)?;
        let [height, width] = [0, 1].map(|side| channel.shape[side] as u32);
        let step = width * pixel_bytes;
        let message = RawImage { width, height, encoding: encoding.into(), step, ..RawImage::default() };
        Some(Self { field, name: channel.bare_name().to_owned(), bit, message })
    }
}

pub struct Pose {
    base_position_m: Field,
    base_yaw_rad: Field,
    camera_pitch_rad: Field,
    /// Of each `NAME_position_m`.
    others: Vec<(String, Field)>,
}

impl Pose {
    pub fn of(spec: &Spec) -> Option<Self> {
        let reals = |name: &str, count: usize| {
            let (channel, field) = spec.channel(name)?;
            (!channel.is_of_action() && field.dtype == Dtype::F32 && field.count == count).then_some(field)
        };
        let other = |channel: &Channel| {
            let field = reals(&channel.name, 3)?;
            Some((channel.name.strip_suffix("_position_m")?.to_owned(), field))
        };
        Some(Self {
            base_position_m: reals("base_position_m", 2)?,
            base_yaw_rad: reals("base_yaw_rad", 1)?,
            camera_pitch_rad: reals("camera_pitch_rad", 1)?,
            others: spec.channels.iter().filter_map(other).collect(),
        })
    }

    pub fn places(&self, record: &[u8]) -> Places {
        let others = self.others.iter().map(|(name, field)| (name.clone(), vector(*field, record)));
        Places {
            base_position_m: vector(self.base_position_m, record),
            base_yaw_rad: self.base_yaw_rad.f32(record),
            camera_pitch_rad: self.camera_pitch_rad.f32(record),
            others_m: others.collect(),
        }
    }
}

fn vector<const N: usize>(field: Field, record: &[u8]) -> [f32; N] {
    std::array::from_fn(|at| field.numbers(record).nth(at).expect("as many as it is declared with") as f32)
}
