//! The program `orchestrator`: all of it is in the library, where tests reach its parts.

use std::process::ExitCode;

wire::require_processor!();

fn main() -> ExitCode {
    orchestrator::main(wire::version!())
}
