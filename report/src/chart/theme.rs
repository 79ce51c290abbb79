//! Figures on a dark page. An SVG document has the colours of a light one, so that it can be printed as it is; where it
//! is part of a page, rules of the page's style sheet take the place of each colour.

use super::{palette, svg};
use std::fmt::Write;

/// Rules for the figures of a page that chooses between light and dark by `color-scheme`.
pub fn rules() -> String {
    let mut rules = String::new();
    for (light, dark) in svg::IN_THE_DARK.into_iter().chain(palette::in_the_dark()) {
        for attribute in ["fill", "stroke"] {
            let _ = writeln!(rules, "svg [{attribute}=\"{light}\"] {{ {attribute}: light-dark({light}, {dark}); }}");
        }
    }
    rules
}
