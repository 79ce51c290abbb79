//! What is on the screen: what was read last, and what the keys have chosen. Pure.

use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use view::data::{Curves, Live, Problem};

#[derive(Debug, Clone)]
pub struct Look {
    pub live: Result<Live, Problem>,
    pub curves: Result<Curves, Problem>,
    /// Of the suite that is watched: where the run stands in it, and what each run is at, a line each.
    pub suite: Option<String>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Lines {
    #[default]
    Last,
    Warnings,
    /// The table of kitchens in the place of the log.
    Kitchens,
}

#[derive(Debug, Default)]
pub struct Model {
    pub live: Option<Live>,
    pub suite: Option<String>,
    pub curves: Curves,
    pub problem: Option<String>,
    pub scrolled: usize,
    pub lines: Lines,
    pub chart: usize,
}

pub const CHARTS: usize = 3;

impl Model {
    pub fn take(&mut self, look: Look) {
        let Look { live, curves, suite } = look;
        self.problem = None;
        self.suite = suite.or(self.suite.take());
        match live {
            Ok(live) => self.live = Some(live),
            Err(problem) => self.problem = Some(problem.to_string()),
        }
        match curves {
            Ok(curves) => self.add(curves),
            Err(problem) => self.problem = Some(problem.to_string()),
        }
    }

    fn add(&mut self, new: Curves) {
        let known = self.curves.frames.len();
        if new.edition != self.curves.edition || new.from != known {
            self.curves = new;
            return;
        }
        let Curves { frames, stage, elapsed_s, series, stages, paper, .. } = new;
        let added = frames.len();
        let all = &mut self.curves;
        all.frames.extend(frames);
        all.stage.extend(stage);
        all.elapsed_s.extend(elapsed_s);
        for (name, values) in series {
            // A figure that comes for the first time had no value before.
            let column = all.series.entry(name).or_default();
            column.resize(known, None);
            column.extend(values);
        }
        for column in all.series.values_mut() {
            column.resize(known + added, None);
        }
        (all.stages, all.paper) = (stages, paper);
    }

    pub fn key(&mut self, key: KeyEvent) -> bool {
        if key.kind == KeyEventKind::Release {
            return true;
        }
        let control = key.modifiers.contains(KeyModifiers::CONTROL);
        let rows = self.live.as_ref().map_or(0, |live| live.workers.len().max(live.kitchens.len()));
        let last = rows.saturating_sub(1);
        match key.code {
            KeyCode::Char('q') | KeyCode::Esc => return false,
            KeyCode::Char('c' | 'd') if control => return false,
            KeyCode::Char('w') => {
                self.lines = match self.lines {
                    Lines::Last => Lines::Warnings,
                    Lines::Warnings if self.live.as_ref().is_some_and(|live| !live.kitchens.is_empty()) => {
                        Lines::Kitchens
                    }
                    Lines::Warnings | Lines::Kitchens => Lines::Last,
                };
            }
            KeyCode::Char('c') | KeyCode::Tab => self.chart = (self.chart + 1) % CHARTS,
            KeyCode::Up | KeyCode::Char('k') => self.scrolled = self.scrolled.saturating_sub(1),
            KeyCode::Down | KeyCode::Char('j') => self.scrolled = (self.scrolled + 1).min(last),
            KeyCode::PageUp => self.scrolled = self.scrolled.saturating_sub(10),
            KeyCode::PageDown => self.scrolled = (self.scrolled + 10).min(last),
            KeyCode::Home => self.scrolled = 0,
            KeyCode::End => self.scrolled = last,
            _ => {}
        }
        true
    }
}
