//! Figures in the page.

use crate::chart::Figure;
use maud::{Markup, PreEscaped, html};

/// These figures; where there are none, why.
pub fn drawn(figures: &[Figure], otherwise: &str) -> Markup {
    if figures.is_empty() {
        return notice(otherwise);
    }
    html! {
        div.figures { @for figure in figures { (placed(figure)) } }
    }
}

/// Why there is nothing here.
pub fn notice(why: &str) -> Markup {
    html! { p.missing { (why) } }
}

/// A figure's panels, which the page places side by side as its width allows, under the legend that they share.
fn placed(figure: &Figure) -> Markup {
    let class = match (figure.columns, figure.panels.len()) {
        (1, _) => "wide",
        (_, 1 | 2) => "pair",
        _ => "many",
    };
    html! {
        figure id=(figure.name) class=(class) {
            @if !figure.legend.is_empty() {
                div.legend {
                    @for (key, name) in figure.legend_keys() { span { (PreEscaped(key)) " " (name) } }
                }
            }
            div.panels { @for panel in figure.panel_svgs() { (PreEscaped(panel)) } }
            figcaption { (figure.caption) " " code { "figures/" (figure.name) ".svg" } }
        }
    }
}
