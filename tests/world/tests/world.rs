//! Ten thousand schedules of kills, stops, lags, full and torn disks.

#[test]
fn first_look() {
    let first: u64 = std::env::var("FIRST").map_or(0, |text| text.parse().unwrap());
    let count: u64 = std::env::var("COUNT").map_or(1000, |text| text.parse().unwrap());
    let began = std::time::Instant::now();
    let (mut turns, mut faults, mut sessions, mut failures, mut bad) = (0, 0, 0, 0, 0);
    for seed in first..first + count {
        let report = world::play(seed, None, count == 1);
        for line in &report.trace {
            println!("{line}");
        }
        turns += report.turns;
        faults += report.faults;
        sessions += report.sessions;
        failures += report.failures;
        if let Some(violation) = report.violation {
            bad += 1;
            println!("seed {seed}: {violation}");
        }
    }
    println!(
        "{count} seeds, {bad} bad, {turns} turns, {faults} faults, {sessions} sessions, {failures} failures, {:?}",
        began.elapsed()
    );
    assert_eq!(bad, 0);
}
