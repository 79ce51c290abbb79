//! A table as HTML.

use crate::chart::style_key;
use crate::format::{interval, percent};
use crate::statistics::Estimate;
use maud::{Markup, PreEscaped, Render, html};

#[derive(Debug, Clone)]
pub struct Cell {
    text: String,
    /// Beneath the text, smaller.
    below: String,
    kind: Kind,
    columns: usize,
    /// Number of a style whose sample stands before the text.
    style: Option<usize>,
}

/// How a cell is set.
#[derive(Debug, Clone, Copy)]
enum Kind {
    /// To the left.
    Text,
    /// To the left, with room for sentences.
    Wide,
    /// To the right.
    Number,
}

impl Cell {
    /// Words.
    pub fn text(text: impl Into<String>) -> Self {
        Self::new(text, Kind::Text)
    }

    /// A group's name, with a sample of how figures show it.
    pub fn group(label: &str, style: usize) -> Self {
        Self { style: Some(style), ..Self::text(label) }
    }

    /// Words that take several lines.
    pub fn wide(text: impl Into<String>) -> Self {
        Self::new(text, Kind::Wide)
    }

    /// A figure, to the right.
    pub fn number(text: impl Into<String>) -> Self {
        Self::new(text, Kind::Number)
    }

    /// A percentage with its interval beneath.
    pub fn estimate(estimate: &Estimate) -> Self {
        let cell = Self::number(percent(estimate.point));
        match &estimate.interval {
            Some(found) => cell.over(interval(found)),
            None => cell,
        }
    }

    fn new(text: impl Into<String>, kind: Kind) -> Self {
        Self { text: text.into(), below: String::new(), kind, columns: 1, style: None }
    }

    /// With something smaller beneath.
    pub fn over(self, below: impl Into<String>) -> Self {
        Self { below: below.into(), ..self }
    }

    /// As wide as several columns.
    pub fn across(self, columns: usize) -> Self {
        Self { columns, ..self }
    }

    /// Its class in the style sheet.
    fn class(&self) -> Option<&'static str> {
        match self.kind {
            Kind::Text => None,
            Kind::Wide => Some("wide"),
            Kind::Number => Some("number"),
        }
    }

    fn colspan(&self) -> Option<usize> {
        (self.columns != 1).then_some(self.columns)
    }
}

impl Render for Cell {
    fn render(&self) -> Markup {
        html! {
            @if let Some(style) = self.style { (PreEscaped(style_key(style, ""))) " " }
            (self.text)
            @if !self.below.is_empty() { br; small { (self.below) } }
        }
    }
}

/// What a row is about.
#[derive(Debug, Clone, Copy)]
pub enum RowKind {
    /// Nothing that would have to be seen at once.
    Plain,
    /// A row of the paper of which no group is.
    NotRun,
    /// A group beside a row of the paper.
    Ours,
}

impl RowKind {
    /// Its class in the style sheet.
    fn class(self) -> Option<&'static str> {
        match self {
            Self::Plain => None,
            Self::NotRun => Some("absent"),
            Self::Ours => Some("ours"),
        }
    }
}

/// A head over several columns: how many, and its text.
pub type Span = (usize, &'static str);

/// A table under construction.
#[derive(Debug, Default)]
pub struct Table {
    spans: Vec<Span>,
    head: Vec<Cell>,
    rows: Vec<(RowKind, Vec<Cell>)>,
}

impl Table {
    pub fn new(head: Vec<Cell>) -> Self {
        Self { spans: Vec::new(), head, rows: Vec::new() }
    }

    /// And heads over groups of columns above them.
    pub fn spans(mut self, spans: Vec<Span>) -> Self {
        self.spans = spans;
        self
    }

    /// Adds a row.
    pub fn row(&mut self, kind: RowKind, cells: Vec<Cell>) {
        let columns: usize = cells.iter().map(|cell| cell.columns).sum();
        assert_eq!(columns, self.head.len(), "a row fills all columns");
        self.rows.push((kind, cells));
    }

    /// Nothing but a head.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }
}

impl Render for Table {
    fn render(&self) -> Markup {
        html! {
            div.scroll {
                table {
                    thead {
                        @if !self.spans.is_empty() {
                            tr { @for (columns, text) in &self.spans { th colspan=(columns) { (text) } } }
                        }
                        tr { @for cell in &self.head { th class=[cell.class()] colspan=[cell.colspan()] { (cell) } } }
                    }
                    tbody {
                        @for (kind, cells) in &self.rows {
                            tr class=[kind.class()] {
                                @for cell in cells { td class=[cell.class()] colspan=[cell.colspan()] { (cell) } }
                            }
                        }
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_comes_from_outside_is_text_in_a_table() {
        let mut table = Table::new(vec![Cell::text("<b>"), Cell::number("n")]);
        table.row(RowKind::Ours, vec![Cell::text("runs/<script>&").over("\"a\""), Cell::number("1")]);
        let html = table.render().into_string();
        assert!(html.contains("<th>&lt;b&gt;</th><th class=\"number\">n</th>"), "{html}");
        let cells = "<td>runs/&lt;script&gt;&amp;<br><small>&quot;a&quot;</small></td><td class=\"number\">1</td>";
        assert!(html.contains(&format!("<tr class=\"ours\">{cells}</tr>")), "{html}");
    }
}
