//! Puts the folder of the libtorch that tch was built against into the run path of the learner and its tests, so
//! that they start without environment variables, and compiles what we call of libtorch that tch does not bind.

/// Called from Rust. The first defines what libtorch's headers ask for.
const CALLED: [&str; 6] =
    ["group.cpp", "convolution.cpp", "determinism.cpp", "graph.cpp", "patches.cpp", "warnings.cpp"];
/// Linked whether anybody names them or not: their functions take the place of libtorch's own.
const IN_PLACE: [&str; 2] = ["arithmetic.cpp", "product.cpp"];
/// What they include.
const HEADERS: [&str; 4] = ["arithmetic.h", "gloo", "guard.h", "product.h"];

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-env-changed=DEP_TCH_LIBTORCH_LIB");
    let folder = std::env::var("DEP_TCH_LIBTORCH_LIB").expect("torch-sys is a direct dependency and names its folder");
    // An installed learner has its libtorch beside it (deploy/install).
    println!("cargo:rustc-link-arg=-Wl,-rpath,$ORIGIN/libtorch/lib");
    println!("cargo:rustc-link-arg=-Wl,-rpath,{folder}");
    for source in CALLED.iter().chain(&IN_PLACE).chain(&HEADERS) {
        println!("cargo:rerun-if-changed=src/ffi/{source}");
    }
    let include = std::path::Path::new(&folder).with_file_name("include");
    let compiler = || {
        let mut compiler = cc::Build::new();
        compiler.cpp(true).std("c++17").pic(true).include(&include).include("src/ffi/gloo");
        compiler.include(include.join("torch/csrc/api/include"));
        // libtorch's own headers are not free of warnings, and line tables of them are larger than the code.
        compiler.warnings(false).debug(false).opt_level(3);
        // No multiplication and addition may become one where the source has two.
        compiler.flag("-ffp-contract=off");
        compiler
    };
    // As one unit: most of what is compiled are libtorch's headers, and so they are read once.
    let unit = |name: &str, files: &[&str]| {
        let [sources, out] = ["CARGO_MANIFEST_DIR", "OUT_DIR"].map(|name| std::env::var(name).expect("cargo sets it"));
        let lines: Vec<String> = files.iter().map(|file| format!("#include \"{sources}/src/ffi/{file}\"\n")).collect();
        let path = std::path::Path::new(&out).join(name);
        std::fs::write(&path, lines.concat()).expect("a build script's own folder can be written");
        path
    };
    compiler().file(unit("called.cpp", &CALLED)).compile("stillroom_ffi");
    compiler()
        .file(unit("in_place.cpp", &IN_PLACE))
        .link_lib_modifier("+whole-archive")
        .compile("stillroom_arithmetic");
}
