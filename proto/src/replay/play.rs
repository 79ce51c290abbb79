//! A recorded episode, simulated again: at every moment the record of it, as a recorder would have recorded it.

use super::{Compared, Difference, LENGTH, RecordedEpisode, ReplayVerdict, STATE};
use crate::config::Config;
use crate::record::End;
use crate::task::{Composition, Spec, SpecError, Summing};
use std::error::Error;

pub trait Player {
    /// Takes one action, which the task has, and writes what it did: the bytes of a record's parts and outcomes.
    fn act(&mut self, action: &[u8], done: &mut [u8]) -> Result<(), Box<dyn Error + Send + Sync>>;

    /// Writes what is seen now: the bytes of a record's observations and states, but for images.
    fn observe(&mut self, seen: &mut [u8]);

    fn state_hash(&self) -> u64;

    fn end(&self) -> Option<End>;
}

#[derive(Debug, thiserror::Error)]
pub enum PlayError {
    #[error("{steps} hashes but {bytes} bytes of actions were recorded")]
    Actions { steps: usize, bytes: usize },
    #[error("{steps} steps but {digests} digests of {each} each were recorded")]
    Digests { steps: usize, digests: usize, each: usize },
    #[error("step {step}: there is no action {action}")]
    NoSuchAction { step: u64, action: String },
    #[error("step {step}")]
    Failed {
        step: u64,
        #[source]
        cause: Box<dyn Error + Send + Sync>,
    },
}

/// What of a step a configuration's task has compared, and what its metrics are.
pub struct Rules {
    pub spec: &'static Spec,
    pub compared: Compared,
    pub own_rewards: Vec<(String, Composition)>,
    names: Vec<String>,
    summing: Summing,
}

impl Rules {
    pub fn of(config: &Config) -> Result<Self, SpecError> {
        let spec = config.spec();
        let compared = Compared::of(spec, &config.reward.weights)?;
        let (names, own_rewards) = (compared.names().collect(), config.own_rewards()?);
        Ok(Self { spec, names, compared, own_rewards, summing: Summing::of(spec) })
    }
}

pub struct Seen<'a> {
    /// All of a record but its header and images.
    pub record: &'a [u8],
    /// Rewards of the action; none at the start.
    pub rewards: Option<&'a [f32]>,
}

pub struct Performance {
    pub verdict: ReplayVerdict,
    /// How it ended: [`Spec::outcome`].
    pub outcome: String,
    /// The task's metrics over the steps that were recorded.
    pub metrics: Vec<Option<f64>>,
}

/// Takes the recorded actions, and compares all that was recorded on the way. `watch` is called at the start and after
/// each action.
pub fn play<P: Player + ?Sized, E: From<PlayError>>(
    rules: &Rules,
    environment: &mut P,
    recorded: &RecordedEpisode,
    mut watch: impl FnMut(&mut P, &Seen) -> Result<(), E>,
) -> Result<Performance, E> {
    let layout = rules.spec.layout();
    check_lengths(rules, recorded)?;
    let mut compare = Comparison::of(rules, recorded);
    let mut record = vec![0; layout.small_bytes];
    environment.observe(&mut record[layout.seen.clone()]);
    if let Some(hash) = recorded.start_hash {
        compare.state(0, hash, environment.state_hash());
    }
    compare.digests(0, &recorded.start, &rules.compared.start(&record), |_| true);
    watch(environment, &Seen { record: &record, rewards: None })?;
    let (mut seen, mut rewards, mut digests) = (record.clone(), vec![], vec![]);
    let mut sums = rules.summing.nothing(rules.compared.rewards().len());
    let actions = recorded.actions.chunks_exact(layout.action.range().len());
    for (step, (action, &hash)) in (0u64..).zip(actions.zip(&recorded.hashes)) {
        seen.copy_from_slice(&record);
        act(environment, step, action, rules.spec, &mut record)?;
        rules.compared.reward(layout, &record, &mut rewards);
        digests.clear();
        rules.compared.step(Some(&seen), &record, &rewards, environment.end(), &mut digests);
        compare.step(step, &digests, hash, environment.state_hash());
        rules.summing.add(&mut sums, &record, &rewards);
        watch(environment, &Seen { record: &record, rewards: Some(&rewards) })?;
        if environment.end().is_some() && step + 1 < recorded.hashes.len() as u64 {
            // The recorded episode went on: whatever comes now differs.
            compare.differ(step + 2, LENGTH);
            break;
        }
    }
    let metrics: Vec<Option<f64>> = rules.summing.metrics(Some(&sums), &record).collect();
    let outcome = rules.spec.outcome(&metrics, environment.end());
    Ok(Performance { verdict: compare.verdict, outcome, metrics })
}

/// Takes an action, and writes what it did and what is seen then into a record.
fn act<P: Player + ?Sized>(
    environment: &mut P,
    step: u64,
    action: &[u8],
    spec: &Spec,
    record: &mut [u8],
) -> Result<(), PlayError> {
    let layout = spec.layout();
    if !spec.actions.has(action) {
        return Err(PlayError::NoSuchAction { step, action: spec.actions.text(action) });
    }
    record[layout.action.range()].copy_from_slice(action);
    let done = environment.act(action, &mut record[layout.of_action.clone()]);
    done.map_err(|cause| PlayError::Failed { step, cause })?;
    environment.observe(&mut record[layout.seen.clone()]);
    Ok(())
}

/// Everything of an episode is of its length, or not there.
fn check_lengths(rules: &Rules, recorded: &RecordedEpisode) -> Result<(), PlayError> {
    let RecordedEpisode { actions, hashes, digests, start, .. } = recorded;
    let (steps, bytes) = (hashes.len(), rules.spec.layout().action.range().len());
    if actions.len() != steps * bytes {
        return Err(PlayError::Actions { steps, bytes: actions.len() });
    }
    let (of_step, of_start) = (rules.compared.count(), rules.compared.start_count());
    let whole = |digests: &[u32], wanted: usize| digests.is_empty() || digests.len() == wanted;
    if whole(digests, steps * of_step) && whole(start, of_start) {
        return Ok(());
    }
    Err(PlayError::Digests { steps, digests: digests.len(), each: of_step })
}

struct Comparison<'a> {
    rules: &'a Rules,
    recorded: &'a RecordedEpisode,
    verdict: ReplayVerdict,
}

impl<'a> Comparison<'a> {
    fn of(rules: &'a Rules, recorded: &'a RecordedEpisode) -> Self {
        let RecordedEpisode { environment, episode, .. } = *recorded;
        let verdict =
            ReplayVerdict { environment, episode, compared: 0, first_difference: None, images: 0, film: None };
        Self { rules, recorded, verdict }
    }

    /// What an action was chosen from comes before the state that it led to, and that before what else it did.
    fn step(&mut self, step: u64, simulated: &[u32], hash: u64, state_hash: u64) {
        let recorded = self.recorded.digests.chunks_exact(simulated.len()).nth(step as usize).unwrap_or_default();
        let compared = &self.rules.compared;
        self.digests(step, recorded, simulated, |at| compared.is_seen(at));
        self.state(step + 1, hash, state_hash);
        self.digests(step + 1, recorded, simulated, |_| true);
    }

    fn state(&mut self, step: u64, recorded: u64, simulated: u64) {
        self.verdict.compared += 1;
        if recorded != simulated {
            self.differ(step, STATE);
        }
    }

    /// Those of these digests, by their places. 0 was not recorded.
    fn digests(&mut self, step: u64, recorded: &[u32], simulated: &[u32], of: impl Fn(usize) -> bool) {
        let mut pairs = recorded.iter().zip(simulated).enumerate();
        if let Some((at, _)) =
            pairs.find(|&(at, (recorded, simulated))| *recorded != 0 && recorded != simulated && of(at))
        {
            self.differ(step, &self.rules.names[at]);
        }
    }

    fn differ(&mut self, step: u64, what: &str) {
        let difference = || Difference { step, what: what.to_owned() };
        self.verdict.first_difference.get_or_insert_with(difference);
    }
}
