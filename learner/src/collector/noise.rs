//! Action noise that depends on nothing but where it is used.

use crate::network::fill_normal;
use proto::episode::EnvironmentId;
use proto::random::{Key, Purpose};
use proto::task::ActionHead;

/// What chooses an action from what the policy gives: draws for one environment's step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Noise {
    /// So many of standard Gumbel noise: argmax(logits + noise) samples from softmax(logits) (Gumbel 1954; Maddison et al.
    /// 2014, "A* Sampling").
    Gumbel(usize),
    /// So many standard normal numbers: mean + deviation · noise samples from a Gaussian.
    Normal(usize),
}

impl Noise {
    pub fn of(head: &ActionHead) -> Self {
        if head.is_gaussian() { Self::Normal(head.outputs()) } else { Self::Gumbel(head.outputs()) }
    }

    pub fn count(self) -> usize {
        match self {
            Self::Gumbel(count) | Self::Normal(count) => count,
        }
    }

    /// Appends the draws for an environment's step to `noise`: a function of (seed, environment, episode, step). The action
    /// sampled there does not depend on batch order, on timing, or on whether the process was restarted in between.
    pub fn draw(self, seed: u64, environment: EnvironmentId, episode: u32, step: u32, noise: &mut Vec<f32>) {
        let kitchen = environment.kitchen.number();
        let key = Key { seed, purpose: Purpose::ActionNoise, kitchen, environment: environment.number, episode, step };
        self.draw_from(key, noise);
    }

    pub(crate) fn draw_from(self, key: Key, noise: &mut Vec<f32>) {
        let mut random = key.stream();
        // libm, so that every machine samples the same actions.
        match self {
            Self::Gumbel(count) => {
                noise.extend((0..count).map(|_| -libm::log(-libm::log(random.uniform_open())) as f32));
            }
            Self::Normal(count) => {
                let mut draws = vec![0.0; count];
                fill_normal(&mut random, &mut draws);
                noise.extend(draws.into_iter().map(|draw| draw as f32));
            }
        }
    }
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
            Noise::Gumbel(4).draw(11, EnvironmentId::of(2, 1, 4), 7, step, &mut noise);
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
            for kind in [Noise::Gumbel(3), Noise::Normal(3)] {
                kind.draw(seed, EnvironmentId::of(actor, 0, 1), episode, step, &mut noise);
            }
            noise
        };
        let reference = draw(1, 2, 3, 4);
        assert_eq!(reference, draw(1, 2, 3, 4));
        for other in [draw(2, 2, 3, 4), draw(1, 3, 3, 4), draw(1, 2, 4, 4), draw(1, 2, 3, 5), draw(1, 21, 3, 4)] {
            assert!(reference.iter().zip(&other).all(|(one, other)| one != other));
        }
        assert!(reference.iter().all(|value| value.is_finite()));
    }

    #[test]
    fn normal_noise_has_the_moments_of_a_standard_gaussian() {
        let mut noise = vec![];
        for step in 0..20_000 {
            Noise::Normal(3).draw(5, EnvironmentId::of(2, 1, 4), 7, step, &mut noise);
        }
        let mean = |of: &dyn Fn(f64) -> f64| noise.iter().map(|&x| of(x.into())).sum::<f64>() / noise.len() as f64;
        let moments = [mean(&|x| x), mean(&|x| x * x), mean(&|x| x.powi(3)), mean(&|x| x.powi(4))];
        for (moment, (expected, deviation)) in
            moments.into_iter().zip([(0.0, 1.0), (1.0, 1.5), (0.0, 4.0), (3.0, 10.0)])
        {
            assert!((moment - expected).abs() < 4.0 * deviation / (noise.len() as f64).sqrt(), "{moments:?}");
        }
    }
}
