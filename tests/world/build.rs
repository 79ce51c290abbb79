//! Puts libtorch's folder into the run path of the test: the learner's library, whose collector and store are run here,
//! links it. No tensor is made.

fn main() {
    println!("cargo:rerun-if-env-changed=DEP_TCH_LIBTORCH_LIB");
    let folder = std::env::var("DEP_TCH_LIBTORCH_LIB").expect("torch-sys is a direct dependency and names its folder");
    println!("cargo:rustc-link-arg=-Wl,-rpath,{folder}");
}
