//! Places on a canvas, and the size of what is written there.

/// Size of labels, pixels.
pub const LABEL: f64 = 12.0;

/// A rectangle on the canvas, pixels; y grows downwards.
#[derive(Debug, Clone, Copy)]
pub struct Rect {
    pub left: f64,
    pub top: f64,
    pub width: f64,
    pub height: f64,
}

impl Rect {
    pub fn right(self) -> f64 {
        self.left + self.width
    }

    pub fn bottom(self) -> f64 {
        self.top + self.height
    }
}
