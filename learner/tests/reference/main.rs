//! The learner's mathematics against PyTorch: `make_fixtures.py` is the method written a second time, its results are
//! the `.safetensors` beside it. Also here: what must be bit-identical on the CPU.
//!
//! All in one binary because loading libtorch takes longer than most of these tests.

mod algorithm;
mod images;
mod import;
mod kept;
mod learners;
mod network;
mod numbers;
mod probe;
mod repetition;
mod shared;
mod whole;
mod world;
