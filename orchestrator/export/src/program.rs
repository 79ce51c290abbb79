//! The programs on a policy's page: a few lines of Python that let it act.

use crate::policy::{IMAGES, MASK, Policy};
use proto::task::{ActionHead, Dtype, Image, Place};
use std::ffi::OsStr;
use std::path::Path;

/// In the package's kitchens. `actions`: how many there are.
pub(crate) fn of_kitchens(policy: &Policy, model: &str, actions: usize) -> String {
    let episode = &policy.config.episode;
    let names = if policy.config.network.previous_action {
        r#"("depth", "goal", "previous_action")"#
    } else {
        r#"("depth", "goal")"#
    };
    format!(
        r#"```python
import numpy, onnxruntime, stillroom

policy, random = onnxruntime.InferenceSession("{model}"), numpy.random.default_rng(1)
env = stillroom.KitchenEnv(
    7, action_space="{action_space}", carried_goal="{carried_goal}", max_steps={max_steps},
    start_distance_max_m={start}, goal_distance_max_m={goal},
)
observation, info = env.reset(seed=1)
states, ended = {{name: numpy.zeros((1, {hidden}), numpy.float32) for name in {states:?}}}, False
while not ended:
    rows = {{name: numpy.expand_dims(observation[name], 0) for name in {names}}}
    log_probs, value, *after = policy.run(None, rows | states)
    states = dict(zip(states, after))
    action = random.choice({actions}, p=numpy.exp(log_probs[0]) / numpy.exp(log_probs[0]).sum())
    observation, reward, terminated, truncated, info = env.step(action)
    ended = terminated or truncated
print("success" if info["success"] else "failure", "after", info["step"], "steps")
```
"#,
        action_space = episode.action_space,
        carried_goal = policy.carried_goal(),
        max_steps = episode.max_steps,
        start = episode.start_distance_max_m,
        goal = episode.goal_distance_max_m,
        hidden = policy.config.network.hidden,
        states = policy.states(),
    )
}

/// In an environment of the user's own, whose observations are numbers and images.
pub(crate) fn of_own_environment(policy: &Policy, model: &str) -> String {
    let (given, before, after) = given(policy);
    let (imports, make) = made(policy.config.environment.as_ref().map_or(&[][..], |one| &one.command[..]));
    let action = match policy.config.action_head() {
        ActionHead::Discrete(_) => r#"int(out["log_probs"][0].argmax())  # training and evaluation sample"#.to_owned(),
        ActionHead::MultiDiscrete(counts) => {
            let ends = counts.iter().scan(0, |end, count| {
                *end += *count;
                Some(*end)
            });
            let ends: Vec<usize> = ends.take(counts.len().saturating_sub(1)).collect();
            format!(
                r#"numpy.array([part.argmax() for part in numpy.split(out["log_probs"][0], {ends:?})])
    action = action.reshape(env.action_space.shape)  # training and evaluation sample"#
            )
        }
        ActionHead::Box(_) => r#"out["means"][0].reshape(env.action_space.shape)  # training and evaluation sample
    action = numpy.clip(action, env.action_space.low, env.action_space.high)"#
            .to_owned(),
    };
    let (begins, inputs, goes_on) = match policy.states() {
        [] => (String::new(), "given", ""),
        states => (
            format!(
                "states = {{name: numpy.zeros((1, {hidden}), numpy.float32) for name in {states:?}}}\n",
                hidden = policy.config.network.hidden
            ),
            "given | states",
            "    states = {name: out[\"next_\" + name] for name in states}\n",
        ),
    };
    format!(
        r#"```python
import numpy, onnxruntime
{imports}

policy, env = onnxruntime.InferenceSession("{model}"), {make}
outputs = [output.name for output in policy.get_outputs()]
(seen, info), ended = env.reset(seed=1), False
{begins}{before}while not ended:
{given}    out = dict(zip(outputs, policy.run(None, {inputs})))
{goes_on}    action = {action}
{after}    seen, reward, terminated, truncated, info = env.step(action)
    ended = terminated or truncated
```
"#
    )
}

/// Lines that import what makes the environment that a command serves, and what makes it.
fn made(command: &[String]) -> (String, String) {
    let after = |word: &str| Some(command.get(command.iter().position(|one| one == word)? + 1)?.as_str());
    let Some((place, name)) = after("serve").and_then(|env| env.split_once(':')) else {
        return ("from mine import make_env  # the run's environment".to_owned(), "make_env()".to_owned());
    };
    let kwargs = after("--kwargs").filter(|&kwargs| kwargs != "{}");
    let (import, loads) = match kwargs {
        Some(kwargs) => ("import json\n", format!("**json.loads({kwargs:?})")),
        None => ("", String::new()),
    };
    let comma = if loads.is_empty() { "" } else { ", " };
    match place {
        "gymnasium" => (format!("{import}import gymnasium"), format!("gymnasium.make({name:?}{comma}{loads})")),
        "envpool" => {
            (format!("{import}from stillroom.pools import PoolEnv"), format!("PoolEnv({name:?}{comma}{loads})"))
        }
        _ => {
            let file = Path::new(place).extension().filter(|&extension| extension == "py").map(|_| Path::new(place));
            let folder = file.and_then(Path::parent).or_else(|| after("--path").map(Path::new));
            let module = file.and_then(Path::file_stem).map_or_else(|| place.into(), OsStr::to_string_lossy);
            let path = folder
                .map_or_else(String::new, |folder| format!("\nsys.path.insert(0, {:?})", folder.display().to_string()));
            let lines = format!("{import}import importlib, sys{path}\nmine = importlib.import_module({module:?})");
            (lines, format!("mine.{name}({loads})"))
        }
    }
}

/// Lines that fill in the model's inputs but its states, and for the last action a line before the loop and one behind
/// the choice.
fn given(policy: &Policy) -> (String, String, String) {
    let inputs = policy.inputs();
    let names = inputs.places().map(|place| place.name).chain(inputs.images.iter().map(|image| image.name.as_str()));
    let is_bare = names.eq(["observation"]);
    let spec = policy.config.spec();
    let seen = |name: &str| match spec.channel(name).and_then(|(channel, _)| channel.key.as_deref()) {
        Some(key) => format!("seen[{key:?}]"),
        None if is_bare => "seen".to_owned(),
        None => format!("seen[{name:?}]"),
    };
    let mut lines = vec!["given = {}".to_owned()];
    let parts: Vec<String> = inputs.places().map(|place| part_of(&seen(place.name), &place)).collect();
    if !parts.is_empty() {
        let name = policy.numbers_name();
        lines.push(format!("parts = [{}]", parts.join(", ")));
        lines.push("numbers = numpy.concatenate([numpy.ravel(part) for part in parts])".to_owned());
        lines.push(format!("given[{name:?}] = numbers.astype(numpy.float32)[None]"));
    }
    lines.extend(inputs.images.iter().map(|Image { name, field, .. }| {
        let numbers = if field.dtype == Dtype::F32 { ".astype(numpy.float32)" } else { "" };
        format!("given[\"{IMAGES}{name}\"] = {}{numbers}[None]", seen(name))
    }));
    if policy.is_masked() {
        lines.push(format!("given[{MASK:?}] = numpy.ravel(info[{MASK:?}]).astype(bool)[None]"));
    }
    let (mut before, mut after) = (String::new(), String::new());
    if policy.config.network.previous_action {
        lines.push("given[\"previous_action\"] = numpy.array([previous])".to_owned());
        before = format!("previous = {}\n", policy.config.action_head().outputs());
        "    previous = action\n".clone_into(&mut after);
    }
    (lines.iter().flat_map(|line| ["    ", line, "\n"]).collect(), before, after)
}

/// An observation as the network takes it.
fn part_of(seen: &str, place: &Place) -> String {
    match place.one_hot {
        None => seen.to_owned(),
        Some((0, count)) => format!("numpy.eye({count})[numpy.int64({seen})]"),
        Some((least, count)) => format!("numpy.eye({count})[numpy.int64({seen}) - ({least})]"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_environment_is_made_as_its_run_made_it() {
        let of = |words: &str| made(&words.split(' ').map(str::to_owned).collect::<Vec<_>>());
        let python = "/venv/bin/python -m stillroom serve";
        for (words, imports, make) in [
            (
                "gymnasium:CartPole-v1 --kwargs {\"size\":5}",
                "import json\nimport gymnasium",
                "gymnasium.make(\"CartPole-v1\", **json.loads(\"{\\\"size\\\":5}\"))",
            ),
            ("envpool:Pong-v5", "from stillroom.pools import PoolEnv", "PoolEnv(\"Pong-v5\")"),
            (
                "/home/me/reach.py:make --path /home/me/runs",
                "import importlib, sys\nsys.path.insert(0, \"/home/me\")\nmine = importlib.import_module(\"reach\")",
                "mine.make()",
            ),
            (
                "mine.arms:make --path /home/me",
                "import importlib, sys\nsys.path.insert(0, \"/home/me\")\nmine = importlib.import_module(\"mine.arms\")",
                "mine.make()",
            ),
        ] {
            assert_eq!(of(&format!("{python} {words}")), (imports.to_owned(), make.to_owned()));
        }
        assert!(of("sh -c ./simulator").0.starts_with("from mine import make_env"));
    }
}
