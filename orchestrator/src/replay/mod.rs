//! Recorded episodes again: [`newest`] chooses what there is to see, [`simulate`] takes the actions again and draws what
//! the camera saw, with [`ffmpeg`] for films, and [`harvest`] makes a data set of them.

pub mod ffmpeg;
pub mod harvest;
pub mod newest;
pub mod simulate;
