use prost_types::field_descriptor_proto::Type;
use proto::record::End;

pub struct Own {
    pub name: &'static str,
    pub kind: Type,
    pub get: fn(&Engine) -> Option<u64>,
    pub set: fn(&mut Engine, u64) -> bool,
}

macro_rules! engine {
    ($($(#[$doc:meta])* $name:ident: $type:ty, $kind:ident;)*) => {
        /// What the engine says of a step or an episode. What a message does not have is 0 there.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
        pub struct Engine {
            /// In an evaluation: number of the fixed episode in its kitchen, as in episodes.csv.
            pub fixed_episode: Option<u32>,
            $($(#[$doc])* pub $name: $type,)*
        }

        pub const OWN: &[Own] = &[
            Own {
                name: "fixed_episode",
                kind: Type::Uint32,
                get: |engine| engine.fixed_episode.map(u64::from),
                set: |engine, bits| {
                    engine.fixed_episode = u32::try_from(bits).ok();
                    engine.fixed_episode.is_some()
                },
            },
            $(Own {
                name: stringify!($name),
                kind: Type::$kind,
                get: |engine| Some(u64::from(engine.$name)),
                set: |engine, bits| <$type>::narrow(bits).map(|value| engine.$name = value).is_some(),
            },)*
        ];
    };
}

engine! {
    kitchen: u32, Uint32;
    /// Number of the environment among those of its kitchen, over the whole run.
    environment: u32, Uint32;
    actor: u32, Uint32;
    environment_index: u32, Uint32;
    episode: u32, Uint32;
    step: u32, Uint32;
    /// Actions that the environment's half has been given since the run's first step, this one included.
    exchange: u64, Uint64;
    incarnation: u32, Uint32;
    learner_incarnation: u32, Uint32;
    actor_incarnation: u32, Uint32;
    stage_version: u64, Uint64;
    terminated: bool, Bool;
    truncated: bool, Bool;
    /// Hash of the simulator's state: after the action, before any reset; of an episode's start its first.
    state_hash: u64, Fixed64;
    bulk_recorded: bool, Bool;
    length: u32, Uint32;
}

pub const STEP: &str = "kitchen environment actor environment_index episode step exchange incarnation \
    learner_incarnation actor_incarnation stage_version terminated truncated state_hash fixed_episode";
pub const START: &str = "kitchen environment episode incarnation learner_incarnation state_hash bulk_recorded \
    fixed_episode";
pub const END: &str = "kitchen environment episode incarnation learner_incarnation length terminated truncated \
    fixed_episode";

trait Narrow: Sized {
    fn narrow(bits: u64) -> Option<Self>;
}

impl Narrow for u32 {
    fn narrow(bits: u64) -> Option<Self> {
        Self::try_from(bits).ok()
    }
}

impl Narrow for u64 {
    fn narrow(bits: u64) -> Option<Self> {
        Some(bits)
    }
}

impl Narrow for bool {
    fn narrow(bits: u64) -> Option<Self> {
        (bits <= 1).then_some(bits == 1)
    }
}

impl Engine {
    pub fn whose(&self) -> ((u32, u32, u32), (u32, u32)) {
        ((self.kitchen, self.environment, self.episode), (self.incarnation, self.learner_incarnation))
    }

    pub fn end(&self) -> Option<End> {
        match (self.terminated, self.truncated) {
            (true, _) => Some(End::Terminated),
            (false, true) => Some(End::Truncated),
            (false, false) => None,
        }
    }

    pub fn ended(self, end: Option<End>) -> Self {
        Self { terminated: end == Some(End::Terminated), truncated: end == Some(End::Truncated), ..self }
    }
}
