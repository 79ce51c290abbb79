use anyhow::{Result, bail};
use proto::episode::EnvironmentId;
use proto::kitchen::KitchenId;
use std::collections::BTreeSet;

#[derive(Debug, Clone, Default)]
pub struct Wanted {
    pub kitchen: Option<KitchenId>,
    pub environment: Option<EnvironmentId>,
    /// Only of these numbers: within an environment, or in an evaluation those of its table. Empty: all.
    pub episodes: Vec<u32>,
}

#[derive(Debug, Default)]
pub struct Known {
    pub environments: BTreeSet<(u32, u32)>,
    pub episodes: BTreeSet<u32>,
}

impl Wanted {
    pub fn is_of(&self, environment: EnvironmentId) -> bool {
        self.kitchen.is_none_or(|kitchen| kitchen == environment.kitchen)
            && self.environment.is_none_or(|wanted| wanted == environment)
    }

    pub fn has_number(&self, number: u32) -> bool {
        self.episodes.is_empty() || self.episodes.contains(&number)
    }

    pub fn check(&self, known: &Known) -> Result<()> {
        if let Some(kitchen) = self.kitchen {
            let kitchens = known.environments.iter().map(|(kitchen, _)| *kitchen).collect();
            check("kitchen", &kitchen.number(), &kitchens, ToString::to_string)?;
        }
        if let Some(EnvironmentId { kitchen, number }) = self.environment {
            // Environments in no kitchen, which are named without one, are recorded as those of the first scene.
            let name = |(kitchen, number): &(u32, u32)| match KitchenId::scene(0) {
                Some(first) if first.number() == *kitchen => number.to_string(),
                _ => format!("{kitchen}/{number}"),
            };
            check("environment", &(kitchen.number(), number), &known.environments, name)?;
        }
        self.episodes.iter().try_for_each(|number| check("episode", number, &known.episodes, ToString::to_string))
    }
}

fn check<T: Ord>(what: &str, wanted: &T, known: &BTreeSet<T>, name: impl Fn(&T) -> String) -> Result<()> {
    if known.contains(wanted) {
        return Ok(());
    }
    let nearest = match (known.range(..wanted).next_back(), known.range(wanted..).next()) {
        (Some(below), Some(above)) => format!("the nearest are {} and {}", name(below), name(above)),
        (Some(last), None) => format!("the last is {}", name(last)),
        (None, Some(first)) => format!("the first is {}", name(first)),
        (None, None) => "there are none at all".to_owned(),
    };
    bail!("the recordings hold no {what} {}; {nearest}", name(wanted))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_environment_that_was_named_without_a_kitchen_is_called_so() {
        let environment = EnvironmentId { kitchen: KitchenId::scene(0).unwrap(), number: 0 };
        let known = Known { environments: [(3, 0), (30, 3)].into(), episodes: BTreeSet::new() };
        let wanted = Wanted { environment: Some(environment), ..Wanted::default() };
        let said = wanted.check(&known).unwrap_err().to_string();
        assert_eq!(said, "the recordings hold no environment 0; the last is 30/3");
    }
}
