//! Whether processes can be held to the cores that `machine.pin` asks for.

use super::Finding;
use super::device::is_cuda;
use super::placement::{Cores, Placement, PlacementError};
use proto::config::Config;
use proto::device::Torch;

/// The cores of a run's processes; none where the kernel chooses.
pub fn placement(config: &Config, torch: &Torch) -> Result<Option<Placement>, PlacementError> {
    Cores::find(torch)?.place(&config.machine.pin, config.shares(), is_cuda(config, torch))
}

pub fn check(config: &Config, torch: &Torch) -> Finding {
    match placement(config, torch) {
        Ok(None) => Finding::Good("as the kernel chooses (machine.pin = false)".to_owned()),
        Ok(Some(placement)) => Finding::Good(placement.describe()),
        Err(error) => Finding::Problem(error.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::config::Pin;

    #[test]
    fn a_core_that_is_not_there_is_a_problem() {
        let torch = |pci| Torch {
            version: "2.11.0".into(),
            library: String::new(),
            devices: vec!["cpu".into()],
            pci,
            arithmetic: String::new(),
        };
        let mut config = Config::resolve("demo", None).unwrap();
        assert!(matches!(check(&config, &torch(vec![])), Finding::Good(text) if text.contains("kernel")));
        config.machine.pin = Pin::Automatic(true);
        assert!(matches!(check(&config, &torch(vec![])), Finding::Good(text) if text.starts_with("learner 0 on ")));
        config.machine.pin = Pin::Cores(vec![1023]);
        assert!(matches!(check(&config, &torch(vec![])), Finding::Problem(text) if text.contains("core 1023")));
    }
}
