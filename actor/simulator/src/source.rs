//! Where a run's kitchens come from: the generator, or the scene files that its configuration names.

use crate::kitchen::{Kitchen, KitchenError};
use crate::scene_file::{self, SceneError};
use proto::config::Config;
use proto::kitchen::KitchenId;
use std::path::Path;

/// Why a run's kitchen could not be made.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// The generator failed.
    #[error(transparent)]
    Generated(#[from] KitchenError),
    /// The scene cannot be used.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The configuration names fewer scenes.
    #[error("kitchen {kitchen} is scene {index} of the run's list, which has {scenes}")]
    NoScene {
        /// The kitchen.
        kitchen: KitchenId,
        /// Its place in the list.
        index: usize,
        /// How many there are.
        scenes: usize,
    },
}

/// The kitchen with this number in a run with this configuration, whose scene files are named relative to `folder`.
pub fn of_run(id: KitchenId, config: &Config, folder: &Path) -> Result<Kitchen, SourceError> {
    let Some(index) = id.scene_index() else { return Ok(Kitchen::build(id, &config.simulation)?) };
    let missing = || SourceError::NoScene { kitchen: id, index, scenes: config.scenes.len() };
    let scene = config.scenes.get(index).ok_or_else(missing)?;
    Ok(scene_file::load(&folder.join(scene), id, &config.simulation)?)
}
