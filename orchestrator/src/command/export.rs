use crate::command::choice::{Choice, Chosen, nothing_in};
use crate::evaluation::subject::{Source, find};
use crate::output::format::{bytes, counted};
use crate::output::terminal;
use crate::replay::harvest::{Harvest, harvest};
use crate::suite;
use crate::wrong::{demand, demand_folder, reject};
use anyhow::{Context, Result, bail, ensure};
use export::{Policy, Precision};
use proto::dataset::{DatasetRequest, DatasetSetup, PictureKind};
use proto::exit::EXIT_INCOMPLETE;
use proto::run_folder::write_atomically;
use recording::episodes::Recorded;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Write a policy (an ONNX model, or weights alone) or recorded episodes (archives of NumPy) for other programs
///
/// A policy file has all that is needed to let it act. The model takes what environments give (depth in millimetres, goals in metres, the last action, the belief) and
/// gives log-probabilities, values and beliefs. Episodes are simulated again from their recorded actions: so they have
/// depth frames, and pictures if asked for. Nothing is written if any state differs from the recorded one. A page
/// beside the file or in the folder says names, shapes and units. Nothing that is there is replaced.
// It is help for people: names are without backticks.
#[allow(clippy::doc_markdown)]
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  # its newest checkpoint; policy.md says how to use it
  orchestrator export runs/a --out policy.onnx
  # a policy file to hand on
  orchestrator export runs/a/best --half --out policy.safetensors
  orchestrator export runs/a/checkpoints/rollout-00000120.json --out policy.onnx
  orchestrator export EVALUATION --format npz --only success --kitchen 26 \\
    --out arrays
  orchestrator export runs/a/recordings/incarnation-001.000.mcap \\
    --format npz --pictures robot,outside --limit 10 --out arrays

Exit status: 0 if all is written, 1 if nothing is, 6 if episodes are written but the recordings are damaged or not \
complete.")]
pub struct ExportArgs {
    /// A policy: run folder (its newest checkpoint), RUN/best, a checkpoint's manifest, or a policy file. Episodes:
    /// recordings (.mcap), or folders of runs or evaluations
    #[arg(required = true, value_name = "RUN|CHECKPOINT|FILE")]
    subjects: Vec<PathBuf>,
    /// onnx: a model for onnxruntime and others (operators of version 17); safetensors: a policy file, which `eval` and
    /// `play` take: weights under PyTorch's module paths, and the configuration; npz: an archive of NumPy an
    /// episode, of which `python -m stillroom.dataset` makes a LeRobotDataset or Parquet tables [default: as
    /// --out ends, .onnx or .safetensors]
    #[arg(long)]
    format: Option<Format>,
    /// With safetensors: the weights as float16 instead of float32, half the bytes
    #[arg(long)]
    half: bool,
    /// The file, or the folder of episodes
    #[arg(short, long, value_name = "FILE|DIR")]
    out: PathBuf,
    #[command(flatten, next_help_heading = "Episodes")]
    episodes: EpisodeArgs,
}

#[derive(Debug, clap::Args)]
struct EpisodeArgs {
    #[command(flatten)]
    choice: Choice,
    /// Only those of which this metric of the task is 1, e.g. `success_without_disturbance`
    #[arg(long, value_name = "METRIC")]
    only: Option<String>,
    /// At most this many episodes
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    limit: Option<u64>,
    /// Pictures in colour beside the depth frames: what the robot's camera would see, the room from outside
    #[arg(long, value_name = "WHICH,...", value_delimiter = ',')]
    pictures: Vec<Picture>,
    /// Width and height of these pictures, pixels [default: 224]
    #[arg(long, value_parser = clap::value_parser!(u32).range(8..=1024), requires = "pictures")]
    side: Option<u32>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    Onnx,
    Safetensors,
    Npz,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Picture {
    Robot,
    Outside,
}

impl Format {
    /// The one asked for, or as `out` ends.
    fn of(asked: Option<Self>, out: &Path) -> Result<Self> {
        let ending =
            out.extension().and_then(|ending| <Self as clap::ValueEnum>::from_str(ending.to_str()?, false).ok());
        match (asked, ending) {
            (Some(asked), Some(other)) if asked != other => {
                reject!("--out {} ends as another format does: leave out --format, or name it otherwise", out.display())
            }
            (Some(format), _) | (None, Some(format @ (Self::Onnx | Self::Safetensors))) => Ok(format),
            (None, _) => reject!(
                "--out {}: call it policy.onnx (for onnxruntime) or policy.safetensors (PyTorch reads it), or give --format",
                out.display()
            ),
        }
    }
}

impl EpisodeArgs {
    fn is_empty(&self) -> bool {
        self.choice.is_all() && self.only.is_none() && self.limit.is_none() && self.pictures.is_empty()
    }
}

pub fn run(args: &ExportArgs) -> Result<ExitCode> {
    let format = Format::of(args.format, &args.out)?;
    demand!(!args.half || format == Format::Safetensors, "--half is for --format safetensors");
    match format {
        Format::Onnx | Format::Safetensors => export_policy(args, format).map(|()| ExitCode::SUCCESS),
        Format::Npz => export_episodes(args),
    }
}

fn export_policy(args: &ExportArgs, format: Format) -> Result<()> {
    let [subject] = &args.subjects[..] else {
        reject!("a policy is exported from one run or checkpoint, not from {}", args.subjects.len());
    };
    demand!(
        args.episodes.is_empty(),
        "--kitchen, --environment, --episode, --only, --limit and --pictures choose episodes: give --format npz with them"
    );
    let out = &args.out;
    let page = out.with_extension("md");
    free(out)?;
    demand_folder(out)?;
    suite::refuse(subject)?;
    let policy = match find(subject)? {
        Source::Checkpoint(found) => Policy::read(&found.named, &found.manifest, found.config)?,
        Source::File { policy, .. } => *policy,
    };
    if format == Format::Safetensors {
        export::save(&policy, out, if args.half { Precision::Half } else { Precision::Single })?;
    } else {
        demand!(page != *out, "--out {}: the page about the model has this name; call it policy.onnx", out.display());
        free(&page)?;
        let model = export::onnx(&policy)?;
        let name = out.file_name().unwrap_or_default().to_string_lossy();
        write(out, &model)?;
        write(&page, export::guide(&policy, &name).as_bytes())?;
    }
    let size = std::fs::metadata(out).map_or(0, |file| file.len());
    terminal::out(&format!(
        "{}: {}, {}, after {} frames of training",
        out.display(),
        counted(policy.count() as u64, "weight"),
        bytes(size),
        policy.origin.frames
    ));
    if format == Format::Onnx {
        terminal::out(&format!("{} says what it takes and gives", page.display()));
    }
    Ok(())
}

fn export_episodes(args: &ExportArgs) -> Result<ExitCode> {
    // Before recordings are read for minutes.
    free(&args.out)?;
    let EpisodeArgs { choice, only, limit, pictures, side } = &args.episodes;
    let Chosen { recorded, files, incomplete, folder } = choice.gather(&args.subjects)?;
    let Recorded { configs, episodes, config_of, steps, .. } = recorded;
    ensure!(!episodes.is_empty(), "{}", nothing_in(&files, steps));
    let mut kinds: Vec<PictureKind> = pictures
        .iter()
        .map(|picture| match picture {
            Picture::Robot => PictureKind::Robot,
            Picture::Outside => PictureKind::Outside,
        })
        .collect();
    kinds.sort_unstable();
    kinds.dedup();
    let out = std::path::absolute(&args.out)?;
    let setup = DatasetSetup {
        configs,
        folder,
        out: out.to_str().context("--out has a name that is not text")?.to_owned(),
        pictures: kinds,
        side_px: side.unwrap_or(proto::camera::FRAME_SIDE as u32),
        keep: only.clone(),
        limit: *limit,
        episodes: episodes.len() as u64,
    };
    let requests = config_of.into_iter().zip(episodes);
    let requests = requests.map(|(config, recorded)| DatasetRequest { config, recorded }).collect();
    let Harvest { simulated, unfinished, compared, written } = harvest(setup, requests)?;
    let Some([episodes, steps, size]) = written else {
        bail!(
            "none of {} is one to be kept (unfinished: {unfinished}); nothing is written",
            counted(simulated, "episode")
        );
    };
    terminal::out(&format!(
        "{}: {}, {}, {}",
        args.out.display(),
        counted(episodes, "episode"),
        counted(steps, "step"),
        bytes(size)
    ));
    terminal::out(&format!("states compared: {compared}, all as recorded"));
    if unfinished > 0 {
        terminal::out(&format!("left out, because the recording ends before them: {}", counted(unfinished, "episode")));
    }
    terminal::out(&format!("{} says what is in it", args.out.join("README.md").display()));
    if incomplete {
        terminal::note("all that is there is exported, but the recordings are damaged or not complete: see above");
        return Ok(ExitCode::from(EXIT_INCOMPLETE as u8));
    }
    Ok(ExitCode::SUCCESS)
}

fn free(path: &Path) -> Result<()> {
    demand!(!path.exists(), "{} exists; remove it or choose another --out", path.display());
    Ok(())
}

fn write(path: &Path, content: &[u8]) -> Result<()> {
    write_atomically(path, content).with_context(|| format!("{} cannot be written", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As on a full disk: an empty file was in the next call's way.
    #[test]
    fn a_file_that_cannot_be_written_is_not_there() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("policy.onnx");
        std::fs::create_dir_all(folder.path().join("policy.onnx.partial/full")).unwrap();
        assert!(write(&out, b"model").unwrap_err().to_string().ends_with("policy.onnx cannot be written"));
        free(&out).unwrap();
    }
}
