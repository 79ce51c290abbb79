//! `/metrics`: how all runs stand, in Prometheus' text format. Pure.
//!
//! Names carry their unit, and every one of them a help and a type. Values that are not known are left out.

use crate::data::{Card, Live, Runs, Worker};
use proto::task::Described;
use std::collections::BTreeMap;
use std::fmt::Write;

pub const CONTENT_KIND: &str = "text/plain; version=0.0.4; charset=utf-8";

/// By kitchen only up to so many kitchens: Prometheus keeps three series for each.
const KITCHENS_MAX: usize = 128;

struct Family {
    name: String,
    help: String,
    samples: Vec<(Vec<(&'static str, String)>, f64)>,
}

impl Family {
    fn gauge(name: impl Into<String>, help: impl Into<String>) -> Self {
        Self { name: name.into(), help: help.into(), samples: Vec::new() }
    }

    fn add(&mut self, labels: Vec<(&'static str, String)>, value: impl Into<Option<f64>>) {
        self.samples.extend(value.into().map(|value| (labels, value)));
    }

    fn write(&self, text: &mut String) -> std::fmt::Result {
        if self.samples.is_empty() {
            return Ok(());
        }
        let Self { name, help, samples } = self;
        writeln!(text, "# HELP {name} {help}\n# TYPE {name} gauge")?;
        for (labels, value) in samples {
            let pair = |(label, value): &(&str, String)| format!("{label}=\"{}\"", escaped(value));
            let labels: Vec<String> = labels.iter().map(pair).collect();
            let labels = if labels.is_empty() { String::new() } else { format!("{{{}}}", labels.join(",")) };
            let value = match value {
                value if value.is_nan() => "NaN".to_owned(),
                value if value.is_infinite() => if *value > 0.0 { "+Inf" } else { "-Inf" }.to_owned(),
                value => value.to_string(),
            };
            writeln!(text, "{name}{labels} {value}")?;
        }
        Ok(())
    }
}

struct OfMetrics {
    of: &'static str,
    help: &'static str,
    families: Vec<Family>,
}

impl OfMetrics {
    fn new(of: &'static str, help: &'static str) -> Self {
        Self { of, help, families: Vec::new() }
    }

    fn add(&mut self, metrics: &[Described], figures: &BTreeMap<String, f64>, labels: &[(&'static str, String)]) {
        for metric in metrics {
            let name = format!("stillroom_{}_{}", self.of, unit_last(metric));
            let place = self.families.iter().position(|family| family.name == name).unwrap_or_else(|| {
                let kind = if metric.is_share() { "a share of episodes, 0 to 1" } else { "a mean over episodes" };
                self.families.push(Family::gauge(name, format!("{} {}: {kind}.", metric.label, self.help)));
                self.families.len() - 1
            });
            self.families[place].add(labels.to_vec(), figures.get(&metric.name).copied());
        }
    }
}

fn unit_last(metric: &Described) -> String {
    let Described { name, unit, .. } = metric;
    let bare = name.strip_suffix(unit.as_str()).and_then(|name| name.strip_suffix('_')).unwrap_or(name);
    match unit.as_str() {
        "" if metric.is_share() => format!("{name}_ratio"),
        "" => name.clone(),
        "m" => format!("{bare}_meters"),
        "s" => format!("{bare}_seconds"),
        "rad" => format!("{bare}_radians"),
        unit => format!("{bare}_{unit}"),
    }
}

fn escaped(value: &str) -> String {
    value.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}

pub fn read(runs: &dyn Runs) -> String {
    let mut lives = BTreeMap::new();
    let cards = runs.list();
    for card in cards.iter().filter(|card| card.state == "running") {
        // One that cannot be read any more is in the list with its problem.
        if let Ok(live) = runs.live(&card.id) {
            lives.insert(card.id.as_str(), live);
        }
    }
    exposition(&cards, &lives)
}

fn exposition(cards: &[Card], lives: &BTreeMap<&str, Live>) -> String {
    let mut families = of_cards(cards);
    families.extend(of_progress(lives));
    families.extend(of_learning(lives));
    families.extend(of_machine(lives));
    let mut text = String::new();
    for family in &families {
        // Writing into a string does not fail.
        let _ = family.write(&mut text);
    }
    text
}

fn of_run(run: &str) -> Vec<(&'static str, String)> {
    vec![("run", run.to_owned())]
}

fn with(run: &str, label: &'static str, value: &(impl ToString + ?Sized)) -> Vec<(&'static str, String)> {
    vec![("run", run.to_owned()), (label, value.to_string())]
}

fn of_cards(cards: &[Card]) -> Vec<Family> {
    let mut info = Family::gauge("stillroom_run_info", "What a run or an evaluation is; always 1.");
    let mut running = Family::gauge("stillroom_run_running", "1 while an orchestrator works on it.");
    let mut created = Family::gauge("stillroom_run_created_timestamp_seconds", "When it was made.");
    let mut frames = Family::gauge("stillroom_run_frames", "Frames trained on; falls when a learner goes back.");
    let mut budget = Family::gauge("stillroom_run_budget_frames", "Frames that it is to be trained on.");
    let mut played = Family::gauge("stillroom_evaluation_episodes", "Episodes that an evaluation has played.");
    let mut asked = Family::gauge("stillroom_evaluation_budget_episodes", "Episodes that it is to play.");
    let mut metrics = OfMetrics::new("run", "lately");
    let mut left = Family::gauge("stillroom_run_left_seconds", "Time left at the rate of the moment.");
    for card in cards {
        let run = || of_run(&card.id);
        let kind = if card.evaluation { "evaluation" } else { "training" };
        let what = [("preset", card.preset.clone()), ("seed", card.seed.to_string()), ("state", card.state.clone())];
        info.add(run().into_iter().chain(what).chain([("kind", kind.to_owned())]).collect(), 1.0);
        running.add(run(), f64::from(u8::from(card.state == "running")));
        created.add(run(), card.created_unix_s as f64);
        let (done, of) = if card.evaluation { (&mut played, &mut asked) } else { (&mut frames, &mut budget) };
        done.add(run(), card.done as f64);
        of.add(run(), card.budget as f64);
        metrics.add(&card.metrics, &card.figures, &run());
        left.add(run(), card.left_s);
    }
    let before = [info, running, created, frames, budget, played, asked];
    before.into_iter().chain(metrics.families).chain([left]).collect()
}

fn of_progress(lives: &BTreeMap<&str, Live>) -> Vec<Family> {
    let mut rate = Family::gauge("stillroom_run_frames_per_second", "Frames a second lately, updates included.");
    let mut shares = Family::gauge("stillroom_run_time_ratio", "Share of a learner's time by what it does, 0 to 1.");
    let mut wall = Family::gauge("stillroom_run_wall_seconds", "Wall time of all its starts together.");
    let mut stage = Family::gauge("stillroom_run_stage", "Stage of the newest rollout, from 1, with its name.");
    let mut rollouts = Family::gauge("stillroom_run_rollouts", "Rollouts trained on; falls when a learner goes back.");
    let mut starts = Family::gauge("stillroom_run_starts", "Starts of its orchestrator.");
    for (run, live) in lives {
        rate.add(of_run(run), live.frames_per_s);
        for (part, share) in ["simulate", "infer", "update"].into_iter().zip(live.shares) {
            shares.add(with(run, "part", part), share);
        }
        wall.add(of_run(run), live.wall_s);
        if let Some((number, of)) = live.stage.and_then(|number| Some((number, live.stages.get(number)?))) {
            stage.add(with(run, "name", &of.name), number as f64 + 1.0);
        }
        rollouts.add(of_run(run), live.rollouts as f64);
        starts.add(of_run(run), live.starts.len() as f64);
    }
    vec![rate, shares, wall, stage, rollouts, starts]
}

fn of_learning(lives: &BTreeMap<&str, Live>) -> Vec<Family> {
    let mut figures = Family::gauge("stillroom_rollout_figure", "A figure of the newest rollout, by its name.");
    let mut of_kitchens = OfMetrics::new("kitchen", "among a kitchen's newest episodes");
    let mut of_validation = OfMetrics::new("validation", "in the newest validation");
    let mut validated_at =
        Family::gauge("stillroom_validation_frames", "Frames that the newest validation's weights were trained on.");
    for (run, live) in lives {
        for (name, value) in &live.newest {
            figures.add(with(run, "figure", name), f64::from(*value));
        }
        let metrics = &live.card.metrics;
        let kitchens = if live.kitchens.len() > KITCHENS_MAX { &[] } else { &live.kitchens[..] };
        for kitchen in kitchens.iter().filter(|kitchen| kitchen.episodes > 0) {
            of_kitchens.add(metrics, &kitchen.figures, &with(run, "kitchen", &kitchen.kitchen));
        }
        if let Some(newest) = live.validation.iter().max_by_key(|validated| validated.frames) {
            of_validation.add(metrics, &newest.figures, &of_run(run));
            validated_at.add(of_run(run), newest.frames as f64);
        }
    }
    std::iter::once(figures).chain(of_kitchens.families).chain(of_validation.families).chain([validated_at]).collect()
}

fn of_machine(lives: &BTreeMap<&str, Live>) -> Vec<Family> {
    let mut up = Family::gauge("stillroom_process_up", "1 while a process of a run lives on this machine.");
    let mut cpu = Family::gauge("stillroom_process_cpu_cores", "Processor cores that a process uses.");
    let mut memory = Family::gauge("stillroom_process_memory_bytes", "Memory that only this process has.");
    let mut starts = Family::gauge("stillroom_process_starts", "How often a process was started, all starts included.");
    let mut cores = Family::gauge("stillroom_machine_cores", "Processor cores of this machine.");
    let mut busy = Family::gauge("stillroom_gpu_busy_ratio", "Share of the time in which a kernel ran, 0 to 1.");
    let mut used = Family::gauge("stillroom_gpu_memory_used_bytes", "Memory of a GPU that is in use.");
    let mut total = Family::gauge("stillroom_gpu_memory_bytes", "Memory of a GPU.");
    for (run, live) in lives {
        for worker in &live.workers {
            let labels = |worker: &Worker| with(run, "process", &worker.name);
            up.add(labels(worker), f64::from(u8::from(worker.pid.is_some())));
            cpu.add(labels(worker), worker.cores);
            memory.add(labels(worker), worker.memory_bytes.map(|bytes| bytes as f64));
            starts.add(labels(worker), f64::from(worker.starts));
        }
    }
    // All runs of this machine see the same of it.
    if let Some(live) = lives.values().find(|live| live.cores.is_some()) {
        cores.add(Vec::new(), live.cores.map(|cores| cores as f64));
        for gpu in &live.gpus {
            let labels = || vec![("gpu", gpu.index.to_string()), ("name", gpu.name.clone())];
            busy.add(labels(), gpu.busy);
            used.add(labels(), gpu.used_mib as f64 * f64::from(1 << 20));
            total.add(labels(), gpu.total_mib as f64 * f64::from(1 << 20));
        }
    }
    vec![up, cpu, memory, starts, cores, busy, used, total]
}

#[cfg(test)]
mod tests;
