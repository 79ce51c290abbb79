use super::frame::{Frame, Span};

#[derive(Debug, Clone, Copy)]
pub(super) struct Opening {
    pub along: Span,
    pub up: Span,
}

/// A wall: its frame begins in the corner where one stands when it is to the left, or to the right.
#[derive(Debug, Clone)]
pub(super) struct Wall {
    pub frame: Frame,
    pub length_m: f32,
    /// Where something stands before it, hangs on it or goes through it.
    pub taken: Vec<Span>,
    pub openings: Vec<Opening>,
}

impl Wall {
    pub fn new(frame: Frame, length_m: f32) -> Self {
        Self { frame, length_m, taken: Vec::new(), openings: Vec::new() }
    }

    pub fn free(&self) -> Vec<Span> {
        let mut taken = self.taken.clone();
        taken.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let mut free = Vec::new();
        let mut at = 0.0;
        for [from, to] in taken {
            if from > at {
                free.push([at, from]);
            }
            at = f32::max(at, to);
        }
        if at < self.length_m {
            free.push([at, self.length_m]);
        }
        free
    }
}
