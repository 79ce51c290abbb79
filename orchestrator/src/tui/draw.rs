use super::model::{CHARTS, Lines, Model};
use super::panels;
use crate::output::format;
use proto::printable::printable;
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style, Stylize};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Gauge, Paragraph};
use std::collections::BTreeMap;
use std::time::Duration;
use view::data::{Card, Live};

const HEAD: u16 = 4;
/// Columns of a run's name at least.
const NAME: usize = 12;
const CHART_COLUMNS: u16 = 25;
const CHART_LINES: [u16; 2] = [6, 16];
/// Columns of a kitchen's number and episodes, of both rates and the disturbance, with the frame.
const KITCHENS: u16 = 45;
/// Lines that the panels need below the charts; where there are fewer, charts take them all.
const PANEL_LINES: u16 = 4;
/// Lines of the screen that a line of a log takes at most, as a rule.
const LINE_FOLDS: usize = 5;
/// Columns of a screen that has processes and log side by side, and of one that has the kitchens there, too.
const TWO_COLUMNS: u16 = 70;
const BESIDE: u16 = 116;

pub fn draw(frame: &mut Frame, model: &Model) {
    let suite_lines = 2 * u16::from(model.suite.is_some());
    let lines = [Constraint::Length(suite_lines), Constraint::Length(HEAD), Constraint::Min(0), Constraint::Length(1)];
    let [suite, head, body, foot] = Layout::vertical(lines).areas(frame.area());
    let of_suite = model.suite.as_deref().unwrap_or_default();
    let lines: Vec<Line> = of_suite.lines().map(|line| Line::from(format!(" {}", printable(line)))).collect();
    frame.render_widget(Paragraph::new(lines).bold(), suite);
    frame.render_widget(Paragraph::new(foot_line(model, foot.width)), foot);
    let Some(live) = &model.live else {
        frame.render_widget(Paragraph::new(" reading …"), head);
        return;
    };
    draw_head(frame, head, live);
    if live.card.evaluation {
        draw_evaluation(frame, body, model, live);
        return;
    }
    let charts = (body.height / 2).clamp(CHART_LINES[0], CHART_LINES[1]);
    let charts = if body.height < charts + PANEL_LINES { body.height } else { charts };
    let [upper, lower] = Layout::vertical([Constraint::Length(charts), Constraint::Min(0)]).areas(body);
    let shown = charts_shown(upper.width);
    if upper.height > 2 {
        let places = Layout::horizontal(vec![Constraint::Fill(1); shown]).split(upper);
        for (number, place) in places.iter().enumerate() {
            let chart = if shown == CHARTS { number } else { (model.chart + number) % CHARTS };
            panels::chart(frame, *place, model, live, chart);
        }
    }
    draw_panels(frame, lower, model, live);
}

/// An evaluation has no curves: its kitchens have their place where they do not fit beside the log. No box is much longer
/// than what is in it.
fn draw_evaluation(frame: &mut Frame, area: Rect, model: &Model, live: &Live) {
    let kitchens = live.kitchens.len() + 3;
    let above = area.width < BESIDE && has_own_kitchens(model, live) && area.height >= 3 * PANEL_LINES;
    let above = if above { lines_of(kitchens).min(area.height / 2) } else { 0 };
    let below = lines_of((live.workers.len() + 3).max(LINE_FOLDS * live.log.len() + 2).max(kitchens));
    let below = if area.width < TWO_COLUMNS { area.height } else { below }.min(area.height - above);
    let places = [Constraint::Length(above), Constraint::Length(below), Constraint::Min(0)];
    let [upper, lower, _] = Layout::vertical(places).areas(area);
    if above > 0 {
        panels::kitchens(frame, upper, model, live);
    }
    draw_panels(frame, lower, model, live);
}

fn lines_of(rows: usize) -> u16 {
    u16::try_from(rows).unwrap_or(u16::MAX)
}

/// Whether kitchens have a panel beside that of the log.
fn has_own_kitchens(model: &Model, live: &Live) -> bool {
    !live.kitchens.is_empty() && model.lines != Lines::Kitchens
}

fn draw_panels(frame: &mut Frame, area: Rect, model: &Model, live: &Live) {
    if area.height < 2 {
        return;
    }
    let beside = area.width >= BESIDE && has_own_kitchens(model, live);
    let widths = match (beside, area.width >= TWO_COLUMNS) {
        (true, _) => {
            vec![
                Constraint::Length(44),
                Constraint::Fill(1),
                Constraint::Length(panels::kitchens_width(live).min(area.width / 20 * 9).max(KITCHENS)),
            ]
        }
        (false, true) => vec![Constraint::Length(44.min(area.width / 2 + 4)), Constraint::Fill(1)],
        (false, false) => vec![Constraint::Fill(1)],
    };
    let places = Layout::horizontal(widths).split(area);
    if let [only] = places[..] {
        let [upper, lower] = Layout::vertical([Constraint::Fill(1), Constraint::Fill(1)]).areas(only);
        panels::processes(frame, upper, model, live);
        panels::log_or_kitchens(frame, lower, model, live);
        return;
    }
    panels::processes(frame, places[0], model, live);
    panels::log_or_kitchens(frame, places[1], model, live);
    if let Some(place) = places.get(2) {
        panels::kitchens(frame, *place, model, live);
    }
}

fn draw_head(frame: &mut Frame, area: Rect, live: &Live) {
    let [first, second, third, fourth] = Layout::vertical([Constraint::Length(1); 4]).areas(area);
    let card = &live.card;
    let state = match card.state.as_str() {
        "running" => Span::from("running").green(),
        "complete" => Span::from("complete").cyan(),
        other => Span::from(other.to_owned()).yellow(),
    };
    let wall = Duration::try_from_secs_f64(live.wall_s).unwrap_or_default();
    let so_long = if card.state == "running" { "for" } else { "in" };
    let starts = if live.starts.len() > 1 { format!("  {} starts", live.starts.len()) } else { String::new() };
    let mut title = vec![
        state,
        Span::from(format!(
            "  {}, seed {}  {so_long} {}{starts}",
            printable(&card.subject()),
            card.seed,
            format::duration(wall)
        )),
    ];
    // What the colours of the curves are.
    let stages = live.stages.iter().enumerate().filter(|_| live.stages.len() > 1 && !card.evaluation);
    let mut stages: Vec<Span> = stages
        .map(|(index, stage)| {
            Span::from(format!("  ━ stage {}", printable(&stage.name))).fg(panels::STAGES[index % panels::STAGES.len()])
        })
        .collect();
    let wide = |spans: &[Span]| spans.iter().map(Span::width).sum::<usize>();
    let left = usize::from(area.width).saturating_sub(wide(&title) + 3);
    let name = printable(&card.folder);
    if left < wide(&stages) + name.chars().count().max(NAME) {
        stages.clear();
    }
    let name = end_of(&name, left.saturating_sub(wide(&stages)).max(NAME));
    title.insert(0, Span::from(format!(" {name}  ")).bold());
    title.extend(stages);
    frame.render_widget(Paragraph::new(Line::from(title)), first);
    frame.render_widget(progress(live), second);
    frame.render_widget(Paragraph::new(throughput(live, third.width)), third);
    frame.render_widget(Paragraph::new(machine(live, fourth.width)), fourth);
}

fn end_of(path: &str, most: usize) -> String {
    let length = path.chars().count();
    if length <= most {
        return path.to_owned();
    }
    std::iter::once('…').chain(path.chars().skip(length + 1 - most.max(1))).collect()
}

fn progress(live: &Live) -> Gauge<'static> {
    let Card { done, budget, left_s, evaluation, .. } = live.card;
    let what = if evaluation { "episodes" } else { "frames" };
    let ratio = (done as f64 / budget.max(1) as f64).clamp(0.0, 1.0);
    let stage = live.stage.and_then(|stage| live.stages.get(stage)).filter(|_| !evaluation && done < budget);
    let stage = stage.map_or_else(String::new, |stage| {
        format!("stage {} ({})  ", printable(&stage.name), format::reward(&stage.reward))
    });
    let left = left_s.filter(|_| done < budget).and_then(|left_s| Duration::try_from_secs_f64(left_s).ok());
    let left = left.map_or_else(String::new, |left| format!("  {} left", format::duration(left)));
    let (done, budget) = (format::count(done), format::count(budget));
    Gauge::default()
        .gauge_style(Style::new().fg(Color::Cyan).bg(Color::Black))
        .label(format!(" {stage}{done} / {budget} {what}  {:.1}%{left} ", 100.0 * ratio))
        .ratio(ratio)
}

fn throughput(live: &Live, width: u16) -> Line<'static> {
    let Some(rate) = live.frames_per_s else {
        let conditions = live.card.conditions.as_deref().filter(|_| live.card.evaluation);
        return Line::from(conditions.map_or_else(
            || if live.card.evaluation { "" } else { " no rollout yet" }.to_owned(),
            |conditions| format!(" {}", printable(conditions)),
        ));
    };
    let what = if live.card.state == "running" { "" } else { ", mean" };
    let rate = format!(" {} frames/s{what}  time: ", format::rate(rate));
    let [simulate, infer, update] = live.shares;
    let parts = [
        ("simulate", simulate, Color::Green),
        ("infer", infer, Color::Yellow),
        ("update", update, Color::Magenta),
        ("other", (1.0 - simulate - infer - update).max(0.0), Color::DarkGray),
    ];
    let words: usize = parts.iter().map(|(name, ..)| name.len() + " 100%   ".len()).sum();
    let bar = usize::from(width).saturating_sub(rate.chars().count() + words).min(60);
    let mut spans = vec![Span::from(rate).bold()];
    for (name, share, color) in parts {
        let length = (share * bar as f64).round() as usize;
        spans.push(Span::from(format!("{name} {:.0}% ", 100.0 * share)));
        spans.push(Span::styled("█".repeat(length), Style::new().fg(color)));
        spans.push(Span::from(if length > 0 { "  " } else { " " }));
    }
    Line::from(spans)
}

/// What the letters of the metrics stand for, `SRwoD: success without disturbance`, in so many columns: of all, or of the
/// last one alone.
fn letters(live: &Live, columns: usize) -> Option<String> {
    let shares = live.card.metrics.iter().filter(|metric| metric.is_share() && metric.label != metric.name);
    let said = shares.map(|metric| format!("{}: {}", metric.label, metric.name.replace('_', " ")));
    let said: Vec<String> = said.map(|text| printable(&text).into_owned()).collect();
    [said.join(", "), said.last()?.clone()].into_iter().find(|text| text.chars().count() <= columns)
}

/// The same, where it has room behind the keys.
fn letters_below(live: &Live, width: u16) -> Option<String> {
    letters(live, usize::from(width).saturating_sub(keys(width).width()))
}

fn machine(live: &Live, width: u16) -> Line<'static> {
    let mut parts = Vec::new();
    let used: Vec<f64> = live.workers.iter().filter_map(|worker| worker.cores).collect();
    if let (Some(cores), false) = (live.cores, used.is_empty()) {
        parts.push(format!("{:.1} of {}", used.iter().sum::<f64>(), format::counted(cores as u64, "core")));
    }
    let memory: Vec<u64> = live.workers.iter().filter_map(|worker| worker.memory_bytes).collect();
    if !memory.is_empty() {
        parts.push(format::bytes(memory.iter().sum()));
    }
    for gpu in &live.gpus {
        let memory = format!("{}/{} GiB", gpu.used_mib >> 10, gpu.total_mib >> 10);
        parts.push(format!("GPU {} {:.0}% {memory}", gpu.index, 100.0 * gpu.busy));
    }
    let metrics = |figures: &BTreeMap<String, f64>| {
        format::metrics(live.card.metrics.iter().filter(|metric| metric.unit.is_empty()), figures, "  ")
    };
    if live.card.evaluation {
        parts.push(metrics(&live.card.figures));
    } else {
        // Quotients have no curve.
        let quotients = live.card.metrics.iter().filter(|metric| metric.quotient.is_some());
        parts.push(format::metrics(quotients, &live.card.figures, "  "));
    }
    parts.retain(|part| !part.is_empty());
    if let Some(last) = live.validation.last() {
        parts.push(format!("validation at {}: {}", format::count(last.frames), metrics(&last.figures)));
    }
    if letters_below(live, width).is_none() {
        let taken = 1 + parts.iter().map(|part| part.chars().count() + "  |  ".len()).sum::<usize>();
        parts.extend(letters(live, usize::from(width).saturating_sub(taken)));
    }
    Line::from(format!(" {}", parts.join("  |  ")))
}

fn charts_shown(width: u16) -> usize {
    usize::from((width / CHART_COLUMNS).clamp(1, CHARTS as u16))
}

fn foot_line(model: &Model, width: u16) -> Line<'static> {
    let notes = model.live.iter().flat_map(|live| &live.notes);
    let problem = model.problem.iter().chain(notes).next();
    if let Some(problem) = problem {
        return Line::from(format!(" {}", printable(problem))).red();
    }
    let mut line = keys(width);
    if let Some(said) = model.live.as_ref().and_then(|live| letters_below(live, width)) {
        line.push_span(Span::from(said));
    }
    line
}

fn keys(width: u16) -> Line<'static> {
    let key = |key: &'static str, what: &'static str| {
        [Span::styled(key, Style::new().add_modifier(Modifier::REVERSED)), Span::from(format!(" {what}  "))]
    };
    let mut keys = vec![key("q", "leave"), key("↑↓", "scroll"), key("w", "log, warnings, kitchens")];
    if charts_shown(width) < CHARTS {
        keys.push(key("Tab", "charts"));
    }
    Line::from(std::iter::once(Span::from(" ")).chain(keys.into_iter().flatten()).collect::<Vec<_>>())
}
