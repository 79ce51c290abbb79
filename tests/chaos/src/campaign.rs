//! Cases one after another, until as many faults have happened as are wanted, each compared with an undisturbed run of
//! its configuration.

use crate::case_folder::{CaseFolder, Medium};
use crate::evaluation::{self, Evaluated};
use crate::fault::{Case, Fate, Fault};
use crate::privileges::Privileges;
use crate::run_kind::{Kind, RUN_KINDS, RunKind, python};
use crate::suite::{self, Done};
use crate::tally::Tally;
use crate::training::{self, Complete};
use anyhow::{Context, Result, anyhow, bail};
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

/// After so many cases with differences the rest would say nothing new.
const FAILURES_MAX: usize = 20;

/// Let faults happen to small runs, and compare what they leave with undisturbed ones
///
/// What happens follows from the seed and the case's number. Weights, frames, summary, metrics, validations, tables,
/// recorded steps and what is left behind are compared. The exit status is 0 if nothing differs and as many faults have
/// happened as were wanted.
#[derive(Debug, Clone, clap::Args)]
pub struct Campaign {
    /// Seed of all that happens
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Faults that have to happen
    #[arg(long, default_value_t = 200)]
    faults: u64,
    /// No case begins after so many minutes
    #[arg(long, default_value_t = 30)]
    minutes: u64,
    /// Only the case of this number; its files are kept
    #[arg(long)]
    case: Option<u32>,
    /// Cases at once
    #[arg(long, default_value_t = 2)]
    jobs: u32,
    /// Only cases in which a fault of such a class is planned, as `power failure`
    #[arg(long, value_name = "CLASS")]
    only: Option<String>,
}

/// Among so many cases every class of faults occurs.
const FIRST_CASES: u32 = 400;

/// An undisturbed run of a shape.
enum Reference {
    Training(Box<Complete>),
    Evaluation(Evaluated),
    Suite(Done),
}

struct Queue {
    next: u32,
    tally: Tally,
    passed: u64,
    failed: Vec<u32>,
    /// An undisturbed run has failed.
    broken: bool,
}

struct Work<'a> {
    campaign: &'a Campaign,
    root: PathBuf,
    privileges: Privileges,
    begun: Instant,
    /// By the place of the shape among [`RUN_KINDS`]: made when it is first needed.
    references: Vec<OnceLock<Result<Reference, String>>>,
    queue: Mutex<Queue>,
}

impl Campaign {
    /// Runs it; whether all is as it should be.
    pub fn run(&self) -> Result<bool> {
        if let Some(class) = self.only.as_ref().filter(|_| !(0..FIRST_CASES).any(|number| self.is_wanted(number))) {
            let faults = (0..FIRST_CASES).flat_map(|number| Case::draw(self.seed, number).faults);
            let classes: BTreeSet<_> = faults.map(|planned| planned.fault.class()).collect();
            bail!("no class of faults is called `{class}`; there are: {}", Vec::from_iter(classes).join("; "));
        }
        let temporary = tempfile::Builder::new().prefix("chaos-").tempdir().context("a temporary folder")?;
        let work = Work {
            campaign: self,
            root: temporary.path().to_path_buf(),
            privileges: Privileges::probe(),
            begun: Instant::now(),
            references: RUN_KINDS.iter().map(|_| OnceLock::new()).collect(),
            queue: Mutex::new(Queue { next: 0, tally: Tally::default(), passed: 0, failed: vec![], broken: false }),
        };
        if !work.privileges.mounts {
            println!("full disks and a full /dev/shm are skipped: this user may not mount file systems");
        }
        if python().is_none() {
            println!(
                "runs with an environment of Python are left out: STILLROOM_TEST_PYTHON names none with the package"
            );
        }
        if !work.privileges.disks {
            println!("power failures are skipped: this user may not mount a disk (mkfs.ext4, loop devices)");
        }
        std::thread::scope(|scope| {
            for _ in 0..if self.case.is_some() { 1 } else { self.jobs } {
                scope.spawn(|| work.go());
            }
        });
        let all_is_well = work.report();
        let is_kept = self.case.is_some() || !work.queue().failed.is_empty();
        if is_kept {
            println!("files: {}", temporary.keep().display());
        }
        Ok(all_is_well)
    }

    fn is_wanted(&self, number: u32) -> bool {
        let case = Case::draw(self.seed, number);
        let is_of = |class: &String| case.faults.iter().any(|planned| planned.fault.class().contains(class.as_str()));
        case.shape.is_possible() && self.only.as_ref().is_none_or(is_of)
    }
}

impl Work<'_> {
    fn queue(&self) -> std::sync::MutexGuard<'_, Queue> {
        // What is counted stays right whoever panics.
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// One case after another.
    fn go(&self) {
        while let Some(number) = self.take() {
            let case = Case::draw(self.campaign.seed, number);
            let begun = Instant::now();
            let mut tally = Tally::default();
            let outcome = self.case(&case, &mut tally);
            let seconds = begun.elapsed().as_secs_f64();
            let mut queue = self.queue();
            queue.tally.absorb(&tally);
            let so_far = queue.tally.total(Fate::Landed);
            let happened = tally.total(Fate::Landed);
            match outcome {
                Ok(starts) => {
                    queue.passed += 1;
                    println!(
                        "case {number:4}  good    {:32} {happened} faults, {starts} starts, {seconds:.1} s ({so_far} so far)",
                        case.shape.name
                    );
                }
                Err(error) => {
                    queue.failed.push(number);
                    println!("case {number:4}  FAILED  {:32} {happened} faults, {seconds:.1} s", case.shape.name);
                    for planned in &case.faults {
                        println!("           {planned}");
                    }
                    println!("           {error:#}");
                    println!("           files: {}", self.folder(number).display());
                    println!("           again: make chaos ARGS=\"--seed {} --case {number}\"", self.campaign.seed);
                }
            }
        }
    }

    /// The number of the next case; none if enough has happened.
    fn take(&self) -> Option<u32> {
        let mut queue = self.queue();
        if let Some(only) = self.campaign.case {
            return (std::mem::replace(&mut queue.next, u32::MAX) != u32::MAX).then_some(only);
        }
        let over = queue.broken
            || self.begun.elapsed() >= Duration::from_mins(self.campaign.minutes)
            || queue.tally.total(Fate::Landed) >= self.campaign.faults
            || queue.failed.len() >= FAILURES_MAX;
        if over {
            return None;
        }
        let number = (queue.next..u32::MAX).find(|&number| self.campaign.is_wanted(number))?;
        queue.next = number + 1;
        Some(number)
    }

    fn folder(&self, number: u32) -> PathBuf {
        self.root.join(format!("case-{number:04}"))
    }

    /// Runs a case and compares; the number of starts. Its files are removed if all is as it should be.
    fn case(&self, case: &Case, tally: &mut Tally) -> Result<usize> {
        anyhow::ensure!(case.shape.is_possible(), "STILLROOM_TEST_PYTHON names no Python with the package");
        let has = |test: fn(&Fault) -> bool| {
            case.faults.iter().any(|planned| test(&planned.fault) && planned.fault.is_allowed(self.privileges))
        };
        let medium = if has(|fault| matches!(fault, Fault::LosePower)) {
            Medium::Disk
        } else if has(|fault| matches!(fault, Fault::FullDisk(_))) {
            Medium::Memory
        } else {
            Medium::Shared
        };
        let own_memory = has(|fault| matches!(fault, Fault::FullMemory(_)));
        let reference = self.reference(case.shape)?;
        let place = CaseFolder::new(self.folder(case.number), medium, own_memory)?;
        let outcome = match play(case, &place, self.privileges, tally) {
            Ok(outcome) => compare(case.shape, &outcome, reference),
            Err(error) => Err(error),
        };
        match outcome {
            Ok(starts) if self.campaign.case.is_none() => {
                place.remove()?;
                Ok(starts)
            }
            outcome => match (place.keep(), outcome) {
                (Err(loss), Err(error)) => Err(error.context(format!("{loss:#}"))),
                (kept, outcome) => kept.and(outcome),
            },
        }
    }

    fn reference(&self, shape: RunKind) -> Result<&Reference> {
        let index = RUN_KINDS.iter().position(|(_, one)| *one == shape).context("a shape of the list")?;
        let made = self.references[index].get_or_init(|| {
            let undisturbed = Case { number: 0, shape, faults: vec![] };
            let make = || {
                let place = CaseFolder::new(self.root.join(format!("reference-{index}")), Medium::Shared, false)?;
                let outcome = play(&undisturbed, &place, self.privileges, &mut Tally::default())?;
                place.remove()?;
                Ok::<_, anyhow::Error>(outcome)
            };
            make().map_err(|error| format!("{error:#}"))
        });
        made.as_ref().map_err(|error| {
            // Nothing can be compared.
            self.queue().broken = true;
            anyhow!("undisturbed: {error}")
        })
    }

    fn report(&self) -> bool {
        let queue = self.queue();
        for line in queue.tally.lines() {
            println!("{line}");
        }
        let happened = queue.tally.total(Fate::Landed);
        let minutes = self.begun.elapsed().as_secs_f64() / 60.0;
        println!(
            "{happened} faults in {} runs in {minutes:.1} minutes, seed {}: {} as undisturbed, {} not {:?}",
            queue.passed + queue.failed.len() as u64,
            self.campaign.seed,
            queue.passed,
            queue.failed.len(),
            queue.failed
        );
        let enough = self.campaign.case.is_some() || happened >= self.campaign.faults;
        if !enough && queue.failed.len() < FAILURES_MAX {
            println!("only {happened} of {} faults in {} minutes", self.campaign.faults, self.campaign.minutes);
        }
        queue.failed.is_empty() && enough
    }
}

fn play(case: &Case, place: &CaseFolder, privileges: Privileges, tally: &mut Tally) -> Result<Reference> {
    Ok(match case.shape.kind {
        Kind::Training => Reference::Training(Box::new(training::train(case, place, privileges, tally)?)),
        Kind::Evaluation => Reference::Evaluation(evaluation::evaluate(case, place, privileges, tally)?),
        Kind::Suite => Reference::Suite(suite::complete(case, place, privileges, tally)?),
    })
}

/// Starts that a case took; an error with all that differs.
fn compare(shape: RunKind, outcome: &Reference, reference: &Reference) -> Result<usize> {
    let (differences, starts) = match (outcome, reference) {
        (Reference::Training(ours), Reference::Training(theirs)) => (trained(shape, ours, theirs), ours.starts),
        (Reference::Evaluation(ours), Reference::Evaluation(theirs)) => (ours.differences(theirs), ours.starts),
        (Reference::Suite(ours), Reference::Suite(theirs)) => (ours.differences(theirs), ours.calls),
        _ => (vec!["a reference of another kind".to_owned()], 0),
    };
    anyhow::ensure!(differences.is_empty(), "{}", differences.join("\n           "));
    Ok(starts)
}

fn trained(shape: RunKind, ours: &Complete, theirs: &Complete) -> Vec<String> {
    let mut found = vec![];
    if !ours.unsaid.is_empty() {
        found.push(format!("damaged, and no start said so: {:?}", ours.unsaid));
    }
    if !ours.left.is_empty() {
        found.push(format!("left behind: {:?}", ours.left));
    }
    if !ours.replay.ends_with("differences: 0") {
        found.push(format!("replay: {}", ours.replay));
    }
    found.extend(ours.evidence.without_curves());
    if !shape.exact {
        found.extend(ours.evidence.violations(shape.frames));
        return found;
    }
    if ours.result != theirs.result {
        found.push(format!("weights and frames: {:?} instead of {:?}", ours.result, theirs.result));
    }
    if ours.evidence.recording.steps() != shape.frames {
        found.push(format!("recorded steps: {} of {}", ours.evidence.recording.steps(), shape.frames));
    }
    found.extend(ours.evidence.differences(&theirs.evidence));
    if ours.replay != theirs.replay {
        found.push(format!("replay: {} instead of {}", ours.replay, theirs.replay));
    }
    found
}
