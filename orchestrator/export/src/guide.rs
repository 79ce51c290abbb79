//! The page that goes with a policy: what it takes and gives, in which units, and ten lines that let it act.

use crate::policy::{IMAGES, MASK, Policy};
use crate::program::{of_kitchens, of_own_environment};
use proto::config::{CarriedGoal, GoalCoordinates};
use proto::task::{ActionHead, Dtype, Place};
use std::fmt::Write;

/// What somebody who has only `model` (its file's name), an ONNX model of this policy, needs to know; Markdown.
pub fn guide(policy: &Policy, model: &str) -> String {
    let network = &policy.config.network;
    let (hidden, actions) = (network.hidden, policy.config.action_head().outputs());
    let (given, actions_are) = actions_of(policy);
    let origin = &policy.origin;
    let held = match policy.carried_goal() {
        CarriedGoal::GoalToObject => "object - goal",
        CarriedGoal::ObjectToGoal => "goal - object",
    };
    let absolute = match network.goal {
        GoalCoordinates::Cartesian => "; the network takes absolute values",
        GoalCoordinates::Polar | GoalCoordinates::Plain => "",
    };
    let (numbers, states) = (policy.numbers(), policy.states());
    let mut text = format!(
        "# {model}

A policy of Stillroom after {frames} frames of training: one step of any number of environments. Weights
`{digest}`.

| input | type | shape | |
|---|---|---|---|
",
        frames = origin.frames,
        digest = origin.weights,
    );
    let mut line = |text_of: std::fmt::Arguments| {
        // Writing into a String cannot fail.
        let _ = writeln!(text, "{text_of}");
    };
    if policy.has_frame() {
        line(format_args!(
            "| depth | uint16 | rows, 224, 224 | millimetres, row by row from the top, of a camera with 100 degrees of view |"
        ));
    }
    rows_of_images(policy).for_each(|row| line(format_args!("{row}")));
    if network.goal != GoalCoordinates::Plain {
        line(format_args!(
            "| goal | float32 | rows, 3 | metres in the robot's frame (x right, y up, z ahead): object - wrist{absolute}; \
             while the object is held {held} |"
        ));
    } else if numbers > 0 {
        let name = policy.numbers_name();
        let places: Vec<String> = policy.inputs().places().map(|place| place_of(name, &place)).collect();
        line(format_args!("| {name} | float32 | rows, {numbers} | {} |", places.join(", ")));
    }
    if network.previous_action {
        line(format_args!("| previous_action | int64 | rows | number of the last action; {actions} at first |"));
    }
    if policy.is_masked() {
        line(format_args!(
            "| {MASK} | bool | rows, {actions} | whether each option may be chosen; of several choices side by side |"
        ));
    }
    for name in states {
        line(format_args!(
            "| {name} | float32 | rows, {hidden} | zeros at first, then next_{name} of the step before |"
        ));
    }
    line(format_args!(
        "
| output | type | shape | |
|---|---|---|---|
{given}"
    ));
    if policy.has_value() {
        line(format_args!("| value | float32 | rows | the critic's estimate of the discounted return |"));
    }
    for name in states {
        line(format_args!("| next_{name} | float32 | rows, {hidden} | |"));
    }
    line(format_args!(
        "
{actions_are}
"
    ));
    if policy.has_frame() && !states.is_empty() && policy.has_value() && !policy.action_names().is_empty() {
        line(format_args!("With `pip install onnxruntime` and the package `stillroom`:\n"));
        text.push_str(&of_kitchens(policy, model, actions));
    } else if !policy.has_frame() {
        line(format_args!("With `pip install onnxruntime`, in an environment as the run had it:\n"));
        text.push_str(&of_own_environment(policy, model));
    }
    text
}

/// An observation's part of the input `numbers`: `numbers[1:3] = position`.
fn place_of(numbers: &str, place: &Place) -> String {
    let Place { name, range, one_hot } = place;
    let at = if range.len() == 1 { range.start.to_string() } else { format!("{}:{}", range.start, range.end) };
    let coding = one_hot.map_or_else(String::new, |(least, count)| {
        let each = if range.len() > count { ", each" } else { "" };
        format!(" (one-hot of {least} to {}{each})", least + count as i64 - 1)
    });
    format!("`{numbers}[{at}] = {name}`{coding}")
}

/// Rows of the table of inputs that images have, but for the frame.
fn rows_of_images(policy: &Policy) -> impl Iterator<Item = String> {
    policy.inputs().images.into_iter().map(|image| {
        let kind = match image.field.dtype {
            Dtype::U16 => "uint16",
            Dtype::F32 => "float32",
            _ => "uint8",
        };
        let [first, second, third] = image.shape();
        format!("| {IMAGES}{} | {kind} | rows, {first}, {second}, {third} | as the task observes it |", image.name)
    })
}

/// Rows of the table of outputs that give the policy, and what an action is.
fn actions_of(policy: &Policy) -> (String, String) {
    let head = policy.config.action_head();
    let actions = head.outputs();
    match &head {
        ActionHead::Discrete(_) => (
            format!(
                "| log_probs | float32 | rows, {actions} | log-probabilities of the actions; training and evaluation sample |"
            ),
            format!(
                "Actions by number: {}. The file's metadata hold these names and the units, too.",
                policy.action_names().join(", ")
            ),
        ),
        ActionHead::MultiDiscrete(choices) => (
            format!(
                "| log_probs | float32 | rows, {actions} | log-probabilities of the options of each choice, side by side |"
            ),
            format!(
                "An action is a choice among each of {choices:?} options. The file's metadata hold these counts, too."
            ),
        ),
        ActionHead::Box(bounds) => (
            format!(
                "| means | float32 | rows, {actions} | of Gaussians; an evaluation without noise takes them |\n\
                 | log_stds | float32 | rows, {actions} | logarithms of their standard deviations |"
            ),
            format!(
                "An action is {}, clipped to {bounds:?}. The file's metadata hold these bounds, too.",
                if actions == 1 { "one number".to_owned() } else { format!("{actions} numbers") }
            ),
        ),
    }
}
