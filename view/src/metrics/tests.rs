use super::*;
use crate::data::{Gpu, Kitchen, Stage, Start, Validated};
use proto::task::{Kind, Spec};
use std::collections::BTreeSet;
use std::path::Path;

/// A run of which everything is known, and one that is at rest.
fn text() -> String {
    let named = |values: [f64; 3]| {
        let names = ["success", "success_without_disturbance", "disturbance_m"].map(str::to_owned);
        names.into_iter().zip(values).collect::<BTreeMap<_, _>>()
    };
    let worker = |name: &str, pid| Worker {
        name: name.to_owned(),
        pid,
        incarnation: 1,
        starts: 2,
        cores: pid.map(|_| 0.5),
        memory_bytes: pid.map(|_| 1 << 20),
        growth: None,
        stopped: false,
    };
    let card = Card {
        id: "a".to_owned(),
        preset: "de\"mo\\\n".to_owned(),
        seed: 3,
        state: "running".to_owned(),
        done: 4864,
        budget: 45_000_000,
        metrics: Spec::built_in()[0].shown(),
        figures: named([0.25, 0.125, 0.5]),
        left_s: Some(f64::INFINITY),
        ..Card::default()
    };
    let stage =
        Stage { name: "II".into(), reward: "r′".into(), begins_at: 0, budget: 10, frames: 5, figures: [].into() };
    let start = Start { number: 1, place: String::new(), at_unix_s: 1, ended_unix_s: None, how: None, reason: None };
    let live = Live {
        card: card.clone(),
        stages: vec![stage],
        stage: Some(0),
        frames_per_s: Some(1253.5),
        shares: [0.5, 0.25, 0.125],
        starts: vec![start],
        workers: vec![worker("learner-0", Some(7)), worker("actor-00", None)],
        cores: Some(2),
        gpus: vec![Gpu { index: 0, name: "H200".into(), busy: 0.5, used_mib: 1, total_mib: 2 }],
        validation: [(9, 0.5), (4, 0.25)]
            .map(|(frames, success)| Validated { rollout: 1, frames, figures: named([success, 0.0, 0.0]) })
            .to_vec(),
        kitchens: vec![Kitchen { kitchen: 6, environments: vec![0], episodes: 50, figures: named([0.75, 0.5, 0.25]) }],
        newest: BTreeMap::from([("loss/policy".to_owned(), -0.5), ("episode/return".to_owned(), f32::NAN)]),
        ..Live::default()
    };
    let evaluation = Card { id: "b".to_owned(), evaluation: true, done: 5, budget: 9, ..Card::default() };
    exposition(&[card, evaluation], &BTreeMap::from([("a", live)]))
}

/// A sample: name, labels, value.
type Sample = (String, BTreeMap<String, String>, f64);

/// Reads the text format as its description says, and refuses what that does not allow.
fn parsed(text: &str) -> Vec<Sample> {
    let is_name = |name: &str| {
        let mut letters = name.chars();
        letters.next().is_some_and(|first| first.is_ascii_alphabetic() || first == '_')
            && letters.all(|letter| letter.is_ascii_alphanumeric() || letter == '_')
    };
    let (mut helped, mut typed, mut closed) = (BTreeSet::new(), None, BTreeSet::new());
    let mut samples: Vec<Sample> = Vec::new();
    assert!(text.ends_with('\n'));
    for line in text.lines() {
        if let Some(help) = line.strip_prefix("# HELP ") {
            let (name, help) = help.split_once(' ').unwrap();
            assert!(is_name(name) && help.ends_with('.') && helped.insert(name), "{line}");
            continue;
        }
        if let Some(kind) = line.strip_prefix("# TYPE ") {
            let (name, kind) = kind.split_once(' ').unwrap();
            assert!(helped.contains(name) && ["gauge", "counter"].contains(&kind), "{line}");
            assert!(closed.insert(name), "all samples of a name stand together: {line}");
            typed = Some(name);
            continue;
        }
        let name = line.split([' ', '{']).next().unwrap();
        assert_eq!(typed, Some(name), "{line}");
        let mut rest = &line[name.len()..];
        let mut labels = BTreeMap::new();
        if let Some(inner) = rest.strip_prefix('{') {
            rest = inner;
            while !rest.starts_with('}') {
                let (label, after) = rest.split_once("=\"").unwrap();
                assert!(is_name(label), "{line}");
                let (mut value, mut letters) = (String::new(), after.char_indices());
                let end = loop {
                    match letters.next().unwrap() {
                        (at, '"') => break at + 1,
                        (_, '\\') => value.push(match letters.next().unwrap().1 {
                            'n' => '\n',
                            letter => letter,
                        }),
                        (_, letter) => value.push(letter),
                    }
                };
                assert!(labels.insert(label.to_owned(), value).is_none(), "{line}");
                rest = after[end..].trim_start_matches(',');
            }
            rest = &rest[1..];
        }
        let value = rest.strip_prefix(' ').unwrap();
        let value = if value == "+Inf" { f64::INFINITY } else { value.parse().unwrap() };
        let sample = (name.to_owned(), labels, value);
        assert!(!samples.iter().any(|(name, labels, _)| (name, labels) == (&sample.0, &sample.1)), "twice: {line}");
        samples.push(sample);
    }
    samples
}

fn value(samples: &[Sample], name: &str, labels: &[(&str, &str)]) -> Option<f64> {
    let has = |sample: &Sample| labels.iter().all(|(label, value)| sample.1.get(*label).is_some_and(|is| is == value));
    samples.iter().find(|sample| sample.0 == name && has(sample)).map(|sample| sample.2)
}

#[test]
fn what_is_exported_is_text_that_prometheus_reads() {
    let text = text();
    // Read by the package prometheus_client, too: `python/tests/test_opens.py`.
    let reference = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/reference/metrics.prom");
    assert_eq!(text, std::fs::read_to_string(reference).unwrap_or_default());
    let samples = parsed(&text);
    let value = |name: &str, labels: &[(&str, &str)]| value(&samples, name, labels);
    let run = ("run", "a");
    assert_eq!(value("stillroom_run_info", &[run, ("preset", "de\"mo\\\n"), ("seed", "3")]), Some(1.0));
    assert_eq!(value("stillroom_run_frames", &[run]), Some(4864.0));
    assert_eq!(value("stillroom_run_frames", &[("run", "b")]), None, "an evaluation has episodes");
    assert_eq!(value("stillroom_evaluation_episodes", &[("run", "b")]), Some(5.0));
    assert_eq!(value("stillroom_run_running", &[("run", "b")]), Some(0.0));
    assert_eq!(value("stillroom_run_left_seconds", &[run]), Some(f64::INFINITY));
    assert_eq!(value("stillroom_run_left_seconds", &[("run", "b")]), None, "what is not known is left out");
    assert_eq!(value("stillroom_run_time_ratio", &[run, ("part", "infer")]), Some(0.25));
    assert_eq!(value("stillroom_run_stage", &[run, ("name", "II")]), Some(1.0));
    assert_eq!(value("stillroom_rollout_figure", &[run, ("figure", "loss/policy")]), Some(-0.5));
    assert!(value("stillroom_rollout_figure", &[run, ("figure", "episode/return")]).unwrap().is_nan());
    assert_eq!(value("stillroom_kitchen_success_ratio", &[run, ("kitchen", "6")]), Some(0.75));
    assert_eq!(value("stillroom_validation_success_ratio", &[run]), Some(0.5), "the newest");
    assert_eq!(value("stillroom_process_up", &[run, ("process", "actor-00")]), Some(0.0));
    assert_eq!(value("stillroom_process_cpu_cores", &[run, ("process", "learner-0")]), Some(0.5));
    assert_eq!(value("stillroom_gpu_memory_bytes", &[("gpu", "0"), ("name", "H200")]), Some(2_097_152.0));
}

#[test]
fn another_task_has_families_of_its_own_metrics() {
    let metric = |name: &str, unit: &str, kind| Described {
        name: name.to_owned(),
        label: name.to_uppercase(),
        unit: unit.to_owned(),
        kind,
        doc: String::new(),
        quotient: None,
    };
    let metrics =
        vec![metric("spl", "", Kind::F32), metric("path_m", "m", Kind::F32), metric("stopped", "", Kind::Share)];
    let figures = BTreeMap::from([("spl".to_owned(), 0.5), ("path_m".to_owned(), 3.0)]);
    let card = Card { id: "c".to_owned(), metrics, figures, ..Card::default() };
    let samples = parsed(&exposition(&[card], &BTreeMap::new()));
    assert_eq!(value(&samples, "stillroom_run_spl", &[("run", "c")]), Some(0.5));
    assert_eq!(value(&samples, "stillroom_run_path_meters", &[("run", "c")]), Some(3.0));
    assert_eq!(value(&samples, "stillroom_run_stopped_ratio", &[]), None, "what is not known is left out");
    assert!(!samples.iter().any(|(name, ..)| name.contains("success")));
}

#[test]
fn the_dashboard_asks_for_nothing_that_is_not_exported() {
    let samples = parsed(&text());
    let exported: BTreeSet<&str> = samples.iter().map(|(name, ..)| name.as_str()).collect();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy/grafana/stillroom.json");
    let dashboard: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let panels = dashboard["panels"].as_array().unwrap();
    let targets = panels.iter().flat_map(|panel| panel["targets"].as_array().into_iter().flatten());
    let mut asked = vec![dashboard["templating"]["list"][1]["query"]["query"].as_str().unwrap()];
    asked.extend(targets.map(|target| target["expr"].as_str().unwrap()));
    assert!(asked.len() > 12, "{asked:?}");
    for query in asked {
        let words = query.split(|letter: char| !letter.is_ascii_alphanumeric() && letter != '_');
        let names: Vec<&str> = words.filter(|word| word.starts_with("stillroom_")).collect();
        assert!(!names.is_empty() && names.iter().all(|name| exported.contains(name)), "{query}");
        // Of labels and figures, too.
        for figure in query.split("figure=\"").skip(1).filter_map(|rest| rest.split('"').next()) {
            let task = &Spec::built_in()[0];
            let is_declared = proto::metric::of_task(figure).is_some_and(|name| task.metric(name).is_some());
            assert!(is_declared || proto::metric::ALL.contains(&figure), "{query}");
        }
    }
}
