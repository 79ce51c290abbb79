//! A group as tables and figures take it.

use crate::results::FieldResult;
use crate::study::{Field, Group};

/// A group with its style and its results.
#[derive(Debug, Clone)]
pub struct StyledGroup<'a> {
    /// Number of its style in every figure.
    pub style: usize,
    pub group: &'a Group<'a>,
    /// In each field in which it was evaluated.
    pub results: Vec<(Field, FieldResult)>,
}

impl StyledGroup<'_> {
    pub fn in_field(&self, field: Field) -> Option<&FieldResult> {
        self.results.iter().find(|(found, _)| *found == field).map(|(_, result)| result)
    }
}
