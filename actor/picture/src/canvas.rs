use ab_glyph::{Font, FontRef, PxScale, ScaleFont, point};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// 24-bit sRGB.
pub type Rgb = [u8; 3];

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Canvas {
    pub width: usize,
    pub height: usize,
    /// Row after row from the top.
    pub pixels: Vec<Rgb>,
}

#[derive(Debug, thiserror::Error)]
#[error("cannot write {}", path.display())]
pub struct PictureError {
    path: PathBuf,
    source: png::EncodingError,
}

impl Canvas {
    pub fn new(width: usize, height: usize, colour: Rgb) -> Self {
        Self { width, height, pixels: vec![colour; width * height] }
    }

    pub fn place(&mut self, other: &Self, x: usize, y: usize) {
        let columns = other.width.min(self.width.saturating_sub(x));
        for row in 0..other.height.min(self.height.saturating_sub(y)) {
            let (to, from) = ((y + row) * self.width + x, row * other.width);
            self.pixels[to..to + columns].copy_from_slice(&other.pixels[from..from + columns]);
        }
    }

    pub(crate) fn blend(&mut self, x: usize, y: usize, colour: Rgb, share: f32) {
        let pixel = &mut self.pixels[y * self.width + x];
        *pixel = mix(*pixel, colour, share);
    }

    pub fn fill(&mut self, x: usize, y: usize, width: usize, height: usize, colour: Rgb) {
        for row in y..(y + height).min(self.height) {
            let (from, to) = (x.min(self.width), (x + width).min(self.width));
            self.pixels[row * self.width + from..row * self.width + to].fill(colour);
        }
    }

    /// Writes a line of text of this height (pixels), beginning at `x`, its base line at `y`. Returns where it ends.
    pub fn text(&mut self, text: &str, height_px: f32, x: f32, y: f32, colour: Rgb) -> f32 {
        let font = font();
        let scaled = font.as_scaled(PxScale::from(height_px));
        let mut at = x;
        let mut previous = None;
        for letter in text.chars() {
            let id = scaled.glyph_id(letter);
            if let Some(previous) = previous {
                at += scaled.kern(previous, id);
            }
            let glyph = id.with_scale_and_position(height_px, point(at, y));
            if let Some(outline) = font.outline_glyph(glyph) {
                let bounds = outline.px_bounds();
                outline.draw(|column, row, cover| {
                    let (column, row) = (bounds.min.x + column as f32, bounds.min.y + row as f32);
                    if column >= 0.0 && row >= 0.0 && (column as usize) < self.width && (row as usize) < self.height {
                        let pixel = &mut self.pixels[row as usize * self.width + column as usize];
                        *pixel = mix(*pixel, colour, cover);
                    }
                });
            }
            at += scaled.h_advance(id);
            previous = Some(id);
        }
        at
    }

    /// The same, smaller where it would end beyond the right edge.
    pub fn text_within(&mut self, text: &str, height_px: f32, x: f32, y: f32, colour: Rgb) {
        let font = font();
        let scaled = font.as_scaled(PxScale::from(height_px));
        let ids: Vec<_> = text.chars().map(|letter| scaled.glyph_id(letter)).collect();
        let kerns: f32 = ids.windows(2).map(|two| scaled.kern(two[0], two[1])).sum();
        let width = ids.iter().map(|&id| scaled.h_advance(id)).sum::<f32>() + kerns;
        let room = self.width as f32 - 2.0 * x;
        self.text(text, height_px * (room / width).min(1.0), x, y, colour);
    }

    pub fn write_png(&self, path: &Path) -> Result<(), PictureError> {
        let file = std::fs::File::create(path).map_err(png::EncodingError::from);
        file.and_then(|file| self.encode(BufWriter::new(file), png::Compression::High))
            .map_err(|source| PictureError { path: path.to_owned(), source })
    }

    pub fn png(&self) -> Result<Vec<u8>, png::EncodingError> {
        let mut bytes = Vec::new();
        self.encode(&mut bytes, png::Compression::Fast)?;
        Ok(bytes)
    }

    fn encode(&self, to: impl Write, compression: png::Compression) -> Result<(), png::EncodingError> {
        let mut encoder = png::Encoder::new(to, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(compression);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(self.pixels.as_flattened())?;
        writer.finish()
    }
}

fn font() -> FontRef<'static> {
    FontRef::try_from_slice(epaint_default_fonts::UBUNTU_LIGHT).expect("the crate ships a sound font")
}

pub fn mix(below: Rgb, above: Rgb, share: f32) -> Rgb {
    std::array::from_fn(|i| {
        let (below, above) = (f32::from(below[i]), f32::from(above[i]));
        (below + (above - below) * share.clamp(0.0, 1.0)).round() as u8
    })
}
