//! A run message by message, for Foxglove: the topics of its recordings as they grow, and one environment as it is at
//! the moment. Of the latter nothing need have been recorded.

mod scene;

use crate::recording::follow::Follower;
use crate::recording::recorder::camera::{self, FrameNames, Places};
use crate::recording::schema::foxglove::packed_element_field::NumericType;
use crate::recording::schema::foxglove::{FrameTransforms, PackedElementField, PointCloud, RawImage};
use crate::recording::schema::{PROTOBUF, Schema};
use prost::Message;
use prost_types::Timestamp;
use proto::camera::FRAME_SIDE;
use proto::run_folder::RunFolder;
use proto::show::{ShownEpisode, ShownSolids};
use scene::scene_of;
use std::sync::{Arc, LazyLock};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use view::feed::{Feed, Recorded, Topic};

/// Prefix of topics and frames, whichever environment is shown: a layout names them.
const PREFIX: &str = "watch";
const GLANCE: Duration = Duration::from_millis(100);
const POINT_EVERY: usize = 2;

struct Topics {
    scene: Arc<Topic>,
    transforms: Arc<Topic>,
    calibration: Arc<Topic>,
    image: Arc<Topic>,
    points: Arc<Topic>,
}

impl Topics {
    fn all(&self) -> [Arc<Topic>; 5] {
        let Self { scene, transforms, calibration, image, points } = self;
        [scene, transforms, calibration, image, points].map(Arc::clone)
    }
}

static TOPICS: LazyLock<Topics> = LazyLock::new(|| {
    let topic = |name: &str, message: &str| {
        Arc::new(Topic {
            name: format!("/{PREFIX}/{name}"),
            encoding: PROTOBUF.to_owned(),
            schema_name: message.to_owned(),
            schema_encoding: PROTOBUF.to_owned(),
            schema: Schema::of(message).descriptor.to_vec(),
        })
    };
    Topics {
        scene: topic("scene", "foxglove.SceneUpdate"),
        transforms: topic("tf", "foxglove.FrameTransforms"),
        // Foxglove pairs an image with the calibration that shares its name up to the last slash.
        calibration: topic("depth/calibration", "foxglove.CameraCalibration"),
        image: topic("depth/image", "foxglove.RawImage"),
        points: topic("depth/points", "foxglove.PointCloud"),
    }
});

pub struct Recordings {
    follower: Follower,
    names: FrameNames,
}

impl Recordings {
    pub fn of(folder: RunFolder) -> Self {
        Self { follower: Follower::of(folder), names: FrameNames::under(PREFIX) }
    }
}

impl Feed for Recordings {
    fn read(&mut self) -> Vec<Recorded> {
        self.follower.read(GLANCE)
    }

    fn topics(&self) -> Vec<Arc<Topic>> {
        self.follower.topics()
    }

    fn moment_topics(&self) -> Vec<Arc<Topic>> {
        TOPICS.all().to_vec()
    }

    fn moment(&self, shown: &ShownEpisode, solids: &ShownSolids, whole: bool) -> Vec<Recorded> {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let timestamp = Timestamp { seconds: now.as_secs() as i64, nanos: now.subsec_nanos() as i32 };
        let Some(moment) = shown.moments.last() else { return Vec::new() };
        let others = moment
            .channels
            .keys()
            .filter_map(|name| Some((name.strip_suffix("_position_m")?.to_owned(), moment.numbers(name)?)));
        let places = Places {
            base_position_m: moment.numbers("base_position_m").unwrap_or_default(),
            base_yaw_rad: moment.numbers("base_yaw_rad").map_or(0.0, |[yaw_rad]| yaw_rad),
            camera_pitch_rad: solids.camera_pitch_rad,
            others_m: others.collect(),
        };
        let transforms = FrameTransforms { transforms: camera::transforms(timestamp, &self.names, &places) };
        let camera = &self.names.camera;
        let image = RawImage {
            timestamp: Some(timestamp),
            frame_id: camera.clone(),
            width: FRAME_SIDE as u32,
            height: FRAME_SIDE as u32,
            encoding: "16UC1".into(),
            step: (FRAME_SIDE * size_of::<u16>()) as u32,
            data: solids.depth_mm.iter().flat_map(|depth| depth.to_le_bytes()).collect(),
        };
        let calibration = camera::calibration(timestamp, camera);
        let points = points_of(timestamp, camera, &calibration.k, &solids.depth_mm);
        let scene = scene_of(timestamp, &self.names.world(), shown, solids, whole);
        let at_ns = now.as_nanos() as u64;
        let of = |topic: &Arc<Topic>, data: Vec<u8>| Recorded { topic: Arc::clone(topic), at_ns, data };
        vec![
            of(&TOPICS.transforms, transforms.encode_to_vec()),
            of(&TOPICS.calibration, calibration.encode_to_vec()),
            of(&TOPICS.image, image.encode_to_vec()),
            of(&TOPICS.points, points.encode_to_vec()),
            of(&TOPICS.scene, scene.encode_to_vec()),
        ]
    }
}

/// A depth frame as points in the camera's optical frame. `k`: the camera's intrinsic matrix, row by row.
fn points_of(timestamp: Timestamp, frame_id: &str, k: &[f64], depth_mm: &[u16]) -> PointCloud {
    let &[focal_px, _, centre_px, ..] = k else { return PointCloud::default() };
    let mut data = Vec::new();
    for row in (0..FRAME_SIDE).step_by(POINT_EVERY) {
        for column in (0..FRAME_SIDE).step_by(POINT_EVERY) {
            let z = depth_mm.get(row * FRAME_SIDE + column).map_or(0.0, |&depth| f64::from(depth) / 1000.0);
            // Nothing was seen there.
            if z > 0.0 {
                let along = |pixel: usize| (pixel as f64 - centre_px) / focal_px * z;
                let place = [along(column), along(row), z];
                data.extend(place.iter().flat_map(|&part| (part as f32).to_le_bytes()));
            }
        }
    }
    let field = |(number, name): (u32, &str)| PackedElementField {
        name: name.to_owned(),
        offset: number * size_of::<f32>() as u32,
        r#type: NumericType::Float32.into(),
    };
    PointCloud {
        timestamp: Some(timestamp),
        frame_id: frame_id.to_owned(),
        pose: Some(scene::at_rest()),
        point_stride: 3 * size_of::<f32>() as u32,
        fields: (0..).zip(["x", "y", "z"]).map(field).collect(),
        data,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_layout_names_topics_and_figures_that_there_are() {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy/foxglove/stillroom.json");
        let layout: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
        let shown: Vec<String> = TOPICS.all().iter().map(|topic| format!("\"{}\"", topic.name)).collect();
        let text = layout.to_string();
        let watched = text.split("\"/watch/").skip(1).filter_map(|rest| rest.split('"').next());
        let watched: Vec<String> = watched.map(|name| format!("\"/watch/{name}\"")).collect();
        assert!(watched.len() >= 5 && watched.iter().all(|topic| shown.contains(topic)), "{watched:?}");
        assert!(text.contains("\"watch/robot\"") && FrameNames::under(PREFIX).of("robot") == "watch/robot");
        let metrics =
            prost_types::FileDescriptorSet::decode(&*Schema::of("stillroom.LearnerMetrics").descriptor).unwrap();
        let messages = metrics.file.iter().flat_map(|file| &file.message_type);
        let fields: Vec<&str> =
            messages.flat_map(|message| &message.field).map(prost_types::FieldDescriptorProto::name).collect();
        let figures: Vec<&str> =
            text.split("/learner/metrics.").skip(1).filter_map(|rest| rest.split(['"', '[']).next()).collect();
        assert!(figures.len() >= 5 && figures.iter().all(|figure| fields.contains(figure)), "{figures:?}");
    }

    #[test]
    fn points_lie_where_the_camera_saw_them() {
        let calibration = camera::calibration(Timestamp::default(), "c");
        let mut depth_mm = vec![0; FRAME_SIDE * FRAME_SIDE];
        // The last column that is taken, in the first row: 2 m ahead, far right and up.
        let column = FRAME_SIDE - POINT_EVERY;
        depth_mm[column] = 2000;
        let cloud = points_of(Timestamp::default(), "c", &calibration.k, &depth_mm);
        assert_eq!((cloud.data.len(), cloud.point_stride), (12, 12), "pixels that saw nothing are no points");
        let part = |at: usize| f32::from_le_bytes(cloud.data[4 * at..4 * at + 4].try_into().unwrap());
        // The field of view is 100 degrees: at its edge x is z times the tangent of 50.
        let edge = 2.0 * 50_f32.to_radians().tan();
        let expected = edge * (column as f32 - 111.5) / 112.0;
        assert!((part(0) - expected).abs() < 1e-3 && (part(1) + edge * 111.5 / 112.0).abs() < 1e-3);
        assert_eq!(part(2), 2.0);
    }
}
