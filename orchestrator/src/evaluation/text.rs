use crate::output::format::{self, NOTHING, counted, shown};
use crate::output::table::{blocks, right_aligned, wrapped};
use proto::config::Config;
use proto::evaluation::{
    CategoryFigures, Cost, Distribution, Evaluation, EvaluationConfig, Figures, KitchenFigures, ObjectSet,
    SEEDED_EPISODES, describe, seed_of,
};
use proto::kitchen::{KitchenId, KitchenRange, Split, TargetCategory};
use proto::run_folder::BEST;
use proto::task::{Described, Spec};
use report::statistics::{Interval, wilson};
use std::path::Path;
use view::data::{ResultRow, Results, Within};

/// Which episodes are played, as people read it.
pub fn episodes_of(config: &Config, asked: &EvaluationConfig) -> String {
    let [start_m, goal_m] = asked.distances_max_m(config);
    describe(asked.distribution, start_m, goal_m)
}

pub fn place(split: Split, procedural: Option<KitchenRange>, scenes: usize, one: Option<KitchenId>) -> String {
    if let Some(kitchen) = one {
        return format!("kitchen {kitchen}");
    }
    if let Some(range) = procedural {
        return format!("{} ({range})", counted(u64::from(range.count()), "procedural kitchen"));
    }
    let split = match split {
        _ if scenes > 0 => return format!("{} of the run's own", counted(scenes as u64, "scene")),
        Split::Train => "the 19 training kitchens",
        Split::Validation => "the 5 validation kitchens",
        Split::Test => "the 5 test kitchens",
    };
    split.to_owned()
}

/// The same in a word, which begins a table and is in the name of a folder.
pub fn word_of_place(split: Split, procedural: bool, scenes: bool) -> &'static str {
    match split {
        _ if scenes => "scenes",
        _ if procedural => "procedural",
        Split::Train => "train",
        Split::Validation => "validation",
        Split::Test => "test",
    }
}

/// Which policy plays which episodes, in a line.
pub fn conditions(config: &Config, asked: &EvaluationConfig) -> String {
    let policy = asked.checkpoint.as_deref().map_or("fresh weights", |path| {
        let parents = if path.ends_with(".safetensors") { 1 } else { 3 };
        let begin = path.rmatch_indices('/').nth(parents - 1).map_or(0, |(at, _)| at + 1);
        &path[begin..]
    });
    let actions = if asked.deterministic { "the most probable action" } else { "sampled actions" };
    let episodes = episodes_of(config, asked);
    let seeds = seeds_of(asked.distribution, asked.split, asked.episodes);
    let objects = match asked.objects {
        ObjectSet::NoTargets => String::new(),
        ObjectSet::All => "novel and seen objects, ".to_owned(),
        objects => format!("{} objects, ", objects.name()),
    };
    let place = place(asked.split, asked.procedural, config.scenes.len(), asked.kitchen);
    let played = seeds.unwrap_or_else(|| format!("{objects}{episodes}, in {place}"));
    format!("{policy} ({}), {actions}: {played}", config.preset)
}

/// The same in a few words, without the policy: `test, novel objects, drawn episodes`.
pub fn brief(config: &Config, asked: &EvaluationConfig) -> String {
    let of_split = || word_of_place(asked.split, asked.procedural.is_some(), !config.scenes.is_empty()).to_owned();
    let place = asked.kitchen.map_or_else(of_split, |kitchen| format!("kitchen {kitchen}"));
    let has_targets = asked.objects != ObjectSet::NoTargets;
    let objects = if has_targets { format!(", {} objects", asked.objects.name()) } else { String::new() };
    let episodes = match asked.distribution {
        Distribution::Fixed => "fixed episodes",
        Distribution::Run => "drawn episodes",
        Distribution::Seeds => "episodes of fixed seeds",
    };
    let folder = asked.checkpoint.as_deref().and_then(|path| Path::new(path).parent()?.file_name());
    let best = if folder.is_some_and(|folder| folder == BEST) { ", best checkpoint" } else { "" };
    let taken = if asked.deterministic { ", deterministic" } else { "" };
    format!("{place}{objects}, {episodes}{best}{taken}")
}

pub fn seeds_of(distribution: Distribution, split: Split, episodes: u32) -> Option<String> {
    let count = if episodes == 0 { SEEDED_EPISODES } else { episodes };
    let whose = if split == Split::Validation { "validation" } else { "test" };
    let [first, last] = [0, count - 1].map(|episode| seed_of(split, episode));
    let seeds = format!("{}, reset with seeds {first} to {last}", counted(count.into(), &format!("{whose} episode")));
    (distribution == Distribution::Seeds).then_some(seeds)
}

/// Columns of a line of figures where there is no terminal.
const UNBROKEN: usize = 120;

/// `columns`: of the terminal, if it is one. There the line about the episodes stands already, from the beginning.
pub fn lines(spec: &Spec, evaluation: &Evaluation, columns: Option<usize>) -> Vec<String> {
    let Cost { wall_s, steps, .. } = evaluation.cost;
    let conditions = &evaluation.conditions;
    let one = match &evaluation.kitchens[..] {
        [only] if conditions.scenes.is_empty() && conditions.procedural.is_none() => Some(only.kitchen),
        _ => None,
    };
    let place = place(conditions.split, conditions.procedural, conditions.scenes.len(), one);
    let seeds = seeds_of(conditions.distribution, conditions.split, conditions.episodes);
    let played = || seeds.unwrap_or_else(|| format!("{}, in {place}", conditions.episodes_played()));
    let mut lines: Vec<String> = columns.is_none().then(played).into_iter().collect();
    let scenes = conditions.scenes.iter().enumerate().filter(|_| conditions.procedural.is_none());
    lines.extend(scenes.map(|(index, file)| format!("scene {index} is {file}")));
    let results = results(spec, evaluation);
    let heads = results.heads.iter().map(|[head, _]| format!("{head:>6}"));
    let word = word_of_place(conditions.split, conditions.procedural.is_some(), !conditions.scenes.is_empty());
    let head = [format!("{word:12}"), "episodes".to_owned()].into_iter().chain(heads).collect();
    let row = |row: &ResultRow| [vec![row.name.clone(), row.episodes.to_string()], row.cells.clone()].concat();
    let table: Vec<Vec<String>> = std::iter::once(head).chain(results.rows.iter().map(row)).collect();
    lines.extend(blocks(&table, columns).iter().flat_map(|block| right_aligned(block, 1)));
    let (played, in_set) = (evaluation.categories.len(), |one: &&TargetCategory| conditions.objects.contains(**one));
    let asked = TargetCategory::ALL.iter().filter(in_set).count();
    if conditions.scenes.is_empty() && (1..asked).contains(&played) {
        lines.push(format!(
            "{played} of {asked} target categories were played: `--episodes` in multiples of 6 plays all"
        ));
    }
    // The row of all episodes is the last.
    let overall = results.rows.last().map_or(&[][..], |row| &row.cells);
    let intervals = results.heads.iter().zip(overall).zip(&results.intervals);
    lines.extend(intervals.filter_map(|(([head, _], mean), interval)| {
        let Within { whose, low, high } = interval.as_ref()?;
        Some(format!("{head} {mean}, {whose} 95% interval {low} to {high}"))
    }));
    let figures: Vec<String> = results.figures.iter().map(|[label, figure, _]| format!("{label} {figure}")).collect();
    lines.extend(wrapped(&figures.join("  "), columns.unwrap_or(UNBROKEN)));
    let rate = if wall_s > 0.0 { format::rate(steps as f64 / wall_s) } else { NOTHING.to_owned() };
    lines.push(format!("{} steps in {wall_s:.1} s: {rate} steps/s", format::count(steps)));
    lines
}

/// What an evaluation came to: a terminal prints it, and a page shows it.
pub fn results(spec: &Spec, evaluation: &Evaluation) -> Results {
    let described = spec.described();
    let (columns, further) = described.split_at(described.len() - spec.figures.len());
    let printed = |one: &&Described| !one.label.is_empty();
    let columns: Vec<&Described> = columns.iter().filter(printed).collect();
    let row = |name: &str, filter: Option<String>, figures: &Figures| ResultRow {
        name: name.to_owned(),
        filter,
        episodes: figures.episodes,
        cells: columns.iter().map(|one| shown(one, figures.get(&one.name))).collect(),
    };
    let of_kitchen = |part: &KitchenFigures| {
        let kitchen = part.kitchen;
        let name = kitchen.scene_index().map_or_else(|| format!("kitchen {kitchen}"), |scene| format!("scene {scene}"));
        row(&name, Some(format!("kitchen={}", kitchen.number())), &part.figures)
    };
    let of_category = |part: &CategoryFigures| {
        row(part.category.name(), Some(format!("target={}", part.category.name())), &part.figures)
    };
    // A hundred rows would bury the others; the result file has them all.
    let kitchens = if evaluation.conditions.procedural.is_some() { &[][..] } else { &evaluation.kitchens };
    let parts = kitchens.iter().map(of_kitchen).chain(evaluation.categories.iter().map(of_category));
    let sets = evaluation.object_sets.iter().map(|part| row(part.objects.name(), None, &part.figures));
    let overall = &evaluation.overall;
    let interval = |one: &Described| {
        let mean = overall.get(&one.name)?;
        let (whose, [low, high]) = if one.is_share() {
            let successes = (mean * overall.episodes as f64).round() as u64;
            wilson(successes, overall.episodes).map(|Interval { low, high }| ("Wilson's", [low, high]))?
        } else {
            ("the bootstrap's", *evaluation.intervals.get(&one.name)?)
        };
        let [low, high] = [low, high].map(|figure| shown(one, Some(figure)));
        Some(Within { whose, low, high })
    };
    let figure = |one: &Described| {
        let figure = overall.get(&one.name);
        let unit = if one.unit.is_empty() || figure.is_none() { String::new() } else { format!(" {}", one.unit) };
        [one.label.clone(), shown(one, figure) + &unit, one.doc.clone()]
    };
    Results {
        heads: columns.iter().map(|one| [heading(one), one.doc.clone()]).collect(),
        rows: parts.chain(sets).chain([row("all", None, overall)]).collect(),
        intervals: columns.iter().map(|one| interval(one)).collect(),
        figures: further.iter().filter(printed).map(figure).collect(),
    }
}

/// What a column is called.
pub fn heading(one: &Described) -> String {
    if one.unit == "m" { format!("{} (m)", one.label) } else { one.label.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluation::testing::played;
    use proto::config::Config;
    use proto::evaluation::{Conditions, EpisodeRecord, Subject};
    use proto::kitchen::KitchenId;

    fn result(spec: &Spec, objects: ObjectSet, record: EpisodeRecord) -> Vec<String> {
        lines(spec, &evaluation(spec, objects, record), None)
    }

    fn evaluation(spec: &Spec, objects: ObjectSet, record: EpisodeRecord) -> Evaluation {
        let (config, asked) = (Config::default(), EvaluationConfig::fixed(Split::Test, objects, 1));
        let conditions = Conditions::of(&config, &asked, "cpu".to_owned());
        Evaluation::of(spec, Subject::default(), conditions, Cost::default(), &[(record, vec![])])
    }

    #[test]
    fn evaluations_under_other_conditions_have_other_words() {
        let config = Config::default();
        let fixed = EvaluationConfig::fixed(Split::Test, ObjectSet::Novel, 1);
        let best = Some("/a/best/rollout-00000009.json".to_owned());
        let best = EvaluationConfig { checkpoint: best, deterministic: true, ..fixed.clone() };
        let drawn = EvaluationConfig { distribution: Distribution::Run, objects: ObjectSet::All, ..fixed.clone() };
        assert_eq!(brief(&config, &fixed), "test, novel objects, fixed episodes");
        assert_eq!(brief(&config, &drawn), "test, all objects, drawn episodes");
        let words = "test, novel objects, fixed episodes, best checkpoint, deterministic";
        assert_eq!(brief(&config, &best), words);
    }

    #[test]
    fn a_result_is_printed_as_its_task_declares_it() {
        let kitchen = KitchenId::new(2).unwrap();
        let arm = Config::default().spec();
        let printed = result(arm, ObjectSet::Novel, played(kitchen, 6, &["success", "picked_up"]));
        let head =
            "test          episodes  length      SR   SRwoD  SRwoD (per axis)  picked up  disturbance (m)  disturbed";
        assert_eq!(printed[1], head);
        let all =
            "all                  1     1.0  100.0%    0.0%              0.0%     100.0%            0.000       0.00";
        assert_eq!(printed[printed.len() - 9], all);
        let few = "1 of 6 target categories were played: `--episodes` in multiples of 6 plays all";
        assert_eq!(printed[printed.len() - 8], few);
        assert_eq!(printed[printed.len() - 7], "SR 100.0%, Wilson's 95% interval 20.7% to 100.0%");
        let figures = "disturbance per success 0.000 m  success but unsafe 0.0%  unsafe of the successes 0.0%  worst";
        assert!(printed[printed.len() - 3].starts_with(figures), "{printed:#?}");

        let came_to = results(arm, &evaluation(arm, ObjectSet::Novel, played(kitchen, 6, &["success", "picked_up"])));
        let rows: Vec<_> = came_to.rows.iter().map(|row| (row.name.as_str(), row.filter.as_deref())).collect();
        assert!(rows.contains(&("kitchen 2", Some("kitchen=2"))) && rows.last() == Some(&("all", None)), "{rows:?}");
        assert_eq!(came_to.figures[0][..2], ["disturbance per success", "0.000 m"]);

        let mut evaluation = evaluation(arm, ObjectSet::Novel, played(KitchenId::scene(0).unwrap(), 6, &["success"]));
        evaluation.conditions.scenes = vec!["runs/a/scenes/000/cabin.toml".to_owned()];
        let narrow = lines(arm, &evaluation, Some(80));
        let of_scenes = head.replacen("test  ", "scenes", 1);
        assert_eq!(narrow[1], of_scenes.strip_suffix("  disturbance (m)  disturbed").unwrap());
        assert!(narrow.contains(&"scenes        disturbance (m)  disturbed".to_owned()), "{narrow:#?}");
        let of_scene = lines(arm, &evaluation, None);
        assert_eq!(of_scene[1], "scene 0 is runs/a/scenes/000/cabin.toml");
        assert!(of_scene[3].starts_with("scene 0 "), "{of_scene:#?}");

        let text = r#"
        name = "small"
        actions = { kind = "discrete", names = ["Stop", "Ahead"] }
        channels = [
            { name = "there", role = "part", dtype = "f32", values = [0, 1], doc = "There." },
            { name = "spl", role = "outcome", dtype = "f32", range = [0, 1], doc = "How straight." },
        ]
        metrics = [
            { name = "success", label = "SR", over = "last", all_of = [{ channel = "there" }], doc = "There." },
            { name = "spl", label = "SPL", over = "last", value = "spl", doc = "How straight, 0 without success." },
        ]
        "#;
        let small = Spec::parse(text).unwrap();
        let numbers = vec![Some(1.0), Some(0.75)];
        let record = EpisodeRecord { category: None, numbers, ..played(kitchen, 6, &[]) };
        let expected = [
            "fixed episodes at full distance, in kitchen 2",
            "test          episodes  length      SR     SPL",
            "kitchen 2            1     1.0  100.0%    0.75",
            "all                  1     1.0  100.0%    0.75",
        ];
        assert_eq!(result(&small, ObjectSet::NoTargets, record)[..4], expected);
    }
}
