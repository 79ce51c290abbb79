//! Whether the services of a run can be made here: those of the smallest run are, and are removed again. It finds whatever
//! is wrong with the temporary folder and /dev/shm that nobody thought of.

use super::Finding;
use proto::config::Config;
use proto::shares::Shares;
use std::time::{SystemTime, UNIX_EPOCH};
use wire::{WireAddress, WireHost, WireShape};

pub fn check() -> Finding {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_nanos());
    // As long as a run's own id.
    let id = format!("{:012x}", (now ^ u128::from(std::process::id()) << 24) & 0xffff_ffff_ffff);
    let address = WireAddress::new(&id, 1);
    let made = WireHost::create(&address, WireShape::new(Shares::of_one(1), 1, Config::default().spec()));
    let made = made.map(drop).map_err(|error| error.to_string());
    let swept = address.sweep().map(drop).map_err(|error| format!("{address} cannot be removed: {error}"));
    match made.and(swept) {
        Ok(()) => Finding::Good("made and removed".to_owned()),
        Err(problem) => Finding::Problem(format!(
            "{} (a run has its services in /dev/shm and in the temporary folder, which TMPDIR names)",
            // The same words for the same machine.
            problem.replace(&id, "ID")
        )),
    }
}
