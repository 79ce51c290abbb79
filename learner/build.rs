//! Puts the folder of the libtorch that tch was built against into the run path of the learner and its tests, so
//! that they start without environment variables, and compiles what of libtorch tch has no words for.

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-env-changed=DEP_TCH_LIBTORCH_LIB");
    let folder = std::env::var("DEP_TCH_LIBTORCH_LIB").expect("torch-sys is a direct dependency and names its folder");
    // An installed learner has its libtorch beside it (deploy/install).
    println!("cargo:rustc-link-arg=-Wl,-rpath,$ORIGIN/libtorch/lib");
    println!("cargo:rustc-link-arg=-Wl,-rpath,{folder}");

    let include = std::path::Path::new(&folder).with_file_name("include");
    for source in [
        "arithmetic.cpp",
        "arithmetic.h",
        "convolution.cpp",
        "group.cpp",
        "product.cpp",
        "warnings.cpp",
        "guard.h",
        "gloo",
    ] {
        println!("cargo:rerun-if-changed=src/ffi/{source}");
    }
    // Of these every object is linked, named by anybody or not: their functions take the place of libtorch's own.
    cc::Build::new()
        .cpp(true)
        .std("c++17")
        .opt_level(2)
        // No multiplication and addition may become one where the source has two.
        .flag("-ffp-contract=off")
        .warnings(false)
        .debug(false)
        .pic(true)
        .link_lib_modifier("+whole-archive")
        .include(&include)
        .files(["src/ffi/arithmetic.cpp", "src/ffi/product.cpp"])
        .compile("stillroom_arithmetic");
    cc::Build::new()
        .cpp(true)
        .std("c++17")
        // libtorch's own headers are not free of warnings.
        .warnings(false)
        .debug(false)
        .pic(true)
        .include(&include)
        .include(include.join("torch/csrc/api/include"))
        .include("src/ffi/gloo")
        .files(["src/ffi/convolution.cpp", "src/ffi/group.cpp", "src/ffi/warnings.cpp"])
        .compile("stillroom_ffi");
}
