use super::curves::{Piece, extremes, pieces, range};
use super::model::{Lines, Model};
use crate::output::format;
use proto::metric;
use proto::printable::printable;
use proto::task::Described;
use ratatui::Frame;
use ratatui::layout::{Constraint, Rect};
use ratatui::style::{Color, Style, Stylize};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Axis, Block, Cell, Chart, Dataset, GraphType, Paragraph, Row, Table};
use std::ops::Range;
use view::data::{Kitchen, Live, LogLine, Worker};

pub const STAGES: [Color; 4] = [Color::Cyan, Color::Yellow, Color::Green, Color::Magenta];
/// Columns of a chart whose axis has room for its unit.
const WITH_UNIT: u16 = 34;
/// Columns of a kitchen's row: its number, episodes and two figures.
const KITCHEN_COLUMNS: u16 = 32;
const SECOND: Color = Color::DarkGray;

pub fn chart(frame: &mut Frame, area: Rect, model: &Model, live: &Live, number: usize) {
    let places = 2 * usize::from(area.width);
    let of = |name: &str| pieces(&model.curves, name, places);
    let last = |pieces: &[Piece]| pieces.last().and_then(|piece| piece.points.last()).map(|(_, value)| *value);
    let card = &live.card;
    // Two shares have a chart, and one value has.
    let charted: Vec<&Described> = match number {
        0 => vec![],
        1 => card.metrics.iter().filter(|metric| metric.is_share()).take(2).collect(),
        _ => card.metrics.iter().filter(|metric| !metric.is_share()).take(1).collect(),
    };
    let mut curves = charted.iter().map(|metric| of(&metric::of_episode(&metric.name)));
    let (plain, plain_name) = if number == 0 { (metric::RETURN, "return") } else { (metric::LENGTH, "length") };
    let (first, second) = (curves.next().unwrap_or_else(|| of(plain)), curves.next().unwrap_or_default());
    let title = if charted.is_empty() {
        let stage = live.stage.and_then(|stage| live.stages.get(stage));
        // Where there is no mean over the newest tenth the end of the curve, whatever the width.
        let newest = stage.and_then(|stage| stage.figures.get(plain).copied());
        let newest = newest.or_else(|| last(&pieces(&model.curves, plain, 200)));
        vec![Span::from(format!(" {plain_name} {} ", format::number(newest, 2)))]
    } else {
        let text = |metric: &Described, pieces: &[Piece]| {
            let value = card.figures.get(&metric.name).copied().or_else(|| last(pieces));
            format!(" {} {} ", metric.label, format::metric(metric, value))
        };
        let spans = charted.iter().zip([&first, &second]).map(|(metric, pieces)| Span::from(text(metric, pieces)));
        spans.zip([Color::Reset, SECOND]).map(|(span, color)| span.fg(color)).collect()
    };
    let is_share = charted.first().is_some_and(|metric| metric.is_share());
    let [least, greatest] = match number {
        _ if is_share => extremes(first.iter().chain(&second)).map_or([0.0, 1.0], share_bounds),
        1 | 2 => [0.0, range(first.iter()).map_or(1.0, |[_, greatest]| greatest.max(1e-3))],
        _ => range(first.iter()).unwrap_or([0.0, 1.0]),
    };
    let line = |points, color| {
        Dataset::default()
            .marker(Marker::Braille)
            .graph_type(GraphType::Line)
            .style(Style::new().fg(color))
            .data(points)
    };
    let lines = second.iter().map(|piece| line(&piece.points, SECOND));
    let lines = lines.chain(first.iter().map(|piece| line(&piece.points, STAGES[piece.stage % STAGES.len()])));
    let frames = model.curves.frames.last().copied().unwrap_or(0);
    let label = |value: f64| match number {
        _ if is_share => format!("{:.0}%", 100.0 * value),
        0 if greatest - least > 5.0 => format!("{value:.1}"),
        _ if greatest.abs().max(least.abs()) < 0.1 => format!("{value:.3}"),
        _ => format!("{value:.2}"),
    };
    let last = if area.width < WITH_UNIT { short(frames) } else { format!("{} frames", short(frames)) };
    let x = Axis::default().bounds([0.0, frames.max(1) as f64]).labels(["0".to_owned(), last]);
    let y = Axis::default().bounds([least, greatest]).labels([label(least), label(greatest)]);
    let chart = Chart::new(lines.collect()).block(Block::bordered().title(Line::from(title))).x_axis(x).y_axis(y);
    frame.render_widget(chart, area);
}

fn short(count: u64) -> String {
    match count {
        0..10_000 => count.to_string(),
        10_000..999_500 => format!("{}k", (count + 500) / 1000),
        999_500..9_950_000 => format!("{:.1}M", count as f64 / 1e6),
        _ => format!("{:.0}M", count as f64 / 1e6),
    }
}

pub fn processes(frame: &mut Frame, area: Rect, model: &Model, live: &Live) {
    let of = |kind: &str| live.workers.iter().filter(|worker| worker.name.starts_with(kind)).count() as u64;
    let restarts: u32 = live.workers.iter().map(|worker| worker.incarnation.saturating_sub(1)).sum();
    let title = format!(
        " {}, {}, {} ",
        format::counted(of("learner-"), "learner"),
        format::counted(of("actor-"), "actor"),
        format::counted(u64::from(restarts), "restart")
    );
    let (shown, more) = window(live.workers.len(), model.scrolled, usize::from(area.height.saturating_sub(3)));
    let rows = live.workers[shown].iter().map(process_row).chain(more.map(|more| Row::new([more])));
    let widths = [12, 7, 8, 6, 5].map(Constraint::Length);
    let head = Row::new(["process", "pid", "restarts", "starts", "cores"]).bold();
    let table = Table::new(rows, widths).header(head).block(Block::bordered().title(title));
    frame.render_widget(table, area);
}

/// Which of so many rows are shown, and what the last line says of those below. Whatever is scrolled away, the last row
/// stays at the bottom.
fn window(rows: usize, scrolled: usize, height: usize) -> (Range<usize>, Option<String>) {
    let first = scrolled.min(rows.saturating_sub(height));
    let fits = height.min(rows - first);
    let shown = if first + fits < rows { fits.saturating_sub(1) } else { fits };
    let more = rows - first - shown;
    (first..first + shown, (more > 0 && height > 0).then(|| format!("…{more} more")))
}

fn process_row(worker: &Worker) -> Row<'static> {
    let color = match (worker.stopped, worker.incarnation) {
        (true, _) => Color::Red,
        (false, 0 | 1) => Color::Reset,
        _ => Color::Yellow,
    };
    let pid = worker.pid.map_or_else(|| "ended".to_owned(), |pid| pid.to_string());
    let cores = if worker.stopped {
        "stopd".to_owned()
    } else {
        worker.cores.map_or_else(|| format::NOTHING.to_owned(), |cores| format!("{cores:.1}"))
    };
    let (restarts, starts) = (worker.incarnation.saturating_sub(1).to_string(), worker.starts.to_string());
    let cells = [printable(&worker.name).into_owned(), pid, restarts, starts, cores];
    Row::new(cells.map(Cell::from)).style(Style::new().fg(color))
}

pub fn log_or_kitchens(frame: &mut Frame, area: Rect, model: &Model, live: &Live) {
    if model.lines == Lines::Kitchens { kitchens(frame, area, model, live) } else { log(frame, area, model, live) }
}

fn log(frame: &mut Frame, area: Rect, model: &Model, live: &Live) {
    let warnings = format::counted(live.warnings.len() as u64, "warning");
    let (title, lines) = match model.lines {
        Lines::Last => (format!(" log, {warnings} "), &live.log),
        Lines::Warnings | Lines::Kitchens => (format!(" {warnings} "), &live.warnings),
    };
    let (width, height) =
        (usize::from(area.width.saturating_sub(2)).max(1), usize::from(area.height.saturating_sub(2)));
    let mut shown: Vec<Line> = Vec::new();
    for line in lines.iter().rev() {
        let mut pieces = folded(line, width);
        pieces.truncate(height);
        if shown.len() + pieces.len() > height {
            break;
        }
        shown.extend(pieces.into_iter().rev());
    }
    shown.reverse();
    if lines.is_empty() {
        shown.push(Line::from("none"));
    }
    frame.render_widget(Paragraph::new(shown).block(Block::bordered().title(title)), area);
}

fn folded(line: &LogLine, width: usize) -> Vec<Line<'static>> {
    // 2026-11-21T02:04:23.1Z: the time of the day is enough.
    let time = line.at.get(11..19).map(|time| format!("{time} ")).unwrap_or_default();
    let text = format!("{time}{}", printable(&line.text).replace(['\t', '\n'], " "));
    let color = match line.level.as_str() {
        "ERROR" => Color::Red,
        "WARN" => Color::Yellow,
        _ => Color::Reset,
    };
    wrapped(&text, width).into_iter().map(|piece| Line::styled(piece, Style::new().fg(color))).collect()
}

/// Lines which end between words: a word is cut where it is longer than a line.
fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut rest: Vec<char> = text.chars().collect();
    let mut lines = Vec::new();
    while rest.len() > width {
        let next = rest.split_off(rest[..=width].iter().rposition(|&one| one == ' ').unwrap_or(width).max(1));
        lines.push(std::mem::replace(&mut rest, next.into_iter().skip_while(|&one| one == ' ').collect()));
    }
    lines.push(rest);
    lines.iter().map(|line| line.iter().collect()).collect()
}

/// The axis of shares: from the multiple of 5% below them to that above.
fn share_bounds([least, greatest]: [f64; 2]) -> [f64; 2] {
    const STEP: f64 = 0.05;
    let low = (least / STEP).floor().clamp(0.0, 19.0);
    [low * STEP, (greatest / STEP).ceil().clamp(low + 1.0, 20.0) * STEP]
}

/// Columns of a kitchen's number and episodes.
const KITCHEN_AND_EPISODES: u16 = 17;

fn width(metric: &Described) -> u16 {
    (metric.label.chars().count() as u16 + 1).max(7)
}

/// Columns in which every metric of the kitchens has room, with the frame.
pub fn kitchens_width(live: &Live) -> u16 {
    live.card.metrics.iter().map(width).fold(KITCHEN_AND_EPISODES + 2, u16::saturating_add)
}

pub fn kitchens(frame: &mut Frame, area: Rect, model: &Model, live: &Live) {
    // They are read in the order of time: the newest that are known of few are of the run's beginning.
    let known = if live.indexed < 0.9 { &[] } else { &live.kitchens[..] };
    let height = usize::from(area.height.saturating_sub(3));
    let inner = area.width.saturating_sub(2);
    // Side by side where one below the other they do not fit.
    let blocks = if known.len() > height { (inner / KITCHEN_COLUMNS).clamp(1, 3) } else { 1 };
    let mut left = (inner / blocks).saturating_sub(KITCHEN_AND_EPISODES);
    let fits = |metric: &&Described| left.checked_sub(width(metric)).map(|rest| left = rest).is_some();
    let metrics: Vec<&Described> = live.card.metrics.iter().take_while(fits).collect();
    let (shown, more) = window(known.len(), model.scrolled, height * usize::from(blocks));
    let cells = |kitchen: &Kitchen| {
        let figures = metrics.iter().map(|metric| format::metric(metric, kitchen.figures.get(&metric.name).copied()));
        [kitchen.kitchen.to_string(), kitchen.episodes.to_string()].into_iter().chain(figures).map(Cell::from).collect()
    };
    let mut all: Vec<Vec<Cell>> = known[shown].iter().map(cells).collect();
    all.extend(
        more.map(|more| {
            std::iter::once(Cell::from(more)).chain((0..=metrics.len()).map(|_| Cell::default())).collect()
        }),
    );
    let row = |at: usize| {
        Row::new(
            (0..usize::from(blocks))
                .flat_map(|block| all.get(block * height + at).into_iter().flatten().cloned())
                .collect::<Vec<_>>(),
        )
    };
    let rows: Vec<Row> = (0..height.min(all.len())).map(row).collect();
    let widths = || [8, 9].into_iter().chain(metrics.iter().copied().map(width)).map(Constraint::Length);
    let labels = || ["kitchen", "episodes"].into_iter().chain(metrics.iter().map(|metric| metric.label.as_str()));
    let times = usize::from(blocks);
    let head = Row::new((0..times).flat_map(|_| labels())).bold();
    let which = if live.card.evaluation { "episodes by kitchen" } else { "newest episodes" };
    let title = match live.indexed {
        0.999.. => format!(" {which} "),
        indexed => format!(" {which}, {:.0}% of recordings read ", 100.0 * indexed),
    };
    let table = Table::new(rows, (0..times).flat_map(|_| widths())).header(head).column_spacing(0);
    let left_out: Vec<&str> = live.card.metrics[metrics.len()..].iter().map(|metric| metric.label.as_str()).collect();
    let mut block = Block::bordered().title(title);
    if !left_out.is_empty() {
        let named = format!(" no room for {} ", left_out.join(", "));
        let corners = 2;
        let is_whole = named.chars().count() + corners <= usize::from(area.width);
        block = block.title_bottom(if is_whole { named } else { format!(" no room for {} columns ", left_out.len()) });
    }
    if live.kitchens.is_empty() || known.is_empty() && height > 0 {
        let why = if live.indexed < 0.9 { "the recordings are read first" } else { "no episode has ended yet" };
        frame.render_widget(Paragraph::new(why).block(block), area);
        return;
    }
    frame.render_widget(table.block(block), area);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_a_log_is_folded_between_words() {
        assert_eq!(wrapped("the learner saves and leaves", 12), ["the learner", "saves and", "leaves"]);
        assert_eq!(wrapped("/a/long/path at last", 6), ["/a/lon", "g/path", "at", "last"]);
        assert_eq!(wrapped("short", 12), ["short"]);
        assert_eq!(wrapped("", 3), [""]);
    }

    #[test]
    fn an_axis_ends_at_the_nearest_number() {
        let cases = [
            (9999, "9999"),
            (71_744, "72k"),
            (999_499, "999k"),
            (999_500, "1.0M"),
            (9_949_999, "9.9M"),
            (9_950_000, "10M"),
            (44_700_000, "45M"),
        ];
        for (count, said) in cases {
            assert_eq!(short(count), said);
        }
    }

    #[test]
    fn what_does_not_fit_is_counted() {
        let more = |count: usize| Some(format!("…{count} more"));
        assert_eq!(window(19, 0, 26), (0..19, None));
        assert_eq!(window(19, 0, 12), (0..11, more(8)));
        assert_eq!(window(19, 3, 12), (3..14, more(5)));
        assert_eq!(window(19, 18, 12), (7..19, None));
        assert_eq!(window(3, 0, 0), (0..0, None));
    }

    #[test]
    fn shares_in_a_narrow_band_fill_the_chart() {
        for (of, expected) in
            [([0.42, 0.48], [8, 10]), ([0.0, 1.0], [0, 20]), ([1.0, 1.0], [19, 20]), ([0.0, 0.0], [0, 1])]
        {
            assert_eq!(share_bounds(of).map(|bound| (20.0 * bound).round() as u32), expected, "{of:?}");
        }
    }
}
