//! Pictures of one episode in a row, with words beneath each.

use super::place::{LABEL, Rect};
use super::svg::{Anchor, Canvas};
use super::text;

/// One picture of an episode.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Frame {
    pub png: Vec<u8>,
    /// Lines beneath it.
    pub words: Vec<String>,
}

/// Pictures of one episode, from its start to its end.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct FrameStrip {
    /// In order of time.
    pub frames: Vec<Frame>,
    /// Width of each in pixels divided by its height.
    pub aspect: (u32, u32),
}

/// Space between frames.
const GAP: f64 = 6.0;
const LINE: f64 = 14.0;

impl FrameStrip {
    /// Height of a strip of this width with its words, pixels.
    pub fn height(&self, width: f64) -> f64 {
        let lines = self.frames.iter().map(|frame| frame.words.len()).max().unwrap_or(0);
        self.frame_size(width).1 + 6.0 + lines as f64 * LINE
    }

    fn frame_size(&self, width: f64) -> (f64, f64) {
        let count = self.frames.len().max(1) as f64;
        let across = (width - (count - 1.0) * GAP) / count;
        (across, across * f64::from(self.aspect.1) / f64::from(self.aspect.0.max(1)))
    }

    /// Where its pictures are.
    fn places(&self, rect: Rect) -> impl Iterator<Item = (Rect, &[u8])> {
        let (width, height) = self.frame_size(rect.width);
        self.frames.iter().enumerate().map(move |(index, frame)| {
            let left = rect.left + index as f64 * (width + GAP);
            (Rect { left, top: rect.top, width, height }, frame.png.as_slice())
        })
    }

    pub(super) fn draw(&self, canvas: &mut Canvas, rect: Rect) {
        let size = LABEL - 1.5;
        for ((place, png), frame) in self.places(rect).zip(&self.frames) {
            canvas.picture((place.left, place.top), (place.width, place.height), png);
            for (line, words) in frame.words.iter().enumerate() {
                let below = place.bottom() + (line + 1) as f64 * LINE;
                canvas.text(place.left, below, size, Anchor::Start, &text::fitted(words, size, place.width));
            }
        }
    }
}
