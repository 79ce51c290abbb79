use super::pace::{Pace, Work};
use super::restart::RestartPolicy;
use proto::config::Config;
use proto::kitchen::Kitchens;
use std::time::Duration;
use wire::Standstill;

/// Learners hang when they take this many times the longest of the last times. Beside an evaluation, a build or a busy
/// disk they may well take three times as long.
const MARGIN: u32 = 10;
const WARNING: u32 = 3;
/// First work after a start, which warms caches up, may take as many times what is usual.
const FIRST: u32 = 2;

#[derive(Debug, Clone, Copy)]
pub struct Deadlines {
    pub kitchens: Kitchens,
    pub learners: u32,
    pub actors: u32,
    pub restart: RestartPolicy,
    /// From a learner's start to its `Ready`. One that takes longer is started again, once.
    pub learner_ready: Duration,
    /// From the last learner's `Ready` until all actors have answered.
    pub actors_connected: Duration,
    /// The longest that learners may be without a finished rollout or update: all that counts while it is not known how
    /// long they take, and the upper bound afterwards.
    pub silence: Duration,
    /// No learner is taken to hang before this, however quick it was.
    pub floor: Duration,
    /// The longest that a checkpoint may take, while it is not known how long it takes. It counts where one has not
    /// begun yet.
    pub first_save: Duration,
    /// No learner that writes a checkpoint is taken to hang before this: it waits for the disk, as it does for a recorder
    /// that stands still, and whoever were started in its place would wait, too.
    pub disk: Duration,
    /// An actor that the learner has waited for this long, and that has run this long, is taken to hang.
    pub actor_silence: Duration,
    /// From a learner's `Finished` to its exit.
    pub learner_leaves: Duration,
    /// From an actor's closed lifeline to its exit.
    pub actor_leaves: Duration,
    /// From SIGKILL to the death: longer only when the kernel itself is stuck.
    pub killed: Duration,
    pub overlap: bool,
}

impl Deadlines {
    pub fn of(config: &Config) -> Self {
        let actor_deadline = Duration::from_secs_f64(config.learner.actor_deadline_s.min(1e6));
        Self {
            kitchens: config.kitchens(),
            learners: config.learner.count,
            actors: config.actors.count,
            restart: RestartPolicy::default(),
            learner_ready: Duration::from_mins(2),
            actors_connected: 2 * actor_deadline + Duration::from_secs(30),
            silence: Duration::from_secs_f64(config.longest_update_s()) + 2 * actor_deadline,
            floor: Duration::from_secs_f64(config.learner.progress_deadline_s.min(1e6)),
            first_save: Duration::from_mins(3),
            disk: Standstill::DEADLINE,
            actor_silence: actor_deadline,
            learner_leaves: Duration::from_secs(30),
            // All leave at once, and share the cores.
            actor_leaves: Duration::from_secs(2) + Duration::from_millis(20) * config.actors.count,
            killed: Duration::from_secs(10),
            overlap: config.ppo.overlap,
        }
    }

    /// How long learners may be at this work, before they are taken to hang. `first`: it is the first of its kind since
    /// they were started. A checkpoint that fails is followed by a rollout without a word.
    pub fn patience(&self, work: Work, pace: &Pace, first: bool) -> Duration {
        match work {
            Work::Save => self.save(pace, first) + self.longest(Work::Collect, pace, false),
            Work::Collect | Work::Update | Work::Play => self.longest(work, pace, first),
        }
    }

    /// The longest of the last times of this work. With `ppo.overlap` a rollout is reported collected when it and the
    /// update beside it are through: then either event may follow the one before at once, or after a whole rollout.
    pub(super) fn measured(&self, work: Work, pace: &Pace) -> Option<Duration> {
        match work {
            Work::Collect | Work::Update if self.overlap => pace.longest(Work::Collect).max(pace.longest(Work::Update)),
            Work::Collect | Work::Update | Work::Save | Work::Play => pace.longest(work),
        }
    }

    fn save(&self, pace: &Pace, first: bool) -> Duration {
        self.longest(Work::Save, pace, first).max(self.disk)
    }

    fn longest(&self, work: Work, pace: &Pace, first: bool) -> Duration {
        let most = self.silence;
        match (self.measured(work, pace), work) {
            (Some(longest), _) => {
                let usual = (longest * MARGIN).max(self.floor);
                if first { usual * FIRST } else { usual }.min(most)
            }
            (None, Work::Save) => self.first_save.min(most),
            (None, Work::Collect | Work::Update | Work::Play) => most,
        }
    }

    pub(super) fn warning(&self, work: Work, pace: &Pace, first: bool) -> Duration {
        match self.measured(work, pace) {
            Some(longest) if !first => (longest * WARNING).max(self.floor / 6),
            _ => self.floor,
        }
    }

    /// How long a stop may take that begins in the middle of this work: it ends or is abandoned, and a checkpoint is
    /// written. One that has begun is given its own time.
    pub fn stop(&self, work: Work, pace: &Pace, first: bool) -> Duration {
        match work {
            Work::Save => self.save(pace, first),
            Work::Play => self.longest(work, pace, first),
            Work::Collect | Work::Update => self.longest(work, pace, first) + self.longest(Work::Save, pace, false),
        }
    }

    /// How long an actor may leave its learner waiting. An answer of a kitchen is a small part of a rollout; how long an
    /// environment of the user's own takes, its user says.
    pub(super) fn actor_patience(&self, pace: &Pace) -> Duration {
        if self.kitchens == Kitchens::Elsewhere {
            return self.actor_silence;
        }
        let measured = self.measured(Work::Collect, pace).map(|longest| (longest * MARGIN).max(self.floor / 2));
        measured.unwrap_or(self.actor_silence).min(self.actor_silence)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seconds(value: f64) -> Duration {
        Duration::from_secs_f64(value)
    }

    #[test]
    fn patience_follows_what_was_measured_between_a_floor_and_the_longest() {
        let deadlines = Deadlines::of(&Config::default());
        let mut pace = Pace::default();
        let patience = |pace: &Pace, first| deadlines.patience(Work::Update, pace, first);
        assert_eq!(
            (patience(&pace, true), deadlines.warning(Work::Update, &pace, true)),
            (deadlines.silence, seconds(60.0))
        );
        assert_eq!(deadlines.stop(Work::Save, &pace, true), seconds(600.0));
        assert_eq!(deadlines.patience(Work::Save, &pace, true), seconds(600.0) + deadlines.silence);
        assert_eq!(deadlines.actor_patience(&pace), seconds(60.0));
        pace.took(Work::Update, seconds(0.5));
        assert_eq!((patience(&pace, false), patience(&pace, true)), (seconds(60.0), seconds(120.0)));
        assert_eq!(deadlines.warning(Work::Update, &pace, false), seconds(10.0));
        pace.took(Work::Update, seconds(20.0));
        assert_eq!((patience(&pace, false), patience(&pace, true)), (seconds(200.0), seconds(400.0)));
        assert_eq!(deadlines.warning(Work::Update, &pace, false), seconds(60.0));
        assert_eq!(deadlines.stop(Work::Update, &pace, false), seconds(380.0));
        pace.took(Work::Update, seconds(500.0));
        assert_eq!(patience(&pace, false), deadlines.silence);
        pace.took(Work::Collect, seconds(1.0));
        assert_eq!(deadlines.actor_patience(&pace), seconds(30.0));
        pace.took(Work::Collect, seconds(9.0));
        assert_eq!(deadlines.actor_patience(&pace), deadlines.actor_silence, "never longer than the deadline");
        let mut of_another_simulator = deadlines;
        of_another_simulator.kitchens = Kitchens::Elsewhere;
        let mut quick = Pace::default();
        quick.took(Work::Collect, seconds(0.1));
        assert_eq!(deadlines.actor_patience(&quick), seconds(30.0));
        assert_eq!(of_another_simulator.actor_patience(&quick), seconds(60.0), "as its user says");
    }

    /// The files of `deploy/` gave a run less time than it takes itself, and had it killed while it saved.
    #[test]
    fn whoever_stops_a_run_by_a_file_of_ours_gives_it_the_time_that_a_hanging_disk_gets() {
        let deadlines = Deadlines::of(&Config::default());
        let mut pace = Pace::default();
        // What the files say.
        pace.took(Work::Update, seconds(30.0));
        // An update, then the first checkpoint, which hangs as long as it may; then learners that do not leave.
        let stop = deadlines.stop(Work::Update, &pace, false) + deadlines.save(&pace, true);
        let bound = stop + deadlines.learner_leaves + deadlines.killed;
        let given = |text: &str, before: &str, unit: u64| {
            let (_, rest) = text.split_once(before).unwrap();
            let digits: String = rest.chars().take_while(char::is_ascii_digit).collect();
            Duration::from_secs(digits.parse::<u64>().unwrap() * unit)
        };
        let service = include_str!("../../../deploy/systemd/stillroom@.service");
        assert!(given(service, "TimeoutStopSec=", 60) > bound, "{bound:?}");
        for pods in [
            include_str!("../../../deploy/kubernetes/jobset.yaml"),
            include_str!("../../../deploy/kubernetes/runtime.yaml"),
        ] {
            assert!(given(pods, "terminationGracePeriodSeconds: ", 1) > bound, "{bound:?}");
        }
        let checked = include_str!("../../../deploy/check_manifests.py");
        assert!(given(checked, "GRACE_S = ", 1) > bound, "{bound:?}");
        let container = include_str!("../../../docs/cluster.md");
        assert!(given(container, "--stop-timeout ", 1) > bound, "{bound:?}");
    }

    /// With overlap it is usually a moment from the end of an update to that of the rollout collected beside it. At the
    /// begin of a stage it is a whole rollout.
    #[test]
    fn beside_each_other_rollouts_and_updates_have_the_time_of_the_longer() {
        let mut config = Config::default();
        config.ppo.overlap = true;
        let deadlines = Deadlines::of(&config);
        let mut pace = Pace::default();
        pace.took(Work::Update, seconds(20.0));
        pace.took(Work::Collect, seconds(0.001));
        for work in [Work::Collect, Work::Update] {
            assert_eq!(deadlines.patience(work, &pace, false), seconds(200.0), "{work}");
            assert_eq!(deadlines.warning(work, &pace, false), seconds(60.0), "{work}");
        }
        assert_eq!(deadlines.actor_patience(&pace), deadlines.actor_silence);
        pace.took(Work::Collect, seconds(30.0));
        assert_eq!(deadlines.patience(Work::Update, &pace, false), seconds(300.0));
        assert_eq!(Deadlines::of(&Config::default()).patience(Work::Update, &pace, false), seconds(200.0));
    }
}
