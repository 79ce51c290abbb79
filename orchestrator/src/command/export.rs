//! `orchestrator export`: a policy for other programs.

use crate::evaluation::subject::find;
use crate::showing::format::{bytes, counted};
use crate::showing::terminal;
use anyhow::{Context, Result, ensure};
use export::Policy;
use std::path::{Path, PathBuf};

/// Write a policy for other programs: an ONNX model, or its weights alone
///
/// The model takes what environments give (depth in millimetres, goals in metres, the last action, the belief) and
/// gives log-probabilities, values and beliefs; a page beside it says inputs, outputs and units. Nothing that
/// is there is replaced.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  orchestrator export runs/a --out policy.onnx               its newest checkpoint; policy.md says how to use it
  orchestrator export runs/a/best --format safetensors --out policy.safetensors
  orchestrator export runs/a/checkpoints/rollout-00000120.json --out policy.onnx")]
pub struct ExportArgs {
    /// Run folder (its newest checkpoint), RUN/best, or a checkpoint's manifest
    #[arg(value_name = "RUN|CHECKPOINT")]
    subject: PathBuf,
    /// onnx: a model for onnxruntime and others (operators of version 17); safetensors: the weights, float32, under
    /// PyTorch's module paths
    #[arg(long, default_value = "onnx")]
    format: Format,
    /// The file
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    Onnx,
    Safetensors,
}

/// Runs the command.
pub fn run(args: &ExportArgs) -> Result<()> {
    let out = &args.out;
    let page = out.with_extension("md");
    free(out)?;
    let found = find(&args.subject)?;
    let policy = Policy::read(&found.manifest, found.config)?;
    match args.format {
        Format::Safetensors => policy.save(out)?,
        Format::Onnx => {
            ensure!(
                page != *out,
                "--out {}: the page about the model has this name; call it policy.onnx",
                out.display()
            );
            free(&page)?;
            let model = export::onnx(&policy)?;
            let name = out.file_name().unwrap_or_default().to_string_lossy();
            write(&page, export::guide(&policy, &name).as_bytes())?;
            write(out, &model)?;
        }
    }
    let size = std::fs::metadata(out).map_or(0, |file| file.len());
    terminal::out(&format!(
        "{}: {}, {}, after {} frames of training",
        out.display(),
        counted(policy.count() as u64, "weight"),
        bytes(size),
        policy.manifest.frames
    ));
    if args.format == Format::Onnx {
        terminal::out(&format!("{} says what it takes and gives", page.display()));
    }
    Ok(())
}

fn free(path: &Path) -> Result<()> {
    ensure!(!path.exists(), "{} exists; remove it or choose another --out", path.display());
    Ok(())
}

fn write(path: &Path, content: &[u8]) -> Result<()> {
    std::fs::write(path, content).with_context(|| format!("{} cannot be written", path.display()))
}
