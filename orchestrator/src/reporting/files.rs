//! Writing a report down: `report.html`, `report.json`, and `figures/` with each figure as SVG and CSV.

use crate::reporting::gather::Gathered;
use crate::reporting::strips::strips;
use crate::run::identity::unix_now;
use crate::showing::format::{self, counted};
use anyhow::{Context, Result, bail};
use proto::run_folder::write_atomically;
use report::{Made, Options};
use std::collections::BTreeSet;
use std::path::Path;
use wire::fault;

/// Name of the page.
pub const PAGE: &str = "report.html";
/// Name of the numbers.
pub const NUMBERS: &str = "report.json";
/// Folder of the figures.
const FIGURES: &str = "figures";

/// Everything that a call which was killed may have left.
const BEGUN: [&str; 4] = [NUMBERS, "report.json.partial", FIGURES, "report.html.partial"];

/// Refuses a folder that holds something else than a report. One without a page is of a call that was killed, if it
/// holds the numbers, whole or not, and nothing else that is not ours.
pub fn check_free(out: &Path) -> Result<()> {
    let mut names = Vec::new();
    match std::fs::read_dir(out) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        entries => {
            for entry in entries.with_context(|| format!("report folder {}", out.display()))? {
                names.push(entry?.file_name().to_string_lossy().into_owned());
            }
        }
    }
    let has = |name: &str| names.iter().any(|found| found == name);
    let killed = || BEGUN[..2].iter().any(|name| has(name)) && names.iter().all(|name| BEGUN.contains(&name.as_str()));
    if !(names.is_empty() || has(PAGE) || killed()) {
        bail!("{} is not empty, and what it holds is no report: choose another folder with --out", out.display());
    }
    Ok(())
}

fn make_folder(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| refused("create", folder))
}

/// A run may lie where nobody can write.
fn refused(what: &str, path: &Path) -> String {
    format!("cannot {what} {} (--out puts the report somewhere else)", path.display())
}

/// Makes the report on what was gathered and writes it to `out`: the numbers first, by which the folder is known for a
/// report, the page last. An older report there is replaced.
pub fn write(gathered: Gathered, options: &Options, out: &Path) -> Result<Made> {
    check_free(out)?;
    let Gathered { runs, notes } = gathered;
    let made = Made::of(&runs, options, notes)?;
    let (pairs, undrawn) = strips(&runs);
    let made = made.with_episodes(pairs, undrawn);
    let figures = out.join(FIGURES);
    make_folder(out)?;
    let mut written = BTreeSet::new();
    let mut put = |path: &Path, content: &[u8]| {
        written.insert(path.to_path_buf());
        write_atomically(path, content).with_context(|| refused("write", path))
    };
    let mut numbers = serde_json::to_string_pretty(&made.report).context(NUMBERS)?;
    numbers.push('\n');
    put(&out.join(NUMBERS), numbers.as_bytes())?;
    make_folder(&figures)?;
    for figure in made.figures.all() {
        put(&figures.join(format!("{}.svg", figure.name)), figure.svg().as_bytes())?;
        put(&figures.join(format!("{}.csv", figure.name)), figure.csv().as_bytes())?;
    }
    let by = format!(
        "Made {} by stillroom {} from {}.",
        format::date(unix_now()),
        env!("CARGO_PKG_VERSION"),
        counted(runs.len() as u64, "run")
    );
    fault::reach("report.before_page");
    put(&out.join(PAGE), made.page(&by).as_bytes())?;
    // Figures of the report before, which this one does not have.
    for entry in std::fs::read_dir(&figures).with_context(|| figures.display().to_string())? {
        let path = entry?.path();
        let drawn =
            path.extension().is_some_and(|extension| ["svg", "png", "csv"].iter().any(|ours| extension == *ours));
        if drawn && !written.contains(&path) {
            std::fs::remove_file(&path).with_context(|| path.display().to_string())?;
        }
    }
    Ok(made)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_a_reports_or_empty() {
        let temporary = tempfile::tempdir().unwrap();
        let with = |names: &[&str]| {
            let out = temporary.path().join(names.concat());
            std::fs::create_dir_all(&out).unwrap();
            for name in names {
                std::fs::write(out.join(name), "").unwrap();
            }
            check_free(&out)
        };
        check_free(&temporary.path().join("new")).unwrap();
        for ours in [
            &[][..],
            &["report.json.partial"],
            &["report.json", "figures"],
            &["report.json", "figures", "report.html.partial"],
            &["report.html", "report.json", "figures", "of the user's own"],
        ] {
            with(ours).unwrap();
        }
        let file = temporary.path().join("file");
        std::fs::write(&file, "").unwrap();
        assert!(make_folder(&file.join("report")).unwrap_err().to_string().contains("--out puts the report"));
        // Figures alone may be anybody's, and older ones are removed.
        for foreign in [&["figures"][..], &["report.json", "thesis.tex"], &["run.toml"]] {
            assert!(with(foreign).unwrap_err().to_string().contains("no report"), "{foreign:?}");
        }
    }
}
