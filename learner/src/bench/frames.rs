//! Observations of both halves of all environments, in the shared memory of the real services.

use crate::agent::Batch;
use crate::collector::{ColumnMap, Noise};
use crate::record::{Frame, Inputs};
use anyhow::{Context, Result, ensure};
use iceoryx2::sample::Sample;
use proto::camera::{FRAME_PIXELS, FRAME_SIDE, SUMS_PIXELS, WINDOW, sum_windows};
use proto::config::Config;
use proto::record::RecordHeader;
use proto::shares::Shares;
use std::sync::atomic::{AtomicU32, Ordering};
use wire::message::{Halves, Line, ObservationHeader};
use wire::{Ipc, ObservationPublisher, ObservationSubscriber, SHARED_MEMORY, WireAddress, WireHost, WireShape};

/// Length of an episode; columns are in different phases of theirs.
const EPISODE_STEPS: usize = 50;

type Received = Sample<Ipc, [Line], ObservationHeader>;

/// Gives a configuration as many environments as make a half of `batch`, and no more shards than that leaves actors.
pub fn shape(config: &mut Config, batch: u32) {
    [config.actors.count, config.actors.environments_per_actor] = shape_of(batch);
    let most = 1 << config.actors.count.ilog2();
    config.learner.shards = config.learner.shards.min(most);
}

/// Actors and environments of each that make a half of `batch`: 19 actors where that goes, else as few as can be.
fn shape_of(batch: u32) -> [u32; 2] {
    // An actor has at most 256 environments.
    let few = (1..=batch).find(|actors| batch.is_multiple_of(*actors) && 2 * batch / actors <= 256).unwrap_or(batch);
    let actors = if batch.is_multiple_of(19) && 2 * batch / 19 <= 256 { 19 } else { few };
    [actors, 2 * batch / actors]
}

/// Frames in shared memory. They lie where actors wrote them until this is dropped.
pub struct Frames {
    // Samples before ports before the host: they are dropped in this order.
    halves: [Vec<Received>; 2],
    map: ColumnMap,
    frame: Frame,
    seed: u64,
    draws: Noise,
    action: u8,
    numbers: usize,
    _ports: (ObservationSubscriber, Vec<ObservationPublisher>),
    _host: WireHost,
    _swept: Swept,
}

struct Swept(WireAddress);

impl Drop for Swept {
    fn drop(&mut self) {
        if let Err(error) = self.0.sweep() {
            tracing::warn!("{}: {error}; `orchestrator clean` removes it", self.0);
        }
    }
}

static TAKEN: AtomicU32 = AtomicU32::new(1);

impl Frames {
    pub fn new(config: &Config) -> Result<Self> {
        let (actors, each) = (config.actors.count, config.actors.environments_per_actor);
        ensure!(Halves::of(each).count() == 2, "an actor has two halves");
        let need = config.environments() * config.spec().layout().bytes;
        let status = rustix::fs::statvfs(SHARED_MEMORY).context(SHARED_MEMORY)?;
        let free = status.f_bavail * status.f_frsize;
        ensure!(
            need as u64 + (8 << 20) <= free,
            "{SHARED_MEMORY} has {} MiB free, frames of {} environments take {} MiB: measure smaller batches (--batches)",
            free >> 20,
            config.environments(),
            need >> 20
        );
        let address = WireAddress::new(&format!("bench{}", std::process::id()), TAKEN.fetch_add(1, Ordering::Relaxed));
        let swept = Swept(address.clone());
        let shape = WireShape::new(Shares::of_one(actors), each, config.spec());
        let host = WireHost::create(&address, shape)?;
        let subscriber = host.wire().observation_subscriber(0)?;
        let (mut halves, mut publishers) = ([vec![], vec![]], vec![]);
        for actor in 0..actors {
            let publisher = host.wire().observation_publisher(actor)?;
            for half in 0..2 {
                let range = Halves::of(each).range(half);
                let mut sample = publisher.loan_slice_uninit(shape.lines(range.len()))?;
                *sample.user_header_mut() = ObservationHeader { actor, half, ..Default::default() };
                let first = (actor * each) as usize + range.start;
                let mut sample = sample.write_from_fn(|_| Line([0; 64]));
                for (i, record) in sample.payload_mut().chunks_exact_mut(shape.record_lines).enumerate() {
                    write(Line::bytes_mut(record), first + i, config);
                }
                sample.send()?;
                halves[half as usize].push(subscriber.receive()?.context("what was sent is there")?);
            }
            publishers.push(publisher);
        }
        let map = ColumnMap::of(0, config);
        let (draws, action) = (Noise::of(&config.action_head()), config.policy_actions().pop().unwrap_or_default());
        let inputs = Inputs::of(config.spec());
        let numbers = inputs.width();
        let ports = (subscriber, publishers);
        let (seed, frame) = (config.seed, Frame::of(config));
        Ok(Self { halves, map, frame, seed, draws, action, numbers, _ports: ports, _host: host, _swept: swept })
    }

    /// Noise for one half's actions in a step: the collector draws it when an observation arrives.
    pub fn noise(&self, half: u32, step: usize) -> Vec<f32> {
        let mut noise = vec![];
        for column in self.map.batch(half) {
            self.draws.draw(self.seed, self.map.environment(column), 0, step as u32, &mut noise);
        }
        noise
    }

    /// One half's batch in a step, as the collector makes it once the half is complete.
    pub fn batch(&self, half: u32, step: usize, noise: Vec<f32>) -> Batch<'_> {
        let columns: Vec<usize> = self.map.batch(half).collect();
        let [record, _] = self.frame.lines();
        let frames = self.halves[half as usize].iter().flat_map(|sample| {
            sample.payload().chunks_exact(record).filter_map(|record| {
                let record = Line::bytes(record);
                self.frame.read(record, RecordHeader::of(record))
            })
        });
        let frames = frames.collect();
        let records = self.halves[half as usize].iter().flat_map(|sample| sample.payload().chunks_exact(record));
        let images = records.flat_map(|record| self.frame.images(&[], Line::bytes(record))).collect();
        let number = |column: usize, index: usize| if index % 3 < 2 { 0.1 } else { (column % 7) as f32 * 0.3 };
        let numbers = columns.iter().flat_map(|&column| (0..self.numbers).map(move |index| number(column, index)));
        let numbers = numbers.collect();
        let starts: Vec<bool> = columns.iter().map(|&column| episode_step(column, step) == 0).collect();
        Batch {
            at: vec![step; columns.len()],
            frames,
            images,
            numbers,
            previous_action: vec![self.action; starts.len()],
            episode_start: starts,
            masks: vec![],
            gumbel: noise,
            columns,
        }
    }

    /// Whether a column's episode ends with its action in a step.
    pub fn ends(column: usize, step: usize) -> bool {
        episode_step(column, step) == EPISODE_STEPS - 1
    }
}

fn episode_step(column: usize, step: usize) -> usize {
    (step + 7 * column) % EPISODE_STEPS
}

/// Walls and edges at 0.3 to 4.3 m, other ones for each column; there are sums only where the network takes them. In a task
/// without a frame, images whose bytes differ.
fn write(record: &mut [u8], column: usize, config: &Config) {
    let (layout, inputs) = (config.spec().layout(), config.spec().inputs());
    if !inputs.is_ok_and(|inputs| inputs.frame.is_some()) {
        let pixels = layout.images.iter().flat_map(|image| image.range()).enumerate();
        pixels.for_each(|(index, at)| record[at] = (index * 7 + column * 31) as u8);
        return;
    }
    let [whole, windows] = layout.images[..] else { return };
    let pixels = (0..FRAME_PIXELS).map(|pixel| {
        let (row, at) = (pixel / FRAME_SIDE / 8, pixel % FRAME_SIDE / 8);
        300 + ((row * 389 + at * 131 + column * 1009) % 4000) as u16
    });
    let frame: Vec<u16> = pixels.collect();
    whole.of_mut(record).copy_from_slice(&frame);
    let mut bulk = 1;
    if config.network.input_pool as usize == WINDOW {
        let frame = frame.first_chunk::<FRAME_PIXELS>().expect("a frame");
        let sums: &mut [u16; SUMS_PIXELS] = windows.of_mut(record).try_into().expect("its sums");
        bulk |= u32::from(sum_windows(frame, sums)) << 1;
    }
    RecordHeader::of_mut(record).bulk = bulk;
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::camera::DepthFrame;

    #[test]
    fn frames_lie_in_shared_memory_in_the_order_of_columns_and_are_swept() {
        // The demonstration averages over other windows than sums have.
        for (preset, sums) in [("demo", false), ("recipe", true)] {
            frames_of(preset, sums);
        }
    }

    fn frames_of(preset: &str, sums: bool) {
        let mut config = Config::resolve(preset, None).unwrap();
        (config.actors.count, config.actors.environments_per_actor) = (2, 3);
        let frames = Frames::new(&config).unwrap();
        let left = || {
            let names =
                std::fs::read_dir(SHARED_MEMORY).unwrap().chain(std::fs::read_dir(std::env::temp_dir()).unwrap());
            let ours = format!("stillroom_bench{}_", std::process::id());
            names.flatten().filter(|name| name.file_name().to_string_lossy().starts_with(&ours)).count()
        };
        assert!(left() > 0);
        for (half, columns) in [(0, vec![0, 1, 3, 4]), (1, vec![2, 5])] {
            let batch = frames.batch(half, 0, frames.noise(half, 0));
            assert_eq!(batch.columns, columns);
            for (&column, frame) in columns.iter().zip(&batch.frames) {
                let mut record = vec![Line([0; 64]); config.spec().layout().bytes / size_of::<Line>()];
                write(Line::bytes_mut(&mut record), column, &config);
                let record = Line::bytes(&record);
                assert_eq!(Some(*frame), frames.frame.read(record, RecordHeader::of(record)));
                assert_eq!(matches!(frame, DepthFrame::Sums(_)), sums);
            }
            assert_eq!(batch.gumbel.len(), columns.len() * frames.draws.count());
        }
        drop(frames);
        assert_eq!(left(), 0);
    }
}
