//! One episode as two policies play it: pictures of both, one strip above the other.

use crate::chart::{Figure, Frame, FrameStrip};

/// One episode, played by weights from before a stage and from after it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ShownPair {
    /// What is said of it: of which run, which episode, and how it was chosen.
    pub caption: String,
    /// Before and after.
    pub strips: [ShownStrip; 2],
}

/// An episode in pictures.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ShownStrip {
    /// Which weights, and how it ended.
    pub title: String,
    /// From its start to its end.
    pub frames: Vec<Frame>,
    /// Width and height of each picture, pixels.
    pub size: (u32, u32),
}

pub fn episodes(pairs: Vec<ShownPair>) -> Vec<Figure> {
    let figure = |(index, ShownPair { caption, strips }): (usize, ShownPair)| {
        let panels = strips
            .map(|ShownStrip { title, frames, size }| Figure::strip_panel(title, FrameStrip { frames, aspect: size }));
        Figure {
            name: format!("episode-{}", index + 1),
            caption,
            legend: Vec::new(),
            columns: 1,
            panel_height: panels.iter().map(|(_, height)| *height).fold(0.0, f64::max),
            panels: panels.map(|(panel, _)| panel).into(),
        }
    };
    pairs.into_iter().enumerate().map(figure).collect()
}
