//! Where stages end: a line through a whole plot where all its curves have the stage, a stroke across those curves that
//! have it where others have not.

use crate::chart::{LinePlot, Mark, Series};
use crate::study::Group;
use crate::styled_group::StyledGroup;

/// Frames at which the stages of a group end, but for the last.
pub fn ends(group: &Group<'_>) -> Vec<f64> {
    marks(group).into_iter().map(|mark| mark.x).collect()
}

fn marks(group: &Group<'_>) -> Vec<Mark> {
    let mut at = 0;
    let stages = group.runs.iter().take(1).flat_map(|run| run.config.stages.array_windows::<2>());
    let mark = |[before, after]: &[_; 2]| {
        let (before, after): (&proto::config::StageConfig, &proto::config::StageConfig) = (before, after);
        at += before.frames;
        Mark { x: at as f64, label: format!("stage {}", after.name) }
    };
    stages.map(mark).collect()
}

/// Marks the stages on a plot whose curves are those of these groups. A curve that ends before a stage begins does not
/// have it.
pub fn mark(plot: &mut LinePlot, entries: &[&StyledGroup<'_>]) {
    let reached = |series: &Series| -> Vec<Mark> {
        let last = series.points.last().map_or(0.0, |point| point.0);
        let entry = entries.iter().find(|entry| entry.style == series.style);
        let marks = entry.map_or_else(Vec::new, |entry| marks(entry.group));
        marks.into_iter().filter(|mark| mark.x < last).collect()
    };
    let of_each: Vec<Vec<Mark>> = plot.series.iter().map(reached).collect();
    let Some(first) = of_each.first() else { return };
    if of_each.iter().all(|marks| marks == first) {
        plot.marks.clone_from(first);
        return;
    }
    for (series, marks) in plot.series.iter_mut().zip(of_each) {
        series.marks = marks;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chart::{Axis, Unit};
    use crate::study::{groups, tests::run};

    #[test]
    fn a_stage_is_marked_on_those_that_have_it() {
        let runs = [run("a", "disturb-two-stage", 1), run("b", "disturb-stage1-45m", 1)];
        let groups = groups(&runs).unwrap();
        let entries: Vec<StyledGroup<'_>> =
            groups.iter().enumerate().map(|(style, group)| StyledGroup { style, group, results: Vec::new() }).collect();
        let marked = |curves: &[(usize, f64)]| {
            let series = curves.iter().map(|&(style, frames)| Series {
                style,
                points: vec![(0.0, 0.1), (frames, 0.2)],
                ..Series::default()
            });
            let mut plot = LinePlot {
                x: Axis::new("frames", Unit::Count),
                y: Axis::new("rate", Unit::Percent),
                series: series.collect(),
                marks: Vec::new(),
            };
            mark(&mut plot, &entries.iter().collect::<Vec<_>>());
            (plot.marks.len(), plot.series.iter().map(|series| series.marks.len()).collect::<Vec<_>>())
        };
        assert_eq!(marked(&[(0, 45e6)]), (1, vec![0]), "a line through the plot");
        assert_eq!(marked(&[(0, 45e6), (1, 45e6)]), (0, vec![1, 0]), "a stroke on the curve that has the stage");
        assert_eq!(marked(&[(0, 15e6)]), (0, vec![0]), "it did not get there");
        assert_eq!(marked(&[]), (0, vec![]));
    }
}
