//! Pixels of an SVG figure.

use super::place::Rect;
use super::text;
use resvg::tiny_skia::{FilterQuality, Pixmap, PixmapPaint, Transform};
use resvg::usvg::{self, Options, Tree, fontdb::Database};
use std::sync::{Arc, LazyLock};

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

static FONTS: LazyLock<Arc<Database>> = LazyLock::new(|| {
    let mut fonts = Database::new();
    fonts.load_font_data(text::face().to_vec());
    Arc::new(fonts)
});

/// The document as a PNG file. `pictures`: those within it and their places, for which the library that draws documents
/// has no decoder.
pub fn encode(svg: &str, pictures: &[(Rect, &[u8])]) -> Result<Vec<u8>, PngError> {
    let options = Options { fontdb: Arc::clone(&FONTS), ..Options::default() };
    // A canvas writes each picture on a line of its own.
    let drawn: String = svg.split_inclusive('\n').filter(|line| !line.starts_with("<image ")).collect();
    let tree = Tree::from_str(&drawn, &options)?;
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
