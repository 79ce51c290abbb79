//! Puts the folder of the libtorch that tch was built against into the run path of the learner and its tests, so
//! that they start without environment variables.

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-env-changed=DEP_TCH_LIBTORCH_LIB");
    let folder = std::env::var("DEP_TCH_LIBTORCH_LIB").expect("torch-sys is a direct dependency and names its folder");
    println!("cargo:rustc-link-arg=-Wl,-rpath,{folder}");
}
