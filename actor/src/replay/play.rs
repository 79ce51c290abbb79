//! A recorded episode, simulated again: at every moment the record of it, as a recorder would have recorded it.

use anyhow::{Context, Result, ensure};
use proto::config::Config;
use proto::replay::{Compared, Difference, LENGTH, RecordedEpisode, ReplayVerdict, STATE};
use proto::task::{Composition, Spec, SpecError, Summing};
use simulator::environment::Environment;

/// What of a step a configuration's task has compared, and what its metrics are.
pub(crate) struct Rules {
    pub spec: &'static Spec,
    pub compared: Compared,
    /// The configuration's own rewards.
    pub own_rewards: Vec<(String, Composition)>,
    names: Vec<String>,
    summing: Summing,
}

impl Rules {
    /// Those of a run.
    pub fn of(config: &Config) -> Result<Self, SpecError> {
        let spec = config.spec();
        let compared = Compared::of(spec, &config.reward.weights)?;
        let (names, own_rewards) = (compared.names().collect(), config.own_rewards()?);
        Ok(Self { spec, names, compared, own_rewards, summing: Summing::of(spec) })
    }
}

/// The start of an episode, or what an action led to.
pub(crate) struct Seen<'a> {
    /// All of a record but its header and images.
    pub record: &'a [u8],
    /// Rewards of the action; none at the start.
    pub rewards: Option<&'a [f32]>,
}

/// What came of it.
pub(crate) struct Performance {
    pub verdict: ReplayVerdict,
    /// How it ended: [`Spec::outcome`].
    pub outcome: String,
    /// The task's metrics over the steps that were recorded.
    pub metrics: Vec<Option<f64>>,
}

/// Takes the recorded actions, and compares all that was recorded on the way. `watch` is called at the start and after
/// each action.
pub(crate) fn play(
    rules: &Rules,
    environment: &mut dyn Environment,
    recorded: &RecordedEpisode,
    mut watch: impl FnMut(&mut dyn Environment, &Seen) -> Result<()>,
) -> Result<Performance> {
    let layout = rules.spec.layout();
    check_lengths(rules, recorded)?;
    let mut compare = Comparison::of(rules, recorded);
    let mut record = vec![0; layout.small_bytes];
    environment.observe(&mut record[layout.seen.clone()]);
    if let Some(hash) = recorded.start_hash {
        compare.state(0, hash, environment.base().state_hash());
    }
    compare.digests(0, &recorded.start, &rules.compared.start(&record), |_| true);
    watch(environment, &Seen { record: &record, rewards: None })?;
    let (mut seen, mut rewards, mut digests) = (record.clone(), vec![], vec![]);
    let mut sums = rules.summing.nothing(rules.compared.rewards().len());
    let actions = recorded.actions.chunks_exact(layout.action.range().len());
    for (step, (action, &hash)) in (0u64..).zip(actions.zip(&recorded.hashes)) {
        seen.copy_from_slice(&record);
        act(environment, action, rules.spec, &mut record).with_context(|| format!("step {step}"))?;
        rules.compared.reward(layout, &record, &mut rewards);
        digests.clear();
        rules.compared.step(Some(&seen), &record, &rewards, environment.base().end(), &mut digests);
        compare.step(step, &digests, hash, environment.base().state_hash());
        rules.summing.add(&mut sums, &record, &rewards);
        watch(environment, &Seen { record: &record, rewards: Some(&rewards) })?;
        if environment.base().ended() && step + 1 < recorded.hashes.len() as u64 {
            // The recorded episode went on: whatever comes now differs.
            compare.differ(step + 2, LENGTH);
            break;
        }
    }
    let metrics: Vec<Option<f64>> = rules.summing.metrics(Some(&sums), &record).collect();
    let outcome = rules.spec.outcome(&metrics, environment.base().end());
    Ok(Performance { verdict: compare.verdict, outcome, metrics })
}

/// Takes an action, and writes what it did and what is seen then into a record.
fn act(environment: &mut dyn Environment, action: &[u8], spec: &Spec, record: &mut [u8]) -> Result<()> {
    let (layout, names) = (spec.layout(), spec.actions.names());
    let number = layout.action.dtype.read(action);
    ensure!(names.is_empty() || number < names.len() as f64, "there is no action {number}");
    record[layout.action.range()].copy_from_slice(action);
    environment.act(action, &mut record[layout.of_action.clone()]);
    environment.observe(&mut record[layout.seen.clone()]);
    Ok(())
}

/// Everything of an episode is of its length, or not there.
fn check_lengths(rules: &Rules, recorded: &RecordedEpisode) -> Result<()> {
    let RecordedEpisode { actions, hashes, digests, start, .. } = recorded;
    let (count, bytes) = (hashes.len(), rules.spec.layout().action.range().len());
    ensure!(actions.len() == count * bytes, "{count} hashes but {} bytes of actions were recorded", actions.len());
    let (of_step, of_start) = (rules.compared.count(), rules.compared.start_count());
    let whole = |digests: &[u32], wanted: usize| digests.is_empty() || digests.len() == wanted;
    ensure!(
        whole(digests, count * of_step) && whole(start, of_start),
        "{count} steps but {} digests of {of_step} each were recorded",
        digests.len()
    );
    Ok(())
}

/// The verdict as it comes about. The first difference stands.
struct Comparison<'a> {
    rules: &'a Rules,
    recorded: &'a RecordedEpisode,
    verdict: ReplayVerdict,
}

impl<'a> Comparison<'a> {
    fn of(rules: &'a Rules, recorded: &'a RecordedEpisode) -> Self {
        let RecordedEpisode { environment, episode, .. } = *recorded;
        let verdict = ReplayVerdict { environment, episode, compared: 0, first_difference: None, images: 0 };
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
