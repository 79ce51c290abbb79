//! The page itself: files that are in the program.

/// One file.
#[derive(Debug, Clone, Copy)]
pub struct Asset {
    /// Its address.
    pub path: &'static str,
    /// Its kind.
    pub kind: &'static str,
    /// What is in it.
    pub content: &'static [u8],
}

macro_rules! assets {
    ($($path:literal $kind:literal $file:literal)*) => {
        /// All files.
        pub const ASSETS: &[Asset] =
            &[$(Asset { path: $path, kind: $kind, content: include_bytes!(concat!("../page/", $file)) }),*];
    };
}

assets! {
    "/" "text/html; charset=utf-8" "index.html"
    "/style.css" "text/css; charset=utf-8" "style.css"
    "/main.js" "text/javascript; charset=utf-8" "main.js"
    "/dom.js" "text/javascript; charset=utf-8" "dom.js"
    "/format.js" "text/javascript; charset=utf-8" "format.js"
    "/chart.js" "text/javascript; charset=utf-8" "chart.js"
    "/list.js" "text/javascript; charset=utf-8" "list.js"
    "/run.js" "text/javascript; charset=utf-8" "run.js"
    "/episodes.js" "text/javascript; charset=utf-8" "episodes.js"
    "/episode.js" "text/javascript; charset=utf-8" "episode.js"
    "/stage.js" "text/javascript; charset=utf-8" "stage.js"
    "/icon.svg" "image/svg+xml" "icon.svg"
}
