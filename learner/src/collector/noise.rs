//! Action noise that depends on nothing but where it is used.

use proto::episode::EnvironmentId;
use proto::random::{Key, Purpose};

/// Appends `count` draws of standard Gumbel noise for one environment's step to `noise`.
///
/// argmax(logits + noise) samples from softmax(logits) (Gumbel 1954; Maddison et al. 2014, "A* Sampling"). The draw
/// is a function of (seed, environment, episode, step): the action sampled there does not depend on batch order, on
/// timing, or on whether the process was restarted in between.
pub fn gumbel(seed: u64, environment: EnvironmentId, episode: u32, step: u32, count: usize, noise: &mut Vec<f32>) {
    let kitchen = environment.kitchen.number();
    let key = Key { seed, purpose: Purpose::ActionNoise, kitchen, environment: environment.number, episode, step };
    gumbel_of(key, count, noise);
}

/// Appends `count` draws of standard Gumbel noise from the stream of `key` to `noise`.
pub(crate) fn gumbel_of(key: Key, count: usize, noise: &mut Vec<f32>) {
    let mut random = key.stream();
    // libm, so that every machine samples the same actions.
    noise.extend((0..count).map(|_| -libm::log(-libm::log(random.uniform_open())) as f32));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn argmax_of_noisy_logits_samples_the_softmax() {
        let probabilities = [0.5_f64, 0.3, 0.15, 0.05];
        let mut counts = [0_u32; 4];
        let draws = 40_000;
        for step in 0..draws {
            let mut noise = vec![];
            gumbel(11, EnvironmentId::of(2, 1, 4), 7, step, 4, &mut noise);
            let best = (0..4)
                .max_by(|&a, &b| {
                    let score = |i: usize| probabilities[i].ln() + f64::from(noise[i]);
                    score(a).total_cmp(&score(b))
                })
                .unwrap();
            counts[best] += 1;
        }
        for (count, probability) in counts.iter().zip(probabilities) {
            let expected = probability * f64::from(draws);
            let deviations = (f64::from(*count) - expected) / (expected * (1.0 - probability)).sqrt();
            assert!(deviations.abs() < 4.0, "{counts:?}");
        }
    }

    #[test]
    fn every_coordinate_matters_and_the_same_ones_repeat() {
        let draw = |seed, actor, episode, step| {
            let mut noise = vec![];
            gumbel(seed, EnvironmentId::of(actor, 0, 1), episode, step, 3, &mut noise);
            noise
        };
        let reference = draw(1, 2, 3, 4);
        assert_eq!(reference, draw(1, 2, 3, 4));
        for other in [draw(2, 2, 3, 4), draw(1, 3, 3, 4), draw(1, 2, 4, 4), draw(1, 2, 3, 5), draw(1, 21, 3, 4)] {
            assert_ne!(reference, other);
        }
        assert!(reference.iter().all(|value| value.is_finite()));
    }
}
