use super::run::{Evaluated, Run};
use proto::evaluation::EpisodeRecord;
use proto::task::Column;

/// Evaluations of weights from before a run's second stage and from after it, on the same episodes.
#[derive(Debug, Clone)]
pub struct EvaluatedPair<'a> {
    pub run: &'a Run,
    pub stage: String,
    pub before: &'a Evaluated,
    pub after: &'a Evaluated,
    /// The episodes that both played, those first that show most: the best by the task's ranking afterwards, by how much
    /// their return under the stage's reward rose.
    pub episodes: Vec<[&'a EpisodeRecord; 2]>,
}

/// The pair of a run, if there is one among the evaluations that are `usable`. Weights that the run began with count as
/// before its first stage, whichever run evaluated them.
pub fn pair_of<'a>(run: &'a Run, all: &'a [Run], usable: impl Fn(&Evaluated) -> bool) -> Option<EvaluatedPair<'a>> {
    let (boundary, stage) = match (&run.config.from, run.config.stages.as_slice()) {
        (Some(_), [first, ..]) => (0, first),
        (None, [first, second, ..]) => (first.frames, second),
        _ => return None,
    };
    let spec = run.config.spec();
    let ranking: Vec<Column> = spec.ranking().iter().filter_map(|metric| spec.column(&metric.name)).collect();
    let stage_return = spec.column(&format!("return_{}", stage.reward));
    let earlier = |evaluated: &&Evaluated| match &run.config.from {
        Some(from) => evaluated.result.subject.weights == from.weights,
        None => (1..=boundary).contains(&evaluated.result.subject.frames),
    };
    let before = all.iter().filter(|other| run.config.from.is_some() || std::ptr::eq(*other, run));
    let before = before.flat_map(|other| other.evaluations.iter().filter(|one| same_kitchens(other, run, one)));
    let before: Vec<&Evaluated> = before.filter(|one| usable(one)).filter(earlier).collect();
    let mut pairs: Vec<EvaluatedPair<'a>> = Vec::new();
    let after = run.evaluations.iter().filter(|one| usable(one) && one.result.subject.frames > boundary);
    for after in after {
        for before in before.iter().filter(|before| alike(before, after)) {
            let episodes = in_common(before, after, &ranking, stage_return);
            if !episodes.is_empty() {
                pairs.push(EvaluatedPair { run, stage: stage.name.clone(), before, after, episodes });
            }
        }
    }
    // The weights that are nearest to both ends of the stage; of evaluations of the same weights the newest.
    let rank = |one: &Evaluated| (one.result.subject.frames, one.result.cost.at_unix_s);
    pairs.into_iter().max_by_key(|pair| (rank(pair.after), rank(pair.before)))
}

/// Whether the kitchens that one run was evaluated in are another's, too: conditions number those that are a run's own.
fn same_kitchens(one: &Run, other: &Run, evaluated: &Evaluated) -> bool {
    let conditions = &evaluated.result.conditions;
    (conditions.scenes.is_empty() || one.config.scenes == other.config.scenes)
        && (conditions.procedural.is_none() || one.config.kitchens.seed == other.config.kitchens.seed)
}

/// Whether an episode's number means the same episode in both. It does whatever the seeds: fixed episodes are a file, and
/// drawn ones follow from the kitchen, their number and the distances.
fn alike(a: &Evaluated, b: &Evaluated) -> bool {
    let [a, b] = [a, b].map(|one| &one.result.conditions);
    let which = |conditions: &'_ proto::evaluation::Conditions| {
        let distances = [conditions.start_distance_max_m, conditions.goal_distance_max_m].map(f32::to_bits);
        (conditions.split, conditions.distribution, conditions.procedural, conditions.scenes.clone(), distances)
    };
    which(a) == which(b)
}

fn in_common<'a>(
    before: &'a Evaluated,
    after: &'a Evaluated,
    ranking: &[Column],
    stage_return: Option<Column>,
) -> Vec<[&'a EpisodeRecord; 2]> {
    let same = |one: &EpisodeRecord, other: &EpisodeRecord| {
        (one.kitchen, one.episode, one.category) == (other.kitchen, other.episode, other.category)
    };
    let found = after.episodes.iter().filter_map(|later| {
        let earlier = before.episodes.iter().find(|earlier| same(earlier, later))?;
        Some([earlier, later])
    });
    let mut both: Vec<[&EpisodeRecord; 2]> = found.collect();
    let number = |record: &EpisodeRecord, column| record.number(column).unwrap_or(0.0);
    let shown = |[earlier, later]: &[&EpisodeRecord; 2]| -> Vec<f64> {
        let rise = stage_return.map(|column| number(later, column) - number(earlier, column));
        ranking.iter().map(|&column| number(later, column)).chain(rise).collect()
    };
    both.sort_by(|a, b| {
        let order = shown(b).iter().zip(shown(a)).map(|(b, a)| b.total_cmp(&a)).find(|order| order.is_ne());
        order.unwrap_or_else(|| (a[0].kitchen, a[0].episode).cmp(&(b[0].kitchen, b[0].episode)))
    });
    both
}
