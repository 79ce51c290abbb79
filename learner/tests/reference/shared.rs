//! What the script and the tests share: numbers that both make, and how ours are compared with its.

use learner::network::RawFrame;
use proto::camera::{FRAME_PIXELS, FRAME_SIDE};
use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;
use tch::{Kind, Tensor};

/// `noise` of the script.
pub fn noise(name: &str, count: usize) -> Vec<f64> {
    let seed = name.bytes().fold(0x811c_9dc5u32, |hash, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193));
    (0..count as u32)
        .map(|index| {
            let mut x = index.wrapping_mul(0x9e37_79b9).wrapping_add(seed);
            x ^= x >> 16;
            x = x.wrapping_mul(0x85eb_ca6b);
            x ^= x >> 13;
            x = x.wrapping_mul(0xc2b2_ae35);
            x ^= x >> 16;
            f64::from(x) / 2_147_483_648.0 - 1.0
        })
        .collect()
}

pub fn noise_f32(name: &str, count: usize) -> Vec<f32> {
    noise(name, count).into_iter().map(|value| value as f32).collect()
}

pub fn noise_tensor(name: &str, shape: &[i64]) -> Tensor {
    Tensor::from_slice(&noise_f32(name, shape.iter().product::<i64>() as usize)).view(shape)
}

/// `set_weights` of the script.
pub fn weight_values(name: &str, shape: &[i64]) -> Tensor {
    let count = shape.iter().product::<i64>();
    let values: Vec<f32> = noise(name, count as usize)
        .into_iter()
        .map(|value| {
            let fan_in = count / shape[0];
            // A one-dimensional `weight` is the scale of a normalisation.
            let scale = if name.ends_with(".weight") { 1.0 } else { 0.0 };
            if shape.len() > 1 { value * (3.0 / fan_in as f64).sqrt() } else { 0.1 * value + scale }
        })
        .map(|value| value as f32)
        .collect();
    Tensor::from_slice(&values).view(shape)
}

pub fn depth_mm(t: usize, n: usize) -> Box<RawFrame> {
    let tiles = noise(&format!("frame.{t}.{n}"), 28 * 28);
    let mut frame: Box<RawFrame> = vec![0; FRAME_PIXELS].try_into().expect("a frame's pixels");
    for (pixel, depth_mm) in frame.iter_mut().enumerate() {
        let (row, column) = (pixel / FRAME_SIDE, pixel % FRAME_SIDE);
        let tile = ((tiles[row / 8 * 28 + column / 8] + 1.0) * 2048.0).floor();
        *depth_mm = tile as u16 + column as u16;
    }
    frame
}

pub fn goal_m(t: usize, n: usize) -> [f32; 3] {
    let values = noise_f32(&format!("goal.{t}.{n}"), 3);
    [values[0] * 2.0, values[1] * 2.0, values[2] * 2.0]
}

/// What `learner probe` found, and said.
pub struct Probed {
    pub good: bool,
    pub printed: String,
    pub said: String,
    pub found: BTreeMap<String, Tensor>,
}

/// `learner probe` with files of these; `task`: a declaration.
pub fn probe(
    weights: &[(impl AsRef<str>, impl AsRef<Tensor>)],
    batch: &[(impl AsRef<str>, impl AsRef<Tensor>)],
    settings: &str,
    task: Option<&str>,
) -> Probed {
    let folder = tempfile::tempdir().expect("a folder for the files");
    let path = |name: &str| folder.path().join(name);
    Tensor::write_safetensors(weights, path("weights")).expect("weights are written");
    Tensor::write_safetensors(batch, path("batch")).expect("a batch is written");
    std::fs::write(path("config"), settings).expect("settings");
    let mut command = Command::new(env!("CARGO_BIN_EXE_learner"));
    command.args(["probe", "--weights", "weights", "--batch", "batch", "--out", "out", "--config", "config"]);
    if let Some(task) = task {
        std::fs::write(path("task.toml"), task).expect("the task is written");
        command.args(["--preset", "gym", "--task", "task.toml"]);
    }
    let run = command.current_dir(folder.path()).output().expect("the learner starts");
    let [printed, said] = [run.stdout, run.stderr].map(|text| String::from_utf8(text).expect("text"));
    let found = Tensor::read_safetensors(path("out")).unwrap_or_default().into_iter().collect();
    Probed { good: run.status.success(), printed, said, found }
}

pub fn fixture(name: &str) -> BTreeMap<String, Tensor> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/reference").join(format!("{name}.safetensors"));
    Tensor::read_safetensors(&path).expect("the fixture is committed").into_iter().collect()
}

pub fn doubles(tensor: &Tensor) -> Vec<f64> {
    Vec::<f64>::try_from(tensor.detach().to_kind(Kind::Double).contiguous().view(-1)).expect("numbers")
}

#[track_caller]
pub fn assert_close(what: &str, ours: &Tensor, theirs: &Tensor, tolerance: f64) {
    assert_eq!(ours.size(), theirs.size(), "{what}");
    let theirs = doubles(theirs);
    let scale = theirs.iter().fold(0f64, |scale, value| scale.max(value.abs())).max(1e-12);
    for (index, (a, b)) in doubles(ours).iter().zip(&theirs).enumerate() {
        assert!((a - b).abs() <= tolerance * scale, "{what}[{index}]: {a} is not {b}, scale {scale}");
    }
}

/// Compares named tensors with the script's `probes`: norms, and products with noise.
#[track_caller]
pub fn assert_probes(named: &BTreeMap<String, Tensor>, probes: &Tensor, tolerance: f64) {
    let probes = doubles(probes);
    assert_eq!(named.len() * 2, probes.len());
    for ((name, tensor), probe) in named.iter().zip(probes.chunks(2)) {
        let values = doubles(tensor);
        let norm = values.iter().map(|v| v * v).sum::<f64>().sqrt();
        let product: f64 = values.iter().zip(noise(&format!("probe.{name}"), values.len())).map(|(a, b)| a * b).sum();
        assert!((norm - probe[0]).abs() <= tolerance * probe[0], "norm of {name}: {norm} is not {}", probe[0]);
        assert!((product - probe[1]).abs() <= tolerance * probe[0], "{name}: {product} is not {}", probe[1]);
    }
}
