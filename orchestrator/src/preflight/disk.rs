use super::Finding;
use crate::output::format::bytes;
use proto::config::{Config, dqn};
use proto::disk::is_not_offered;
use proto::stage::total_frames;
use rustix::fs::statvfs;
use std::fs::File;
use std::io::{Error, ErrorKind};
use std::path::Path;

/// What must be free beside the checkpoints, bytes: logs, metrics, and the beginning of a recording.
const LEAST: u64 = 256 << 20;
/// A recorded step without its frame, compressed.
const RECORDED_STEP: u64 = 120;
/// A recorded depth frame: zstd, between a level camera (2 KB) and one that looks down (28 KB).
const RECORDED_FRAME: u64 = 20_000;

const STATE: u64 = 64;

const KITCHEN: u64 = 32_000;

/// Fixed episodes, with novel and with seen objects.
const EPISODES_OF_A_KITCHEN: u64 = 720;

/// Frames of an evaluation at most: so many episodes of each kitchen with novel and with seen objects.
fn frames_of(config: &Config, episodes: u32) -> u64 {
    let each = if episodes == 0 { EPISODES_OF_A_KITCHEN } else { 2 * u64::from(episodes) };
    config.kitchens().count().max(1) as u64 * each * u64::from(config.episode.max_steps)
}

/// What a run or an evaluation writes at most, bytes: (checkpoints and kitchens, recordings).
pub fn need(config: &Config) -> (u64, u64) {
    let network = &config.network;
    let inputs = config.spec().inputs().ok();
    let has_frame = inputs.as_ref().is_none_or(|inputs| inputs.frame.is_some());
    let encoder = if has_frame { network.encoder.weights(network.input_pool) } else { 0 };
    let images = inputs.as_ref().map_or(0, |inputs| inputs.images.iter().map(dqn::weights).sum::<u64>());
    // Actor's and critic's.
    let first = inputs.iter().map(|inputs| inputs.width() as u64);
    let widths: Vec<u64> = first.chain(network.mlp.iter().map(|&width| u64::from(width))).collect();
    let layers: u64 = widths.windows(2).map(|pair| 2 * (pair[0] + 1) * pair[1]).sum();
    // The unit and heads grow with the belief.
    let [gates, states] = [network.memory.gates(), network.memory.states()].map(u64::from);
    let behind = if gates > 0 || has_frame { u64::from(network.hidden) } else { widths[widths.len() - 1] };
    let parameters = encoder + images + layers + gates * behind * (behind + 560) + behind * 400;
    let environments = config.environments() as u64;
    // Weights and two moments, beliefs, environment states.
    let state = STATE + u64::from(config.episode.max_steps);
    let checkpoint = parameters * 12 + environments * (states * behind * 4 + state);
    let (kept, frames) = match &config.evaluation {
        // It reads weights where they lie.
        Some(asked) => (0, frames_of(config, asked.episodes)),
        None => (u64::from(config.checkpoint.keep) + config.stages.len() as u64 + 1, total_frames(&config.stages)),
    };
    let frames = frames as f64;
    let recorded_step = RECORDED_STEP as f64 + config.recording.depth_share * RECORDED_FRAME as f64;
    let recordings = if config.recording.enabled { (frames * recorded_step) as u64 } else { 0 };
    let kitchens = config.kitchens.range().map_or(0, |range| u64::from(range.count()) * KITCHEN);
    (checkpoint * kept + kitchens, recordings)
}

pub fn check(config: &Config, folder: &Path) -> Finding {
    let existing = folder.ancestors().find(|folder| folder.exists()).unwrap_or(Path::new("."));
    let existing = if existing.as_os_str().is_empty() { Path::new(".") } else { existing };
    let room = statvfs(existing).map(|status| check_against(config, existing, status.f_bavail * status.f_frsize));
    match room.map_err(Error::from).and_then(|room| try_out(existing).map(|()| room)) {
        Ok(room) => room,
        Err(error) if is_not_offered(&error) => Finding::Problem(format!("{}: {NO_LOCKS}", existing.display())),
        Err(error) if error.kind() == ErrorKind::NotFound => {
            let place = existing.display();
            Finding::Problem(format!(
                "{} cannot be made: {place} holds no files. Choose another folder",
                folder.display()
            ))
        }
        Err(error) => Finding::Problem(format!(
            "{} cannot be made: {} cannot be written to ({error}). Choose another folder",
            folder.display(),
            existing.display()
        )),
    }
}

pub const NO_LOCKS: &str = "this disk has no file locks (flock), which keep two orchestrators from working on one run: put \
                            the run on another disk, or mount this one with locks";

fn try_out(folder: &Path) -> Result<(), Error> {
    let path = folder.join(format!(".stillroom-{}", std::process::id()));
    let file = File::create_new(&path)?;
    std::fs::remove_file(&path)?;
    Ok(file.try_lock()?)
}

fn check_against(config: &Config, folder: &Path, free: u64) -> Finding {
    let (checkpoints, recordings) = need(config);
    let place = folder.display();
    let figures = format!(
        "checkpoints take up to {}, recordings about {}; {} are free at {place}",
        bytes(checkpoints),
        bytes(recordings),
        bytes(free)
    );
    if free < checkpoints + LEAST {
        Finding::Problem(format!(
            "the disk is too full to begin: {figures}, and {} must stay free beside the checkpoints. Free some space, \
             or put the run on another disk",
            bytes(LEAST)
        ))
    } else if free < checkpoints + recordings + LEAST {
        Finding::Warning(format!(
            "the disk may not hold the whole recording: {figures}. A smaller recording.depth_share, or \
             recording.enabled = false, writes less"
        ))
    } else {
        Finding::Good(figures)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::evaluation::{EvaluationConfig, ObjectSet};
    use proto::kitchen::Split;

    #[test]
    fn a_full_disk_is_a_problem_and_a_small_one_a_warning() {
        let paper = Config::resolve("paper", None).unwrap();
        let folder = Path::new("/somewhere");
        // The checkpoints would fit; what must stay free beside them is named, because no other figure explains it.
        let Finding::Problem(text) = check_against(&paper, folder, need(&paper).0 + LEAST - 1) else { panic!("full") };
        assert!(text.contains("and 256 MiB must stay free beside the checkpoints. Free some space"), "{text}");
        assert!(!matches!(check_against(&paper, folder, need(&paper).0 + LEAST), Finding::Problem(_)));
        assert!(matches!(check_against(&paper, folder, 2 << 30), Finding::Warning(_)));
        assert!(matches!(check_against(&paper, folder, 1 << 40), Finding::Good(_)));
        let mut quiet = paper.clone();
        quiet.recording.enabled = false;
        assert!(matches!(check_against(&quiet, folder, 2 << 30), Finding::Good(_)));
    }

    #[test]
    fn an_evaluation_needs_room_for_its_episodes_alone() {
        let mut config = Config::resolve("paper", None).unwrap();
        config.evaluation = Some(EvaluationConfig::fixed(Split::Test, ObjectSet::Novel, 2));
        let (checkpoints, recordings) = need(&config);
        // Twenty episodes of two hundred steps.
        assert_eq!(checkpoints, 0);
        assert!((480_000..100_000_000).contains(&recordings), "{recordings}");
    }

    #[test]
    fn checkpoints_of_two_small_networks_are_small() {
        proto::task::Spec::declare(include_str!("../../../learner/tests/support/numbers.toml")).unwrap();
        let gym = |text: &str| Config::resolve_with("gym", Some((text, "mine.toml"))).unwrap();
        let [none, lstm] =
            ["", "network.memory = \"lstm\""].map(|more| need(&gym(&format!("task = \"numbers\"\n{more}"))).0);
        assert!(none < 2 << 20 && lstm > 8 * none, "{none} {lstm}");
    }

    #[test]
    fn a_place_that_cannot_be_written_to_is_a_problem() {
        let temporary = tempfile::tempdir().unwrap();
        let file = temporary.path().join("file");
        std::fs::write(&file, "").unwrap();
        let demo = Config::resolve("demo", None).unwrap();
        let Finding::Problem(text) = check(&demo, &file.join("run")) else { panic!("a file holds no folder") };
        assert!(text.contains("file cannot be written to (Not a directory"), "{text}");
        let Finding::Problem(text) = check(&demo, Path::new("/proc/run")) else { panic!("there are no files") };
        assert_eq!(text, "/proc/run cannot be made: /proc holds no files. Choose another folder");
    }
}
