//! The collector against simulated actors. `tests/world` has crashes of both at every point.

#[path = "../../tests/support/environment.rs"]
mod environment;
mod fake_actor;
mod figures;
mod refusals;

use super::*;
use crate::record::named;
use fake_actor::FakeActor;
use proto::camera::FRAME_PIXELS;
use proto::config::Config;
use std::collections::BTreeMap;
use wire::message::Line;

const SEED: u64 = 5;
const MAX_STEPS: u32 = 7;
const POLICY_ACTIONS: usize = 21;
static FRAME: [u16; FRAME_PIXELS] = [0; FRAME_PIXELS];

#[derive(Debug, Clone)]
struct FakeSample(Vec<Vec<Line>>);

impl HalfSample for FakeSample {
    fn len(&self) -> usize {
        self.0.len()
    }
    fn record(&self, i: usize) -> &[u8] {
        Line::bytes(&self.0[i])
    }
    fn has_frame(&self, i: usize) -> bool {
        self.header(i).bulk != 0
    }
    fn frame(&self, _i: usize) -> Option<DepthFrame<'_>> {
        Some(DepthFrame::Whole(&FRAME))
    }
    fn images(&self, _i: usize) -> impl Iterator<Item = &[u8]> {
        std::iter::empty()
    }
}

impl FakeSample {
    /// The header of its first record.
    fn header_mut(&mut self) -> &mut RecordHeader {
        RecordHeader::of_mut(Line::bytes_mut(&mut self.0[0]))
    }

    /// Numbers of a channel of its first record.
    fn reals(&mut self, name: &str) -> &mut [f32] {
        named(Config::default().spec(), name).of_mut(Line::bytes_mut(&mut self.0[0]))
    }

    /// The same of a channel of whole numbers.
    fn wholes(&mut self, name: &str) -> &mut [u32] {
        named(Config::default().spec(), name).of_mut(Line::bytes_mut(&mut self.0[0]))
    }
}

type Message = (ObservationHeader, FakeSample);

/// Whose turn it is.
fn due(collector: &Collector<FakeSample>) -> Vec<Lane> {
    let Task::Act(lanes) = collector.task() else { panic!("{:?}", collector.task()) };
    lanes
}

/// All columns are one shard.
fn collector(settings: Settings, boundary: Boundary) -> Collector<FakeSample> {
    Collector::new(settings, &Shards::one(settings.column_map.columns()), boundary)
}

/// One environment of one actor, which is to send its first observation.
fn one() -> (ColumnMap, Collector<FakeSample>, FakeActor) {
    let column_map = ColumnMap::new(0, 1, 1);
    let collector = collector(settings(column_map, 1), Boundary::start(1));
    let mut actor = FakeActor::new(0, 1);
    actor.restore = Some(collector.restore(0, 0));
    (column_map, collector, actor)
}

fn reward(name: &str) -> Reward {
    Reward { composition: Config::default().reward(name), multiplier: 0.0 }
}

fn settings(column_map: ColumnMap, learner_incarnation: u32) -> Settings {
    Settings {
        column_map,
        task: Config::default().spec(),
        seed: SEED,
        noise: Noise::Gumbel(POLICY_ACTIONS),
        max_episode_steps: MAX_STEPS,
        gamma: 0.99,
        signals: Signals::of(&Config::default()),
        learner_incarnation,
        recorded: false,
    }
}

type Change = fn(&mut ObservationHeader, &mut FakeSample);

#[test]
fn an_actor_that_disagrees_is_named() {
    let column_map = ColumnMap::new(0, 2, 2);
    let mut collector = collector(settings(column_map, 1), Boundary::start(column_map.columns()));
    let mut actor = FakeActor::new(1, 1);
    actor.restore = Some(collector.restore(1, 0));
    let sent = actor.turn(column_map).unwrap();
    let cases: [(Change, &str); 12] = [
        (|_, sample| sample.reals("wrist_to_object_m")[1] = f32::NAN, "wrist_to_object_m[1] is not finite"),
        (|_, sample| sample.header_mut().episode = 3, "actor 1, kitchen 3, environment 1: it is at episode 3, step 0"),
        (|_, sample| sample.header_mut().flags = 0, "episode-start flag"),
        (|_, sample| sample.header_mut().environment = 0, "holds environment 0"),
        (|_, sample| sample.header_mut().bulk = 0, "actor 1, kitchen 3, environment 1: its depth frame"),
        (|_, sample| sample.0.clear(), "actor 1 sent 0 observations for half 1, which has 1"),
        (|header, _| header.step = 1, "actor 1 is at exchange 1 of half 1"),
        (|header, _| header.actor = 2, "makes no sense"),
        (|header, _| header.actor_incarnation = u32::MAX, "makes no sense"),
        (|_, sample| sample.header_mut().flags |= flag::TERMINATED, "its header's flags are 0xa"),
        (|_, sample| sample.wholes("current_target")[0] = 99, "current_target is 99"),
        (|_, sample| sample.reals("object_to_goal_m")[0] = 1e6, "object_to_goal_m[0] is 1000000"),
    ];
    for (change, problem) in cases {
        let (mut header, mut sample) = sent[1].clone();
        change(&mut header, &mut sample);
        let error = collector.receive(&header, sample).unwrap_err();
        let text = error.to_string();
        assert!(text.contains(problem) && error.is_non_finite() == problem.contains("not finite"), "{text}");
    }

    // What is right is taken once; a copy, an old learner's and a dead predecessor's change nothing.
    let (header, sample) = sent[1].clone();
    assert_eq!(collector.receive(&header, sample.clone()), Ok(Received::Kept));
    assert_eq!(collector.receive(&header, sample.clone()), Ok(Received::Duplicate));
    let old = ObservationHeader { learner_incarnation: 0, ..header };
    assert_eq!(collector.receive(&old, sample), Ok(Received::Foreign));
    let (hello, nothing) = FakeActor::new(1, 2).hello();
    assert_eq!(collector.receive(&hello, nothing.clone()), Ok(Received::Hello { actor: 1, actor_incarnation: 2 }));
    let (hello, _) = FakeActor::new(1, 1).hello();
    assert_eq!(collector.receive(&hello, nothing), Ok(Received::Duplicate));
}

#[test]
fn a_batch_has_the_goal_vector_that_was_reported() {
    let (column_map, mut collector, mut actor) = one();
    let (header, mut sample) = actor.turn(column_map).unwrap().remove(0);
    sample.reals("goal_m").copy_from_slice(&[0.25, -1.5, 3.0]);
    collector.receive(&header, sample).unwrap();
    collector.begin(RolloutShape { steps: 1, environments_in_last_step: 1, frames: 1 }, reward("r"), 1);
    assert_eq!(collector.batch(&due(&collector)).input().numbers, [0.25, -1.5, 3.0]);
}

/// A rollout's outcomes by step and column, what the policy is given in it, its figures and the boundary after it.
type Collected = (Vec<(usize, usize, Outcome)>, Vec<Vec<f32>>, String, Boundary);

fn collected(planned: usize, cut: Option<usize>) -> Collected {
    let column_map = ColumnMap::new(0, 2, 3);
    let mut collector = collector(settings(column_map, 1), Boundary::start(6));
    let mut actors = [0, 1].map(|actor| FakeActor::new(actor, 1));
    for actor in &mut actors {
        actor.restore = Some(collector.restore(actor.number, 0));
    }
    collector.begin(RolloutShape::next(u64::MAX, planned, 6), reward("r"), 1);
    let (mut outcomes, mut seen) = (vec![], vec![]);
    loop {
        for (header, sample) in actors.iter_mut().filter_map(|actor| actor.turn(column_map)).flatten() {
            collector.receive(&header, sample).unwrap();
        }
        if cut.is_some_and(|steps| collector.between_steps() == Some([steps, planned])) {
            collector.cut();
        }
        let lanes = match collector.task() {
            Task::Await => continue,
            Task::Act(lanes) => lanes,
            Task::Finish => break,
        };
        outcomes
            .extend(collector.settle(&lanes).into_iter().map(|settled| (settled.t, settled.column, settled.outcome)));
        let batch = collector.batch(&lanes);
        seen.push(batch.input().numbers.to_vec());
        let actions: Vec<u8> =
            batch.rows().zip(&batch.columns).map(|(t, column)| ((5 * column + 7 * t) % 21) as u8).collect();
        for batch in collector.answer(&lanes, &actions) {
            actors[batch.actor as usize].actions.push_back(batch);
        }
    }
    let figures = format!("{:?}", collector.finish()[0].metrics());
    (outcomes, seen, figures, collector.boundary())
}

/// A rollout that is ended early is one that was to be that short.
#[test]
fn a_rollout_cut_short_is_a_short_one() {
    for steps in 1..5 {
        assert_eq!(collected(5, Some(steps)), collected(steps, None), "{steps} steps of 5");
    }
}
