//! An action, drawn on the host from what the policy gives.

use crate::network::{FORBIDDEN_LOGIT, HALF_LN_TAU};
use proto::task::{ActionHead, PolicyAction};

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Sampled {
    pub action: PolicyAction,
    pub log_prob: f32,
    pub value: f32,
    /// Whether all that the network gives for the row is finite.
    pub finite: bool,
}

/// Draws an action from a row of [`crate::network::Distribution::rows`] with noise; its log-probability.
pub(super) fn sample(head: &ActionHead, row: &[f32], noise: &[f32]) -> (PolicyAction, f32) {
    if head.is_gaussian() {
        return draw(row, noise);
    }
    let (mut log_prob, mut begin) = (0.0, 0);
    let choose = |options: usize| {
        let own = begin..begin + options;
        begin = own.end;
        let option = best(&row[own.clone()], &noise[own.clone()]);
        log_prob += row[own.start + option];
        option as i64
    };
    let options = head.choices().map(choose).collect();
    (PolicyAction::Options(options), log_prob)
}

/// argmax of log-probability plus Gumbel noise: a sample of the policy (Gumbel's trick). The first of equals.
fn best(log_probs: &[f32], gumbel: &[f32]) -> usize {
    let mut best = (0, f32::NEG_INFINITY);
    for (option, (log_prob, noise)) in log_probs.iter().zip(gumbel).enumerate() {
        if log_prob + noise > best.1 {
            best = (option, log_prob + noise);
        }
    }
    best.0
}

/// mean + deviation · noise for each number. libm, so that every machine draws the same.
fn draw(row: &[f32], noise: &[f32]) -> (PolicyAction, f32) {
    let (means, log_stds) = row.split_at(noise.len());
    let (mut numbers, mut log_prob) = (Vec::with_capacity(noise.len()), 0.0);
    for ((&mean, &log_std), &noise) in means.iter().zip(log_stds).zip(noise) {
        let (mean, log_std) = (f64::from(mean), f64::from(log_std));
        let deviation = libm::exp(log_std);
        // What is judged is the number as it is kept.
        let number = (mean + deviation * f64::from(noise)) as f32;
        let away = (f64::from(number) - mean) / deviation;
        log_prob -= 0.5 * away * away + log_std + HALF_LN_TAU;
        numbers.push(number);
    }
    (PolicyAction::Numbers(numbers), log_prob as f32)
}

/// Puts the logit of what is never chosen where a mask forbids an option; of a task without masks it is empty.
pub(super) fn forbid(mask: &[bool], logits: &mut [f32]) {
    for (logit, _) in logits.iter_mut().zip(mask).filter(|(_, allowed)| !**allowed) {
        *logit = FORBIDDEN_LOGIT as f32;
    }
}

/// Logits of each choice become log-probabilities.
pub(super) fn normalize(head: &ActionHead, row: &mut [f32]) {
    let mut rest = row;
    for options in head.choices() {
        let Some((logits, others)) = rest.split_at_mut_checked(options) else { return };
        let most = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let total: f64 = logits.iter().map(|&logit| libm::exp(f64::from(logit - most))).sum();
        let log_total = libm::log(total);
        for logit in logits {
            *logit = (f64::from(*logit - most) - log_total) as f32;
        }
        rest = others;
    }
}

/// The option of an action's only choice.
pub(super) fn option(action: &PolicyAction) -> usize {
    match action {
        PolicyAction::Options(options) => options.first().map_or(0, |&option| option as usize),
        PolicyAction::Numbers(_) => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By the textbook's formulas.
    #[test]
    fn what_is_drawn_has_the_probability_that_is_told() {
        let head = ActionHead::Box(vec![[-1.0, 1.0]; 2]);
        let row = [0.5, -2.0, 0.0, 0.5f32.ln()];
        let (action, log_prob) = sample(&head, &row, &[1.5, -2.0]);
        assert_eq!(action, PolicyAction::Numbers(vec![2.0, -3.0]));
        let density =
            |away: f64, deviation: f64| (-0.5 * away * away).exp() / (deviation * std::f64::consts::TAU.sqrt());
        let expected = (density(1.5, 1.0) * density(-2.0, 0.5)).ln();
        assert!((f64::from(log_prob) - expected).abs() < 1e-6, "{log_prob} {expected}");
        // Without noise it is the mean; the environment is given what the bounds admit.
        let (mean, _) = sample(&head, &row, &[0.0; 2]);
        let mut bytes = vec![];
        head.write(&mean, &mut bytes);
        assert_eq!(bytes, [0.5f32, -1.0].map(f32::to_ne_bytes).concat());

        let head = ActionHead::MultiDiscrete(vec![2, 3]);
        let mut row = [1.0, 2.0, 0.0, 3.0, 0.0];
        normalize(&head, &mut row);
        let sums = [&row[..2], &row[2..]].map(|part| part.iter().map(|p| p.exp()).sum::<f32>());
        assert!(sums.iter().all(|sum| (sum - 1.0).abs() < 1e-6), "{sums:?}");
        let (action, log_prob) = sample(&head, &row, &[0.0, -0.9, 5.0, 0.0, 0.0]);
        assert_eq!(action, PolicyAction::Options(vec![1, 0]));
        assert_eq!(log_prob, row[1] + row[2]);
        let mut bytes = vec![];
        head.write(&action, &mut bytes);
        assert_eq!(bytes, [1i32, 0].map(i32::to_ne_bytes).concat());
        assert_eq!(ActionHead::Discrete(vec![3, 7]).choices().collect::<Vec<_>>(), [2]);

        // What is forbidden has no part in a choice, whatever its logit and noise.
        let mut row = [9.0, 2.0, 0.0, 9.0, 0.0];
        forbid(&[false, true, true, false, true], &mut row);
        normalize(&head, &mut row);
        let (action, log_prob) = sample(&head, &row, &[50.0, 0.0, 0.0, 50.0, 1.0]);
        assert_eq!((action, log_prob), (PolicyAction::Options(vec![1, 2]), 0.5f32.ln()));
    }
}
