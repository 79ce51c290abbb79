//! The few elements of SVG that the figures are made of.

use super::text;
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use std::fmt::Write;

/// Where a text is relative to its point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Anchor {
    Start,
    Middle,
    End,
}

/// How a line is drawn.
#[derive(Debug, Clone, Copy)]
pub struct Stroke<'a> {
    /// CSS colour.
    pub colour: &'a str,
    /// Pixels.
    pub width: f64,
    /// Lengths of dashes and gaps, as SVG has them; empty = solid.
    pub dashes: &'a str,
}

/// A drawing under construction; y grows downwards, in pixels.
#[derive(Debug)]
pub struct Canvas {
    body: String,
}

/// Colour of text.
const INK: &str = "#222222";
/// What all is drawn on.
pub const PAPER: &str = "#ffffff";
/// Where a map says nothing.
pub const BLANK: &str = "#f2f2f2";
/// Colour of axes.
pub const AXIS: &str = "#555555";
/// Colour of grid lines.
pub const GRID: &str = "#e4e4e4";

/// Each of these colours, and what it is on a dark page.
pub const IN_THE_DARK: [(&str, &str); 5] =
    [(INK, "#e6e4df"), (PAPER, "#1c2025"), (BLANK, "#23282e"), (AXIS, "#a8adb4"), (GRID, "#2e343b")];

impl Canvas {
    /// A white canvas that is described as `description`.
    pub fn new(width: f64, height: f64, description: &str) -> Self {
        let (width, height) = (number(width), number(height));
        let family = text::FAMILY;
        let description = escape(description);
        let mut body = String::new();
        let _ = write!(
            body,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"0 0 {width} {height}\" font-family=\"{family}\" role=\"img\">\n<desc>{description}</desc>\n\
             <rect width=\"{width}\" height=\"{height}\" fill=\"{PAPER}\"/>\n"
        );
        Self { body }
    }

    /// A text in ink.
    pub fn text(&mut self, x: f64, y: f64, size: f64, anchor: Anchor, content: &str) {
        self.rotated_text(x, y, size, anchor, 0.0, content);
    }

    /// A text turned about its point, degrees clockwise.
    pub fn rotated_text(&mut self, x: f64, y: f64, size: f64, anchor: Anchor, degrees: f64, content: &str) {
        if content.is_empty() {
            return;
        }
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let (x, y) = (number(x), number(y));
        let turn =
            if degrees == 0.0 { String::new() } else { format!(" transform=\"rotate({} {x} {y})\"", number(degrees)) };
        // One text is one line.
        let content = content.replace(char::is_control, " ");
        // A halo, so that lines beneath do not run through the letters.
        let _ = writeln!(
            self.body,
            "<text x=\"{x}\" y=\"{y}\" font-size=\"{}\" text-anchor=\"{anchor}\" fill=\"{INK}\" stroke=\"{PAPER}\" \
             stroke-width=\"3\" stroke-linejoin=\"round\" paint-order=\"stroke\"{turn}>{}</text>",
            number(size),
            escape(&content)
        );
    }

    /// A line through the points.
    pub fn line(&mut self, points: &[(f64, f64)], stroke: Stroke<'_>) {
        self.faint_line(points, stroke, 1.0);
    }

    /// A translucent line through the points.
    pub fn faint_line(&mut self, points: &[(f64, f64)], stroke: Stroke<'_>, opacity: f64) {
        let opacity = if opacity < 1.0 { format!(" stroke-opacity=\"{}\"", number(opacity)) } else { String::new() };
        let dashes =
            if stroke.dashes.is_empty() { String::new() } else { format!(" stroke-dasharray=\"{}\"", stroke.dashes) };
        let _ = writeln!(
            self.body,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"{}\" stroke-linejoin=\"round\"{dashes}{opacity}/>",
            list(points),
            stroke.colour,
            number(stroke.width)
        );
    }

    /// A filled area.
    pub fn area(&mut self, points: &[(f64, f64)], colour: &str, opacity: f64) {
        let _ = writeln!(
            self.body,
            "<polygon points=\"{}\" fill=\"{colour}\" fill-opacity=\"{}\"/>",
            list(points),
            number(opacity)
        );
    }

    /// A filled rectangle.
    pub fn rectangle(&mut self, (left, top): (f64, f64), (width, height): (f64, f64), colour: &str) {
        let _ = writeln!(
            self.body,
            "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" fill=\"{colour}\"/>",
            number(left),
            number(top),
            number(width),
            number(height)
        );
    }

    pub fn picture(&mut self, (left, top): (f64, f64), (width, height): (f64, f64), png: &[u8]) {
        let _ = writeln!(
            self.body,
            "<image x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" href=\"data:image/png;base64,{}\"/>",
            number(left),
            number(top),
            number(width),
            number(height),
            BASE64_STANDARD.encode(png)
        );
    }

    /// A shape of given outline around a point, filled with one colour and outlined with another.
    pub fn shape(&mut self, outline: &[(f64, f64)], (x, y): (f64, f64), fill: &str, stroke: &str) {
        let points: Vec<_> = outline.iter().map(|&(dx, dy)| (x + dx, y + dy)).collect();
        let _ = writeln!(
            self.body,
            "<polygon points=\"{}\" fill=\"{fill}\" stroke=\"{stroke}\" stroke-width=\"1.4\"/>",
            list(&points)
        );
    }

    /// The document.
    pub fn finish(mut self) -> String {
        self.body.push_str("</svg>\n");
        self.body
    }
}

fn list(points: &[(f64, f64)]) -> String {
    points.iter().map(|&(x, y)| format!("{},{}", number(x), number(y))).collect::<Vec<_>>().join(" ")
}

/// At most two decimals, and none that are zero.
fn number(value: f64) -> String {
    assert!(value.is_finite(), "a figure has no place for {value}");
    let text = format!("{value:.2}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

/// Text as XML and HTML have it.
fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
