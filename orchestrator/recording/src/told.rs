//! An episode as its recording has it: of environments that nothing here simulates.

use super::assembly::{Assembly, Kept};
use super::declared::Declared;
use super::form::Told;
use proto::config::Config;
use proto::show::{ShowOrbit, ShownEpisode, ShownMoment, ShownTask};
use proto::task::UNFINISHED;
use std::collections::BTreeMap;

/// `ended`: its outcome and its figures. What was seen last is in no message: the last moment has no channels of it.
pub fn shown(
    config: &Config,
    declared: &Declared,
    assembly: Assembly,
    ended: Option<(String, BTreeMap<String, f64>)>,
) -> ShownEpisode {
    let (outcome, figures) = ended.unwrap_or_else(|| (UNFINISHED.to_owned(), BTreeMap::new()));
    let Kept { start, steps } = assembly.kept.unwrap_or_default();
    let seen = |at: usize| steps.get(at).filter(|step| step.seen).or(start.as_ref().filter(|_| at == 0));
    let moments = (0..=steps.len()).map(|at| moment(declared, at.checked_sub(1).map(|acted| &steps[acted]), seen(at)));
    ShownEpisode {
        task: ShownTask::of(config),
        target: None,
        outcome,
        figures,
        goal_tolerance_m: 0.0,
        orbit: ShowOrbit { centre_m: [0.0; 3], radius_m: 1.0, yaw_rad: 0.0, pitch_rad: 0.0 },
        plan_centre_m: [0.0; 2],
        plan_half_m: [1.0; 2],
        black_m: 1.0,
        moments: moments.collect(),
        things: Vec::new(),
        compared: 0,
        first_difference: None,
    }
}

fn moment(declared: &Declared, acted: Option<&Told>, seen: Option<&Told>) -> ShownMoment {
    let Declared { spec, compared, .. } = declared;
    let fields = spec.channels.iter().zip(&spec.layout().fields).filter(|(channel, _)| !channel.is_bulk());
    let channels = fields.filter_map(|(channel, field)| {
        let told = if channel.is_of_action() { acted } else { seen };
        Some((channel.name.clone(), field.numbers(&told?.record).map(|number| number as f32).collect()))
    });
    let action = |step: &Told| {
        let mut numbers = spec.layout().action.numbers(&step.record);
        match spec.actions.names() {
            [] => numbers.map(|number| format!("{number:.2}")).collect::<Vec<_>>().join(", "),
            names => numbers.next().and_then(|at| names.get(at as usize).cloned()).unwrap_or_default(),
        }
    };
    ShownMoment {
        action: acted.map(action),
        channels: channels.collect(),
        rewards: compared
            .rewards()
            .map(str::to_owned)
            .zip(acted.iter().flat_map(|step| step.rewards.clone()))
            .collect(),
        moved: Vec::new(),
        nearly: None,
    }
}
