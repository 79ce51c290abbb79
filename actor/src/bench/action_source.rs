use proto::episode::EnvironmentId;
use proto::random::{Key, Purpose};
use simulator::robot::action::Action;
use simulator::tasks::arm_point_nav::Environment;
use simulator::tasks::arm_point_nav::oracle::{Policy, Variant};

const SEED: u64 = 1;

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PolicyKind {
    /// Every action equally likely but Done, so that episodes last.
    Random,
    /// The planner with privileged state at full speed: what it does touches more than noise does.
    Oracle,
}

impl PolicyKind {
    pub const ALL: [Self; 2] = [Self::Random, Self::Oracle];

    pub fn name(self) -> &'static str {
        match self {
            Self::Random => "random",
            Self::Oracle => "oracle",
        }
    }
}

/// The actions of one episode, chosen beforehand, so that choosing them takes no time in a measurement.
///
/// `environment` stands at the start of the episode.
pub fn script(kind: PolicyKind, environment: &Environment, id: EnvironmentId, episode: u32) -> Vec<Action> {
    match kind {
        PolicyKind::Random => (0..environment.max_steps()).map(|step| random_action(id, episode, step)).collect(),
        PolicyKind::Oracle => rehearse(environment.clone()),
    }
}

/// What the oracle does, found out by letting it.
fn rehearse(mut environment: Environment) -> Vec<Action> {
    let mut oracle = Policy::new(Variant::Fast);
    let mut actions = Vec::new();
    while !environment.ended() {
        let action = oracle.next(&environment);
        environment.step(action);
        actions.push(action);
    }
    actions
}

/// An action from counter-based noise: the same on every machine, whatever happens in the kitchen.
fn random_action(id: EnvironmentId, episode: u32, step: u32) -> Action {
    let key = Key {
        seed: SEED,
        purpose: Purpose::RandomPolicy,
        kitchen: id.kitchen.number(),
        environment: id.number,
        episode,
        step,
    };
    let lasting = Action::ALL.iter().filter(|&&action| action != Action::DoneMidLevel).count();
    let action = Action::ALL[key.stream().below(lasting as u32) as usize];
    assert!(action != Action::DoneMidLevel, "Done is the last of all actions");
    action
}
