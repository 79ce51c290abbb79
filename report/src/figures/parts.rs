//! Figures of more groups than there are colours.

use crate::chart::{Figure, STYLES};
use crate::styled_group::StyledGroup;

/// As many figures as are needed so that none has more curves than there are colours.
pub fn in_parts<'a>(
    all: &'a [&'a StyledGroup<'a>],
    name: &str,
    mut figure: impl FnMut(String, &'a [&'a StyledGroup<'a>]) -> Figure,
) -> Vec<Figure> {
    let parts = all.len().div_ceil(STYLES);
    all.chunks(STYLES)
        .enumerate()
        .map(|(part, chunk)| figure(if parts > 1 { format!("{name}-{}", part + 1) } else { name.to_owned() }, chunk))
        .collect()
}

/// Names of these groups beside their styles.
pub fn legend(entries: &[&StyledGroup<'_>]) -> Vec<(usize, String)> {
    entries.iter().map(|entry| (entry.style, entry.group.label.clone())).collect()
}
