//! Which of the recorded episodes are wanted, and the error when there are none.

use proto::episode::EnvironmentId;
use proto::kitchen::KitchenId;
use std::collections::BTreeSet;

/// Which episodes are wanted; the default is all of them.
#[derive(Debug, Clone, Default)]
pub struct Wanted {
    /// Only of this kitchen.
    pub kitchen: Option<KitchenId>,
    /// Only of this environment.
    pub environment: Option<EnvironmentId>,
    /// Only of these numbers: within an environment, or in an evaluation those of its table. Empty: all.
    pub episodes: Vec<u32>,
}

/// What the recordings hold, whether wanted or not.
#[derive(Debug, Default)]
pub struct Known {
    /// Kitchen and number of every environment.
    pub environments: BTreeSet<(u8, u32)>,
    /// Numbers of the episodes of the wanted environments.
    pub episodes: BTreeSet<u32>,
}

/// Something is wanted that was not recorded.
#[derive(Debug, thiserror::Error)]
#[error("the recordings hold no {what} {name}; {nearest}")]
pub struct NotRecorded {
    what: &'static str,
    name: String,
    nearest: String,
}

impl Wanted {
    /// Whether episodes of this environment are wanted.
    pub fn is_of(&self, environment: EnvironmentId) -> bool {
        self.kitchen.is_none_or(|kitchen| kitchen == environment.kitchen)
            && self.environment.is_none_or(|wanted| wanted == environment)
    }

    /// Whether episodes of this number are wanted.
    pub fn has_number(&self, number: u32) -> bool {
        self.episodes.is_empty() || self.episodes.contains(&number)
    }

    /// An error that names the nearest ones if anything wanted is not there.
    pub fn check(&self, known: &Known) -> Result<(), NotRecorded> {
        if let Some(kitchen) = self.kitchen {
            let kitchens = known.environments.iter().map(|(kitchen, _)| *kitchen).collect();
            check("kitchen", &kitchen.number(), &kitchens, ToString::to_string)?;
        }
        if let Some(EnvironmentId { kitchen, number }) = self.environment {
            let name = |(kitchen, number): &(u8, u32)| format!("{kitchen}/{number}");
            check("environment", &(kitchen.number(), number), &known.environments, name)?;
        }
        self.episodes.iter().try_for_each(|number| check("episode", number, &known.episodes, ToString::to_string))
    }
}

fn check<T: Ord>(
    what: &'static str,
    wanted: &T,
    known: &BTreeSet<T>,
    name: impl Fn(&T) -> String,
) -> Result<(), NotRecorded> {
    if known.contains(wanted) {
        return Ok(());
    }
    let nearest = match (known.range(..wanted).next_back(), known.range(wanted..).next()) {
        (Some(below), Some(above)) => format!("the nearest are {} and {}", name(below), name(above)),
        (Some(last), None) => format!("the last is {}", name(last)),
        (None, Some(first)) => format!("the first is {}", name(first)),
        (None, None) => "there are none at all".to_owned(),
    };
    Err(NotRecorded { what, name: name(wanted), nearest })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_there_is_said_with_its_nearest() {
        let known = Known { environments: BTreeSet::from([(2, 0), (2, 1), (5, 0)]), episodes: BTreeSet::from([3, 7]) };
        let kitchen = |number| KitchenId::new(number).unwrap();
        let said = |wanted: Wanted| wanted.check(&known).map_err(|error| error.to_string());
        let episodes = |episodes: &[u32]| said(Wanted { episodes: episodes.to_vec(), ..Wanted::default() });
        assert_eq!(said(Wanted::default()), Ok(()));
        assert_eq!(episodes(&[7, 3]), Ok(()));
        assert_eq!(episodes(&[3, 5]).unwrap_err(), "the recordings hold no episode 5; the nearest are 3 and 7");
        assert_eq!(episodes(&[9]).unwrap_err(), "the recordings hold no episode 9; the last is 7");
        let of = |kitchen, number| EnvironmentId { kitchen, number };
        let environment = said(Wanted { environment: Some(of(kitchen(2), 4)), ..Wanted::default() });
        assert_eq!(environment.unwrap_err(), "the recordings hold no environment 2/4; the nearest are 2/1 and 5/0");
        let kitchen = said(Wanted { kitchen: Some(kitchen(1)), ..Wanted::default() });
        assert_eq!(kitchen.unwrap_err(), "the recordings hold no kitchen 1; the first is 2");
    }
}
