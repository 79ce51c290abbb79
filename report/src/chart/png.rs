//! Pixels of an SVG figure.

use super::place::Rect;
use super::text;
use resvg::tiny_skia::{FilterQuality, Pixmap, PixmapPaint, Transform};
use resvg::usvg::{self, Options, Tree};
use std::borrow::Cow;

/// Pixels of the picture for one of the figure: sharp in print and on dense screens.
const SCALE: f32 = 2.0;

/// A figure that could not be drawn.
#[derive(Debug, thiserror::Error)]
pub enum PngError {
    /// Not an SVG document.
    #[error("a figure is no SVG document: {0}")]
    Svg(#[from] usvg::Error),
    /// Too large, or of no size.
    #[error("a figure of {width} x {height} pixels cannot be drawn")]
    Size {
        /// Pixels.
        width: u32,
        /// Pixels.
        height: u32,
    },
    /// The encoder failed.
    #[error("a figure cannot be written as PNG: {0}")]
    Png(String),
}

/// The document as a PNG file. `pictures`: those within it and their places, for which the library that draws documents
/// has no decoder. It has no letters either: to shape texts of all scripts, which figures have not, would be the half of
/// it. They are drawn as the face's outlines.
pub fn encode(svg: &str, pictures: &[(Rect, &[u8])]) -> Result<Vec<u8>, PngError> {
    // A canvas writes each picture and each text on a line of its own.
    let lines = svg.split_inclusive('\n').filter(|line| !line.starts_with("<image "));
    let drawn: String = lines.map(|line| outlined(line).map_or(Cow::Borrowed(line), Cow::Owned)).collect();
    let tree = Tree::from_str(&drawn, &Options::default())?;
    let size = tree.size();
    let [width, height] = [size.width(), size.height()].map(|length| (length * SCALE).round() as u32);
    let mut pixels = Pixmap::new(width, height).ok_or(PngError::Size { width, height })?;
    resvg::render(&tree, Transform::from_scale(SCALE, SCALE), &mut pixels.as_mut());
    for (place, png) in pictures {
        let picture = Pixmap::decode_png(png).map_err(|error| PngError::Png(error.to_string()))?;
        let [across, down] = [place.width / f64::from(picture.width()), place.height / f64::from(picture.height())];
        let place = Transform::from_row(
            across as f32 * SCALE,
            0.0,
            0.0,
            down as f32 * SCALE,
            place.left as f32 * SCALE,
            place.top as f32 * SCALE,
        );
        let paint = PixmapPaint { quality: FilterQuality::Bicubic, ..PixmapPaint::default() };
        pixels.draw_pixmap(0, 0, picture.as_ref(), &paint, place, None);
    }
    pixels.encode_png().map_err(|error| PngError::Png(error.to_string()))
}

/// A line of a canvas with the outlines of its letters, if it is a text.
fn outlined(line: &str) -> Option<String> {
    let (attributes, content) = line.strip_prefix("<text")?.trim_end().strip_suffix("</text>")?.split_once('>')?;
    let value = |name: &str| attributes.split_once(&format!(" {name}=\"")).and_then(|(_, rest)| rest.split_once('"'));
    let number = |name: &str| value(name).and_then(|(text, _)| text.parse::<f64>().ok());
    let (x, y, size) = (number("x")?, number("y")?, number("font-size")?);
    // What stands behind it concerns outlines as it does texts: colours, halo, turn.
    let (anchor, style) = value("text-anchor")?;
    let content = content.replace("&lt;", "<").replace("&gt;", ">").replace("&quot;", "\"").replace("&amp;", "&");
    let before = match anchor {
        "start" => 0.0,
        "middle" => 0.5,
        _ => 1.0,
    };
    let outlines = text::outlines(&content, size, |width| (x - before * width, y));
    Some(format!("<path d=\"{outlines}\"{style}/>\n"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chart::svg::{Anchor, Canvas};

    /// The columns and rows of the picture in which something dark is.
    fn inked(canvas: Canvas) -> (Vec<u32>, Vec<u32>) {
        let picture = Pixmap::decode_png(&encode(&canvas.finish(), &[]).unwrap()).unwrap();
        let dark = |x, y| picture.pixel(x, y).unwrap().red() < 128;
        let (width, height) = (picture.width(), picture.height());
        let columns = (0..width).filter(|&x| (0..height).any(|y| dark(x, y))).collect();
        (columns, (0..height).filter(|&y| (0..width).any(|x| dark(x, y))).collect())
    }

    #[test]
    fn letters_stand_where_the_document_has_them() {
        let written = |anchor, degrees| {
            // Wide and high enough for the text to end within it.
            let mut canvas = Canvas::new(400.0, 400.0, "letters");
            canvas.rotated_text(100.0, 100.0, 20.0, anchor, degrees, "H < λ & \"H\"");
            inked(canvas)
        };
        let (columns, rows) = written(Anchor::Start, 0.0);
        let width = text::width("H < λ & \"H\"", 20.0) * f64::from(SCALE);
        let ends = |cells: &[u32]| (f64::from(cells[0]), f64::from(cells[cells.len() - 1]));
        let (left, right) = ends(&columns);
        assert!((200.0..208.0).contains(&left) && (right - left - width).abs() < 12.0, "{left} {right} {width}");
        // A capital is 0.73 em high and stands on its point.
        let (top, bottom) = ends(&rows);
        assert!((bottom - 200.0).abs() < 4.0 && (top - 171.0).abs() < 4.0, "{top} {bottom}");
        // The same letters, further to the left by half of their width and by all of it; the canvas ends before their
        // beginning.
        let right_of = |anchor| ends(&written(anchor, 0.0).0).1;
        for (anchor, before) in [(Anchor::Middle, 0.5), (Anchor::End, 1.0)] {
            let moved = right - right_of(anchor);
            assert!((moved - before * width).abs() < 3.0, "{moved} of {width}");
        }
        // Turned to the right, it goes down from its point.
        let (columns, rows) = written(Anchor::Start, 90.0);
        let (top, bottom) = ends(&rows);
        assert!((200.0..208.0).contains(&top) && (bottom - top - width).abs() < 12.0, "{top} {bottom}");
        assert!(columns.len() < 50, "{columns:?}");
    }

    #[test]
    fn what_is_no_text_stays() {
        assert_eq!(outlined("<polyline points=\"0,0\"/>\n"), None);
        let path = outlined("<text x=\"1\" y=\"2\" font-size=\"8\" text-anchor=\"end\" fill=\"#222222\">|</text>\n");
        let path = path.unwrap();
        assert!(path.starts_with("<path d=\"M") && path.ends_with("\" fill=\"#222222\"/>\n"), "{path}");
    }
}
