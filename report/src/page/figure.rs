//! Figures in the page.

use crate::chart::Figure;
use maud::{Markup, PreEscaped, html};
use std::fmt::Write;

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
            figcaption {
                (figure.caption)
                span.downloads {
                    @for (ending, kind, content) in [
                        ("svg", "image/svg+xml", figure.svg()),
                        ("csv", "text/csv;charset=utf-8", figure.csv()),
                    ] {
                        " "
                        a download={ (figure.name) "." (ending) } href={ "data:" (kind) "," (encoded(&content)) } {
                            (ending.to_uppercase())
                        }
                    }
                }
            }
        }
    }
}

/// The content of a `data:` address. Only what would end the address or the attribute, or what a browser takes out, is
/// written as a number: the figure is in the page twice, and need not be there three times as long.
fn encoded(content: &str) -> String {
    let mut address = String::with_capacity(content.len() + content.len() / 4);
    for letter in content.chars() {
        match letter {
            '%' | '#' | '"' | '<' | '>' | '&' | '\'' | '\n' | '\r' | '\t' => {
                let _ = write!(address, "%{:02X}", u32::from(letter));
            }
            letter => address.push(letter),
        }
    }
    address
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_would_end_an_address_is_written_as_a_number() {
        assert_eq!(encoded("<a b=\"1%\">λ′\n#&</a>"), "%3Ca b=%221%25%22%3Eλ′%0A%23%26%3C/a%3E");
    }
}
