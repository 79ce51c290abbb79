//! What a figure shows as a table, for whoever wants to draw it differently.

use super::frame_strip::FrameStrip;
use super::heat_map::HeatMap;
use super::interval_plot::IntervalPlot;
use super::line_plot::LinePlot;
use csv::{Writer, WriterBuilder};

type Written = Result<(), csv::Error>;

/// A table under construction. The panels of one figure are of one kind, so that it has one head.
pub struct Sheet {
    table: Writer<Vec<u8>>,
    headed: bool,
}

impl Sheet {
    /// An empty one.
    pub fn new() -> Self {
        Self { table: WriterBuilder::new().from_writer(Vec::new()), headed: false }
    }

    /// What a panel of this title shows. `legend`: the names of styles.
    pub fn lines(&mut self, title: &str, legend: &[(usize, String)], plot: &LinePlot) {
        self.put(|table, head| lines(table, head, title, legend, plot));
    }

    /// What a panel of this title shows.
    pub fn intervals(&mut self, title: &str, plot: &IntervalPlot) {
        self.put(|table, head| intervals(table, head, title, plot));
    }

    /// What a panel of this title shows.
    pub fn heat(&mut self, title: &str, map: &HeatMap) {
        self.put(|table, head| heat(table, head, title, map));
    }

    /// What a panel of this title shows.
    pub fn frames(&mut self, title: &str, strip: &FrameStrip) {
        self.put(|table, head| frames(table, head, title, strip));
    }

    fn put(&mut self, write: impl FnOnce(&mut Writer<Vec<u8>>, bool) -> Written) {
        let head = !std::mem::replace(&mut self.headed, true);
        write(&mut self.table, head).expect("rows of one length, written to memory");
    }

    /// The table as CSV.
    pub fn finish(self) -> String {
        let bytes = self.table.into_inner().expect("memory takes all");
        String::from_utf8(bytes).expect("text was written")
    }
}

fn lines(table: &mut Writer<Vec<u8>>, head: bool, title: &str, legend: &[(usize, String)], plot: &LinePlot) -> Written {
    if head {
        // All panels of a figure have one axis across.
        table.write_record(["panel", "series", "line", "axis", &plot.x.label, "value", "low", "high"])?;
    }
    for series in &plot.series {
        let name = legend.iter().find(|(style, _)| *style == series.style).map_or("", |(_, name)| name);
        let mut row = |line: &str, (x, y): (f64, f64), band: Option<(f64, f64)>| {
            let [low, high] = [band.map(|(low, _)| low), band.map(|(_, high)| high)].map(written);
            let fixed = [title, name, line, &plot.y.label];
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

fn intervals(table: &mut Writer<Vec<u8>>, head: bool, title: &str, plot: &IntervalPlot) -> Written {
    if head {
        table.write_record(["panel", "group", "axis", "value", "low", "high", "paper"])?;
    }
    for row in &plot.rows {
        let (low, high) = (row.interval.map(|(low, _)| low), row.interval.map(|(_, high)| high));
        let numbers = [row.point, low, high, row.published].map(written);
        let fixed = [title, &row.name, &plot.axis.label];
        table.write_record(fixed.into_iter().chain(numbers.iter().map(String::as_str)))?;
    }
    Ok(())
}

fn heat(table: &mut Writer<Vec<u8>>, head: bool, title: &str, map: &HeatMap) -> Written {
    if head {
        table.write_record(["panel", "row", &map.x_label, &map.scale_label])?;
    }
    for (name, values) in map.rows.iter().zip(&map.values) {
        for (column, value) in values.iter().enumerate() {
            let Some(value) = value else { continue };
            table.write_record([title, name, &column.to_string(), &written(Some(*value))])?;
        }
    }
    Ok(())
}

fn frames(table: &mut Writer<Vec<u8>>, head: bool, title: &str, strip: &FrameStrip) -> Written {
    if head {
        table.write_record(["strip", "frame", "what it shows"])?;
    }
    for (number, frame) in strip.frames.iter().enumerate() {
        table.write_record([title, &(number + 1).to_string(), &frame.words.join("; ")])?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chart::{Axis, IntervalRow, Series, Unit};

    const TITLE: &str = "success, \"SR\"";

    fn table(put: impl FnOnce(&mut Sheet)) -> String {
        let mut sheet = Sheet::new();
        put(&mut sheet);
        sheet.finish()
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
        let legend = [(0, "other".to_owned()), (3, "a, b".to_owned())];
        let table = table(|sheet| sheet.lines(TITLE, &legend, &plot));
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
        let intervals = table(|sheet| sheet.intervals(TITLE, &plot));
        assert!(intervals.ends_with(",g,IQM,0.5,,,0.25\n"), "{intervals}");
        let map = HeatMap {
            x_label: "step".into(),
            scale_label: "share".into(),
            rows: vec!["Done".into()],
            values: vec![vec![Some(0.5), None, Some(1.0)]],
        };
        let heat = table(|sheet| sheet.heat(TITLE, &map));
        assert_eq!(
            heat.lines().map(|line| line.rsplit_once(",Done,").map_or("", |(_, rest)| rest)).collect::<Vec<_>>(),
            ["", "0,0.5", "2,1"]
        );
    }
}
