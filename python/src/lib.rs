//! The simulator as a Python module, `stillroom._stillroom`: what the package `stillroom` is made of.
//!
//! ```text
//! argument        checks of arguments from Python
//! settings        arguments from Python as a configuration
//! room            a kitchen that environments share
//! episode_player  one environment with its episode and its oracle; knows no Python
//! facts           what is told of a step beside the observation
//! frames          depth frames in arrays of numpy
//! snapshot        a moment to which an environment can return
//! checkpoint      checkpoints and policy files
//! run_files       files of run folders
//! state           everything about a moment, for users who may know it
//! depth_scene     depth images of any scene
//! elsewhere       an environment whose things another physics engine moves
//! error           errors of Rust as those of Python
//! serve           an actor's process that is a Python interpreter
//! served          environments of Python, called step by step
//! numbers         what Python gives, written where it lies in a record
//! batch           many environments, stepped by threads while Python's lock is free
//! ```

mod argument;
mod batch;
mod checkpoint;
mod depth_scene;
mod elsewhere;
mod episode_player;
mod error;
mod facts;
mod frames;
mod numbers;
mod room;
mod run_files;
mod serve;
mod served;
mod settings;
mod snapshot;
mod state;

use proto::config::{Config, SimulationConfig};
use proto::kitchen::{KitchenId, Split, TargetCategory};
use proto::task::{Channel, Role, Spec};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use simulator::simulation::{JAM_DEPTH_M, JAM_GROWTH_M};

/// Cargo links the module again where this is another one: `make dist` links for an older glibc.
const _LINKED_FOR: Option<&str> = option_env!("STILLROOM_LINKED_FOR");

/// Numbers of the built-in kitchens of a split: `train`, `validation` or `test`.
#[pyfunction]
fn kitchens(split: &Bound<'_, PyAny>) -> PyResult<Vec<u32>> {
    let splits = [("train", Split::Train), ("validation", Split::Validation), ("test", Split::Test)];
    let split = argument::chosen("split", split, &splits)?;
    Ok(KitchenId::of_split(split).into_iter().map(KitchenId::number).collect())
}

/// Names of the tasks.
#[pyfunction]
fn tasks() -> Vec<&'static str> {
    Spec::built_in().iter().map(|spec| &*spec.name).collect()
}

/// Whether the engine has this name for itself.
#[pyfunction]
fn is_reserved(name: &str) -> bool {
    proto::task::is_reserved(name)
}

/// What a task's environments report: of each channel its name, role, type, shape, unit, and what it is.
#[pyfunction]
fn channels<'py>(py: Python<'py>, task: &Bound<'py, PyAny>) -> PyResult<Vec<Bound<'py, PyDict>>> {
    let tasks: Vec<_> = Spec::built_in().iter().map(|spec| (&spec.name, spec)).collect();
    let table = |channel: &Channel| {
        let table = PyDict::new(py);
        let name = if channel.role == Role::Part { &channel.name } else { facts::called(channel) };
        table.set_item("name", name)?;
        table.set_item("role", format!("{:?}", channel.role).to_lowercase())?;
        table.set_item("dtype", format!("{:?}", channel.dtype).to_lowercase())?;
        table.set_item("shape", &channel.shape)?;
        table.set_item("unit", &channel.unit)?;
        table.set_item("doc", &channel.doc)?;
        Ok(table)
    };
    argument::chosen("task", task, &tasks)?.channels.iter().map(table).collect()
}

#[pymodule]
fn _stillroom(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("BUILD", wire::version::BUILD)?;
    // Before anything is computed: all of it is compiled for AVX2.
    #[cfg(target_arch = "x86_64")]
    if !std::arch::is_x86_feature_detected!("avx2") {
        return Err(pyo3::exceptions::PyImportError::new_err(
            "stillroom needs a processor with AVX2 (2015 or later); in a virtual machine, let the guest see the host's \
             processor",
        ));
    }
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("ACTIONS", Config::default().spec().actions.names().to_vec())?;
    module.add("TARGETS", TargetCategory::ALL.map(TargetCategory::name).to_vec())?;
    module.add("FRAME_SIDE", proto::camera::FRAME_SIDE)?;
    module.add("SUBSTEPS", SimulationConfig::default().substeps)?;
    module.add("JAM_DEPTH_M", JAM_DEPTH_M)?;
    module.add("JAM_GROWTH_M", JAM_GROWTH_M)?;
    module.add("CheckpointError", module.py().get_type::<checkpoint::CheckpointError>())?;
    module.add_function(wrap_pyfunction!(kitchens, module)?)?;
    module.add_function(wrap_pyfunction!(tasks, module)?)?;
    module.add_function(wrap_pyfunction!(is_reserved, module)?)?;
    module.add_function(wrap_pyfunction!(channels, module)?)?;
    module.add_function(wrap_pyfunction!(argument::whole, module)?)?;
    module.add_function(wrap_pyfunction!(argument::choice, module)?)?;
    module.add_function(wrap_pyfunction!(argument::shown, module)?)?;
    module.add_function(wrap_pyfunction!(run_files::read_of_run, module)?)?;
    module.add_function(wrap_pyfunction!(run_files::list_of_run, module)?)?;
    module.add_function(wrap_pyfunction!(run_files::toml_as_json, module)?)?;
    module.add_function(wrap_pyfunction!(checkpoint::read_checkpoint, module)?)?;
    module.add_function(wrap_pyfunction!(checkpoint::read_policy, module)?)?;
    module.add_function(wrap_pyfunction!(serve::episode_seed, module)?)?;
    module.add_function(wrap_pyfunction!(serve::hold_lifeline, module)?)?;
    module.add_class::<serve::Actor>()?;
    module.add_class::<serve::Replay>()?;
    module.add_function(wrap_pyfunction!(depth_scene::tangent, module)?)?;
    module.add_function(wrap_pyfunction!(depth_scene::sine_cosine, module)?)?;
    module.add_class::<settings::Settings>()?;
    module.add_class::<room::Kitchen>()?;
    module.add_class::<snapshot::Snapshot>()?;
    module.add_class::<depth_scene::DepthMesh>()?;
    module.add_class::<depth_scene::DepthScene>()?;
    module.add_class::<batch::Batch>()
}
