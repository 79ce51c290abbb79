use super::*;
use proto::config::KitchenSource;
use proto::run_folder::RunFolder;
use std::time::{Duration, Instant};

impl KitchenPrefetcher {
    /// Whether the kitchen that an environment ordered is open.
    pub fn is_ready(&self, environment: u32) -> bool {
        self.orders.lock().ready.contains_key(&environment)
    }
}

fn config() -> Config {
    let mut config = Config::default();
    config.kitchens.source = KitchenSource::Procedural;
    config
}

fn id(number: u32) -> KitchenId {
    KitchenId::new(number).unwrap()
}

fn order(environment: u32, kitchen: u32, open: bool) -> Order {
    Order { environment, kitchen: id(kitchen), open }
}

fn file(folder: &Path, kitchen: u32) -> PathBuf {
    RunFolder::new(folder).kitchens().join(format!("{kitchen}.kitchen"))
}

fn wait_until(what: &str, done: impl Fn() -> bool) {
    let begun = Instant::now();
    while !done() {
        assert!(begun.elapsed() < Duration::from_mins(4), "{what} for four minutes");
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn what_is_ordered_is_made_ahead_and_is_the_same_as_what_is_taken_at_once() {
    let [ahead, at_once] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let prefetcher = KitchenPrefetcher::of(&config(), ahead.path()).unwrap();
    prefetcher.order(order(0, 1002, false));
    prefetcher.order(order(0, 1002, false));
    wait_until("nobody makes it", || file(ahead.path(), 1002).exists());
    let made_ahead = prefetcher.take(0, id(1002)).unwrap();
    assert!(made_ahead.scenery.is_none(), "it was not to be opened");
    let taken = KitchenPrefetcher::without_thread(&config(), at_once.path()).take(0, id(1002)).unwrap();
    assert_eq!(made_ahead.kitchen.settled_poses(), taken.kitchen.settled_poses());
    let bytes = [&ahead, &at_once].map(|folder| std::fs::read(file(folder.path(), 1002)).unwrap());
    assert_eq!(bytes[0], bytes[1]);
}

#[test]
fn what_is_opened_ahead_is_handed_over_as_it_is_and_is_the_same_as_what_is_taken_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let prefetcher = KitchenPrefetcher::of(&config(), folder.path()).unwrap();
    prefetcher.order(order(7, 1002, true));
    wait_until("nobody opens it", || prefetcher.is_ready(7));
    // Opened is opened: nothing is read any more.
    std::fs::remove_file(file(folder.path(), 1002)).unwrap();
    let ahead = prefetcher.take(7, id(1002)).unwrap();
    assert!(ahead.scenery.is_some() && !file(folder.path(), 1002).exists());
    assert!(!prefetcher.is_ready(7), "it was handed over");
    let at_once = KitchenPrefetcher::without_thread(&config(), folder.path()).take(7, id(1002)).unwrap();
    assert_eq!(ahead.kitchen.settled_poses(), at_once.kitchen.settled_poses());
    assert_eq!(ahead.kitchen.robot_stands(), at_once.kitchen.robot_stands());
}

#[test]
fn environments_in_one_kitchen_share_it_and_nobody_keeps_it_when_they_have_left() {
    let folder = tempfile::tempdir().unwrap();
    let prefetcher = KitchenPrefetcher::of(&config(), folder.path()).unwrap();
    let first = prefetcher.take(0, id(1002)).unwrap().kitchen;
    let second = prefetcher.take(1, id(1002)).unwrap().kitchen;
    prefetcher.order(order(2, 1002, true));
    wait_until("nobody opens it", || prefetcher.is_ready(2));
    let third = prefetcher.take(2, id(1002)).unwrap().kitchen;
    assert!(Arc::ptr_eq(&first, &second) && Arc::ptr_eq(&first, &third));
    let gone = Arc::downgrade(&first);
    drop((first, second, third));
    assert!(gone.upgrade().is_none());
}

#[test]
fn at_most_one_kitchen_waits_for_each_environment() {
    let folder = tempfile::tempdir().unwrap();
    let prefetcher = KitchenPrefetcher::of(&config(), folder.path()).unwrap();
    for kitchen in [1002, 1003, 1004, 1002, 1003] {
        prefetcher.order(order(0, kitchen, true));
        prefetcher.order(order(1, kitchen, false));
        assert!(prefetcher.orders.lock().waiting.len() <= 2);
        wait_until("nobody opens it", || prefetcher.is_ready(0));
        let state = prefetcher.orders.lock();
        assert_eq!(state.ready.len(), 1);
        assert_eq!(state.ready[&0].kitchen.id(), id(kitchen));
        assert!(state.in_use.values().filter(|kitchen| kitchen.strong_count() > 0).count() <= 1);
    }
    // The environment went elsewhere than it had thought.
    assert_eq!(prefetcher.take(0, id(1002)).unwrap().kitchen.id(), id(1002));
    assert!(prefetcher.orders.lock().ready.is_empty());
}

#[test]
fn what_is_needed_open_comes_first_and_what_is_taken_is_no_longer_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    let prefetcher = KitchenPrefetcher::without_thread(&config(), folder.path());
    for order in [order(0, 1002, false), order(1, 1003, true), order(2, 1004, true), order(3, 1002, false)] {
        prefetcher.order(order);
    }
    let mut state = prefetcher.orders.lock();
    state.cancel(2);
    let next: Vec<_> = std::iter::from_fn(|| state.next()).collect();
    assert_eq!(next, [order(1, 1003, true), order(0, 1002, false), order(3, 1002, false)]);
}

/// A run folder that cannot be written, or a kitchen that cannot be made, ends the actor where the kitchen is needed.
#[test]
fn a_thread_that_fails_leaves_the_error_to_whoever_takes() {
    let folder = tempfile::tempdir().unwrap();
    let prefetcher = KitchenPrefetcher::of(&config(), folder.path()).unwrap();
    let scene = KitchenId::scene(0).unwrap();
    prefetcher.order(Order { environment: 0, kitchen: scene, open: true });
    prefetcher.order(order(1, 1002, true));
    wait_until("nobody goes on", || prefetcher.is_ready(1));
    assert!(!prefetcher.is_ready(0) && prefetcher.take(0, scene).is_err());
}
