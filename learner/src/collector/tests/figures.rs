//! The figures of a rollout.

use super::*;
use proto::metric;

#[test]
fn the_figures_of_a_rollout_are_those_of_each_shard() {
    let mut config = Config::default();
    (config.actors.count, config.actors.environments_per_actor, config.learner.shards) = (3, 1, 2);
    let column_map = ColumnMap::of(0, &config);
    let mut collector =
        Collector::<FakeSample>::new(settings(column_map, 1), &Shards::of(&config, &(0..3)), Boundary::start(3));
    let mut actors = [0, 1, 2].map(|actor| FakeActor::new(actor, 1));
    for (number, actor) in (0..).zip(&mut actors) {
        actor.restore = Some(collector.restore(number, 0));
    }
    let arrive = |collector: &mut Collector<FakeSample>, actors: &mut [FakeActor; 3]| {
        for (header, sample) in actors.iter_mut().map(|actor| actor.turn(column_map).unwrap().remove(0)) {
            collector.receive(&header, sample).unwrap();
        }
        collector.settle(&due(collector))
    };
    let reward = reward("r");
    collector.begin(RolloutShape { steps: 1, environments_in_last_step: 3, frames: 3 }, reward, 1);
    assert!(arrive(&mut collector, &mut actors).is_empty());
    let first = due(&collector);
    for (actor, batch) in actors.iter_mut().zip(collector.answer(&first, &[4; 3])) {
        actor.actions.push_back(batch);
    }
    let rewards: Vec<f64> =
        arrive(&mut collector, &mut actors).iter().map(|settled| f64::from(settled.outcome.reward)).collect();
    assert_eq!(collector.collected(), 3);
    let last = due(&collector);
    assert!(last.iter().all(|lane| lane.t == 1));
    assert!(collector.answer(&last, &[4; 3]).is_empty(), "what is valued is not answered");
    let figures: Vec<BTreeMap<String, f64>> = collector.finish().iter().map(RolloutStatistics::metrics).collect();
    let means = [f64::midpoint(rewards[0], rewards[1]), rewards[2]];
    assert_eq!(figures.iter().map(|figures| figures[metric::REWARD]).collect::<Vec<_>>(), means);
}
