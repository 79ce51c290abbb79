//! Environments of Python in a run: the same weights as built-in actors train, one sentence for each way to fail, and
//! nothing started that the user has not named.
//!
//! They need a Python with the package `stillroom`, which `STILLROOM_TEST_PYTHON` names: `make test-python` runs them.

use proto::run_folder::RunFolder;
use proto::task::{Role, Spec};
use rustix::process::Signal;
use std::path::Path;
use std::process::Command;
use std::time::Duration;
use system_tests::{
    Browser, Printed, TINY, Viewer, Workshop, complete, finish, kill, kill_child, signal, start, wait_for, wait_until,
};
use toml::{Table, Value};

const ACTORS: u32 = 2;
const ENVIRONMENTS: u32 = 3;
/// In the last step of the last rollout some environments of an actor act, and others do not.
const FRAMES: u64 = 603;
const SEED: u64 = 5;

/// A workshop, and a Python with the package.
struct Place {
    workshop: Workshop,
    python: String,
}

fn place() -> Place {
    let python = std::env::var("STILLROOM_TEST_PYTHON").expect("STILLROOM_TEST_PYTHON: `make test-python` names it");
    let workshop = Workshop::new();
    std::fs::write(workshop.path("task.toml"), declaration()).expect("a writable folder");
    std::fs::write(workshop.path("sums.toml"), SUMS).expect("a writable folder");
    Place { workshop, python }
}

/// The network averages over windows of an image.
const SUMS: &str = "[[channels]]\nname = \"depth_mm\"\nrole = \"observation\"\ndtype = \"u16\"\nshape = [224, 224]\n\
                    sums = 2\ndoc = \"\"\n";

fn source(name: &str) -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/system/environments");
    folder.join(name).to_str().expect("a path of text").to_owned()
}

/// What `ArmPointNav` declares beside its spaces: the image's sums, parts of rewards, rewards, weights, label and cost.
fn declaration() -> String {
    let spec = Spec::built_in().iter().find(|spec| spec.name == "arm_point_nav").expect("a built-in task");
    let mut table: Table = toml::from_str(spec.text()).expect("a declaration");
    table.retain(|key, _| ["channels", "rewards", "weights", "label", "cost"].contains(&key));
    let wanted = |name: &str| {
        spec.channel(name).is_some_and(|(channel, _)| matches!(channel.role, Role::Part | Role::Observation))
    };
    let Some(Value::Array(channels)) = table.get_mut("channels") else { panic!("a declaration has channels") };
    channels.retain(|channel| wanted(channel["name"].as_str().expect("a name")));
    toml::to_string(&table).expect("tables can be written")
}

impl Place {
    /// A command of the user who begins the runs.
    fn user(&self, mut command: Command) -> Command {
        command.env("XDG_STATE_HOME", self.workshop.path("states"));
        command
    }

    /// `orchestrator` with these arguments, complete.
    fn orchestrator(&self, arguments: &[&str]) -> Printed {
        complete(self.user(self.workshop.orchestrator(arguments)))
    }

    fn assert_replays(&self, run: &str) {
        let replayed = self.orchestrator(&["replay", run, "--check"]);
        assert!(replayed.success && replayed.stdout.contains("differences: 0"), "{replayed:#?}");
    }

    /// `orchestrator up` with environments of a file beside this one.
    fn up(&self, run: &str, env: &str, kwargs: &serde_json::Value, more: &[&str]) -> Command {
        let mut command = self.workshop.up_seeded(run, ACTORS, ENVIRONMENTS, FRAMES, SEED);
        command.args(["--env", &source(env), "--python", &self.python, "--env-kwargs", &kwargs.to_string()]);
        command.args(more);
        self.user(command)
    }

    /// The kitchen of a scene, played by Python.
    fn kitchen(&self, run: &str) -> Command {
        let kwargs = serde_json::json!({
            "seed": SEED, "environments": ACTORS * ENVIRONMENTS, "scene": scene(), "preset": "demo", "max_steps": 24,
            "start_distance_max_m": 1.0, "goal_distance_max_m": 1.0,
        });
        self.up(run, "kitchen.py:make_env", &kwargs, &["--env-declaration", "task.toml"])
    }

    /// `orchestrator up` with an environment of numbers alone.
    fn of_numbers(&self, run: &str, env: &str, more: &[&str]) -> Command {
        let mut command = self.workshop.orchestrator(&["up", "--preset", "gym", "--run", run, "--env", env]);
        command.args(["--python", &self.python, "--actors", "2", "--envs-per-actor", "3", "--frames", "1200"]);
        for setting in ["ppo.rollout_steps=20", "ppo.epochs=2", "ppo.minibatches=1", "checkpoint.interval_s=0.0"] {
            command.args(["--set", setting]);
        }
        command.args(more);
        self.user(command)
    }

    /// The weights that built-in actors train in the scene.
    fn built_in(&self) -> (String, u64) {
        let mut command = self.workshop.up_seeded("built-in", ACTORS, ENVIRONMENTS, FRAMES, SEED);
        command.args(["--set", &format!("scenes=[\"{}\"]", scene())]);
        complete(command).result()
    }

    /// A run is begun, its first actor is killed in the second rollout, and its learner in the fourth.
    fn disturbed(&self, run: &str, command: Command) -> Printed {
        let child = start(command);
        for (rollouts, word) in [(1, "--actor 0 "), (3, "--rank 0 ")] {
            self.workshop.run(run).wait_for_rollouts(rollouts);
            self.workshop.run(run).processes(word).into_iter().for_each(kill);
        }
        finish(child)
    }
}

fn scene() -> String {
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes/studio/scene.toml");
    scene.canonicalize().expect("a scene").to_str().expect("a path of text").to_owned()
}

#[test]
#[ignore = "needs a Python with the package: make test-python"]
fn a_kitchen_that_python_serves_ends_in_the_weights_of_built_in_actors_killed_or_not() {
    let place = place();
    let workshop = &place.workshop;
    let expected = place.built_in();
    let served = complete(place.kitchen("served"));
    assert_eq!(served.result(), expected);
    assert_eq!(served.deaths(), Vec::<&str>::new());
    let killed = place.disturbed("killed", place.kitchen("killed"));
    assert!(!killed.deaths().is_empty(), "{killed:#?}");
    assert_eq!(killed.result(), expected);
    workshop.run("killed").assert_nothing_left();
    for run in ["served", "killed"] {
        place.assert_replays(run);
        let filmed = place.orchestrator(&["replay", run]);
        filmed.refused("films need 'rgb_array'");
        assert!(
            filmed.stderr.matches("rgb_array").count() == 1 && !filmed.stderr.contains("exit status"),
            "{filmed:#?}"
        );
    }
}

/// The seeds of an evaluation's episodes follow from nothing but their numbers, and so does its table.
#[test]
#[ignore = "needs a Python with the package: make test-python"]
fn an_evaluation_is_the_same_by_any_number_of_workers_and_kills() {
    let place = place();
    let workshop = &place.workshop;
    let validated = ["--set", "validation.every_frames=600", "--set", "validation.episodes=4"];
    assert!(complete(place.of_numbers("run", "gymnasium:CartPole-v1", &validated)).success);
    let table = |out: &str| std::fs::read_to_string(workshop.path(out).join("episodes.csv")).expect("a table");
    let eval = |out: &str, more: &[&str], fault: Option<&str>| {
        let arguments = [&["eval", "run", "--episodes", "9", "--json", "--out", out], more].concat();
        let mut command = place.user(workshop.orchestrator(&arguments));
        command.envs(fault.map(|fault| ("STILLROOM_FAULT", fault)));
        let printed = complete(command).good();
        (table(out), printed.json())
    };
    let (undisturbed, result) = eval("one", &["--actors", "1", "--environments", "1"], None);
    assert_eq!(undisturbed.lines().next(), Some("episode,end,length,return_r,score,state_hash"));
    assert_eq!(undisturbed.lines().count(), 10);
    let (mean, interval) = (result["overall"]["score"].as_f64().unwrap(), &result["intervals"]["score"]);
    assert!(interval[0].as_f64().unwrap() <= mean && mean <= interval[1].as_f64().unwrap(), "{result:#}");
    for (out, actors, environments, fault) in
        [("many", "3", "2", None), ("killed", "2", "8", Some("actor.before_send:31"))]
    {
        let (again, _) = eval(out, &["--actors", actors, "--environments", environments], fault);
        assert_eq!(again, undisturbed, "{out}");
        workshop.run(out).assert_nothing_left();
    }
    // What chose the best checkpoint is not what tests it.
    let (validation, _) = eval("validation", &["--split", "validation"], None);
    assert_ne!(validation, undisturbed);
    let score = std::fs::read_to_string(RunFolder::new(workshop.path("run")).validation_log()).expect("two lines");
    assert!(score.lines().count() == 2 && score.contains("\"score\":"), "{score}");
    for arguments in [&["eval", "run/best", "--episodes", "3"][..], &["compare", "run", "one"]] {
        let printed = place.orchestrator(arguments);
        assert!(printed.success && printed.stdout.contains("score"), "{arguments:?} {printed:#?}");
        // The number under which a record has the place of such an environment; a date may hold it, too.
        let mut words = printed.stdout.split(|mark: char| !mark.is_alphanumeric() && mark != '-');
        assert!(words.all(|word| word != "128"), "{arguments:?} {printed:#?}");
    }
    assert!(place.orchestrator(&["report", "run"]).success);
    let report = workshop.json("run/report/report.json");
    let results = report["groups"][0]["results"].to_string();
    assert!(results.contains("\"score\"") && results.contains("-seeds"), "{results}");
    for refused in [&["--split", "train"][..], &["--kitchens", "procedural:1000..1003"], &["--distribution", "run"]] {
        let printed = place.orchestrator(&[&["eval", "run"], refused].concat());
        assert!(!printed.success && printed.stderr.lines().count() == 1, "{printed:#?}");
    }
}

/// Snapshots bring back what no seed and actions could, and what is lost without them ends its episode.
#[test]
#[ignore = "needs a Python with the package: make test-python"]
fn an_environment_is_restored_as_it_declares() {
    let place = place();
    let workshop = &place.workshop;
    let own = |class: &str| source(&format!("restored.py:{class}"));
    let pendulum = source("../../../../python/examples/pendulum.py:make_env");
    for (name, env) in [("snapshot", own("Kept")), ("pendulum", pendulum)] {
        let expected = complete(place.of_numbers(name, &env, &[])).result();
        let killed = place.disturbed(&format!("{name}-killed"), place.of_numbers(&format!("{name}-killed"), &env, &[]));
        assert!(!killed.deaths().is_empty(), "{killed:#?}");
        assert_eq!(killed.result(), expected, "{name}");
        // A learner without a checkpoint begins again, and its actors, which have gone on, too.
        let run = format!("{name}-anew");
        let more = ["--set", "checkpoint.interval_s=1000.0"];
        let anew = place.disturbed(&run, place.of_numbers(&run, &env, &more));
        assert!(!anew.deaths().is_empty(), "{anew:#?}");
        assert_eq!(anew.result(), expected, "{run}");
        let status = place.orchestrator(&["status", name]).stdout;
        assert!(status.contains("restore snapshot: "), "{status}");
    }
    let killed = place.disturbed("none", place.of_numbers("none", &own("Walk"), &[]));
    assert!(!killed.deaths().is_empty() && killed.stderr.contains("same in distribution only"), "{killed:#?}");
    assert_eq!(killed.result().1, 1200);
    workshop.run("none").assert_nothing_left();
    place.orchestrator(&["replay", "none", "--check"]).refused("cannot be restored");
    for class in ["Forgetful", "Claiming"] {
        complete(place.of_numbers("refused", &own(class), &[])).refused("the environment does not repeat itself");
    }
    let child = start(place.of_numbers("other", &own("ByProcess"), &[]));
    workshop.run("other").wait_for_rollouts(1);
    workshop.run("other").processes("--actor 0 ").into_iter().for_each(kill);
    let other = finish(child);
    let found = other.stderr.lines().find(|line| line.contains("led to another state before this process was started"));
    let line = found.unwrap_or_else(|| panic!("{other:#?}"));
    assert!(["actor", "environment ", ", episode ", ", step "].iter().all(|part| line.contains(part)), "{line}");
    assert!(!other.success, "{other:#?}");
}

/// Numbers, choices and images cross, are recorded, and are taken again after kills; by one learner or two.
#[test]
#[ignore = "needs a Python with the package: make test-python"]
fn a_run_with_actions_and_images_of_any_kind_ends_in_the_same_weights_killed_or_not() {
    let place = place();
    let stage = "stages=[{ name = \"I\", reward = \"r\", frames = 600 }]";
    let alone = ["auxiliary.task=none", "network.goal=plain", "network.previous_action=false"];
    let told = "channels = [
        { name = \"elapsed\", role = \"privileged\", dtype = \"u8\", range = [0, 7], doc = \"Steps so far.\" },
        { name = \"wanted\", role = \"privileged\", dtype = \"f32\", shape = [4], range = [0, 4], doc = \"What pays.\" },
    ]";
    std::fs::write(place.workshop.path("told.toml"), told).expect("a writable folder");
    std::fs::write(place.workshop.path("none.toml"), "").expect("a writable folder");
    for (kind, more, memory, declaration) in [
        ("numbers", "learner.shards=2", "none", "none.toml"),
        ("choices", "ppo.overlap=true", "lstm", "none.toml"),
        ("told", "learner.shards=2", "lstm", "told.toml"),
        ("images", "ppo.minibatches=2", "none", "none.toml"),
        ("masked", "learner.shards=2", "none", "none.toml"),
        ("masked_choices", "ppo.overlap=true", "none", "none.toml"),
    ] {
        let memory = format!("network.memory={memory}");
        let settings = [stage, more, &memory].into_iter().chain(alone).flat_map(|setting| ["--set", setting]);
        let settings: Vec<&str> = settings.chain(["--env-declaration", declaration]).collect();
        let run = |name: &str| place.up(name, &format!("actions.py:{kind}"), &serde_json::json!({}), &settings);
        let expected = complete(run(kind)).result();
        let name = format!("{kind}-killed");
        let killed = place.disturbed(&name, run(&name));
        assert!(!killed.deaths().is_empty(), "{killed:#?}");
        assert_eq!(killed.result(), expected, "{kind}");
        for run in [kind, &name] {
            place.assert_replays(run);
        }
        if more == "learner.shards=2" {
            let mut two = run(&format!("{kind}-of-two"));
            two.args(["--learners", "2"]);
            assert_eq!(complete(two).result(), expected, "shards give the same weights to any number of learners");
        }
    }
    the_page_says_nothing_of_kitchens(&place.workshop, "numbers");
}

/// Pictures, targets and failures are of tasks that have them.
fn the_page_says_nothing_of_kitchens(workshop: &Workshop, run: &str) {
    let Some(mut browser) = Browser::start() else { return };
    let viewer = Viewer::start(workshop, &[run]);
    browser.open(&viewer.page());
    for (page, ready) in [
        (String::new(), ".state.complete"),
        (format!("http://{}/#/run/{run}/episodes", viewer.address), "table.episodes tbody tr:nth-child(2)"),
    ] {
        if !page.is_empty() {
            browser.open(&page);
        }
        browser.wait_for(&format!("document.querySelector({ready:?})"));
        let shown = browser.value("document.body.innerText.toLowerCase()");
        // A command has the program's path.
        let shown = shown.as_str().expect("text").replace("/target/release/", "/");
        for word in ["kitchen", "target", "failure", "newest episodes"] {
            assert!(!shown.contains(word), "{word}: {shown}");
        }
        let links = browser.value("document.querySelectorAll('a[href*=\"/episode/\"]').length > 0");
        assert_eq!(links, !page.is_empty(), "the table's rows lead to episodes");
    }
    // An episode has its steps without pictures, and the command of its film.
    let episode = "[...document.querySelectorAll('table.episodes a')].find(({ hash }) => hash.endsWith('-2-3'))";
    browser.value(&format!("{episode}.click()"));
    browser.wait_for("document.querySelector('canvas.strip')");
    browser.press("ArrowRight");
    browser.wait_for("document.querySelector('main').innerText.includes('step 1')");
    let command = format!(" replay {run} --environment 2 --episode 3");
    browser.wait_for(&format!("document.querySelector('main').innerText.includes({command:?})"));
    assert_eq!(browser.value("document.querySelector('.picture, .film') === null"), true);
    assert_eq!(browser.complaints, Vec::<String>::new(), "the page's console has no error");
    assert!(viewer.stop());
}

/// Environments of an image and a place, which fail as the arguments say.
fn faulty(place: &Place, name: &str, function: &str, kwargs: &serde_json::Value) -> Command {
    let text = TINY.replace("actor_deadline_s = 60.0", "actor_deadline_s = 10.0");
    std::fs::write(place.workshop.path("tiny.toml"), text).expect("a writable folder");
    let stage = format!("stages=[{{ name = \"I\", reward = \"r\", frames = {FRAMES} }}]");
    let more = ["--env-declaration", "sums.toml", "--set", &stage, "--set", "auxiliary.weight=0.0"];
    place.up(name, &format!("faulty.py:{function}"), kwargs, &more)
}

#[test]
#[ignore = "needs a Python with the package: make test-python"]
fn vectors_end_in_the_weights_of_single_environments_killed_or_not() {
    let place = place();
    let expected = complete(faulty(&place, "single", "make_env", &serde_json::json!({}))).result();
    for mode in ["NextStep", "SameStep", "Disabled"] {
        let vectors = faulty(&place, mode, "make_vector", &serde_json::json!({ "mode": mode }));
        assert_eq!(complete(vectors).result(), expected, "{mode}");
    }
    let killed =
        place.disturbed("killed", faulty(&place, "killed", "make_vector", &serde_json::json!({ "mode": "NextStep" })));
    assert!(!killed.deaths().is_empty(), "{killed:#?}");
    assert_eq!(killed.result(), expected);
    place.assert_replays("killed");
}

/// An environment that fails once: the sentence, whether the actor dies of it, and the weights.
#[test]
#[ignore = "needs a Python with the package: make test-python"]
fn every_failure_is_one_sentence_and_costs_nothing() {
    let place = place();
    let workshop = &place.workshop;
    let run = |name: &str, fault: &str| {
        let kwargs = serde_json::json!({ "fault": fault, "marker": workshop.path(&format!("{name}.marker")) });
        complete(faulty(&place, name, "make_env", &kwargs))
    };
    let expected = run("sound", "").result();
    for (fault, sentence) in [
        ("step", "step() raised ZeroDivisionError: the robot fell over ("),
        ("reset", "reset() raised ValueError: no start was found"),
        ("shape", "its `goal_m` is an array of [2] float32, not an array of [3] float32"),
        ("dtype", "its `goal_m` is an array of [3] int16, not an array of [3] float32"),
        ("list", "its `goal_m` is a list, not an array of [3] float32"),
        ("range", "its goal_m[0] is 7."),
        ("nan", "its goal_m[0] is not finite"),
        ("reward", "its reward is not finite"),
        ("key", "it gives no `goal_m`"),
        ("tuple", "step() returned 2 values, not (observation, reward, terminated, truncated, info)"),
        ("end", "step()'s `terminated` is a str, not a bool"),
        ("none", "step()'s reward is None, not a number of type float32"),
        ("exit", "step() called sys.exit(enough)"),
        ("os_exit", "exit status 3, its last call was in environment"),
        ("segfault", "signal 11 (SIGSEGV), its last call was in environment"),
        ("hang", "killed by the orchestrator, its last call was in environment"),
        ("print", ""),
        ("child", "exit status 3, its last call was in environment"),
    ] {
        let printed = run(fault, fault);
        assert_eq!(printed.result(), expected, "{fault}");
        let found = printed.stderr.lines().find(|line| line.contains(sentence));
        let line = found.unwrap_or_else(|| panic!("{fault}: no line with `{sentence}`: {printed:#?}"));
        println!("{fault}: {line}");
        if !sentence.is_empty() {
            let named = ["environment ", ", episode ", ", step "].iter().all(|part| line.contains(part));
            assert!(named && line.contains("actor"), "{fault}: {line}");
            let is_placed = !line.contains("() raised ") || line.contains("faulty.py:");
            let hangs = line.contains("killed by the orchestrator") || line.contains("SIGSEGV");
            assert!(is_placed && (!hangs || line.contains("faulty.py:")), "{fault}: {line}");
        }
        assert_eq!(printed.deaths().is_empty(), sentence.is_empty(), "{fault}: {printed:#?}");
        workshop.run(fault).assert_nothing_left();
        assert_eq!(workshop.run(fault).processes(fault), Vec::<u32>::new(), "no process is left behind");
    }
    // The first actor to get there fails.
    let logged = |name: &str| {
        let log = |actor| std::fs::read_to_string(workshop.run(name).folder.log(&format!("actor-{actor:02}")));
        (0..ACTORS).map(|actor| log(actor).unwrap_or_default()).collect::<String>()
    };
    assert!(logged("print").contains("a line of the environment's own"));
    assert!(logged("step").contains("Traceback"));
}

/// Its seeds and actions lead to the same error at every start.
#[test]
#[ignore = "needs a Python with the package: make test-python"]
fn an_environment_that_fails_at_every_start_ends_the_run_with_its_sentence() {
    let place = place();
    let kwargs = serde_json::json!({ "fault": "shape", "marker": "always" });
    let printed = complete(faulty(&place, "run", "make_env", &kwargs));
    assert!(!printed.success && printed.deaths().len() <= 2 + ACTORS as usize, "{printed:#?}");
    let last = " died twice of the same error: environment ";
    let ended: Vec<&str> = printed.stderr.lines().filter(|line| line.contains(last)).collect();
    let mend = "step 5: its `goal_m` is an array of [2] float32, not an array of [3] float32; mend the environment, then \
                resume the run";
    assert!(ended.len() == 1 && ended[0].contains("ERROR") && ended[0].ends_with(mend), "{printed:#?}");
    place.workshop.run("run").assert_nothing_left();
}

#[test]
#[ignore = "needs a Python with the package: make test-python"]
fn a_leak_is_said_once_of_each_actor_and_stands_in_the_status() {
    let place = place();
    let env = source("restored.py:Leaking");
    let printed = complete(place.of_numbers("run", &env, &[]));
    let status = place.orchestrator(&["status", "run"]).stdout;
    for actor in ["actor-00", "actor-01"] {
        let sentence = format!("{actor}: its memory grew by ");
        for text in [&printed.stderr, &status] {
            let found: Vec<&str> = text.lines().filter(|line| line.contains(&sentence)).collect();
            assert_eq!(found.len(), 1, "{text}");
            assert!(found[0].contains(" MiB in its last ") && found[0].contains(" leaks"), "{found:?}");
        }
    }
    let other = place.orchestrator(&["status", "--json", "run"]).stdout;
    assert!(other.contains("\"growth\":{\"actor-00\":\"its memory grew"), "{other}");
}

#[test]
#[ignore = "needs a Python with the package: make test-python"]
fn an_environment_that_cannot_take_part_is_refused_before_a_run_begins() {
    let place = place();
    let workshop = &place.workshop;
    let refused = |arguments: &[&str]| {
        let printed = place.orchestrator(&[&["up", "--run", "refused"], arguments].concat());
        assert!(!printed.success && !workshop.path("refused").exists(), "{printed:#?}");
        printed.stderr
    };
    let python = place.python.as_str();
    for (env, expected) in [
        ("gymnasium:NoSuchThing-v0", "the environment cannot be made"),
        ("no_such_module:make_env", "there is no Python module `no_such_module`"),
        ("./no_such_file.py:make_env", "there is no file"),
        ("json:no_such_function", "`json` has no function `no_such_function`"),
        ("json:loads", "the environment cannot be made"),
        ("nothing", "expected gymnasium:ID, envpool:ID, package.module:function or ./file.py:function"),
    ] {
        let said = refused(&["--python", python, "--env", env]);
        assert!(said.contains(expected), "{env}: {said}");
    }
    for (env, expected) in [
        ("faulty.py:random_env", "the environment does not repeat itself"),
        ("faulty.py:at_once", "the environment's reward is nan"),
        ("actions.py:stuck", "the environment's action_mask allows no option"),
    ] {
        let said = refused(&["--python", python, "--env", &source(env)]);
        assert!(said.contains(expected), "{said}");
    }
    let said = refused(&["--python", "/usr/bin/env", "--env", "gymnasium:CartPole-v1"]);
    assert!(said.lines().count() < 4, "{said}");
    let said = refused(&["--python", python, "--env", "gymnasium:CartPole-v1", "--env-kwargs", "[1"]);
    assert!(said.contains("--env-kwargs is no JSON"), "{said}");
}

/// While it is imported, and in a step: Ctrl-C, a request to end, and a kill, which says nothing.
#[test]
#[ignore = "needs a Python with the package: make test-python"]
fn a_trial_that_is_interrupted_leaves_no_process_and_says_that_nothing_was_begun() {
    let place = place();
    let workshop = &place.workshop;
    let hangs = "open(PLACE, 'w').write(str(os.getpid()))\nINDENTtime.sleep(1000)\n";
    let text = std::fs::read_to_string(source("faulty.py")).expect("a file beside this one");
    for (at, hang) in [("import", hangs.replace("INDENT", "")), ("step", hangs.replace("INDENT", "        "))] {
        for ended in [Signal::INT, Signal::TERM, Signal::KILL] {
            let marker = workshop.path(&format!("{at}-{}", ended.as_raw()));
            let hang = hang.replace("PLACE", &format!("{:?}", marker.display().to_string()));
            let hanging = match at {
                "import" => format!("import os, time\n{hang}"),
                _ => text.replace("        terminated = self._step == 9\n", &format!("        {hang}")),
            };
            std::fs::write(workshop.path("mine.py"), hanging).expect("a writable folder");
            let arguments = ["up", "--run", "run", "--env", "./mine.py:make_env", "--python", &place.python];
            let child = start(place.user(workshop.orchestrator(&arguments)));
            let pid = wait_for("it hangs", || std::fs::read_to_string(&marker).ok()?.parse::<u32>().ok());
            // It is said what it does, every five seconds.
            std::thread::sleep(Duration::from_secs(if at == "import" { 3 } else { 6 }));
            signal(child.id(), ended);
            let printed = finish(child);
            assert!(!printed.success && !workshop.path("run").exists(), "{printed:#?}");
            if ended != Signal::KILL {
                printed.refused("interrupted while the environment was tried: nothing was begun");
            }
            let doing = if at == "import" { "it is being imported, " } else { "step 1 of the episode with seed 0, " };
            assert!(printed.stderr.contains(&format!("trying the environment: {doing}")), "{printed:#?}");
            let stat = || std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
            wait_until("it is gone", || stat().is_empty() || stat().contains(") Z "));
        }
    }
}

#[test]
#[ignore = "needs a Python with the package: make test-python"]
fn a_step_of_the_trial_that_hangs_is_said_with_its_place() {
    let place = place();
    let kwargs = serde_json::json!({ "fault": "hang", "marker": "trial" }).to_string();
    let env = source("faulty.py:make_env");
    let arguments = ["up", "--run", "run", "--env", &env, "--env-kwargs", &kwargs, "--python", &place.python];
    let printed = place.orchestrator(&[&arguments[..], &["--set", "learner.actor_deadline_s=2"]].concat());
    printed.refused("the environment's step() has not returned for 2 s (last call: step 6 of the episode with seed 1)");
    assert!(printed.stderr.contains(", and is in step() (") && printed.stderr.contains("faulty.py:"), "{printed:#?}");
}

#[test]
#[ignore = "needs a Python with the package: make test-python"]
fn a_run_of_somebody_elses_starts_no_command_before_it_is_allowed() {
    let place = place();
    let workshop = &place.workshop;
    let child = start(place.kitchen("run"));
    workshop.run("run").wait_for_rollouts(1);
    place.orchestrator(&["stop", "run"]).good();
    assert!(finish(child).success);
    let other = |arguments: &[&str]| {
        let mut command = workshop.orchestrator(arguments);
        command.env("XDG_STATE_HOME", workshop.path("other-states"));
        complete(command)
    };
    for command in [&["resume", "run"][..], &["replay", "run", "--check"]] {
        let refused = other(command);
        assert!(!refused.success, "{refused:#?}");
        assert!(refused.stderr.contains("`orchestrator allow "), "{refused:#?}");
    }
    let allowed = other(&["allow", "run"]);
    assert!(allowed.success && allowed.stdout.contains("stillroom serve"), "{allowed:#?}");
    let resumed = other(&["resume", "run"]);
    assert_eq!(resumed.result().1, FRAMES);
}

/// A program in C with `stillroom_actor.h`, compiled into the workshop; `make library` builds what it needs.
fn compiled(workshop: &Workshop, file: &str, name: &str) -> String {
    let programs = system_tests::binary("orchestrator").parent().expect("a folder").to_owned();
    let program = workshop.path(name).to_str().expect("a path of text").to_owned();
    let folder = programs.to_str().expect("a path of text");
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
    let done = Command::new("cc")
        .args(["-std=c11", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2", file, "-o", &program])
        .args([&format!("-I{root}/actor/c/include"), &format!("-L{folder}"), "-lstillroom_actor", "-lm"])
        .arg(format!("-Wl,-rpath,{folder}"))
        .status();
    assert!(done.expect("a C compiler").success());
    program
}

/// The arithmetic is the same, and so are the seeds.
#[test]
#[ignore = "needs a Python with the package: make test-python"]
fn a_simulator_in_c_ends_in_the_weights_of_the_same_in_python_killed_or_not() {
    let place = place();
    let workshop = &place.workshop;
    let example = concat!(env!("CARGO_MANIFEST_DIR"), "/../actor/c/examples/cart_pole.c");
    let program = compiled(workshop, example, "cart_pole");
    let up = |run: &str, environment: &[&str]| {
        let common = ["up", "--run", run, "--actors", "2", "--envs-per-actor", "3", "--frames", "12000", "--seed", "5"];
        let set = ["--set", "ppo.rollout_steps=32", "--set", "learner.device=cpu"];
        place.user(workshop.orchestrator(&[&common, environment, &set].concat()))
    };
    let expected =
        complete(up("python", &["--env", &source("cart_pole.py:make_env"), "--python", &place.python])).result();
    assert_eq!(complete(up("c", &["--env-command", &program])).result(), expected);
    let killed = place.disturbed("killed", up("killed", &["--env-command", &program]));
    assert!(!killed.deaths().is_empty(), "{killed:#?}");
    assert_eq!(killed.result(), expected);
    place.assert_replays("c");
}

#[test]
#[ignore = "needs a Python with the package: make test-python"]
fn a_program_in_c_with_something_wrong_is_refused_in_a_sentence() {
    let workshop = Workshop::new();
    let program = compiled(&workshop, &source("wrong.c"), "wrong");
    for (wrong, expected) in [
        ("null", "was given no simulator"),
        ("argv", "was not given main's argc and argv"),
        ("abi", "compiled for ABI 7 of stillroom_actor.h, the library has 1"),
        ("actions", "has 255 actions, not 1 to 254"),
        ("name", "the simulator's name is NULL"),
        ("channels", "has 1 channels at 0x0"),
        ("count", "channels at 0x"),
        ("functions", "`make`, `reset` or `step` of the simulator is NULL"),
        ("role", "channel `seen` has role 9"),
        ("dimensions", "channel `seen` has 9 dimensions"),
        ("shape", "channel `seen` has 1 dimensions at 0x0"),
        ("text", "the name of channel 0 is not UTF-8"),
        ("outcome", "has no channel of STILLROOM_OBSERVATION"),
        ("mask", "its mask allows no action"),
        ("make", "make() failed: it does not say why"),
        ("reset", "reset() failed: it does not say why"),
        ("step", "step() failed: the robot fell over"),
        ("random", "it does not repeat itself"),
    ] {
        let mut command = Command::new(&program);
        let printed = command.args([wrong, "--describe"]).output().expect("a program");
        let said = String::from_utf8_lossy(&printed.stderr);
        assert_eq!(printed.status.code(), Some(2), "{wrong}: {said}");
        assert!(said.starts_with("stillroom: error: ") && said.contains(expected), "{wrong}: {said}");
        assert_eq!(said.lines().count(), 1, "{wrong}: {said}");
    }
}

/// The environment is another one when the run goes on.
#[test]
#[ignore = "needs a Python with the package: make test-python"]
fn an_environment_with_other_spaces_is_refused_by_name() {
    let place = place();
    let workshop = &place.workshop;
    let file = workshop.path("mine.py");
    let text = std::fs::read_to_string(source("faulty.py")).expect("a file beside this one");
    std::fs::write(&file, &text).expect("a writable folder");
    let mut command = workshop.up_seeded("run", 1, 1, 200_000, SEED);
    command.args(["--env", "./mine.py:make_env", "--env-declaration", "sums.toml", "--set", "auxiliary.weight=0.0"]);
    command
        .args(["--set", "stages=[{ name = \"I\", reward = \"r\", frames = 200000 }]"])
        .args(["--python", &place.python]);
    let child = start(place.user(command));
    workshop.run("run").wait_for_rollouts(1);
    std::fs::write(&file, text.replace("Discrete(2)", "Discrete(3)")).expect("a writable folder");
    workshop.run("run").processes("--actor 0 ").into_iter().for_each(kill);
    let log = RunFolder::new(workshop.path("run")).log("actor-00");
    wait_until("the actor refuses", || {
        std::fs::read_to_string(&log)
            .unwrap_or_default()
            .contains("the environment has 3 actions, but the run was begun")
    });
    kill_child(child);
}
