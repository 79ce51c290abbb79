//! The page itself: files that are in the program. `orchestrator view` serves them one by one; a report is the same page
//! as one file, with its data inside.

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use sha2::{Digest, Sha256};

#[derive(Debug, Clone, Copy)]
pub(crate) struct Asset {
    pub path: &'static str,
    pub kind: &'static str,
    pub content: &'static str,
}

macro_rules! asset {
    ($path:literal, $kind:literal, $file:literal) => {
        Asset { path: $path, kind: $kind, content: include_str!(concat!("../page/", $file)) }
    };
}

const INDEX: &str = include_str!("../page/index.html");
const STYLES: [&str; 2] = [include_str!("../page/uPlot/uPlot.min.css"), include_str!("../page/style.css")];
const CHARTS: &str = include_str!("../page/uPlot/uPlot.iife.min.js");
const CHARTS_LICENCE: &str = include_str!("../page/uPlot/LICENSE");
/// What comes before a report's data.
const DATA: &str = "<script type=\"application/json\" id=\"report\">";
/// What a report is drawn by: each file imports from those before it.
const MODULES: [&str; 5] = [
    include_str!("../page/dom.js"),
    include_str!("../page/format.js"),
    include_str!("../page/chart.js"),
    include_str!("../page/curves.js"),
    include_str!("../page/report.js"),
];

pub(crate) const ASSETS: &[Asset] = &[
    asset!("/", "text/html; charset=utf-8", "index.html"),
    asset!("/uPlot.css", "text/css; charset=utf-8", "uPlot/uPlot.min.css"),
    asset!("/style.css", "text/css; charset=utf-8", "style.css"),
    asset!("/uPlot.js", "text/javascript; charset=utf-8", "uPlot/uPlot.iife.min.js"),
    asset!("/uPlot.txt", "text/plain; charset=utf-8", "uPlot/LICENSE"),
    asset!("/main.js", "text/javascript; charset=utf-8", "main.js"),
    asset!("/dom.js", "text/javascript; charset=utf-8", "dom.js"),
    asset!("/format.js", "text/javascript; charset=utf-8", "format.js"),
    asset!("/chart.js", "text/javascript; charset=utf-8", "chart.js"),
    asset!("/curves.js", "text/javascript; charset=utf-8", "curves.js"),
    asset!("/list.js", "text/javascript; charset=utf-8", "list.js"),
    asset!("/report.js", "text/javascript; charset=utf-8", "report.js"),
    asset!("/suite.js", "text/javascript; charset=utf-8", "suite.js"),
    asset!("/run.js", "text/javascript; charset=utf-8", "run.js"),
    asset!("/episodes.js", "text/javascript; charset=utf-8", "episodes.js"),
    asset!("/episode.js", "text/javascript; charset=utf-8", "episode.js"),
    asset!("/play.js", "text/javascript; charset=utf-8", "play.js"),
    asset!("/film.js", "text/javascript; charset=utf-8", "film.js"),
    asset!("/gif.js", "text/javascript; charset=utf-8", "gif.js"),
    asset!("/stage.js", "text/javascript; charset=utf-8", "stage.js"),
    asset!("/icon.svg", "image/svg+xml", "icon.svg"),
];

/// A report as one file that needs no network. `data`: JSON that `report.js` draws; `otherwise`: HTML for a reader
/// whose browser runs no scripts.
///
/// Its policy lets nothing be loaded, and runs these very scripts alone: names in the data cannot become code.
pub fn report(data: &str, otherwise: &str) -> String {
    let parts = parts();
    let policy = policy(&parts);
    let [style, charts, modules] = parts;
    // Within JSON a sign of markup stands in texts only.
    let data = data.replace('<', "\\u003c");
    let (head, rest) = INDEX.split_once("<link").expect("the page names its files");
    let (_, rest) = rest.split_once("</head>").expect("a head ends");
    let (before, after) = rest.split_once("</main>").expect("the page has a place for its content");
    format!(
        "{head}<meta http-equiv=\"Content-Security-Policy\" content=\"{policy}\">\n<style>{style}</style>\n</head>\
         {before}{otherwise}</main>{after}{DATA}{data}</script>\n\
         <script>{charts}</script>\n<script type=\"module\">{modules}</script>\n"
    )
}

/// Style, charts and modules of a report.
fn parts() -> [String; 3] {
    [STYLES.concat(), format!("/* uPlot\n{CHARTS_LICENCE}\n*/\n{CHARTS}"), joined(&MODULES)]
}

fn policy(parts: &[String; 3]) -> String {
    let [style, charts, modules] = parts.each_ref().map(|text| hash(text));
    format!(
        "default-src 'none'; style-src {style}; script-src {charts} {modules}; img-src data: blob:; base-uri 'none'; \
         form-action 'none'"
    )
}

/// For a report that lies in somebody's folder: of its scripts those of this very program run, and no other.
pub(crate) fn report_policy() -> String {
    format!("{}; frame-ancestors 'none'", policy(&parts()))
}

/// A report from its file, by the scripts of this program: those of another version would not run. None without its data.
pub(crate) fn again(page: &str) -> Option<String> {
    let (_, rest) = page.split_once(DATA)?;
    let (data, _) = rest.split_once("</script>")?;
    Some(report(data, ""))
}

/// Modules as one: a browser cannot import what lies in the same file.
fn joined(modules: &[&str]) -> String {
    let lines = modules.iter().flat_map(|module| module.lines()).filter(|line| !line.starts_with("import "));
    lines.flat_map(|line| [line.strip_prefix("export ").unwrap_or(line), "\n"]).collect()
}

fn hash(content: &str) -> String {
    format!("'sha256-{}'", BASE64_STANDARD.encode(Sha256::digest(content)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The table of episodes was dead: a local `words` hid the function of that name.
    #[test]
    fn no_script_declares_a_name_anew_that_it_imports() {
        for Asset { path, content, .. } in ASSETS.iter().filter(|asset| asset.path.rsplit('.').next() == Some("js")) {
            let imported = content.lines().filter_map(|line| line.strip_prefix("import { ")?.split_once(" }"));
            for name in imported.flat_map(|(names, _)| names.split(", ")) {
                for word in ["const", "let", "function", "class"] {
                    let declared = [" ", ";", "("].map(|end| format!("{word} {name}{end}"));
                    assert!(!declared.iter().any(|text| content.contains(text)), "{path} declares `{name}` anew");
                }
            }
        }
    }
}
