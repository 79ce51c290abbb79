//! The learning rate's way over a stage, and the entropy bonus's: the learner takes it, the orchestrator foretells it.

/// How far the learning rate has fallen after so many frames of a stage, 0..=1. It falls over `learning_rate_frames`,
/// whatever the stage's length; over the stage if that is 0.
pub fn learning_rate_progress(frames_in_stage: u64, stage_frames: u64, learning_rate_frames: u64) -> f64 {
    let whole = if learning_rate_frames == 0 { stage_frames } else { learning_rate_frames };
    (frames_in_stage as f64 / whole as f64).min(1.0)
}

/// A number that falls with it, or itself, after a share `progress` of the way: linear from `start` to `start ·
/// end_share`.
pub fn falling(start: f64, end_share: f64, progress: f64) -> f64 {
    start * (1.0 + (end_share - 1.0) * progress.clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The reference's factor: max(1/3, 1 - 2/3 · frames / 30M), in each of its stages.
    #[test]
    fn the_rate_of_a_stage_falls_over_frames_of_its_own_number() {
        let after = |frames, stage, whole| falling(1.0, 1.0 / 3.0, learning_rate_progress(frames, stage, whole));
        let million = 1_000_000;
        for (stage, end) in [(20 * million, 0.556), (25 * million, 0.444), (30 * million, 0.333), (45 * million, 0.333)]
        {
            let rate = after(stage, stage, 30 * million);
            assert!((rate - end).abs() < 5e-4, "{stage} frames end at {rate}");
            assert!((after(stage, stage, 0) - 1.0 / 3.0).abs() < 1e-12, "a stage's own length ends at a third");
            assert_eq!(after(0, stage, 30 * million), 1.0);
        }
        assert!((after(10 * million, 20 * million, 0) - 2.0 / 3.0).abs() < 1e-12);
        // It stays at its end.
        assert_eq!(after(31 * million, 45 * million, 30 * million), after(45 * million, 45 * million, 30 * million));
    }
}
