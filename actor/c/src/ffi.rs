//! A simulator as `stillroom_actor.h` describes it. Every pointer, size and number that can be checked is.

use crate::error::ServeError;
use engine::guest::{Guest, Record, Source};
use proto::config::Config;
use proto::task::{Actions, Channel, Description, Dtype, Restore, Role, Spec};
use std::collections::BTreeMap;
use std::ffi::{CStr, c_char, c_int, c_void};
use std::ptr::{NonNull, null, null_mut};

const ABI: u32 = 1;
const CHANNELS_MOST: usize = 256;
const DIMENSIONS_MOST: usize = 8;
const ACTIONS_MOST: u32 = 254;
/// Arguments of a program, and the letters of one text.
pub const ARGUMENTS_MOST: usize = 4096;

type Environment = NonNull<c_void>;

/// `stillroom_channel`.
#[repr(C)]
struct CChannel {
    name: *const c_char,
    role: u32,
    dtype: u32,
    dimensions: u32,
    shape: *const u32,
    least: f64,
    most: f64,
}

/// `stillroom_result`.
#[repr(C)]
#[derive(Default)]
struct CResult {
    reward: f64,
    terminated: u8,
    truncated: u8,
}

type Make = unsafe extern "C" fn() -> *mut c_void;
type Reset = unsafe extern "C" fn(*mut c_void, u32, *const *mut c_void) -> c_int;
type Step = unsafe extern "C" fn(*mut c_void, u32, *const *mut c_void, *mut CResult) -> c_int;
type Problem = unsafe extern "C" fn() -> *const c_char;

/// `stillroom_simulator`.
#[repr(C)]
pub struct CSimulator {
    abi: u32,
    actions: u32,
    name: *const c_char,
    channels: *const CChannel,
    channel_count: usize,
    make: Option<Make>,
    reset: Option<Reset>,
    step: Option<Step>,
    problem: Option<Problem>,
}

/// A simulator of somebody's, all of which was checked.
#[derive(Clone)]
pub struct Simulator {
    pub description: Description,
    make: Make,
    reset: Reset,
    step: Step,
    problem: Option<Problem>,
}

pub struct Environments {
    simulator: Simulator,
    sources: Vec<Source>,
    reward: Option<Source>,
    made: Vec<Environment>,
    /// Where each channel's numbers are written, for a call.
    places: Vec<*mut c_void>,
}

// SAFETY: the environments are used by one thread at a time, and it is the one that called `stillroom_serve`.
unsafe impl Send for Environments {}

pub fn refused<T>(problem: impl Into<String>) -> Result<T, ServeError> {
    Err(ServeError::Refused(problem.into()))
}

/// The text at a pointer that is not null.
fn text(what: &str, place: *const c_char) -> Result<String, ServeError> {
    if place.is_null() {
        return refused(format!("{what} is NULL, not a text"));
    }
    // SAFETY: it is not null, and the header asks for a text that ends with a zero.
    let text = unsafe { CStr::from_ptr(place) };
    match text.to_str() {
        Ok(text) if text.len() <= ARGUMENTS_MOST => Ok(text.to_owned()),
        _ => refused(format!("{what} is not UTF-8 of at most {ARGUMENTS_MOST} bytes")),
    }
}

impl Simulator {
    /// # Safety
    /// The pointer is null, or what the header asks for.
    pub unsafe fn read(simulator: *const CSimulator) -> Result<Self, ServeError> {
        // The number stands first under every ABI, and nothing else is read before it is the right one.
        if simulator.is_null() || !simulator.is_aligned() {
            return refused("stillroom_serve was given no simulator: the pointer is NULL, or not aligned");
        }
        // SAFETY: as the caller promises.
        let abi = unsafe { (&raw const (*simulator).abi).read() };
        if abi != ABI {
            return refused(format!(
                "the program is compiled for ABI {abi} of stillroom_actor.h, the library has {ABI}"
            ));
        }
        // SAFETY: as the caller promises, now that the layout is known.
        let simulator = unsafe { &*simulator };
        let CSimulator { actions, name, channels, channel_count: count, make, reset, step, problem, .. } = *simulator;
        let (Some(make), Some(reset), Some(step)) = (make, reset, step) else {
            return refused("`make`, `reset` or `step` of the simulator is NULL");
        };
        if !(1..=ACTIONS_MOST).contains(&actions) {
            return refused(format!("the simulator has {actions} actions, not 1 to {ACTIONS_MOST}"));
        }
        if channels.is_null() || !channels.is_aligned() || !(1..=CHANNELS_MOST).contains(&count) {
            return refused(format!("the simulator has {count} channels at {channels:?}, not 1 to {CHANNELS_MOST}"));
        }
        // SAFETY: not null, aligned, and as many as the caller promises.
        let channels = unsafe { std::slice::from_raw_parts(channels, count) };
        let names = (0..actions).map(|number| format!("action_{number}")).collect();
        let description = Description {
            name: text("the simulator's name", name)?,
            actions: Actions::Discrete { names, subsets: BTreeMap::new() },
            channels: channels.iter().enumerate().map(|(index, one)| one.read(index)).collect::<Result<_, _>>()?,
            restore: Restore::Replay,
        };
        if !description.channels.iter().any(|channel| channel.role == Role::Observation) {
            return refused("the simulator has no channel of STILLROOM_OBSERVATION");
        }
        Ok(Self { description, make, reset, step, problem })
    }

    fn failed(&self, call: &str) -> String {
        // SAFETY: the simulator's own function, on its own thread.
        let place = self.problem.map_or(null(), |problem| unsafe { problem() });
        let said = text("the problem", place).unwrap_or_else(|_| "it does not say why".to_owned());
        format!("{call}() failed: {said}")
    }

    /// So many environments in a run of a task.
    pub fn environments(self, count: usize, spec: &Spec) -> Result<Environments, ServeError> {
        let source = |channel: &Channel| {
            let found = Source::of(spec, &channel.name);
            found.ok_or_else(|| ServeError::Refused(format!("the run's task has no channel `{}`", channel.name)))
        };
        let sources: Vec<Source> = self.description.channels.iter().map(source).collect::<Result<_, _>>()?;
        let other = |(channel, source): &(&Channel, &Source)| {
            (channel.dtype, &channel.shape, channel.role)
                != (source.channel.dtype, &source.channel.shape, source.channel.role)
        };
        if let Some((channel, _)) = self.description.channels.iter().zip(&sources).find(other) {
            return refused(format!("the run's task has another channel `{}`", channel.name));
        }
        let make = |_| {
            // SAFETY: the simulator's own function, on its own thread.
            let made = NonNull::new(unsafe { (self.make)() });
            made.ok_or_else(|| ServeError::Refused(self.failed("make")))
        };
        let made = (0..count).map(make).collect::<Result<_, _>>()?;
        let places = vec![null_mut(); sources.len()];
        Ok(Environments { reward: Source::reward(spec), simulator: self, sources, made, places })
    }

    /// The same for what a run's configuration names.
    pub fn environments_of(self, count: usize, config: &Config) -> Result<Environments, ServeError> {
        self.environments(count, config.spec())
    }
}

impl CChannel {
    fn read(&self, index: usize) -> Result<Channel, ServeError> {
        let name = text(&format!("the name of channel {index}"), self.name)?;
        let roles = [Role::Observation, Role::Part, Role::Outcome, Role::Mask, Role::Privileged];
        let dtypes = [Dtype::U8, Dtype::U16, Dtype::I32, Dtype::U32, Dtype::F32];
        let (Some(&role), Some(&dtype)) = (roles.get(self.role as usize), dtypes.get(self.dtype as usize)) else {
            let Self { role, dtype, .. } = self;
            return refused(format!(
                "channel `{name}` has role {role} and dtype {dtype}, which the header does not have"
            ));
        };
        let dimensions = self.dimensions as usize;
        if dimensions > DIMENSIONS_MOST || dimensions > 0 && (self.shape.is_null() || !self.shape.is_aligned()) {
            return refused(format!(
                "channel `{name}` has {dimensions} dimensions at {:?}: at most {DIMENSIONS_MOST}, and not at NULL",
                self.shape
            ));
        }
        let shape = match dimensions {
            0 => vec![],
            // SAFETY: not null, aligned, and as many as the caller of `stillroom_serve` promises.
            _ => unsafe { std::slice::from_raw_parts(self.shape, dimensions) }
                .iter()
                .map(|&size| size as usize)
                .collect(),
        };
        let (unit, doc) = (String::new(), format!("Of the simulator: `{name}`."));
        let mut channel = Channel {
            name,
            role,
            dtype,
            shape,
            unit,
            range: None,
            values: vec![],
            names: vec![],
            sums: None,
            tolerance: None,
            key: None,
            doc,
        };
        channel.range = (role != Role::Mask && !channel.is_bulk()).then_some([self.least, self.most]);
        Ok(channel)
    }
}

impl Environments {
    /// Points to where each channel's numbers lie in a record.
    fn point(&mut self, record: &mut Record<'_>) -> *const *mut c_void {
        for (place, Source { channel, field }) in self.places.iter_mut().zip(&self.sources) {
            *place = record.piece(channel)[field.range()].as_mut_ptr().cast();
        }
        self.places.as_ptr()
    }
}

impl Guest for Environments {
    fn reset(&mut self, index: usize, seed: u32, mut record: Record<'_>) -> Result<(), String> {
        let places = self.point(&mut record);
        // SAFETY: an environment that `make` returned, and places within the record, each as long as its channel.
        let status = unsafe { (self.simulator.reset)(self.made[index].as_ptr(), seed, places) };
        if status == 0 { Ok(()) } else { Err(self.simulator.failed("reset")) }
    }

    fn step(&mut self, index: usize, action: &[u8], mut record: Record<'_>) -> Result<[bool; 2], String> {
        let mut result = CResult::default();
        let number = action.first().copied().unwrap_or_default();
        let places = self.point(&mut record);
        let environment = self.made[index].as_ptr();
        // SAFETY: as in `reset`; the result outlives the call.
        let status = unsafe { (self.simulator.step)(environment, number.into(), places, &raw mut result) };
        if status != 0 {
            return Err(self.simulator.failed("step"));
        }
        if let Some(Source { channel, field }) = &self.reward {
            record.piece(channel)[field.range()].copy_from_slice(&(result.reward as f32).to_ne_bytes());
        }
        Ok([result.terminated != 0, result.truncated != 0])
    }
}
