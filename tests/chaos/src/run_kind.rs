//! What is disturbed: small runs of every kind, each of a second or two when nothing happens to it.

use system_tests::TINY;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// `orchestrator up`, then `resume` until it is complete.
    Training,
    /// `orchestrator eval`, into a new folder after each of its own deaths.
    Evaluation,
    /// `orchestrator suite`, called until all is done.
    Suite,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RunKind {
    /// What it is called.
    pub name: &'static str,
    pub kind: Kind,
    pub learners: u32,
    pub actors: u32,
    pub environments: u32,
    pub frames: u64,
    /// Changes of the tiny configuration: (what is replaced, by what).
    changes: &'static [(&'static str, &'static str)],
    /// Further tables of it.
    tables: &'static str,
    /// Its scene, relative to the checkout.
    scene: Option<&'static str>,
    /// The results are the same whatever happens. Otherwise they depend on timing, and only what must always hold is
    /// compared.
    pub exact: bool,
    /// It has validations.
    pub validates: bool,
    /// An environment of Python in the kitchens' place: the class or function in a file beside the system's tests.
    pub environment: Option<&'static str>,
}

const PLAIN: RunKind = RunKind {
    name: "one learner",
    kind: Kind::Training,
    learners: 1,
    actors: 2,
    environments: 3,
    frames: 1803,
    changes: &[],
    tables: "",
    scene: None,
    exact: true,
    validates: false,
    environment: None,
};

/// All that is disturbed, each with how often it is drawn. No budget is a multiple of a step.
pub const RUN_KINDS: &[(u32, RunKind)] = &[
    (4, PLAIN),
    (3, RunKind { name: "two learners, inverse dynamics", learners: 2, tables: INVERSE_DYNAMICS, ..PLAIN }),
    (3, RunKind { name: "three learners", learners: 3, actors: 4, frames: 2003, ..PLAIN }),
    (2, RunKind { name: "one learner, CPC|A", tables: CPCA, ..PLAIN }),
    (2, RunKind { name: "Lagrangian", tables: LAGRANGIAN, ..PLAIN }),
    (
        2,
        RunKind {
            name: "pre-emption",
            learners: 3,
            actors: 3,
            frames: 4003,
            changes: &[("rollout_steps = 10\n", "rollout_steps = 40\npreemption_share = 0.6\n")],
            exact: false,
            ..PLAIN
        },
    ),
    (
        3,
        RunKind {
            name: "two learners, overlap",
            learners: 2,
            changes: &[("[ppo]\n", "[ppo]\noverlap = true\n")],
            tables: LAGRANGIAN,
            ..PLAIN
        },
    ),
    (2, RunKind { name: "scene", actors: 1, frames: 1003, scene: Some("scenes/studio/scene.toml"), ..PLAIN }),
    (3, RunKind { name: "validation", frames: 1203, tables: VALIDATION, validates: true, ..PLAIN }),
    (2, RunKind { name: "evaluation", kind: Kind::Evaluation, actors: 5, frames: 0, ..PLAIN }),
    (2, RunKind { name: "Python, snapshots", environment: Some("restored.py:Seeded"), ..PLAIN }),
    (2, RunKind { name: "Python, replay", environment: Some("cart_pole.py:make_env"), ..PLAIN }),
    (1, RunKind { name: "suite", kind: Kind::Suite, actors: 1, environments: 2, frames: 603, ..PLAIN }),
];

const INVERSE_DYNAMICS: &str = "[auxiliary]\ntask = \"inverse_dynamics\"\n";
const CPCA: &str = "[auxiliary]\ntask = \"cpca16\"\n";
/// `--frames` divides the budget as these stages do.
const LAGRANGIAN: &str = "[[stages]]\nname = \"I\"\nreward = \"r\"\nframes = 900\n\
                          [[stages]]\nname = \"II\"\nreward = \"lagrangian\"\nframes = 900\n";
/// Two of them: the end's may begin only after the first, which then runs or waits.
const VALIDATION: &str = "[validation]\nevery_frames = 700\nepisodes = 1\n";

/// Beside the preset gym.
const OF_NUMBERS: &str = "[ppo]\nrollout_steps = 10\nepochs = 2\nminibatches = 1\n\
                          [learner]\nthreads = 1\nactor_deadline_s = 60.0\n[checkpoint]\ninterval_s = 0.0\n";

/// A Python with the package, if there is one: `make chaos` names it, as `make test-python` does.
pub fn python() -> Option<String> {
    std::env::var("STILLROOM_TEST_PYTHON").ok().filter(|python| !python.is_empty())
}

impl RunKind {
    /// Whether it can be played here.
    pub fn is_possible(&self) -> bool {
        self.environment.is_none() || python().is_some()
    }

    /// What `orchestrator up` is given beside the configuration and sizes.
    pub fn words(&self) -> Vec<String> {
        let Some(environment) = self.environment else { return vec!["--preset".to_owned(), "demo".to_owned()] };
        // Of the checkout that this was compiled in.
        let env = format!("{}/../tests/system/environments/{environment}", env!("CARGO_MANIFEST_DIR"));
        let words = ["--preset", "gym", "--env", &env, "--python", &python().unwrap_or_default()];
        words.map(str::to_owned).to_vec()
    }

    pub fn config(&self) -> String {
        if self.environment.is_some() {
            return OF_NUMBERS.to_owned();
        }
        let tiny = self.changes.iter().fold(TINY.to_owned(), |text, (from, to)| {
            assert!(text.contains(from), "the tiny configuration holds {from:?}");
            text.replace(from, to)
        });
        // Of the checkout that this was compiled in.
        let scene = self
            .scene
            .map_or_else(String::new, |scene| format!("scenes = [\"{}/../../{scene}\"]\n", env!("CARGO_MANIFEST_DIR")));
        format!("{scene}{tiny}\n{}", self.tables)
    }

    /// Rollouts of the whole run, about.
    pub fn rollouts(&self) -> u64 {
        let steps = if self.exact { 10 } else { 40 };
        self.frames / (u64::from(self.actors * self.environments) * steps)
    }

    /// The suite's file: two seeds, each evaluated.
    pub fn suite(&self) -> String {
        format!(
            "seeds = [5, 6]\nframes = {}\n[[evaluations]]\nsplit = \"test\"\nobjects = \"novel\"\nepisodes = 1\n\
             [[runs]]\npreset = \"demo\"\nname = \"tiny\"\n\
             [config.actors]\ncount = {}\nenvironments_per_actor = {}\n{}",
            self.frames,
            self.actors,
            self.environments,
            TINY.replace("\n[", "\n[config.")
        )
    }
}
