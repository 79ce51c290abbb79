use super::*;
use engine::Environments;
use proto::config::KitchenSource;
use proto::random::{Key, Purpose};
use simulator::robot::action::Action;
use std::cell::Cell;
use std::path::Path;
use wire::message::{EnvironmentState, Line};

const STEPS: u32 = 60;

fn config(episodes_each: u32) -> Config {
    let mut config = Config::default();
    config.kitchens.source = KitchenSource::Procedural;
    config.kitchens.count = 4;
    config.kitchens.episodes_each = episodes_each;
    config.actors.environments_per_actor = 3;
    config.validate().unwrap();
    config
}

/// What all environments do and see in so many steps, as a learner gets it; each step waits for `before`, which is given
/// the episode of each.
fn played(
    environments: &mut Environments<Kitchens>,
    config: &Config,
    before: impl Fn(&mut Environments<Kitchens>, &[u32]),
) -> Vec<(RecordHeader, u64)> {
    let spec = config.spec();
    let count = spec.actions.names().len();
    let ending = if count == 4 { 0 } else { Action::DoneMidLevel.index() };
    let mut seen = Vec::new();
    let mut episodes = vec![0; environments.count() as usize];
    let mut random =
        Key { seed: 5, purpose: Purpose::RandomPolicy, kitchen: 0, environment: 0, episode: 0, step: 0 }.stream();
    for _ in 0..STEPS {
        before(environments, &episodes);
        // Every third action ends an episode.
        let actions: Vec<u8> = (0..episodes.len())
            .map(|_| if random.below(3) == 0 { ending } else { random.below(count as u32) as u8 })
            .collect();
        environments.act(0..actions.len(), &actions, &mut []).unwrap();
        for (index, episode) in episodes.iter_mut().enumerate() {
            let mut record = vec![Line([0; 64]); spec.layout().bytes / size_of::<Line>()];
            let record = Line::bytes_mut(&mut record);
            environments.observe(index, record).unwrap();
            let header = *RecordHeader::of(record);
            *episode = header.episode;
            seen.push((header, xxhash_rust::xxh3::xxh3_64(record)));
        }
    }
    seen
}

fn environments(prefetcher: KitchenPrefetcher, config: &Config) -> Environments<Kitchens> {
    Environments::new(Kitchens::of(prefetcher, config).unwrap(), &homes(0, config), config).unwrap()
}

/// Waits until the prefetcher's thread has done all that can be done ahead.
fn until_all_is_ready(environments: &mut Environments<Kitchens>, config: &Config, episodes: &[u32]) {
    for (home, &episode) in homes(0, config).into_iter().zip(episodes) {
        while !environments.simulator().scenes.is_ready(home, episode) {
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
    }
}

#[test]
fn what_is_opened_ahead_does_not_matter_to_a_single_bit() {
    let folder = tempfile::tempdir().unwrap();
    for episodes_each in [1, 5] {
        let config = config(episodes_each);
        let prefetcher = |folder: &Path| KitchenPrefetcher::of(&config, folder).unwrap();
        let at_once = KitchenPrefetcher::without_thread(&config, folder.path());
        let expected = played(&mut environments(at_once, &config), &config, |_, _| ());
        let kitchens: std::collections::BTreeSet<u32> =
            expected.iter().map(|(header, _)| header.acted_episode / episodes_each).collect();
        assert!(kitchens.len() > 2, "environments went from kitchen to kitchen: {kitchens:?}");
        let ahead = played(&mut environments(prefetcher(folder.path()), &config), &config, |environments, episodes| {
            until_all_is_ready(environments, &config, episodes);
        });
        assert!(ahead == expected, "opened ahead");
        let in_time_or_not = played(&mut environments(prefetcher(folder.path()), &config), &config, |_, _| ());
        assert!(in_time_or_not == expected, "opened in time or not");
    }
}

#[test]
fn what_is_prepared_while_waiting_does_not_matter_to_a_single_bit() {
    let folder = tempfile::tempdir().unwrap();
    let procedural = config(5);
    let mut built_in = Config::default();
    built_in.actors.environments_per_actor = 3;
    let other_task = Config { task: "point_nav".to_owned(), ..built_in.clone() };
    for config in [procedural, built_in, other_task] {
        let environments = || environments(KitchenPrefetcher::without_thread(&config, folder.path()), &config);
        let expected = played(&mut environments(), &config, |_, _| ());
        for most in [1, 4, usize::MAX] {
            let done = Cell::new(0);
            let mut prepared = environments();
            let seen = played(&mut prepared, &config, |environments, _| {
                done.set(done.get() + (0..most).take_while(|_| environments.prepare()).count());
            });
            assert!(seen == expected, "at most {most} pieces before each step");
            assert!(done.get() > STEPS as usize / 2, "there was something to prepare: {}", done.get());
        }
    }
}

/// An actor that starts again is told where its environments stand, in kitchens far from those of their first episodes.
#[test]
fn a_restored_environment_is_in_the_kitchen_of_its_episode() {
    for task in ["arm_point_nav", "point_nav"] {
        restore(&Config { task: task.to_owned(), ..config(2) });
    }
}

fn restore(config: &Config) {
    let folder = tempfile::tempdir().unwrap();
    let mut restored = environments(KitchenPrefetcher::of(config, folder.path()).unwrap(), config);
    let mut expected = environments(KitchenPrefetcher::without_thread(config, folder.path()), config);
    // Action 1 ends no episode in either task.
    let states = [9, 0, 4].map(|episode| {
        let mut state = EnvironmentState::start_of(episode);
        for action in [1, 1] {
            state.push(&[action]);
        }
        state
    });
    for (environments, prepares) in [(&mut restored, true), (&mut expected, false)] {
        played(environments, config, |environments, _| while prepares && environments.prepare() {});
        environments.rebuild(&states).unwrap();
        for (index, (home, state)) in homes(0, config).into_iter().zip(&states).enumerate() {
            let kitchens = environments.simulator();
            let place = kitchens.place(home, state.episode);
            let (id, environment) = &kitchens.environments[index];
            assert_eq!((*id, environment.base().kitchen().id()), (place, place.kitchen));
            let mut record = vec![Line([0; 64]); config.spec().layout().bytes / size_of::<Line>()];
            let record = Line::bytes_mut(&mut record);
            environments.observe(index, record).unwrap();
            let RecordHeader { episode, step, .. } = *RecordHeader::of(record);
            assert_eq!((episode, step), (state.episode, 2));
        }
    }
    let [restored, expected] =
        [restored, expected].map(|mut environments| played(&mut environments, config, |_, _| ()));
    assert!(restored == expected);
}
