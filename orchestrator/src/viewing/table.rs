//! Episodes as rows: from recordings, from the tables of evaluations; filtered, sorted, a page at a time.

use crate::recording::shelf::{Key, Shelved};
use proto::evaluation::EpisodeRecord;
use proto::kitchen::TargetCategory;
use proto::record::End;
use proto::task::Spec;
use std::cmp::Ordering;
use std::collections::{BTreeSet, HashMap};
use view::data::{EpisodeKey, EpisodePage, EpisodeQuery, EpisodeRow, ROWS, ROWS_MAX};

/// An episode of the recordings that has ended.
pub fn row_of_shelved((kitchen, environment, episode): Key, shelved: &Shelved) -> Option<EpisodeRow> {
    let end = shelved.end.as_ref()?;
    let outcome = outcome(end.success, end.success_undisturbed, end.time_limit);
    let key = EpisodeKey { kitchen, environment, episode };
    Some(EpisodeRow {
        key: shelved.is_playable().then_some(key),
        kitchen,
        episode: shelved.fixed.unwrap_or(episode),
        environment: Some(environment),
        target: target(end.target),
        outcome,
        picked_up: end.picked_up,
        length: end.length,
        failed_actions: Some(shelved.failed_actions()),
        returns: end.return_r.zip(end.return_r_prime).map(|(r, r_prime)| [r, r_prime]),
        disturbance_m: end.disturbance_m,
        disturbed_objects: end.disturbed_objects,
        object_goal_m: end.object_goal_m,
    })
}

/// An episode of an evaluation. `recorded`: the recordings' episodes by kitchen and number in it.
pub fn row_of_record(spec: &Spec, record: &EpisodeRecord, recorded: &HashMap<(u32, u32), EpisodeKey>) -> EpisodeRow {
    let kitchen = record.kitchen.number();
    let key = recorded.get(&(kitchen, record.episode)).copied();
    let known = |name: &str| record.number(spec.column(name)?);
    let number = |name: &str| known(name).unwrap_or(0.0);
    let is = |name: &str| number(name) == 1.0;
    EpisodeRow {
        key,
        kitchen,
        episode: record.episode,
        environment: key.map(|key| key.environment),
        target: record.category.map_or("", TargetCategory::name).to_owned(),
        outcome: outcome(is("success"), is("success_without_disturbance"), record.end == End::Truncated),
        picked_up: is("picked_up"),
        length: record.length,
        failed_actions: known("failed_actions").map(|count| count as u32),
        returns: known("return_r").zip(known("return_r_prime")).map(|(r, r_prime)| [r, r_prime]),
        disturbance_m: number("disturbance_m") as f32,
        disturbed_objects: number("disturbed_objects") as u32,
        object_goal_m: number("object_goal_m") as f32,
    }
}

fn outcome(success: bool, undisturbed: bool, time_limit: bool) -> &'static str {
    match (success, undisturbed, time_limit) {
        (true, true, _) => "success-without-disturbance",
        (true, false, _) => "success",
        (false, _, false) => "failure",
        (false, _, true) => "time-limit",
    }
}

fn target(number: i32) -> String {
    let category = u8::try_from(number).ok().and_then(TargetCategory::from_index);
    category.map_or_else(|| format!("target {number}"), |category| category.name().to_owned())
}

/// Takes the rows that are asked for, in the order that is asked for; `rows` come with the newest last.
pub fn page(mut rows: Vec<EpisodeRow>, query: &EpisodeQuery) -> EpisodePage {
    let total = rows.len();
    let kitchens: BTreeSet<u32> = rows.iter().map(|row| row.kitchen).collect();
    let targets: BTreeSet<String> = rows.iter().map(|row| row.target.clone()).collect();
    rows.retain(|row| matches(row, query));
    let matching = rows.len();
    match comparison(&query.sort) {
        Some(compare) => rows.sort_by(compare),
        None => rows.reverse(),
    }
    if query.descending && comparison(&query.sort).is_some() {
        rows.reverse();
    }
    let limit = if query.limit == 0 { ROWS } else { query.limit.min(ROWS_MAX) };
    EpisodePage {
        total,
        matching,
        rows: rows.into_iter().skip(query.offset).take(limit).collect(),
        kitchens: kitchens.into_iter().collect(),
        targets: targets.into_iter().collect(),
        ..EpisodePage::default()
    }
}

fn matches(row: &EpisodeRow, query: &EpisodeQuery) -> bool {
    let is_success = row.outcome.starts_with("success");
    query.kitchen.is_none_or(|kitchen| row.kitchen == kitchen)
        && query.target.as_ref().is_none_or(|target| row.target == *target)
        && query.outcome.as_ref().is_none_or(|outcome| match outcome.as_str() {
            "any-success" => is_success,
            "any-failure" => !is_success,
            outcome => row.outcome == outcome,
        })
        && query.disturbed.is_none_or(|disturbed| (row.disturbed_objects > 0) == disturbed)
        && query.recorded.is_none_or(|recorded| row.key.is_some() == recorded)
        && number(&query.range).is_none_or(|number| within(number(row), query))
}

/// Whether a number is in the range that is asked for; one that is not known is in none.
fn within(number: Option<f64>, query: &EpisodeQuery) -> bool {
    match (number, query.least, query.most) {
        (_, None, None) => true,
        (Some(number), least, most) => {
            least.is_none_or(|least| number >= least) && most.is_none_or(|most| number <= most)
        }
        (None, ..) => false,
    }
}

/// The number in a column; none of a column without numbers.
fn number(column: &str) -> Option<fn(&EpisodeRow) -> Option<f64>> {
    Some(match column {
        "length" => |row| Some(f64::from(row.length)),
        "failed" => |row| row.failed_actions.map(f64::from),
        "return" => |row| row.returns.map(|[r, _]| r),
        // As it is read: 0.1 m is not 0.10000000149 m.
        "disturbance" => |row| row.disturbance_m.to_string().parse().ok(),
        "objects" => |row| Some(f64::from(row.disturbed_objects)),
        "distance" => |row| row.object_goal_m.to_string().parse().ok(),
        _ => return None,
    })
}

/// How rows are compared in a column; none of no column.
fn comparison(column: &str) -> Option<fn(&EpisodeRow, &EpisodeRow) -> Ordering> {
    Some(match column {
        "kitchen" => |a, b| (a.kitchen, a.environment, a.episode).cmp(&(b.kitchen, b.environment, b.episode)),
        "episode" => |a, b| a.episode.cmp(&b.episode),
        "target" => |a, b| a.target.cmp(&b.target),
        "outcome" => |a, b| a.outcome.cmp(b.outcome),
        "length" => |a, b| a.length.cmp(&b.length),
        "failed" => |a, b| a.failed_actions.cmp(&b.failed_actions),
        "return" => |a, b| a.returns.map_or(f64::MIN, |r| r[0]).total_cmp(&b.returns.map_or(f64::MIN, |r| r[0])),
        "disturbance" => |a, b| a.disturbance_m.total_cmp(&b.disturbance_m),
        "objects" => |a, b| a.disturbed_objects.cmp(&b.disturbed_objects),
        "distance" => |a, b| a.object_goal_m.total_cmp(&b.object_goal_m),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(kitchen: u32, episode: u32, outcome: &'static str, objects: u32) -> EpisodeRow {
        EpisodeRow {
            key: (episode != 3).then_some(EpisodeKey { kitchen, environment: 0, episode }),
            kitchen,
            episode,
            environment: Some(0),
            target: if episode.is_multiple_of(2) { "Mug" } else { "Bread" }.to_owned(),
            outcome,
            picked_up: true,
            length: 10 * episode,
            failed_actions: Some(0),
            returns: None,
            disturbance_m: 0.1 * objects as f32,
            disturbed_objects: objects,
            object_goal_m: 0.0,
        }
    }

    fn rows() -> Vec<EpisodeRow> {
        vec![
            row(2, 1, "failure", 0),
            row(1, 2, "success", 2),
            row(2, 3, "success-without-disturbance", 0),
            row(1, 4, "time-limit", 1),
        ]
    }

    fn episodes(query: &EpisodeQuery) -> Vec<u32> {
        page(rows(), query).rows.iter().map(|row| row.episode).collect()
    }

    #[test]
    fn the_newest_come_first_unless_a_column_says_otherwise() {
        let query = EpisodeQuery::default();
        assert_eq!(episodes(&query), [4, 3, 2, 1]);
        let by = |sort: &str, descending| EpisodeQuery { sort: sort.to_owned(), descending, ..EpisodeQuery::default() };
        assert_eq!(episodes(&by("kitchen", false)), [2, 4, 1, 3]);
        assert_eq!(episodes(&by("disturbance", true)), [2, 4, 3, 1]);
        assert_eq!(episodes(&by("length", false)), [1, 2, 3, 4]);
        assert_eq!(episodes(&by("no such column", true)), [4, 3, 2, 1]);
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
        assert_eq!(only(|query| query.disturbed = Some(true)), [2, 4]);
        assert_eq!(only(|query| query.recorded = Some(false)), [3]);
        let range = |column: &str, least: Option<f64>, most: Option<f64>| {
            episodes(&EpisodeQuery { range: column.to_owned(), least, most, ..EpisodeQuery::default() })
        };
        assert_eq!(range("length", Some(20.0), Some(30.0)), [3, 2]);
        assert_eq!(range("disturbance", Some(0.1), None), [4, 2], "both ends are in the range");
        assert_eq!(range("objects", None, Some(0.0)), [3, 1]);
        assert_eq!(range("return", Some(-1e9), None), [0; 0], "what is not known is in no range");
        assert_eq!(range("failed", None, None), [4, 3, 2, 1]);
        assert_eq!(range("no such column", Some(7.0), None), [4, 3, 2, 1]);
        assert_eq!(only(|query| (query.offset, query.limit) = (1, 2)), [2, 3]);
        assert_eq!(only(|query| query.offset = usize::MAX), [0; 0]);
        let whole = page(rows(), &EpisodeQuery { kitchen: Some(1), ..EpisodeQuery::default() });
        assert_eq!((whole.total, whole.matching, whole.kitchens), (4, 2, vec![1, 2]));
        assert_eq!(whole.targets, ["Bread", "Mug"]);
    }
}
