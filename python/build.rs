//! How the module is linked.

fn main() {
    // The simulator's `acosf` is also called where Python has loaded the C library's.
    println!("cargo::rustc-cdylib-link-arg=-Wl,-Bsymbolic-functions");
    println!("cargo::rerun-if-changed=build.rs");
}
