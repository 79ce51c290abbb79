//! Evaluation: its request, the assignment of episodes to environments, the record of each episode, and the result
//! file.
//!
//! A kitchen has 720 episodes: 12 categories times 60, categories taking turns, so that episode i is of category i mod
//! 12. Validation and test kitchens have fixed ones; drawn ones exist for any kitchen, see [`Distribution`]. An
//! [`EvaluationConfig`] chooses some of them; [`Plan`] deals them to the environments of the actors; each that ends
//! becomes an [`EpisodeRecord`]; [`Figures`] sum up any set of records; [`Evaluation`] is the result file.
//! `docs/evaluation.md` describes both files for people.

mod asked;
mod confusion;
mod distribution;
mod episode_table;
mod figures;
mod interval;
mod plan;
mod record;
mod result;

pub use asked::{EvaluationConfig, ObjectSet, SEEDED_EPISODES, SEEDED_EPISODES_MOST};
pub use confusion::Confusion;
pub use distribution::{Distribution, describe, seed_of};
pub use episode_table::{has_targets, read_table, read_table_from, write_table};
pub use figures::{CurvePoint, Figures};
pub use plan::{EPISODES_OF_SET, EPISODES_PER_KITCHEN, Plan, category_of};
pub use record::EpisodeRecord;
pub use result::{
    ActionCounts, CategoryFigures, Conditions, Cost, Evaluation, KitchenFigures, ObjectSetFigures, RESULT_FILE,
    ResultError, Subject, TABLE_FILE,
};
