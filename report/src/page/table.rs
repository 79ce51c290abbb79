//! A table as HTML.

use crate::chart::escape;
use std::fmt::Write;

/// One cell.
#[derive(Debug, Clone)]
pub struct Cell {
    text: String,
    /// Beneath the text, smaller.
    below: String,
    class: &'static str,
    columns: usize,
}

impl Cell {
    /// Words.
    pub fn text(text: impl Into<String>) -> Self {
        Self::new(text, "")
    }

    /// Words that may take several lines.
    pub fn wide(text: impl Into<String>) -> Self {
        Self::new(text, "wide")
    }

    /// A figure, to the right.
    pub fn number(text: impl Into<String>) -> Self {
        Self::new(text, "number")
    }

    fn new(text: impl Into<String>, class: &'static str) -> Self {
        Self { text: text.into(), below: String::new(), class, columns: 1 }
    }

    /// With something smaller beneath.
    pub fn over(self, below: impl Into<String>) -> Self {
        Self { below: below.into(), ..self }
    }

    /// As wide as several columns.
    pub fn across(self, columns: usize) -> Self {
        Self { columns, ..self }
    }
}

/// A head over several columns: how many, and its text.
pub type Span = (usize, &'static str);

/// A table under construction.
#[derive(Debug, Default)]
pub struct Table {
    spans: Vec<Span>,
    head: Vec<Cell>,
    rows: Vec<(&'static str, Vec<Cell>)>,
}

impl Table {
    /// With these heads.
    pub fn new(head: Vec<Cell>) -> Self {
        Self { spans: Vec::new(), head, rows: Vec::new() }
    }

    /// And heads over groups of columns above them.
    pub fn spans(mut self, spans: Vec<Span>) -> Self {
        self.spans = spans;
        self
    }

    /// Adds a row of a class of the style sheet.
    pub fn row(&mut self, class: &'static str, cells: Vec<Cell>) {
        let columns: usize = cells.iter().map(|cell| cell.columns).sum();
        assert_eq!(columns, self.head.len(), "a row fills all columns");
        self.rows.push((class, cells));
    }

    /// Nothing but a head.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// As HTML.
    pub fn html(&self) -> String {
        let mut html = String::from("<div class=\"scroll\"><table>\n<thead>");
        if !self.spans.is_empty() {
            html.push_str("<tr>");
            for (columns, text) in &self.spans {
                let _ = write!(html, "<th colspan=\"{columns}\">{}</th>", escape(text));
            }
            html.push_str("</tr>\n");
        }
        html.push_str("<tr>");
        for cell in &self.head {
            html.push_str(&tag("th", cell));
        }
        html.push_str("</tr></thead>\n<tbody>\n");
        for (class, cells) in &self.rows {
            if class.is_empty() {
                html.push_str("<tr>");
            } else {
                let _ = write!(html, "<tr class=\"{class}\">");
            }
            for cell in cells {
                html.push_str(&tag("td", cell));
            }
            html.push_str("</tr>\n");
        }
        html.push_str("</tbody></table></div>\n");
        html
    }
}

fn tag(name: &str, cell: &Cell) -> String {
    let class = if cell.class.is_empty() { String::new() } else { format!(" class=\"{}\"", cell.class) };
    let columns = if cell.columns == 1 { String::new() } else { format!(" colspan=\"{}\"", cell.columns) };
    let below =
        if cell.below.is_empty() { String::new() } else { format!("<br><small>{}</small>", escape(&cell.below)) };
    format!("<{name}{class}{columns}>{}{below}</{name}>", escape(&cell.text))
}
