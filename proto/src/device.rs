//! Which of a machine's GPUs a process sees.

/// The variable that says which CUDA devices a process sees: numbers or UUIDs, separated by commas. The orchestrator sets
/// it for its learners.
pub const VISIBLE_DEVICES: &str = "CUDA_VISIBLE_DEVICES";

/// What the machine calls device `index` of those that are `visible`; all are where nothing is said. Empty where there are
/// not so many: no device rather than another's.
pub fn device_name(index: usize, visible: Option<&str>) -> String {
    match visible {
        None => index.to_string(),
        Some(visible) => visible.split(',').nth(index).unwrap_or_default().trim().to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn devices_are_those_that_are_given() {
        let names = |visible| [0, 1].map(|index| device_name(index, visible));
        assert_eq!(names(None), ["0", "1"]);
        assert_eq!(names(Some("3, 5,6")), ["3", "5"]);
        assert_eq!(names(Some("GPU-3cdeb329")), ["GPU-3cdeb329", ""]);
    }
}
