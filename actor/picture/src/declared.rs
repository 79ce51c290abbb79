use super::moment::{Captions, Task};
use proto::kitchen::TargetCategory;
use proto::task::{Channel, Field, Role, Spec, Term, Weight};
use rapier3d::math::Vec3;
use simulator::environment::Base;

pub fn target_name(spec: &'static Spec, record: &[u8]) -> Option<&'static str> {
    let (channel, field) = spec.channel("current_target")?;
    channel.names.get(field.number(record) as usize).map(String::as_str)
}

pub fn target(spec: &'static Spec, environment: &Base, record: &[u8]) -> Option<usize> {
    let name = target_name(spec, record)?;
    let category = TargetCategory::ALL.into_iter().find(|category| category.name() == name)?;
    Some(environment.kitchen().target_movable(category))
}

pub fn action_name(spec: &'static Spec, record: &[u8]) -> Option<&'static str> {
    let number = spec.layout().action.number(record);
    spec.actions.names().get(number as usize).map(String::as_str)
}

/// An action's name as the page has it: `MoveArmXP` is "move arm x +".
fn in_words(name: &str) -> String {
    let mut words = String::new();
    let letters: Vec<char> =
        ["Continuous", "MidLevel"].into_iter().fold(name, |name, end| name.trim_end_matches(end)).chars().collect();
    for (at, &letter) in letters.iter().enumerate() {
        let before = at.checked_sub(1).map(|before| letters[before]);
        let is_last = at + 1 == letters.len();
        let signed = is_last && before.is_some_and(|before| before.is_lowercase() || "XYZ".contains(before));
        match letter {
            'P' if signed => words.push_str(" +"),
            'M' if signed => words.push_str(" −"),
            _ if letter.is_uppercase() && before.is_some_and(char::is_lowercase) => words.extend([' ', letter]),
            _ => words.push(letter),
        }
    }
    words.replace('_', " ").to_lowercase()
}

/// A channel's name without its unit; that of a distance says that it is one.
fn named(channel: &Channel) -> String {
    let name = channel.bare_name().replace('_', " ");
    name.replace("wrist object", "wrist to object").replace("object goal", "object to goal")
}

/// Whether the task's first reward has no negative weight for a part.
fn is_good(spec: &Spec, part: &str) -> bool {
    let terms = spec.rewards.first().into_iter().flat_map(|reward| &reward.terms);
    let weight = |term: &Term| match term {
        Term::Part(name, Weight::Number(weight)) if name == part => Some(*weight),
        _ => None,
    };
    terms.filter_map(weight).all(|weight| weight >= 0.0)
}

/// Caption of a moment that an action led to, without its number and the episode's end: parts of rewards that are 1,
/// what is held, and what the task's metrics limit.
pub fn captions(spec: &'static Spec, record: &[u8]) -> Captions {
    let pairs = || spec.channels.iter().zip(&spec.layout().fields);
    let remarks = pairs().filter(|(channel, field)| {
        channel.role == Role::Part && channel.values == [0.0, 1.0] && field.number(record) == 1.0
    });
    let remark = |(channel, _): (&Channel, &Field)| (named(channel), is_good(spec, &channel.name));
    let mut remarks: Vec<_> = remarks.map(remark).collect();
    let number = |name: &str| spec.channel(name).map_or(0.0, |(_, field)| field.number(record));
    let held = held(spec, record);
    let action = action_name(spec, record).unwrap_or_default();
    let again = held.is_some() && action.starts_with("PickUp") && number("picked_up") != 1.0;
    if again {
        remarks.push(("already holding".to_owned(), false));
    }
    let measure = |(channel, field): (&Channel, Field)| {
        format!("{} {:.3} {}", named(channel), field.number(record), channel.unit)
    };
    let measures = spec.limited().and_then(|channel| spec.channel(channel)).map(measure);
    let holds = held.filter(|_| !again).map(|target| format!("holding {target}"));
    Captions {
        action: in_words(action),
        remarks,
        measures: holds.into_iter().chain(measures).collect::<Vec<_>>().join(", "),
        outcome: None,
    }
}

/// The target, if it was held after the step.
fn held(spec: &'static Spec, record: &[u8]) -> Option<&'static str> {
    let (_, held) = spec.channel("held")?;
    let (target, field) = spec.channel("target")?;
    (held.number(record) == 1.0).then(|| target.names.get(field.number(record) as usize).map(String::as_str))?
}

pub fn task(spec: &'static Spec, environment: &Base, record: &[u8], title: String) -> Task {
    let goal = spec.channel("goal_position_m");
    let goal_tolerance_m = goal.and_then(|(channel, _)| channel.tolerance).unwrap_or_default();
    let goal = goal.map(|(_, field)| {
        Vec3::from_array(std::array::from_fn(|axis| field.numbers(record).nth(axis).unwrap_or_default() as f32))
    });
    Task { target: target(spec, environment, record), goal, goal_tolerance_m, title }
}
