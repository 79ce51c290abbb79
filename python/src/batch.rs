//! Many environments. Threads step them while Python's lock is free; what they see goes straight into arrays.
//!
//! Nothing depends on the number of threads: an environment's step is a function of its own state alone.

use crate::elsewhere;
use crate::episode_player::{Chosen, EpisodePlayer, Series};
use crate::error::value_error;
use crate::facts::{self, Facts};
use crate::frames::{Frame, Frames};
use crate::room::Kitchen;
use crate::settings::Settings;
use crate::snapshot::Snapshot;
use crate::state::state;
use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use proto::config::Config;
use proto::record::End;
use proto::task::Field;
use pyo3::exceptions::{PyIndexError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use simulator::depth::DepthCamera;
use simulator::tasks::arm_point_nav::oracle::Variant;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::{iter, thread};

/// When an episode that has ended is followed by the next (the names are Gymnasium's).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Autoreset {
    /// The step after its last one ignores its action and begins the next.
    NextStep,
    /// Its last step.
    SameStep,
    /// When the caller says so.
    Disabled,
}

/// Environments whose actions are taken before any of their frames is drawn, at most: half of an actor's 32.
const BLOCK_MOST: usize = 16;
/// Blocks for each of several threads, where there are as many environments: some blocks take longer than others.
const BLOCKS_EACH: usize = 4;

/// The episode that Python asks for: series, seed, number.
type Asked = (Option<String>, Option<u64>, Option<u32>);

/// What a thread keeps between calls: a camera for each kitchen, and scratch memory. Cameras stand under the address of
/// their kitchen; a weak reference beside them keeps the address taken: scenes may share a number.
#[derive(Default)]
struct Worker {
    cameras: HashMap<usize, (Weak<simulator::kitchen::Kitchen>, DepthCamera)>,
    scratch: Vec<u16>,
}

impl Worker {
    fn look(&mut self, place: &mut EpisodePlayer, side: usize, frame: &mut Frame) {
        let kitchen = &place.room.kitchen;
        let at = Arc::as_ptr(kitchen).addr();
        if !self.cameras.contains_key(&at) {
            self.cameras.retain(|_, (kitchen, _)| kitchen.strong_count() > 0);
        }
        let camera = self.cameras.entry(at);
        let (_, camera) = camera.or_insert_with(|| (Arc::downgrade(kitchen), DepthCamera::new(kitchen.bodies())));
        frame.take(place.base_mut(), camera, side, &mut self.scratch);
    }
}

struct Task<'a> {
    index: usize,
    place: &'a mut EpisodePlayer,
    frame: Frame<'a>,
}

struct Report {
    /// After the action, before any reset.
    done: Facts,
    now: Facts,
    /// Numbers of the action that led to what was done, and to now.
    actions: [i64; 2],
    /// In the mode of the same step, after an episode's end: its last frame.
    last: Option<Vec<u16>>,
    /// The action was ignored, and an episode begun instead.
    reset: bool,
}

/// Environments that are stepped together.
#[pyclass(module = "stillroom._stillroom")]
pub struct Batch {
    settings: Settings,
    autoreset: Autoreset,
    places: Vec<EpisodePlayer>,
    workers: Vec<Worker>,
    frames: Frames,
    /// Name, place in a record, and array of each.
    vectors: Vec<(&'static str, Field, Py<PyArray2<f32>>)>,
    previous_actions: Py<PyArray1<i64>>,
}

#[pymethods]
impl Batch {
    /// An environment for each of `kitchens`; `numbers` tell those of one kitchen apart. Call `reset` before `step`.
    #[new]
    fn new(
        py: Python<'_>,
        settings: &Settings,
        kitchens: Vec<Kitchen>,
        numbers: Vec<u32>,
        autoreset: &str,
        threads: usize,
    ) -> PyResult<Self> {
        if kitchens.is_empty() || kitchens.len() != numbers.len() || threads == 0 {
            return Err(PyValueError::new_err("a batch has at least one environment and one thread"));
        }
        let autoreset = match autoreset {
            "NextStep" => Autoreset::NextStep,
            "SameStep" => Autoreset::SameStep,
            "Disabled" => Autoreset::Disabled,
            _ => return Err(PyValueError::new_err(format!("there is no autoreset mode `{autoreset}`"))),
        };
        let chosen = Chosen { series: Series::Sampled, number: 0, seed: 0 };
        let config: &Arc<Config> = &settings.config;
        let make =
            |(kitchen, number): (Kitchen, u32)| EpisodePlayer::new(kitchen.room, Arc::clone(config), number, chosen);
        let places = py.detach(|| kitchens.into_iter().zip(numbers).map(make).collect::<Result<Vec<_>, _>>());
        let places = places.map_err(value_error)?;
        let count = places.len();
        let threads = threads.min(count);
        Ok(Self {
            frames: Frames::new(py, count, settings.frame_side, settings.in_metres),
            vectors: settings
                .vectors()
                .map(|(channel, field)| {
                    (channel.bare_name(), field, PyArray2::zeros(py, [count, field.count], false).unbind())
                })
                .collect(),
            previous_actions: PyArray1::zeros(py, [count], false).unbind(),
            workers: iter::repeat_with(Worker::default).take(threads).collect(),
            settings: settings.clone(),
            autoreset,
            places,
        })
    }

    /// The arrays that every step overwrites, by the name of the observation: depth \[environments, side, side\],
    /// vectors \[environments, numbers\], previous actions \[environments\].
    #[getter]
    fn observations<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let observations = PyDict::new(py);
        observations.set_item("depth", self.frames.array(py))?;
        for (name, _, array) in &self.vectors {
            observations.set_item(name, array.clone_ref(py))?;
        }
        observations.set_item("previous_action", self.previous_actions.clone_ref(py))?;
        Ok(observations)
    }

    /// Threads that step.
    #[getter]
    fn threads(&self) -> usize {
        self.workers.len()
    }

    /// Begins episodes: for each environment none, or (series, seed, number), where None is the series, the seed and
    /// the next number of the episode before. Returns the facts of all.
    fn reset<'py>(slf: &Bound<'py, Self>, asked: Vec<Option<Asked>>) -> PyResult<Bound<'py, PyAny>> {
        let (py, mut this) = (slf.py(), alone(slf)?);
        if asked.len() != this.places.len() {
            return Err(PyValueError::new_err("one entry for each environment"));
        }
        let mut begun = Vec::with_capacity(asked.len());
        for (place, asked) in this.places.iter().zip(asked) {
            begun.push(asked.map(|asked| choose(place, asked)).transpose()?);
        }
        // All are drawn before one begins: if one cannot be, all stay as they are.
        let drawn = this.in_threads(py, |_, Task { index, place, .. }, _| {
            let draw = |chosen| place.draw(chosen).map(|start| (chosen, start)).map_err(value_error);
            Ok(Mutex::new(begun[*index].map(draw).transpose()?))
        })?;
        let reports = this.in_threads(py, |worker, Task { index, place, frame }, settings| {
            if let Some((chosen, start)) = drawn[*index].lock().unwrap_or_else(PoisonError::into_inner).take() {
                place.begin(chosen, start);
                worker.look(place, settings.frame_side, frame);
            }
            Ok(report_of(place, settings, false, None))
        })?;
        this.begun(py, reports)
    }

    /// Takes an action in each environment. Returns rewards, terminated, truncated, facts after the actions, facts now
    /// (the same object but in the mode of the same step), which environments were reset instead, and for each episode
    /// that ended in the mode of the same step its index and last observation.
    // An argument from Python is a value.
    #[allow(clippy::needless_pass_by_value)]
    fn step<'py>(slf: &Bound<'py, Self>, actions: PyReadonlyArray1<'py, i64>) -> PyResult<Bound<'py, PyTuple>> {
        let (py, mut this) = (slf.py(), alone(slf)?);
        let actions = this.checked(&actions)?;
        let autoreset = this.autoreset;
        // First all actions of a block, then all its frames, as an actor does it: physics and drawing each need the
        // processor's caches.
        let reports = this.in_blocks(py, |worker, block, settings| {
            let mut reports = Vec::with_capacity(block.len());
            for Task { index, place, .. } in &mut *block {
                reports.push(act(worker, place, actions[*index], autoreset, settings)?);
            }
            for Task { place, frame, .. } in block {
                worker.look(place, settings.frame_side, frame);
            }
            Ok(reports)
        })?;
        this.put(py, &reports)?;
        this.told(py, &reports)
    }

    /// Where an action takes the robot of the only environment: poses \[sub-steps, parts, 7\], as `MuJoCo` writes them,
    /// and whether it succeeds if nothing stops the robot. It is taken by `finish`.
    // An argument from Python is a value.
    #[allow(clippy::needless_pass_by_value)]
    fn way<'py>(slf: &Bound<'py, Self>, actions: PyReadonlyArray1<'py, i64>) -> PyResult<elsewhere::Told<'py>> {
        let (py, mut this) = (slf.py(), alone(slf)?);
        let actions = this.checked(&actions)?;
        elsewhere::way(py, &mut this.places, &actions)
    }

    /// Takes the action whose way the robot has gone, while another engine moved the things to these poses
    /// \[things, 7\]. Returns what `step` does.
    // An argument from Python is a value.
    #[allow(clippy::needless_pass_by_value)]
    fn finish<'py>(
        slf: &Bound<'py, Self>,
        actions: PyReadonlyArray1<'py, i64>,
        arrived: bool,
        poses: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyTuple>> {
        let (py, mut this) = (slf.py(), alone(slf)?);
        let actions = this.checked(&actions)?;
        let poses = elsewhere::poses(&this.places, &poses)?;
        let reports = this.in_threads(py, |worker, Task { index, place, frame }, settings| {
            place.finish(actions[*index], arrived, &poses);
            worker.look(place, settings.frame_side, frame);
            Ok(report_of(place, settings, false, None))
        })?;
        this.put(py, &reports)?;
        this.told(py, &reports)
    }

    /// Whether an environment's episode has ended.
    fn ended(slf: &Bound<'_, Self>, index: usize) -> PyResult<bool> {
        Ok(alone(slf)?.place(index)?.ended())
    }

    /// Everything about one environment's moment.
    fn state<'py>(slf: &Bound<'py, Self>, index: usize) -> PyResult<Bound<'py, PyAny>> {
        Ok(state(slf.py(), alone(slf)?.place(index)?)?.into_any())
    }

    /// How far each object of an environment is from where it stood at the episode's start, metres.
    fn displacements_m<'py>(slf: &Bound<'py, Self>, index: usize) -> PyResult<Bound<'py, PyArray1<f32>>> {
        Ok(PyArray1::from_iter(slf.py(), alone(slf)?.place(index)?.base().displacements_m()))
    }

    /// A picture for people, rows × columns × RGB.
    fn picture<'py>(slf: &Bound<'py, Self>, index: usize, side: usize) -> PyResult<Bound<'py, PyArray3<u8>>> {
        let (py, mut this) = (slf.py(), alone(slf)?);
        this.place(index)?;
        let place = &mut this.places[index];
        let canvas = py.detach(|| place.picture(side));
        let pixels = PyArray1::from_slice(py, canvas.pixels.as_flattened());
        pixels.reshape([canvas.height, canvas.width, 3])
    }

    /// A copy of an environment's moment.
    fn snapshot(slf: &Bound<'_, Self>, index: usize) -> PyResult<Snapshot> {
        Ok(Snapshot { place: alone(slf)?.place(index)?.clone() })
    }

    /// Returns an environment to a moment of its kitchen; returns the facts of all.
    fn restore<'py>(slf: &Bound<'py, Self>, index: usize, snapshot: &Snapshot) -> PyResult<Bound<'py, PyAny>> {
        let (py, mut this) = (slf.py(), alone(slf)?);
        let (kept, here) = (&snapshot.place, this.place(index)?);
        if kept.room.origin != here.room.origin || kept.config.simulation != here.config.simulation {
            let (then, now) = (kept.room.kitchen.id(), here.room.kitchen.id());
            return Err(PyValueError::new_err(format!("a snapshot of kitchen {then} is none of kitchen {now}")));
        }
        let settings = |place: &EpisodePlayer| {
            (place.config.task.clone(), place.config.episode, place.config.network.carried_goal)
        };
        if settings(kept) != settings(here) {
            return Err(PyValueError::new_err("the snapshot's episodes have other settings than this environment's"));
        }
        this.places[index] = kept.clone();
        let reports = this.in_threads(py, |worker, Task { index: at, place, frame }, settings| {
            if *at == index {
                worker.look(place, settings.frame_side, frame);
            }
            Ok(report_of(place, settings, false, None))
        })?;
        this.begun(py, reports)
    }

    /// What the oracle would do now in each environment; in one whose episode has ended, action 0.
    fn oracle<'py>(slf: &Bound<'py, Self>, variant: &str) -> PyResult<Bound<'py, PyArray1<i64>>> {
        let variant = Variant::named(variant).ok_or_else(|| PyValueError::new_err("there is no such variant"))?;
        let (py, mut this) = (slf.py(), alone(slf)?);
        let advised = this.in_threads(py, |_, Task { place, .. }, settings| {
            if place.ended() {
                return Ok(0);
            }
            let action = place.advise(variant);
            let index = settings.space().iter().position(|&other| Some(other) == action);
            // The package makes oracles of environments with all of ArmPointNav's actions only.
            index.map(|index| index as i64).ok_or_else(|| PyValueError::new_err("the oracle needs all actions"))
        })?;
        Ok(PyArray1::from_vec(py, advised))
    }
}

/// The batch, if no other thread is in it: while it works Python's lock is free.
fn alone<'py>(batch: &Bound<'py, Batch>) -> PyResult<PyRefMut<'py, Batch>> {
    let taken = "another thread is in a call of this environment: it belongs to one thread at a time";
    batch.try_borrow_mut().map_err(|_| PyRuntimeError::new_err(taken))
}

impl Batch {
    fn place(&self, index: usize) -> PyResult<&EpisodePlayer> {
        let count = self.places.len();
        let missing = || PyIndexError::new_err(format!("there are environments 0 to {}, not {index}", count - 1));
        self.places.get(index).ok_or_else(missing)
    }

    /// The actions, if all can be taken.
    fn checked(&self, actions: &PyReadonlyArray1<'_, i64>) -> PyResult<Vec<u8>> {
        let (space, actions) = (self.settings.space(), actions.as_slice()?);
        let count = self.places.len();
        if actions.len() != count {
            return Err(PyValueError::new_err(format!("{} actions for {count} environments", actions.len())));
        }
        let checked = actions.iter().zip(&self.places).enumerate().map(|(index, (&number, place))| {
            if self.autoreset == Autoreset::Disabled && place.ended() {
                return Err(PyValueError::new_err(format!(
                    "the episode of environment {index} has ended: reset it before the next step"
                )));
            }
            let action = usize::try_from(number).ok().and_then(|number| space.get(number)).copied();
            action.ok_or_else(|| PyValueError::new_err(format!("environment {index} has no action {number}")))
        });
        checked.collect()
    }

    /// Calls `work` for each environment in the threads, Python's lock being free; the results in order.
    fn in_threads<T: Send>(
        &mut self,
        py: Python<'_>,
        work: impl Fn(&mut Worker, &mut Task<'_>, &Settings) -> PyResult<T> + Sync,
    ) -> PyResult<Vec<T>> {
        self.in_blocks(py, |worker, block, settings| {
            block.iter_mut().map(|task| work(worker, task, settings)).collect()
        })
    }

    /// Calls `work` for each block of environments; the results in order. The calling thread is the first of the threads:
    /// starting one takes as long as an environment's step.
    fn in_blocks<T: Send>(
        &mut self,
        py: Python<'_>,
        work: impl Fn(&mut Worker, &mut [Task<'_>], &Settings) -> PyResult<Vec<T>> + Sync,
    ) -> PyResult<Vec<T>> {
        let Self { settings, places, workers, frames, .. } = self;
        let settings = &*settings;
        let mut writing = frames.write(py)?;
        let frames = writing.frames(settings.frame_side * settings.frame_side)?;
        let tasks = places.iter_mut().zip(frames).enumerate();
        let mut tasks: Vec<Task<'_>> = tasks.map(|(index, (place, frame))| Task { index, place, frame }).collect();
        let size = if workers.len() == 1 { BLOCK_MOST } else { tasks.len() / (workers.len() * BLOCKS_EACH) };
        let blocks = Mutex::new(tasks.chunks_mut(size.clamp(1, BLOCK_MOST)).enumerate());
        let done = Mutex::new(Vec::new());
        let go = |worker: &mut Worker| {
            loop {
                let block = blocks.lock().unwrap_or_else(PoisonError::into_inner).next();
                let Some((number, block)) = block else { return };
                let result = work(worker, block, settings);
                done.lock().unwrap_or_else(PoisonError::into_inner).push((number, result));
            }
        };
        let (here, others) = workers.split_first_mut().expect("a batch has a thread");
        py.detach(|| {
            thread::scope(|scope| {
                for worker in others {
                    scope.spawn(|| go(worker));
                }
                go(here);
            });
        });
        let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
        done.sort_by_key(|(number, _)| *number);
        let mut results = Vec::with_capacity(self.places.len());
        for (_, result) in done {
            results.extend(result?);
        }
        Ok(results)
    }

    /// Puts what is seen beside the frames into its arrays.
    fn put(&self, py: Python<'_>, reports: &[Report]) -> PyResult<()> {
        for (_, field, array) in &self.vectors {
            let numbers = reports.iter().flat_map(|report| field.numbers(&report.now.record));
            let mut array = array.bind(py).try_readwrite()?;
            array.as_slice_mut()?.iter_mut().zip(numbers).for_each(|(place, number)| *place = number as f32);
        }
        let previous: Vec<i64> = reports.iter().map(|report| report.actions[1]).collect();
        self.previous_actions.bind(py).try_readwrite()?.as_slice_mut()?.copy_from_slice(&previous);
        Ok(())
    }

    /// What `reset` and `restore` return: the facts of all.
    fn begun<'py>(&self, py: Python<'py>, reports: Vec<Report>) -> PyResult<Bound<'py, PyAny>> {
        self.put(py, &reports)?;
        let rows: Vec<Facts> = reports.into_iter().map(|report| report.now).collect();
        Ok(facts::table(py, self.settings.config.spec(), &rows)?.into_any())
    }

    /// What `step` returns.
    fn told<'py>(&self, py: Python<'py>, reports: &[Report]) -> PyResult<Bound<'py, PyTuple>> {
        let task = self.settings.config.spec();
        let reward = |report: &Report| {
            let reward = f64::from(self.settings.reward.of(|index| report.done.part(task, index), 0.0));
            if report.reset { 0.0 } else { reward }
        };
        let rows: Vec<Facts> = reports.iter().map(|report| report.done.clone()).collect();
        let done = facts::table(py, task, &rows)?;
        let mut last = Vec::new();
        for (index, report) in reports.iter().enumerate() {
            if let Some(depth_mm) = &report.last {
                let (side, seen) = (self.settings.frame_side, PyDict::new(py));
                seen.set_item("depth", PyArray1::from_slice(py, depth_mm).reshape([side, side])?)?;
                for (name, field, _) in &self.vectors {
                    let numbers = field.numbers(&report.done.record).map(|number| number as f32);
                    seen.set_item(name, PyArray1::from_iter(py, numbers))?;
                }
                seen.set_item("previous_action", report.actions[0])?;
                last.push((index, seen));
            }
        }
        let now = if last.is_empty() {
            done.clone()
        } else {
            facts::table(py, task, &reports.iter().map(|report| report.now.clone()).collect::<Vec<_>>())?
        };
        (
            facts::column(py, reports, reward),
            facts::column(py, &rows, |facts| facts.end() == Some(End::Terminated)),
            facts::column(py, &rows, |facts| facts.end() == Some(End::Truncated)),
            done,
            now,
            facts::column(py, reports, |report| report.reset),
            last,
        )
            .into_pyobject(py)
    }
}

/// Takes an action, or begins an episode where one is due; what is seen now is not drawn yet.
fn act(
    worker: &mut Worker,
    place: &mut EpisodePlayer,
    action: u8,
    autoreset: Autoreset,
    settings: &Settings,
) -> PyResult<Report> {
    // In the mode `Disabled` that was refused; in `SameStep` only a restored moment can have ended.
    if place.ended() {
        place.begin_next().map_err(value_error)?;
        return Ok(report_of(place, settings, true, None));
    }
    place.step(action);
    let report = report_of(place, settings, false, None);
    if autoreset != Autoreset::SameStep || !place.ended() {
        return Ok(report);
    }
    let side = settings.frame_side;
    let mut depth_mm = vec![0; side * side];
    worker.look(place, side, &mut Frame::Millimetres(&mut depth_mm));
    place.begin_next().map_err(value_error)?;
    let next = report_of(place, settings, false, Some(depth_mm));
    Ok(Report { done: report.done, actions: [report.actions[0], next.actions[1]], ..next })
}

/// The episode that an environment is asked to begin.
fn choose(place: &EpisodePlayer, (series, seed, number): Asked) -> PyResult<Chosen> {
    let before = place.chosen;
    let series = match series.as_deref() {
        None => before.series,
        Some("sampled") => Series::Sampled,
        Some("fixed") => Series::Fixed,
        Some("drawn") => Series::Drawn,
        Some(other) => return Err(PyValueError::new_err(format!("there is no series of episodes `{other}`"))),
    };
    let begun = seed.is_some() || series != before.series;
    let number = number.unwrap_or_else(|| if begun { 0 } else { place.next().number });
    Ok(Chosen { series, number, seed: seed.unwrap_or(before.seed) })
}

/// What is told of an environment now.
fn report_of(place: &EpisodePlayer, settings: &Settings, reset: bool, last: Option<Vec<u16>>) -> Report {
    let facts = Facts::of(place);
    let actions = [previous_action(settings, place); 2];
    Report { done: facts.clone(), now: facts, actions, last, reset }
}

/// Number of the action that led here; the number of actions if none did.
fn previous_action(settings: &Settings, place: &EpisodePlayer) -> i64 {
    let space = settings.space();
    let Some(previous) = place.actions.last() else { return space.len() as i64 };
    space.iter().position(|action| action == previous).expect("an environment takes actions of its space only") as i64
}
