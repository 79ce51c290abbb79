//! zip 0.6 for tch and torch-sys, which ask for it with Zstandard, bzip2 and AES: a tenth of the whole build. They call it
//! for `.npz` files and for downloads of libtorch, and Stillroom has neither from them.

pub use plain::*;
