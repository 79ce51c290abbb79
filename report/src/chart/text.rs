//! The face of all figures, `DejaVu Sans`: it is in the program to measure texts.

use ab_glyph::{Font, FontRef, ScaleFont};
use std::sync::LazyLock;

/// What a browser is asked for; the second and third have nearly the same widths.
pub const FAMILY: &str = "DejaVu Sans, Verdana, Geneva, sans-serif";

static FONT: LazyLock<FontRef<'static>> =
    LazyLock::new(|| FontRef::try_from_slice(dejavu::sans::regular()).expect("the crate ships a sound font"));

/// Width of a line of text of this size, pixels.
pub fn width(text: &str, size: f64) -> f64 {
    let units = FONT.units_per_em().expect("a TrueType font has an em");
    // ab_glyph scales by the line's height, SVG by the em.
    let scaled = FONT.as_scaled(size as f32 * FONT.height_unscaled() / units);
    text.chars().map(|letter| f64::from(scaled.h_advance(scaled.glyph_id(letter)))).sum()
}

/// The text, cut with an ellipsis if it is wider than that.
pub fn fitted(text: &str, size: f64, most: f64) -> String {
    if width(text, size) <= most {
        return text.to_owned();
    }
    let mut kept: String = text.to_owned();
    while kept.pop().is_some() {
        let cut = format!("{}…", kept.trim_end());
        if width(&cut, size) <= most {
            return cut;
        }
    }
    String::new()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_sign_that_figures_use_is_in_the_face() {
        for sign in "λτ′≥≤×–−…±→".chars() {
            assert_ne!(FONT.glyph_id(sign).0, 0, "{sign}");
        }
    }

    /// Advance widths of `DejaVu Sans` 2.37, units of 2048 to the em: zero 1303, m 1995.
    #[test]
    fn widths_are_in_pixels_of_the_em() {
        assert!((width("0", 2048.0) - 1303.0).abs() < 0.5);
        assert!((width("m0", 20.48) - 32.98).abs() < 0.01);
    }

    #[test]
    fn what_does_not_fit_is_cut() {
        assert_eq!(fitted("short", 12.0, 100.0), "short");
        let cut = fitted("a name that is far too long for its place", 12.0, 100.0);
        assert!(cut.ends_with('…') && width(&cut, 12.0) <= 100.0, "{cut}");
    }
}
