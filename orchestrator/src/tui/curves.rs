//! Points of learning curves: means over as many rollouts as a place on the screen stands for. Pure.

use proto::metric;
use std::collections::BTreeMap;
use view::data::Curves;

const SMOOTHED: f64 = 0.04;

#[derive(Debug, Clone, PartialEq)]
pub struct Piece {
    pub stage: usize,
    pub points: Vec<(f64, f64)>,
}

/// A figure's curve by stage, of at most `places` points in all: a stage begins with a new mean, because its reward is
/// another one. Each rollout counts by the episodes that ended in it.
pub fn pieces(curves: &Curves, name: &str, places: usize) -> Vec<Piece> {
    let (Some(values), Some(&end)) = (curves.series.get(name), curves.frames.last()) else { return Vec::new() };
    let episodes = curves.series.get(metric::EPISODES);
    let weight = |at: usize| episodes.map_or(Some(1.0), |episodes| episodes.get(at).copied().flatten());
    let place = |frames: u64| ((frames as f64 / end.max(1) as f64 * places as f64) as usize).min(places.max(1) - 1);
    // For each stage and place: the sum of values and of weights.
    let mut sums: BTreeMap<u32, Vec<(f64, f64)>> = BTreeMap::new();
    for (at, (&frames, &stage)) in curves.frames.iter().zip(&curves.stage).enumerate() {
        if let (Some(Some(value)), Some(weight)) = (values.get(at), weight(at)) {
            let sum = &mut sums.entry(stage).or_insert_with(|| vec![(0.0, 0.0); places.max(1)])[place(frames)];
            sum.0 += f64::from(*value) * f64::from(weight);
            sum.1 += f64::from(weight);
        }
    }
    let reach = (SMOOTHED * places as f64 / 2.0) as usize;
    let piece = |(stage, sums): (u32, Vec<(f64, f64)>)| {
        let mean = |at: usize| {
            let around = &sums[at.saturating_sub(reach)..(at + reach + 1).min(sums.len())];
            let (sum, weight) = around.iter().fold((0.0, 0.0), |all, one| (all.0 + one.0, all.1 + one.1));
            sum / weight
        };
        let middle = |at: usize| (at as f64 + 0.5) / places.max(1) as f64 * end as f64;
        let filled = (0..sums.len()).filter(|&at| sums[at].1 > 0.0);
        Piece { stage: stage as usize, points: filled.map(|at| (middle(at), mean(at))).collect() }
    };
    let pieces = sums.into_iter().map(piece);
    pieces.filter(|piece| !piece.points.is_empty()).collect()
}

pub fn extremes<'a>(pieces: impl Iterator<Item = &'a Piece>) -> Option<[f64; 2]> {
    let values = pieces.flat_map(|piece| &piece.points).map(|(_, value)| *value).filter(|value| value.is_finite());
    values.fold(None, |range: Option<[f64; 2]>, value| {
        let [least, greatest] = range.unwrap_or([value, value]);
        Some([least.min(value), greatest.max(value)])
    })
}

/// An axis for values between their extremes: one value has one, too.
pub fn range<'a>(pieces: impl Iterator<Item = &'a Piece>) -> Option<[f64; 2]> {
    let range = extremes(pieces);
    range.map(|[least, greatest]| if greatest > least { [least, greatest] } else { [least - 0.5, greatest + 0.5] })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curves(values: &[Option<f32>], episodes: &[Option<f32>], stage: &[u32]) -> Curves {
        let series = [("x".to_owned(), values.to_vec()), (metric::EPISODES.to_owned(), episodes.to_vec())];
        Curves {
            frames: (1..=values.len() as u64).map(|rollout| 100 * rollout).collect(),
            stage: stage.to_vec(),
            series: BTreeMap::from(series),
            ..Curves::default()
        }
    }

    #[test]
    fn rollouts_in_one_place_are_a_mean_by_their_episodes_and_stages_are_apart() {
        let some = |values: &[f32]| values.iter().copied().map(Some).collect::<Vec<_>>();
        let curves = curves(&some(&[1.0, 5.0, 8.0, 2.0]), &some(&[1.0, 3.0, 1.0, 1.0]), &[0, 0, 0, 1]);
        // Places of 200 frames: rollouts end at 100, at 200 and 300, at 400.
        let found = pieces(&curves, "x", 2);
        let expected = [
            Piece { stage: 0, points: vec![(100.0, 1.0), (300.0, (3.0 * 5.0 + 8.0) / 4.0)] },
            Piece { stage: 1, points: vec![(300.0, 2.0)] },
        ];
        assert_eq!(found, expected);
        assert_eq!(range(found.iter()), Some([1.0, 5.75]));
        assert_eq!(pieces(&curves, "y", 2), []);
    }

    #[test]
    fn what_is_missing_is_no_point_and_one_value_has_a_range() {
        let curves = curves(&[None, Some(3.0), Some(9.0)], &[None, Some(2.0), None], &[0, 0, 0]);
        let found = pieces(&curves, "x", 300);
        assert_eq!(found, [Piece { stage: 0, points: vec![(200.5, 3.0)] }]);
        assert_eq!(range(found.iter()), Some([2.5, 3.5]));
        assert_eq!(range([].iter()), None);
    }

    #[test]
    fn many_rollouts_are_smoothed_over_their_neighbours() {
        let values: Vec<Option<f32>> =
            (0..1000).map(|rollout| Some(if rollout % 2 == 0 { 0.0 } else { 1.0 })).collect();
        let curves = curves(&values, &vec![Some(1.0); 1000], &[0; 1000]);
        let points = &pieces(&curves, "x", 500)[0].points;
        assert_eq!(points.len(), 500);
        assert!(points.iter().all(|(_, value)| (value - 0.5).abs() < 0.03));
    }
}
