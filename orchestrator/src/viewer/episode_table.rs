use crate::evaluation::text::heading;
use proto::evaluation::EpisodeRecord;
use proto::kitchen::TargetCategory;
use proto::task::{Described, Spec};
use recording::episode_index::{Key, Shelved};
use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use view::data::{EpisodeColumn, EpisodeKey, EpisodePage, EpisodeQuery, EpisodeRow, Pairs, ROWS, ROWS_MAX};

pub fn row_of_shelved((kitchen, environment, episode): Key, shelved: &Shelved) -> Option<EpisodeRow> {
    let end = shelved.end.as_ref()?;
    let key = EpisodeKey { kitchen, environment, episode };
    Some(EpisodeRow {
        key: shelved.is_playable().then_some(key),
        kitchen,
        episode: shelved.fixed.unwrap_or(episode),
        environment: Some(environment),
        target: shelved.target.clone(),
        outcome: end.outcome.clone(),
        length: end.length,
        figures: as_read(end.figures.iter().map(|(name, number)| (&**name, *number))),
    })
}

pub fn row_of_record(spec: &Spec, record: &EpisodeRecord, recorded: &HashMap<(u32, u32), EpisodeKey>) -> EpisodeRow {
    let kitchen = record.kitchen.number();
    let key = recorded.get(&(kitchen, record.episode)).copied();
    let numbers = spec.columns().into_iter().zip(&record.numbers);
    let figures: Vec<(String, f64)> = numbers.filter_map(|(column, number)| Some((column.name, (*number)?))).collect();
    let metrics = &record.numbers[spec.plain_rewards().count()..];
    EpisodeRow {
        key,
        kitchen,
        episode: record.episode,
        environment: key.map(|key| key.environment),
        target: record.category.map(TargetCategory::name).map(str::to_owned),
        outcome: spec.outcome(metrics, Some(record.end)),
        length: record.length,
        figures: as_read(figures.iter().map(|(name, number)| (&**name, *number))),
    }
}

/// Numbers as they are read: 0.1 m is not 0.10000000149 m.
fn as_read<'a>(figures: impl IntoIterator<Item = (&'a str, f64)>) -> BTreeMap<String, f64> {
    let short = |number: f64| {
        let single = number as f32;
        if f64::from(single) == number { single.to_string().parse().unwrap_or(number) } else { number }
    };
    figures.into_iter().map(|(name, number)| (name.to_owned(), short(number))).collect()
}

fn columns(spec: &Spec) -> Vec<EpisodeColumn> {
    let mut columns = spec.columns();
    columns.rotate_left(spec.plain_rewards().count());
    let column = |one: Described| EpisodeColumn {
        label: if one.label.is_empty() { String::new() } else { heading(&one) },
        is_share: one.is_share(),
        name: one.name,
        doc: one.doc,
    };
    columns.into_iter().map(column).collect()
}

/// Takes the rows that are asked for, in the order that is asked for; `rows` come with the newest last.
pub fn page(spec: &Spec, mut rows: Vec<EpisodeRow>, query: &EpisodeQuery) -> EpisodePage {
    let total = rows.len();
    let kitchens: BTreeSet<u32> = rows.iter().map(|row| row.kitchen).collect();
    let targets: BTreeSet<String> = rows.iter().filter_map(|row| row.target.clone()).collect();
    let columns = columns(spec);
    let successes: Vec<String> = spec.good_outcomes().collect();
    rows.retain(|row| matches(row, query, &successes, &columns));
    let matching = rows.len();
    let sorted = sort(&mut rows, &query.sort, &columns);
    if !sorted || query.descending {
        rows.reverse();
    }
    let limit = if query.limit == 0 { ROWS } else { query.limit.min(ROWS_MAX) };
    EpisodePage {
        total,
        matching,
        rows: rows.into_iter().skip(query.offset).take(limit).collect(),
        kitchens: kitchens.into_iter().collect(),
        targets: targets.into_iter().collect(),
        columns,
        successes,
        ..EpisodePage::default()
    }
}

fn matches(row: &EpisodeRow, query: &EpisodeQuery, successes: &[String], columns: &[EpisodeColumn]) -> bool {
    let is_success = successes.contains(&row.outcome);
    query.kitchen.is_none_or(|kitchen| row.kitchen == kitchen)
        && query.target.as_ref().is_none_or(|target| row.target.as_ref() == Some(target))
        && query.outcome.as_ref().is_none_or(|outcome| match outcome.as_str() {
            "any-success" => is_success,
            "any-failure" => !is_success,
            outcome => row.outcome == outcome,
        })
        && query.recorded.is_none_or(|recorded| row.key.is_some() == recorded)
        && (!has_numbers(&query.range, columns) || within(number(row, &query.range), query))
}

fn within(number: Option<f64>, query: &EpisodeQuery) -> bool {
    match (number, query.least, query.most) {
        (_, None, None) => true,
        (Some(number), least, most) => {
            least.is_none_or(|least| number >= least) && most.is_none_or(|most| number <= most)
        }
        (None, ..) => false,
    }
}

fn has_numbers(column: &str, columns: &[EpisodeColumn]) -> bool {
    column == "length" || columns.iter().any(|one| one.name == column)
}

fn number(row: &EpisodeRow, column: &str) -> Option<f64> {
    if column == "length" { Some(row.length.into()) } else { row.figures.get(column).copied() }
}

fn sort(rows: &mut [EpisodeRow], column: &str, columns: &[EpisodeColumn]) -> bool {
    let compare: fn(&EpisodeRow, &EpisodeRow) -> Ordering = match column {
        "kitchen" => |a, b| (a.kitchen, a.environment, a.episode).cmp(&(b.kitchen, b.environment, b.episode)),
        "episode" => |a, b| a.episode.cmp(&b.episode),
        "target" => |a, b| a.target.cmp(&b.target),
        "outcome" => |a, b| a.outcome.cmp(&b.outcome),
        column if has_numbers(column, columns) => {
            let key = |row: &EpisodeRow| number(row, column).unwrap_or(f64::NEG_INFINITY);
            rows.sort_by(|a, b| key(a).total_cmp(&key(b)));
            return true;
        }
        _ => return false,
    };
    rows.sort_by(compare);
    true
}

/// Recorded episodes of a run, and what tells which of another run are the same.
pub struct Pairable {
    /// Of a training run: what its episodes are drawn by. Those of an evaluation are the same in every one.
    pub seed: Option<u64>,
    pub successes: Vec<String>,
    /// The number that tells two episodes of one outcome apart.
    pub measure: String,
    pub rows: Vec<EpisodeRow>,
    pub indexed: f64,
}

impl Pairable {
    fn name<'a>(&self, row: &'a EpisodeRow) -> (u32, Option<u32>, u32, Option<&'a str>, Option<u64>) {
        let environment = row.environment.filter(|_| self.seed.is_some());
        (row.kitchen, environment, row.episode, row.target.as_deref(), self.seed)
    }

    /// Whether it ended well: the smaller the better.
    fn rank(&self, row: &EpisodeRow) -> usize {
        self.successes.iter().position(|success| *success == row.outcome).unwrap_or(self.successes.len())
    }
}

/// Pairs every episode with the other run's; those that end most differently come first.
pub fn pairs([one, other]: &[Pairable; 2]) -> Pairs {
    let theirs: HashMap<_, _> = other.rows.iter().map(|row| (other.name(row), row)).collect();
    let mut found: Vec<_> = one
        .rows
        .iter()
        .filter_map(|row| {
            let pair = [row, *theirs.get(&one.name(row))?];
            let ranks = [one.rank(pair[0]), other.rank(pair[1])];
            let [a, b] = pair.map(|row| number(row, &one.measure).unwrap_or(0.0));
            Some((ranks, (a - b).abs(), pair))
        })
        .collect();
    found.sort_by(|(a, apart, _), (b, further, _)| {
        b[0].abs_diff(b[1]).cmp(&a[0].abs_diff(a[1])).then_with(|| further.total_cmp(apart))
    });
    let better = |least: fn(&[usize; 2]) -> bool| found.iter().filter(|(ranks, ..)| least(ranks)).count();
    Pairs {
        total: found.len(),
        better: [better(|ranks| ranks[0] < ranks[1]), better(|ranks| ranks[1] < ranks[0])],
        indexed: one.indexed.min(other.indexed),
        rows: found.iter().take(ROWS_MAX).map(|(.., pair)| pair.map(EpisodeRow::clone)).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(kitchen: u32, episode: u32, outcome: &str, disturbance_m: f32) -> EpisodeRow {
        EpisodeRow {
            key: (episode != 3).then_some(EpisodeKey { kitchen, environment: 0, episode }),
            kitchen,
            episode,
            environment: Some(0),
            target: Some(if episode.is_multiple_of(2) { "Mug" } else { "Bread" }.to_owned()),
            outcome: outcome.to_owned(),
            length: 10 * episode,
            figures: as_read([("disturbance_m", disturbance_m.into())]),
        }
    }

    fn arm() -> &'static Spec {
        proto::config::Config::default().spec()
    }

    fn rows() -> Vec<EpisodeRow> {
        vec![
            row(2, 1, "failure", 0.0),
            row(1, 2, "success", 0.2),
            row(2, 3, "success-without-disturbance", 0.0),
            row(1, 4, "time-limit", 0.1),
        ]
    }

    fn episodes(query: &EpisodeQuery) -> Vec<u32> {
        page(arm(), rows(), query).rows.iter().map(|row| row.episode).collect()
    }

    #[test]
    fn the_newest_come_first_unless_a_column_says_otherwise() {
        let query = EpisodeQuery::default();
        assert_eq!(episodes(&query), [4, 3, 2, 1]);
        let by = |sort: &str, descending| EpisodeQuery { sort: sort.to_owned(), descending, ..EpisodeQuery::default() };
        assert_eq!(episodes(&by("kitchen", false)), [2, 4, 1, 3]);
        assert_eq!(episodes(&by("disturbance_m", true)), [2, 4, 3, 1]);
        assert_eq!(episodes(&by("length", false)), [1, 2, 3, 4]);
        assert_eq!(episodes(&by("no such column", true)), [4, 3, 2, 1]);
    }

    #[test]
    fn of_all_that_two_runs_have_those_that_end_otherwise_are_found() {
        let run = |seed, last: EpisodeRow| {
            let mut rows: Vec<EpisodeRow> = (0..2000).map(|episode| row(1, 10 + episode, "failure", 0.0)).collect();
            rows.push(last);
            let successes = vec!["success-without-disturbance".to_owned(), "success".to_owned()];
            Pairable { seed, successes, measure: "disturbance_m".to_owned(), rows, indexed: 1.0 }
        };
        let found = |seeds: [Option<u64>; 2]| {
            let one = run(seeds[0], row(30, 1, "success", 0.2));
            pairs(&[one, run(seeds[1], row(30, 1, "success-without-disturbance", 0.0))])
        };
        let all = found([Some(1), Some(1)]);
        assert_eq!((all.total, all.better, all.rows.len()), (2001, [0, 1], ROWS_MAX));
        assert_eq!(all.rows[0].clone().map(|row| row.kitchen), [30, 30]);
        assert_eq!(found([None, None]).total, 2001, "evaluations play the same episodes");
        assert_eq!(found([Some(1), Some(2)]).total, 0, "another seed draws others");
        assert_eq!(found([Some(1), None]).total, 0);
    }

    #[test]
    fn columns_are_called_as_an_evaluation_calls_them() {
        let columns = columns(arm());
        let label = |name: &str| columns.iter().find(|one| one.name == name).unwrap().label.as_str();
        let names = ["success_without_disturbance_per_axis", "disturbance_m", "return_r"];
        assert_eq!(names.map(label), ["SRwoD (per axis)", "disturbance (m)", ""]);
    }

    #[test]
    fn filters_leave_what_they_are_called_after() {
        let only = |change: fn(&mut EpisodeQuery)| {
            let mut query = EpisodeQuery { sort: "episode".to_owned(), ..EpisodeQuery::default() };
            change(&mut query);
            episodes(&query)
        };
        assert_eq!(only(|query| query.kitchen = Some(1)), [2, 4]);
        assert_eq!(only(|query| query.target = Some("Bread".to_owned())), [1, 3]);
        assert_eq!(only(|query| query.outcome = Some("success".to_owned())), [2]);
        assert_eq!(only(|query| query.outcome = Some("any-success".to_owned())), [2, 3]);
        assert_eq!(only(|query| query.outcome = Some("any-failure".to_owned())), [1, 4]);
        assert_eq!(only(|query| query.recorded = Some(false)), [3]);
        let range = |column: &str, least: Option<f64>, most: Option<f64>| {
            episodes(&EpisodeQuery { range: column.to_owned(), least, most, ..EpisodeQuery::default() })
        };
        assert_eq!(range("length", Some(20.0), Some(30.0)), [3, 2]);
        assert_eq!(range("disturbance_m", Some(0.1), None), [4, 2], "both ends are in the range");
        assert_eq!(range("disturbance_m", None, Some(0.0)), [3, 1]);
        assert_eq!(range("return_r", Some(-1e9), None), [0; 0], "what is not known is in no range");
        assert_eq!(range("return_r", None, None), [4, 3, 2, 1]);
        assert_eq!(range("no such column", Some(7.0), None), [4, 3, 2, 1]);
        assert_eq!(only(|query| (query.offset, query.limit) = (1, 2)), [2, 3]);
        assert_eq!(only(|query| query.offset = usize::MAX), [0; 0]);
        let whole = page(arm(), rows(), &EpisodeQuery { kitchen: Some(1), ..EpisodeQuery::default() });
        assert_eq!((whole.total, whole.matching, whole.kitchens), (4, 2, vec![1, 2]));
        assert_eq!(whole.targets, ["Bread", "Mug"]);
    }
}
