//! The page itself: files that are in the program.

/// One file.
#[derive(Debug, Clone, Copy)]
pub struct Asset {
    /// Its address.
    pub path: &'static str,
    pub kind: &'static str,
    pub content: &'static [u8],
}

macro_rules! asset {
    ($path:literal, $kind:literal, $file:literal) => {
        Asset { path: $path, kind: $kind, content: include_bytes!(concat!("../page/", $file)) }
    };
}

/// All files.
pub const ASSETS: &[Asset] = &[
    asset!("/", "text/html; charset=utf-8", "index.html"),
    asset!("/style.css", "text/css; charset=utf-8", "style.css"),
    asset!("/main.js", "text/javascript; charset=utf-8", "main.js"),
    asset!("/dom.js", "text/javascript; charset=utf-8", "dom.js"),
    asset!("/format.js", "text/javascript; charset=utf-8", "format.js"),
    asset!("/chart.js", "text/javascript; charset=utf-8", "chart.js"),
    asset!("/list.js", "text/javascript; charset=utf-8", "list.js"),
    asset!("/run.js", "text/javascript; charset=utf-8", "run.js"),
    asset!("/episodes.js", "text/javascript; charset=utf-8", "episodes.js"),
    asset!("/episode.js", "text/javascript; charset=utf-8", "episode.js"),
    asset!("/play.js", "text/javascript; charset=utf-8", "play.js"),
    asset!("/film.js", "text/javascript; charset=utf-8", "film.js"),
    asset!("/gif.js", "text/javascript; charset=utf-8", "gif.js"),
    asset!("/stage.js", "text/javascript; charset=utf-8", "stage.js"),
    asset!("/icon.svg", "image/svg+xml", "icon.svg"),
];
