//! What runs came to: statistics over seeds, figures, tables beside the paper's, one page. Reads and writes no files.

pub mod chart;
pub mod statistics;
