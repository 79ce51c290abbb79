//! Statistics against rliable: `tests/reference/make_fixtures.py` has it compute the estimates and notes what it drew.

use report::statistics::{Interval, Scores, interquartile_mean, intervals_over};
use serde::Deserialize;

#[derive(Deserialize)]
struct Fixture {
    cases: Vec<Case>,
    iqm: Vec<Trimmed>,
}

#[derive(Deserialize)]
struct Case {
    name: String,
    scores: Vec<Vec<f64>>,
    /// One character an entry: the seed that it is taken from.
    resamples: Vec<String>,
    mean: Expected,
    iqm: Expected,
}

#[derive(Deserialize)]
struct Expected {
    point: f64,
    low: f64,
    high: f64,
}

#[derive(Deserialize)]
struct Trimmed {
    values: Vec<f64>,
    iqm: f64,
}

fn fixture() -> Fixture {
    serde_json::from_str(include_str!("reference/rliable.json")).expect("the fixture is as its script wrote it")
}

fn close(found: f64, expected: f64) -> bool {
    (found - expected).abs() <= 1e-12 * expected.abs().max(1.0)
}

#[test]
fn intervals_are_those_of_rliable_on_the_same_draws() {
    let fixture = fixture();
    assert_eq!(fixture.cases.len(), 5);
    for case in fixture.cases {
        let scores = Scores::new(&case.scores).expect("a matrix");
        let seeds = |resample: &String| {
            resample.chars().map(|digit| digit.to_digit(36).expect("base 36") as usize).collect::<Vec<_>>()
        };
        let [mean, iqm] = intervals_over(&scores, case.resamples.iter().map(seeds));
        let agree = |point: f64, found: Interval, expected: &Expected| {
            assert!(close(point, expected.point), "{}: {point} is not {}", case.name, expected.point);
            assert!(close(found.low, expected.low), "{}: {found:?}, expected {}", case.name, expected.low);
            assert!(close(found.high, expected.high), "{}: {found:?}, expected {}", case.name, expected.high);
        };
        agree(scores.mean(), mean, &case.mean);
        agree(scores.interquartile_mean(), iqm, &case.iqm);
    }
}

#[test]
fn the_interquartile_mean_is_scipys_trimmed_mean_at_every_length() {
    let fixture = fixture();
    assert_eq!(fixture.iqm.len(), 13);
    for trimmed in fixture.iqm {
        let found = interquartile_mean(&trimmed.values);
        assert!(close(found, trimmed.iqm), "{:?}: {found} is not {}", trimmed.values, trimmed.iqm);
    }
    let all: Vec<Vec<f64>> = (0..5).map(|row| (0..16).map(|column| f64::from(row * 16 + column)).collect()).collect();
    assert_eq!(Scores::new(&all).expect("a matrix").interquartile_mean(), 39.5);
}
