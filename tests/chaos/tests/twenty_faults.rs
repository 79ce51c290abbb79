//! Twenty faults of the harness, as every change has to survive them. `make chaos` lets two hundred happen.

use std::process::Command;

#[test]
fn runs_under_twenty_faults_leave_what_undisturbed_ones_leave() {
    let mut chaos = Command::new(env!("CARGO_BIN_EXE_chaos"));
    let output = chaos.args(["faults", "--seed", "1", "--faults", "20", "--minutes", "15"]).output().unwrap();
    let printed = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{printed}\n{}", String::from_utf8_lossy(&output.stderr));
    assert!(printed.contains("as undisturbed, 0 not"), "{printed}");
}
