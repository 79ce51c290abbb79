//! Where the environments of an actor are, and what their cameras see there.

use super::prefetcher::{KitchenPrefetcher, Opened, Order};
use anyhow::{Context, Result, bail};
use proto::camera::{FRAME_SIDE, SUMS_PIXELS, WINDOW};
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen_schedule::KitchenSchedule;
use proto::record::{RecordHeader, flag};
use proto::task::Field;
use simulator::depth::{DepthCamera, Scenery};
use simulator::environment::{Base, Environment};
use simulator::tasks::{self, Run};
use std::sync::Arc;

/// The kitchen that an environment goes to next is opened when so many episodes before that one are left: early enough
/// that they take longer than opening it, late enough that few such kitchens wait.
const OPENED_AHEAD: u32 = 3;

/// Bits of [`RecordHeader::bulk`]: the frame, and its sums.
const WHOLE: u32 = 1;
const SUMS: u32 = 1 << 1;

/// The kitchens that environments are in, and the camera that looks at them.
pub(super) struct Scenes {
    run: Arc<Run>,
    kitchen_schedule: KitchenSchedule,
    prefetcher: KitchenPrefetcher,
    /// The camera that environments share. It holds the kitchen that all are in; or none of theirs, while each environment
    /// has its own scenery for it.
    camera: DepthCamera,
    /// What each environment's camera sees of its kitchen, where they move.
    sceneries: Vec<Scenery>,
    /// Places of the frame and of its sums in a record.
    frame: [Field; 2],
    /// Whether frames are sent as their sums: where the network averages its input over such windows.
    sums: bool,
}

impl Scenes {
    /// Those of a run, before any environment is in one.
    pub fn of(prefetcher: KitchenPrefetcher, config: &Config) -> Result<Self> {
        let [whole, windows] = config.spec().layout().images[..] else {
            bail!("task `{}` has not one image with its sums, which is what a camera in a kitchen sees", config.task)
        };
        Ok(Self {
            run: Run::of(config),
            kitchen_schedule: config.kitchen_schedule(),
            prefetcher,
            camera: DepthCamera::new(&[]),
            sceneries: Vec::new(),
            frame: [whole, windows],
            sums: config.network.input_pool as usize == WINDOW,
        })
    }

    /// An environment as it is called in its episode of this number, with the scene that it is in then.
    pub fn place(&self, home: EnvironmentId, episode: u32) -> EnvironmentId {
        self.kitchen_schedule.place(home, episode)
    }

    /// Has the kitchens that environments are about to enter opened: the prefetcher's thread begins at the other end,
    /// if there is a processor for it.
    pub fn order(&self, places: impl DoubleEndedIterator<Item = EnvironmentId>) {
        for place in places.rev().filter(|_| self.kitchen_schedule.moves()) {
            self.prefetcher.order(Order { environment: place.number, kitchen: place.kitchen, open: true });
        }
    }

    /// Makes environment number `index` of the actor in the scene of this episode, at its start.
    pub fn enter(
        &mut self,
        index: usize,
        home: EnvironmentId,
        episode: u32,
    ) -> Result<(EnvironmentId, Box<dyn Environment>)> {
        let id = self.place(home, episode);
        let Opened { kitchen, scenery } = self.prefetcher.take(home.number, id.kitchen)?;
        let environment = tasks::open(&self.run, &kitchen, id, episode)
            .with_context(|| format!("cannot set up environment {} of kitchen {}", id.number, id.kitchen))?;
        if self.kitchen_schedule.moves() || index == 0 {
            let mut scenery = scenery.unwrap_or_else(|| Scenery::of(kitchen.bodies()));
            match self.sceneries.get_mut(index) {
                Some(own) => *own = scenery,
                None if self.kitchen_schedule.moves() => self.sceneries.push(scenery),
                None => self.camera.exchange(&mut scenery),
            }
        }
        Ok((id, environment))
    }

    /// Has the kitchen that the environment goes to after this episode made as soon as that is known, and opened when it
    /// is near.
    pub fn look_ahead(&self, home: EnvironmentId, episode: u32, just_entered: bool) {
        let Some((then, next)) = self.kitchen_schedule.next_move(home, episode) else { return };
        let open = then - episode <= OPENED_AHEAD;
        if open || just_entered {
            self.prefetcher.order(Order { environment: home.number, kitchen: next.kitchen, open });
        }
    }

    /// Triangles that the camera has to choose from, in the first environment's kitchen.
    pub fn triangles(&mut self) -> usize {
        self.with_camera(0, |camera| camera.triangles())
    }

    /// Draws what an environment sees into its record, and notes in the header what is there. Where the network averages
    /// over windows only their sums are drawn, and the whole frame as well if it is recorded; the whole frame alone where
    /// a sum exceeds 16 bits.
    pub fn look(&mut self, index: usize, base: &mut Base, header: &mut RecordHeader, record: &mut [u8]) {
        let (sums, [whole, windows]) = (self.sums, self.frame);
        self.with_camera(index, |camera| {
            let frame: &mut [u16; SUMS_PIXELS] = windows.of_mut(record).try_into().expect("the sums of a frame");
            if sums && base.look_for_sums(camera, frame) {
                header.bulk |= SUMS;
            }
            if header.bulk == 0 || header.has(flag::RECORD_BULK) {
                base.look(camera, FRAME_SIDE, whole.of_mut(record));
                header.bulk |= WHOLE;
            }
        });
    }

    /// The camera, while it holds the scenery of an environment.
    fn with_camera<T>(&mut self, index: usize, work: impl FnOnce(&mut DepthCamera) -> T) -> T {
        let Self { camera, sceneries, .. } = self;
        let Some(own) = sceneries.get_mut(index) else { return work(camera) };
        camera.exchange(own);
        let result = work(camera);
        camera.exchange(own);
        result
    }

    /// Whether all is opened ahead for an environment that can be.
    #[cfg(test)]
    pub fn is_ready(&self, home: EnvironmentId, episode: u32) -> bool {
        let next = self.kitchen_schedule.next_move(home, episode);
        next.is_none_or(|(then, _)| then - episode > OPENED_AHEAD) || self.prefetcher.is_ready(home.number)
    }
}
