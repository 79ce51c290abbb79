//! Which environment this thread is simulating, so that a panic deep in the physics can say where it happened.

use proto::episode::EnvironmentId;
use std::cell::Cell;
use std::fmt;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Whereabouts {
    pub environment: EnvironmentId,
    pub episode: u32,
}

thread_local! {
    static HERE: Cell<Option<Whereabouts>> = const { Cell::new(None) };
}

pub fn enter(environment: EnvironmentId, episode: u32) {
    HERE.set(Some(Whereabouts { environment, episode }));
}

pub fn here() -> Option<Whereabouts> {
    HERE.get()
}

impl fmt::Display for Whereabouts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { environment, episode } = self;
        write!(f, "kitchen {}, environment {}, episode {episode}", environment.kitchen, environment.number)
    }
}

/// Adds the environment to panic messages. Call it once, after logging is set up.
pub fn name_it_in_panics() {
    std::panic::set_hook(Box::new(|panic| {
        let place = here().map_or_else(|| "outside any episode".to_owned(), |here| format!("in {here}"));
        tracing::error!("panic {place}: {panic}");
    }));
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::kitchen::KitchenId;

    #[test]
    fn it_reads_as_a_place() {
        enter(EnvironmentId { kitchen: KitchenId::new(7).unwrap(), number: 2 }, 31);
        assert_eq!(here().unwrap().to_string(), "kitchen 7, environment 2, episode 31");
    }
}
