//! What a figure shows as a table, for whoever wants to draw it differently.

use super::figure::{Content, Figure, Panel};
use super::frame_strip::FrameStrip;
use super::heat_map::HeatMap;
use super::interval_plot::IntervalPlot;
use super::line_plot::LinePlot;
use csv::{Writer, WriterBuilder};

type Written = Result<(), csv::Error>;

/// The figure's data as CSV: what all its panels show, with the names that stand in the figure.
pub fn csv(figure: &Figure) -> String {
    let mut table = WriterBuilder::new().from_writer(Vec::new());
    let mut headed = false;
    for panel in &figure.panels {
        // The panels of one figure are of one kind.
        let head = !std::mem::replace(&mut headed, true);
        let written = match &panel.content {
            Content::Lines(plot) => lines(&mut table, head, figure, panel, plot),
            Content::Intervals(plot) => intervals(&mut table, head, panel, plot),
            Content::Heat(map) => heat(&mut table, head, panel, map),
            Content::Frames(strip) => frames(&mut table, head, panel, strip),
        };
        written.expect("rows of one length, written to memory");
    }
    let bytes = table.into_inner().expect("memory takes all");
    String::from_utf8(bytes).expect("text was written")
}

fn lines(table: &mut Writer<Vec<u8>>, head: bool, figure: &Figure, panel: &Panel, plot: &LinePlot) -> Written {
    if head {
        // All panels of a figure have one axis across.
        table.write_record(["panel", "series", "line", "axis", &plot.x.label, "value", "low", "high"])?;
    }
    for series in &plot.series {
        let name = figure.legend.iter().find(|(style, _)| *style == series.style).map_or("", |(_, name)| name);
        let mut row = |line: &str, (x, y): (f64, f64), band: Option<(f64, f64)>| {
            let [low, high] = [band.map(|(low, _)| low), band.map(|(_, high)| high)].map(written);
            let fixed = [&panel.title, name, line, &plot.y.label];
            let numbers = [written(Some(x)), written(Some(y)), low, high];
            table.write_record(fixed.into_iter().chain(numbers.iter().map(String::as_str)))
        };
        for &point in &series.points {
            // A band has the places of its curve, as far as there are several seeds.
            let band = series.band.iter().find(|(x, _, _)| *x == point.0).map(|&(_, low, high)| (low, high));
            row("mean", point, band)?;
        }
        for (number, raw) in series.raw.iter().enumerate() {
            let line = format!("run {}", number + 1);
            raw.iter().try_for_each(|&point| row(&line, point, None))?;
        }
    }
    Ok(())
}

/// A number with nine digits that count, which is more than anything here is known to; nothing for none.
fn written(value: Option<f64>) -> String {
    let rounded = |value: f64| format!("{value:.8e}").parse::<f64>().unwrap_or(value).to_string();
    value.map_or_else(String::new, rounded)
}

fn intervals(table: &mut Writer<Vec<u8>>, head: bool, panel: &Panel, plot: &IntervalPlot) -> Written {
    if head {
        table.write_record(["panel", "group", "axis", "value", "low", "high", "paper"])?;
    }
    for row in &plot.rows {
        let (low, high) = (row.interval.map(|(low, _)| low), row.interval.map(|(_, high)| high));
        let numbers = [row.point, low, high, row.published].map(written);
        let fixed = [&panel.title, &row.name, &plot.axis.label].map(String::as_str);
        table.write_record(fixed.into_iter().chain(numbers.iter().map(String::as_str)))?;
    }
    Ok(())
}

fn heat(table: &mut Writer<Vec<u8>>, head: bool, panel: &Panel, map: &HeatMap) -> Written {
    if head {
        table.write_record(["panel", "row", &map.x_label, &map.scale_label])?;
    }
    for (name, values) in map.rows.iter().zip(&map.values) {
        for (column, value) in values.iter().enumerate() {
            let Some(value) = value else { continue };
            table.write_record([&panel.title, name, &column.to_string(), &written(Some(*value))])?;
        }
    }
    Ok(())
}

fn frames(table: &mut Writer<Vec<u8>>, head: bool, panel: &Panel, strip: &FrameStrip) -> Written {
    if head {
        table.write_record(["strip", "frame", "what it shows"])?;
    }
    for (number, frame) in strip.frames.iter().enumerate() {
        table.write_record([&panel.title, &(number + 1).to_string(), &frame.words.join("; ")])?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chart::{Axis, IntervalRow, Series, Unit};

    fn figure(content: Content, legend: Vec<(usize, String)>) -> Figure {
        let panels = vec![Panel { title: "success, \"SR\"".into(), content }];
        Figure { name: "f".into(), caption: String::new(), legend, columns: 1, panel_height: 100.0, panels }
    }

    #[test]
    fn a_table_has_every_point_that_is_drawn_and_what_it_is_called() {
        let series = Series {
            style: 3,
            points: vec![(0.0, 0.25), (10.0, 1.0 / 3.0)],
            band: vec![(10.0, 0.1 + 0.2, 0.6)],
            raw: vec![vec![(0.0, 0.1)], vec![(0.0, 0.4)]],
            ..Series::default()
        };
        let (x, y) = (Axis::new("frames", Unit::Count), Axis::new("share", Unit::Percent));
        let plot = LinePlot { x, y, series: vec![series], marks: Vec::new() };
        let table = csv(&figure(Content::Lines(plot), vec![(0, "other".into()), (3, "a, b".into())]));
        let start = "\"success, \"\"SR\"\"\",\"a, b\"";
        let rows =
            ["mean,share,0,0.25,,", "mean,share,10,0.333333333,0.3,0.6", "run 1,share,0,0.1,,", "run 2,share,0,0.4,,"];
        let expected: Vec<String> = rows.iter().map(|row| format!("{start},{row}")).collect();
        assert!(table.starts_with("panel,series,line,axis,frames,value,low,high\n"), "{table}");
        assert_eq!(table.lines().skip(1).collect::<Vec<_>>(), expected);
    }

    #[test]
    fn what_is_not_known_is_an_empty_cell() {
        let row = IntervalRow { name: "g".into(), style: 0, point: Some(0.5), interval: None, published: Some(0.25) };
        let plot = IntervalPlot { axis: Axis::new("IQM", Unit::Percent), rows: vec![row] };
        let table = csv(&figure(Content::Intervals(plot), Vec::new()));
        assert!(table.ends_with(",g,IQM,0.5,,,0.25\n"), "{table}");
        let map = HeatMap {
            x_label: "step".into(),
            scale_label: "share".into(),
            rows: vec!["Done".into()],
            values: vec![vec![Some(0.5), None, Some(1.0)]],
        };
        let table = csv(&figure(Content::Heat(map), Vec::new()));
        assert_eq!(
            table.lines().map(|line| line.rsplit_once(",Done,").map_or("", |(_, rest)| rest)).collect::<Vec<_>>(),
            ["", "0,0.5", "2,1"]
        );
    }
}
