//! Environments in kitchens, as the engine runs them.

use super::prefetcher::KitchenPrefetcher;
use super::scenes::Scenes;
use anyhow::{Context, Result, bail};
use engine::Simulator;
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::record::{End, RecordHeader};
use proto::task::Layout;
use simulator::environment::Environment;
use wire::message::Snapshot;

/// The environments of an actor, each in the kitchen of its episode.
pub struct Kitchens {
    scenes: Scenes,
    layout: &'static Layout,
    /// With the names that they have there.
    environments: Vec<(EnvironmentId, Box<dyn Environment>)>,
}

/// The names of an actor's environments.
pub fn homes(actor: u32, config: &Config) -> Vec<EnvironmentId> {
    let count = config.actors.environments_per_actor;
    (0..count).map(|index| EnvironmentId::among(config.kitchens(), actor, index, count)).collect()
}

impl Kitchens {
    /// Those of a run, before any environment is in one.
    pub fn of(prefetcher: KitchenPrefetcher, config: &Config) -> Result<Self> {
        let layout = config.spec().layout();
        Ok(Self { scenes: Scenes::of(prefetcher, config)?, layout, environments: vec![] })
    }

    /// Triangles that the camera has to choose from, in the first environment's scene.
    pub fn triangles(&mut self) -> usize {
        self.scenes.triangles()
    }

    /// Bodies of the first environment's scene; 0 before it is in one.
    pub fn bodies(&self) -> usize {
        self.environments.first().map_or(0, |(_, first)| first.base().kitchen().bodies().len())
    }

    fn environment(&mut self, index: usize) -> Result<&mut Box<dyn Environment>> {
        let (_, environment) = self.environments.get_mut(index).context("an environment begins before it acts")?;
        Ok(environment)
    }
}

impl Simulator for Kitchens {
    type Error = anyhow::Error;

    fn place(&self, home: EnvironmentId, episode: u32) -> EnvironmentId {
        self.scenes.place(home, episode)
    }

    fn announce(&self, places: impl DoubleEndedIterator<Item = EnvironmentId>) {
        self.scenes.order(places);
    }

    fn begin(&mut self, index: usize, home: EnvironmentId, episode: u32, _ahead: &mut [u8]) -> Result<u64> {
        let place = self.place(home, episode);
        let enters = match self.environments.get_mut(index) {
            Some((id, environment)) if *id == place => {
                environment.begin(episode);
                false
            }
            Some(left) => {
                *left = self.scenes.enter(index, home, episode)?;
                true
            }
            None => {
                self.environments.push(self.scenes.enter(index, home, episode)?);
                true
            }
        };
        self.scenes.look_ahead(home, episode, enters);
        Ok(self.environment(index)?.base().state_hash())
    }

    fn restore(&mut self, _: usize, home: EnvironmentId, _: u32, _: u32, _: &Snapshot) -> Result<()> {
        bail!("kitchen {} is rebuilt from its actions: it has no snapshots", home.kitchen)
    }

    fn act(&mut self, index: usize, action: &[u8], done: &mut [u8], _ahead: &mut [u8]) -> Result<(u64, Option<End>)> {
        let environment = self.environment(index)?;
        environment.act(action, done);
        let base = environment.base();
        Ok((base.state_hash(), base.end()))
    }

    fn observe(&mut self, index: usize, header: &mut RecordHeader, record: &mut [u8]) -> Result<()> {
        let (_, environment) = self.environments.get_mut(index).context("an environment begins before it is seen")?;
        let seen = &mut record[self.layout.seen.clone()];
        seen.fill(0);
        environment.observe(seen);
        self.scenes.look(index, environment.base_mut(), header, record);
        Ok(())
    }

    /// An episode in another scene, of which there is one in every `kitchens.episodes_each`, is not prepared.
    fn prepare(&mut self, index: usize, home: EnvironmentId, episode: u32) -> bool {
        let place = self.place(home, episode);
        let Some((id, environment)) = self.environments.get_mut(index) else { return false };
        if place != *id {
            environment.base_mut().forget_past();
            return false;
        }
        environment.prepare(episode)
    }
}

#[cfg(test)]
mod tests;
