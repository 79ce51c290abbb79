use super::unclaimed::{UnclaimedEvaluation, evaluation, is_of, same_run};
use crate::run::identity::Identity;
use crate::run::lock::{LockState, holder, state_of};
use crate::run::scenes::config_by_content;
use crate::training::means::by_stage;
use crate::training::metrics::Figures;
use crate::training::scores::{Score, Scores, evaluations_below};
use crate::training::summary::Summary;
use crate::wrong::reject;
use anyhow::{Context, Result, bail};
use proto::config::{Config, StageConfig};
use proto::evaluation::{RESULT_FILE, Subject};
use proto::run_folder::{Item, RunFolder};
use proto::run_state::{Ending, RunState};
use proto::task::Spec;
use proto::trained::{History, Trained};
use report::study::{Evaluated, Origin, Rollout, Run, Validated, experiment};
use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

const DEPTH: usize = 3;

/// Of weights.
const DIGITS: usize = 12;

pub struct Gathered {
    pub runs: Vec<Run>,
    pub notes: Vec<String>,
}

struct Given {
    place: PathBuf,
    id: String,
    run: Run,
}

impl Given {
    /// Whether weights that were evaluated are this run's: by its id, whatever folder it was in then. An evaluation of
    /// an older version names no id, so the folder must be the same, and what was trained in it.
    fn trained(&self, subject: &Subject) -> bool {
        if let Some(id) = &subject.run_id {
            return *id == self.id;
        }
        let place = subject.run.as_ref().and_then(|run| std::fs::canonicalize(run).ok());
        place.as_deref() == Some(&self.place) && is_of(subject, &self.run.config)
    }
}

/// The runs meant by `paths`: run folders, evaluation folders, or folders that hold runs. Evaluations of a given run
/// are attached to it. Other evaluations are grouped by their run, or by their weights if these are untrained. A folder
/// that cannot be read becomes a note, as long as there is another; so does a run whose experiment and seed another one
/// has, unless it is one of `named`.
pub fn gather(paths: &[PathBuf], named: &[PathBuf]) -> Result<Gathered> {
    let mut runs: Vec<Given> = Vec::new();
    let mut unclaimed: Vec<UnclaimedEvaluation> = Vec::new();
    let mut notes = Vec::new();
    for path in paths {
        let (mut found, before) = (Vec::new(), notes.len());
        if let Err(error) = look(&RunFolder::new(path), DEPTH, &mut found, &mut notes) {
            notes.push(left_out(path, &error));
        }
        if found.is_empty() && notes.len() == before {
            reject!("{} {}", path.display(), no_run(path)?);
        }
        for folder in found {
            let root = folder.root();
            let place = std::fs::canonicalize(root).with_context(|| root.display().to_string())?;
            if runs.iter().any(|known| known.place == place) || unclaimed.iter().any(|known| known.place == place) {
                continue;
            }
            let read = if folder.has(&root.join(RESULT_FILE)) {
                UnclaimedEvaluation::read(&folder, place).map(|read| unclaimed.push(read))
            } else {
                run(&folder, &mut notes).map(|(id, run)| runs.push(Given { place, id, run }))
            };
            if let Err(error) = read {
                notes.push(left_out(root, &error));
            }
        }
    }
    if runs.is_empty() && unclaimed.is_empty() {
        bail!("there is nothing to report on. {}", notes.join(" "));
    }
    let mut alone: Vec<Run> = Vec::new();
    for one in unclaimed {
        if let Some(known) = runs.iter_mut().find(|known| known.trained(&one.evaluated.result.subject)) {
            // Its own evaluations are known already.
            if !one.place.starts_with(&known.place) {
                known.run.evaluations.push(one.evaluated);
            }
            continue;
        }
        let one = one.alone();
        match alone.iter_mut().find(|known| same_run(known, &one)) {
            Some(known) => {
                // What they have in common is their run, or their weights.
                let Subject { run, checkpoint, weights, .. } = known.evaluations[0].result.subject.clone();
                known.name = run.or(checkpoint).unwrap_or_else(|| weights.chars().take(DIGITS).collect());
                known.evaluations.extend(one.evaluations);
            }
            None => alone.push(one),
        }
    }
    let runs = one_of_a_seed(runs.into_iter().map(|known| known.run).chain(alone).collect(), named, &mut notes);
    Ok(Gathered { runs, notes })
}

/// Each experiment with each seed once: its complete run, else the longest, else the newest. All that are `named` stay.
fn one_of_a_seed(runs: Vec<Run>, named: &[PathBuf], notes: &mut Vec<String>) -> Vec<Run> {
    let named: Vec<PathBuf> = named.iter().filter_map(|path| std::fs::canonicalize(path).ok()).collect();
    let rank = |run: &Run| {
        let is_named = std::fs::canonicalize(&run.name).is_ok_and(|place| named.contains(&place));
        let is_complete = run.origin == Origin::Run(RunState::Ended(Ending::Complete));
        let frames = run.rollouts.last().map_or(0, |rollout| rollout.frames);
        let begun_unix_s = Identity::read(&RunFolder::new(&run.name)).map_or(0, |identity| identity.created_unix_s);
        (is_named, is_complete, frames, begun_unix_s)
    };
    let known: Vec<_> = runs.iter().map(|run| (experiment(run), rank(run), run.name.clone())).collect();
    let kept = runs.into_iter().enumerate().filter(|(index, run)| {
        let (experiment, (is_named, ..), name) = &known[*index];
        let same = known.iter().enumerate().filter(|(_, (other, ..))| other == experiment);
        let best = same.max_by_key(|(index, (_, rank, _))| (rank, Reverse(*index)));
        let Some((_, (.., best))) = best.filter(|(best, _)| best != index && !is_named) else { return true };
        notes.push(format!(
            "{name} is left out: {best} is the same experiment with the same seed {}. Of such runs a complete one counts, \
             else the longest, else the newest.",
            run.config.seed
        ));
        false
    });
    kept.map(|(_, run)| run).collect()
}

fn no_run(folder: &Path) -> Result<&'static str> {
    if !folder.exists() {
        return Ok("does not exist; `orchestrator list` shows the runs that there are");
    }
    let folder = RunFolder::new(folder);
    let evaluates = folder.identity().exists() && Config::of_run(&folder)?.evaluation.is_some();
    Ok(if evaluates {
        "is an evaluation without a result: it goes on still, or was stopped before its end (`orchestrator status` tells)"
    } else {
        "is no run and holds none (a run has a run.toml)"
    })
}

fn left_out(folder: &Path, error: &anyhow::Error) -> String {
    format!("{} is left out: {error:#}.", folder.display())
}

/// Run and evaluation folders at or below `folder`; folders inside a run are not searched. Unreadable folders become
/// notes.
fn look(folder: &RunFolder, depth: usize, found: &mut Vec<RunFolder>, notes: &mut Vec<String>) -> Result<()> {
    let items = folder.list(folder.root())?;
    let has = |path: PathBuf| items.iter().any(|item| !item.is_folder && item.path == path);
    let has_result = has(folder.root().join(RESULT_FILE));
    if has_result || has(folder.identity()) {
        // A run.toml whose configuration holds an evaluation is one without a result.
        if has_result || Config::of_run(folder)?.evaluation.is_none() {
            found.push(folder.clone());
        }
        return Ok(());
    }
    for Item { path, is_folder, .. } in items.iter().filter(|_| depth > 0) {
        if !is_folder && path.is_dir() {
            notes.push(format!("{} is left out: it is a link, name the folder itself.", path.display()));
        }
        if let Some(name) = path.file_name().filter(|_| *is_folder)
            && let Err(error) = look(&folder.within(name), depth - 1, found, notes)
        {
            notes.push(left_out(path, &error));
        }
    }
    Ok(())
}

fn run(folder: &RunFolder, notes: &mut Vec<String>) -> Result<(String, Run)> {
    let path = folder.root();
    let identity = Identity::read(folder)?;
    let summary = Summary::read(folder).unwrap_or_else(|error| {
        notes.push(format!("{error:#}."));
        None
    });
    let (config, held) = (config_by_content(folder)?, holder(folder)?);
    let at_rest = held == LockState::Free;
    let Figures { history, notes: about_figures } = Figures::read(folder, at_rest);
    let Scores { scores, notes: about_scores } = Scores::read(folder, config.spec(), at_rest);
    notes.extend(about_figures.into_iter().chain(about_scores).map(|note| format!("{}: {note}.", path.display())));
    let config = config_by_content(folder)?;
    let means = by_stage(&config.stages, &history);
    let newest_tenth = |stage: &StageConfig| {
        let of_stage = means.iter().find(|means| means.name == stage.name);
        of_stage.map(|means| means.last_tenth.with_return()).unwrap_or_default()
    };
    let run = Run {
        name: path.display().to_string(),
        origin: Origin::Run(state_of(&identity, &held, summary.is_some())),
        rollouts: rollouts(&history),
        stages: config.stages.iter().map(newest_tenth).collect(),
        evaluations: evaluations_of(config.spec(), folder, notes)?,
        validation: validation_of(&scores),
        config,
    };
    Ok((identity.id, run))
}

fn rollouts(history: &History) -> Vec<Rollout> {
    // The number of the next rollout and the frames before it.
    let (mut next, mut before, mut elapsed_s) = (0, 0, 0.0);
    let rollout = |trained: &Trained| {
        let took_s = trained.timing.total_s();
        elapsed_s += took_s;
        // A rollout can be missing; how many frames the one after it had is not known then.
        let is_known = took_s > 0.0 && trained.rollout == next;
        let frames_per_s = is_known.then(|| trained.frames.saturating_sub(before) as f64 / took_s);
        (next, before) = (trained.rollout.saturating_add(1), trained.frames);
        Rollout { frames: trained.frames, frames_per_s, elapsed_s, metrics: trained.metrics.clone() }
    };
    history.iter().map(rollout).collect()
}

fn validation_of(scores: &[Score]) -> Vec<Validated> {
    let validated = |score: &Score| {
        let Score { frames, distribution, figures, .. } = score;
        Validated { frames: *frames, distribution: *distribution, figures: figures.clone() }
    };
    let by_frames: BTreeMap<u64, Validated> = scores.iter().map(|score| (score.frames, validated(score))).collect();
    by_frames.into_values().collect()
}

fn evaluations_of(spec: &Spec, folder: &RunFolder, notes: &mut Vec<String>) -> Result<Vec<Evaluated>> {
    let mut evaluations = Vec::new();
    let mut about = Vec::new();
    let below = evaluations_below(folder, &mut about)?;
    notes.extend(about.iter().map(|note| format!("{}: {note}.", folder.root().display())));
    for one in below {
        match evaluation(spec, &one) {
            Ok(read) => evaluations.push(read),
            Err(error) => notes.push(left_out(one.root(), &error)),
        }
    }
    Ok(evaluations)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluation::testing::{played, result_of};
    use proto::config::FromConfig;
    use proto::evaluation::{
        Distribution, Evaluation, EvaluationConfig, ObjectSet, TABLE_FILE, category_of, write_table,
    };
    use proto::event::Timing;
    use proto::kitchen::{KitchenId, Split};
    use report::study::{StudyError, groups};
    use report::{Options, Report};

    fn gather(paths: &[PathBuf]) -> Result<Gathered> {
        super::gather(paths, paths)
    }

    /// A folder, and the paths in it.
    fn place() -> (tempfile::TempDir, impl Fn(&str) -> PathBuf) {
        let temporary = tempfile::tempdir().unwrap();
        let root = temporary.path().to_owned();
        (temporary, move |name| root.join(name))
    }

    #[test]
    fn a_seed_that_a_folder_has_twice_counts_once_unless_both_are_named() {
        let (_temporary, at) = place();
        begin(&at("runs/a"), |_| {});
        begin(&at("runs/b"), |_| {});
        let below = gather(&[at("runs")]).unwrap();
        assert_eq!((below.runs.len(), below.notes.len()), (1, 1), "{:?}", below.notes);
        for [named, other] in [["a", "b"], ["b", "a"]].map(|names| names.map(|name| at(&format!("runs/{name}")))) {
            let gathered = gather(&[at("runs"), named.clone()]).unwrap();
            assert_eq!(gathered.runs[0].name, named.display().to_string());
            let note = format!("{} is left out: {} is the same experiment", other.display(), named.display());
            assert!(gathered.notes[0].starts_with(&note), "{:?}", gathered.notes);
        }
        let both = gather(&[at("runs/a"), at("runs/b")]).unwrap();
        assert!(matches!(groups(&both.runs), Err(StudyError::SameSeed { .. })));

        // Neither is named: the newest, but the longest before it, but the complete one before that.
        let folder = RunFolder::new(at("runs/b"));
        let identity = Identity::read(&folder).unwrap();
        Identity { created_unix_s: identity.created_unix_s + 9, ..identity }.write(&folder).unwrap();
        let mut runs = both.runs;
        let counts = |runs: &[Run]| Path::new(&one_of_a_seed(runs.to_vec(), &[], &mut vec![])[0].name).ends_with("b");
        assert!(counts(&runs));
        runs[0].rollouts = vec![Rollout { frames: 9, ..Rollout::default() }];
        assert!(!counts(&runs));
        runs[1].origin = Origin::Run(RunState::Ended(Ending::Complete));
        assert!(counts(&runs));
    }

    /// An evaluation's folder: one episode, weights that are named by a letter.
    fn evaluate(folder: &Path, split: Split, run: Option<&Path>, weights: &str) {
        let asked = EvaluationConfig::fixed(split, ObjectSet::Novel, 1);
        let mut config =
            Config { evaluation: Some(asked.clone()), seed: 77, ..Config::resolve("recipe", None).unwrap() };
        config.actors.count = 5;
        let novel = (0..12).find(|&episode| ObjectSet::Novel.contains(category_of(episode))).unwrap();
        let record = played(KitchenId::of_split(split)[0], novel, &["success", "picked_up"]);
        let subject = Subject {
            preset: config.preset.clone(),
            seed: 3,
            run: run.map(|run| run.display().to_string()),
            frames: 9,
            weights: weights.repeat(64),
            ..Subject::default()
        };
        let spec = config.spec();
        let mut result = result_of(&config, &asked, &record);
        result.subject = subject;
        std::fs::create_dir_all(folder).unwrap();
        std::fs::write(folder.join(RESULT_FILE), serde_json::to_string(&result).unwrap()).unwrap();
        std::fs::write(folder.join(TABLE_FILE), write_table(spec, &[record], Distribution::Fixed)).unwrap();
        std::fs::write(folder.join("config.toml"), config.to_toml()).unwrap();
    }

    /// Changes the result in an evaluation's folder.
    fn change(folder: &Path, change: impl FnOnce(&mut Evaluation)) {
        let path = folder.join(RESULT_FILE);
        let mut result: Evaluation = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
        change(&mut result);
        std::fs::write(path, serde_json::to_string(&result).unwrap()).unwrap();
    }

    /// An evaluation after that many frames, made after all before.
    fn evaluate_after(folder: &Path, run: &Path, weights: &str, frames: u64) {
        evaluate(folder, Split::Test, Some(run), weights);
        change(folder, |result| (result.subject.frames, result.cost.at_unix_s) = (frames, 1_000_000 - frames));
    }

    #[test]
    fn of_several_checkpoints_of_a_run_the_newest_counts_and_the_others_are_named() {
        let (_temporary, at) = place();
        begin(&at("run"), |_| {});
        // The older one was evaluated last.
        for (name, weights, frames) in [("of/b-new", "b", 900), ("of/a-old", "a", 400)] {
            evaluate_after(&at(name), &at("run"), weights, frames);
        }
        evaluate_after(&at("gone/b-new"), &at("removed"), "b", 900);
        evaluate_after(&at("gone/a-old"), &at("removed"), "a", 400);
        for paths in [vec![at("of")], vec![at("run"), at("of")], vec![at("gone")]] {
            let gathered = gather(&paths).unwrap();
            assert_eq!((gathered.runs.len(), gathered.runs[0].evaluations.len()), (1, 2), "{paths:?}");
            let run = at(if paths[0].ends_with("gone") { "removed" } else { "run" });
            assert_eq!(gathered.runs[0].name, run.display().to_string());
            let report = Report::of(&gathered.runs, &Options::default(), Vec::new()).unwrap();
            let seed = &report.groups[0].results[0].seeds[0];
            assert_eq!((seed.evaluation.as_str(), seed.frames), ("b-new", 900));
            let left_out = report.notes.iter().find(|note| note.contains("Left out: a-old of "));
            assert!(left_out.is_some_and(|note| note.ends_with("after 400 frames, 1 episode.")), "{:?}", report.notes);
        }
        // Of a policy file no run is known; that there was one is.
        evaluate(&at("file"), Split::Test, None, "c");
        change(&at("file"), |result| result.subject.checkpoint = Some("/w/a.safetensors".to_owned()));
        assert_eq!(gather(&[at("file")]).unwrap().runs[0].origin, Origin::Policy("a.safetensors".to_owned()));
        // One alone stands for its run, however old.
        let gathered = gather(&[at("of/a-old")]).unwrap();
        let report = Report::of(&gathered.runs, &Options::default(), Vec::new()).unwrap();
        assert_eq!(report.groups[0].results[0].seeds[0].frames, 400);
        assert!(!report.notes.iter().any(|note| note.contains("Left out")));
        // What its run trained is not known here, which is not that it trained nothing.
        assert_eq!(report.groups[0].runs[0].frames, 400);
        assert_eq!(report.groups[0].runs[0].state, Origin::NotGiven);
        // Two runs that had the same folder one after the other are two.
        begin(&at("run"), |config| config.ppo.clip = 0.3);
        let mut other = gather(&[at("of/a-old")]).unwrap();
        other.runs.extend(gathered.runs);
        assert!(!same_run(&other.runs[0], &other.runs[1]));
    }

    #[test]
    fn an_evaluation_is_of_the_run_whose_id_it_names_not_of_the_folder() {
        let (_temporary, at) = place();
        begin(&at("run"), |_| {});
        evaluate(&at("of"), Split::Test, Some(&at("run")), "a");
        change(&at("of"), |result| result.subject.run_id = RunFolder::new(at("run")).id());
        let found = |run: &str| -> Vec<(Origin, usize)> {
            let gathered = gather(&[at(run), at("of")]).unwrap();
            gathered.runs.into_iter().map(|run| (run.origin, run.evaluations.len())).collect()
        };
        let given = Origin::Run(RunState::NotStarted);
        assert_eq!(found("run"), [(given.clone(), 1)]);
        std::fs::rename(at("run"), at("moved")).unwrap();
        assert_eq!(found("moved"), [(given.clone(), 1)]);
        // The same preset and seed, and yet another run.
        begin(&at("run"), |_| {});
        assert_eq!(found("run"), [(given, 0), (Origin::Unknown, 1)]);
    }

    /// A run's folder without anything trained.
    fn begin(folder: &Path, change: impl FnOnce(&mut Config)) {
        let mut config = Config { seed: 3, ..Config::resolve("recipe", None).unwrap() };
        change(&mut config);
        std::fs::create_dir_all(folder).unwrap();
        let folder = RunFolder::new(folder);
        Identity::new().unwrap().write(&folder).unwrap();
        std::fs::write(folder.config(), config.to_toml()).unwrap();
    }

    /// Groups with the names of the paper's rows that list them.
    fn rows(gathered: &Gathered) -> Vec<String> {
        let report = Report::of(&gathered.runs, &Options::default(), Vec::new()).unwrap();
        let rows = report.comparisons.iter().flat_map(|table| &table.rows);
        rows.filter(|row| !row.ours.is_empty()).map(|row| row.preset.clone()).collect()
    }

    #[test]
    fn evaluations_of_the_same_weights_are_one() {
        let (_temporary, at) = place();
        for (split, name) in [(Split::Test, "test"), (Split::Validation, "validation")] {
            evaluate(&at(&format!("fresh/{name}")), split, None, "a");
            evaluate(&at(&format!("trained/{name}")), split, Some(&at("gone")), "b");
        }
        let gathered = gather(&[at("fresh"), at("trained")]).unwrap();
        let origins: Vec<(&Origin, usize)> =
            gathered.runs.iter().map(|run| (&run.origin, run.evaluations.len())).collect();
        assert_eq!(origins, [(&Origin::Untrained, 2), (&Origin::Unknown, 2)]);
        assert_eq!(groups(&gathered.runs).unwrap().len(), 2);
        assert_eq!(gathered.runs[0].name, "a".repeat(12), "not the folder of one of them");
        // The training of these weights is unknown, so they match no row of the paper, and the report says so.
        assert!(rows(&gathered).is_empty(), "{:?}", rows(&gathered));
        let report = Report::of(&gathered.runs, &Options::default(), Vec::new()).unwrap();
        assert!(report.notes.iter().any(|note| note.contains("give its folder, too")), "{:?}", report.notes);
        assert_eq!(report.groups[1].results.len(), 2, "what was evaluated is shown");
    }

    #[test]
    fn how_weights_were_trained_stands_in_their_runs_folder() {
        let (_temporary, at) = place();
        begin(&at("plain"), |_| {});
        begin(&at("continued"), |config| {
            let checkpoint = "/x/checkpoints/rollout-00000001.json".to_owned();
            config.from = Some(FromConfig { checkpoint, frames: 9, weights: "0".repeat(64), stages: vec![] });
        });
        begin(&at("own"), |config| config.scenes = vec!["scenes/000/scene.toml".into()]);
        begin(&at("replaced"), |config| config.seed = 4);
        for (run, letter) in [("plain", "a"), ("continued", "b"), ("own", "c"), ("replaced", "d")] {
            evaluate(&at(&format!("of/{run}")), Split::Test, Some(&at(run)), letter);
        }
        for (run, row) in [("plain", true), ("continued", false), ("own", false), ("replaced", false)] {
            let gathered = gather(&[at(&format!("of/{run}"))]).unwrap();
            assert_eq!(rows(&gathered), if row { &["disturb-two-stage"][..] } else { &[] }, "{run}");
            assert_eq!(gathered.runs[0].origin == Origin::Unknown, run == "replaced");
        }
        // Given, it is the run's.
        let gathered = gather(&[at("plain"), at("of/plain")]).unwrap();
        assert_eq!((gathered.runs.len(), gathered.runs[0].evaluations.len()), (1, 1));
    }

    /// In every run folder the copies of scenes have the same names.
    #[test]
    fn runs_in_different_scenes_are_different_experiments() {
        let (_temporary, at) = place();
        for (name, seed, text) in [("bath-3", 3, "a bath"), ("hall-3", 3, "a hall"), ("hall-4", 4, "a hall")] {
            begin(&at(name), |config| (config.seed, config.scenes) = (seed, vec!["scenes/000/scene.toml".into()]));
            let scene = RunFolder::new(at(name)).scene(0);
            std::fs::create_dir_all(&scene).unwrap();
            std::fs::write(scene.join("scene.toml"), text).unwrap();
        }
        let gathered = gather(&["bath-3", "hall-3", "hall-4"].map(at)).unwrap();
        let groups = groups(&gathered.runs).unwrap();
        let seeds: Vec<_> = groups.iter().map(|group| (group.label.as_str(), group.runs.len())).collect();
        assert_eq!(seeds, [("bath-3", 1), ("hall", 2)]);
        assert_ne!(groups[0].differences, groups[1].differences, "what tells them apart is said");
    }

    #[test]
    fn throughput_is_of_a_rollout_and_time_of_all_until_then() {
        let mut history = History::default();
        for (rollout, frames) in [(0, 100), (1, 300), (3, 900), (4, 1000)] {
            let timing = Timing { simulate_s: 1.0, infer_s: 0.5, update_s: 2.0, exchange_s: 0.0, other_s: 0.5 };
            history.insert(Trained { rollout, frames, incarnation: 1, timing, ..Trained::default() });
        }
        let rollouts = rollouts(&history);
        // The third rollout is missing: how many of the frames until the fourth were its own is unknown.
        let rates: Vec<_> = rollouts.iter().map(|rollout| rollout.frames_per_s).collect();
        assert_eq!(rates, [Some(25.0), Some(50.0), None, Some(25.0)]);
        assert!(rollouts.iter().map(|rollout| rollout.elapsed_s).eq([4.0, 8.0, 12.0, 16.0]));
    }
}
