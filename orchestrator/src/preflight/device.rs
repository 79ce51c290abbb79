use super::Finding;
use proto::config::{Config, DeviceChoice};
use proto::device::Torch;

/// Checks that each of `gpus` is there. `torch`: what it finds where
/// [`VISIBLE_DEVICES`](proto::device::VISIBLE_DEVICES) is their list, which CUDA reads up to the first that it does not
/// know.
pub fn check_gpus(gpus: &[String], torch: &Torch) -> Finding {
    let Torch { version, library, .. } = torch;
    match gpus.get(torch.cuda_devices()) {
        None => Finding::Good(format!("GPUs {}", gpus.join(", "))),
        Some(missing) => Finding::Problem(format!(
            "--gpus {}: torch {version} at {library} finds no GPU {missing} here. `orchestrator doctor` shows what is \
             found; without --gpus runs go one after another on what there is",
            gpus.join(",")
        )),
    }
}

pub fn is_cuda(config: &Config, torch: &Torch) -> bool {
    torch.has_cuda() && config.learner.device != DeviceChoice::Cpu
}

pub fn check(config: &Config, torch: &Torch) -> Finding {
    let (cuda, learners) = (torch.cuda_devices(), config.learner.count);
    let Torch { version, library, devices, .. } = torch;
    let devices = devices.join(", ");
    if cuda == 0 && config.learner.device == DeviceChoice::Cuda {
        return Finding::Problem(format!(
            "learner.device = \"cuda\", but torch {version} at {library} finds no CUDA device here (it finds: {devices}). \
             A torch with CUDA is named by LIBTORCH; `orchestrator doctor` shows what is found"
        ));
    }
    if is_cuda(config, torch) && (learners as usize) > cuda {
        return Finding::Problem(format!(
            "{learners} learners compute on a CUDA device each, but torch {version} finds {cuda} here (it finds: \
             {devices}). Take fewer (--learners {cuda}), or have all compute on the CPU (learner.device = \"cpu\")"
        ));
    }
    let places = match (is_cuda(config, torch), learners) {
        (false, _) => "cpu".to_owned(),
        (true, 1) => "cuda:0".to_owned(),
        (true, _) => format!("cuda:0 to cuda:{}", learners - 1),
    };
    Finding::Good(format!("{learners} on {places}"))
}

#[cfg(test)]
pub mod tests {
    use super::*;

    pub fn torch(cuda: usize) -> Torch {
        let devices = (0..cuda).map(|index| format!("cuda:{index}")).chain(["cpu".to_owned()]).collect();
        let library = "/x/libtorch_cpu.so".into();
        Torch { version: "2.11.0".into(), library, devices, pci: vec![], arithmetic: "reproducible".into() }
    }

    #[test]
    fn gpus_that_are_not_there_are_named() {
        let gpus = ["0", "GPU-8f2c", "7"].map(str::to_owned);
        assert!(matches!(check_gpus(&gpus, &torch(3)), Finding::Good(_)));
        for (found, missing) in gpus.iter().enumerate() {
            let Finding::Problem(text) = check_gpus(&gpus, &torch(found)) else { panic!("{found} of 3") };
            assert!(text.starts_with("--gpus 0,GPU-8f2c,7: torch 2.11.0 at /x/"), "{text}");
            assert!(text.contains(&format!("finds no GPU {missing} here")), "{text}");
        }
    }

    fn finding(device: DeviceChoice, learners: u32, cuda: usize) -> Finding {
        let torch = torch(cuda);
        let mut config = Config::resolve("demo", None).unwrap();
        (config.learner.device, config.learner.count) = (device, learners);
        check(&config, &torch)
    }

    #[test]
    fn every_learner_has_a_device_of_its_own() {
        use DeviceChoice::{Auto, Cpu, Cuda};
        let good = [
            ((Auto, 1, 0), "1 on cpu"),
            ((Auto, 3, 0), "3 on cpu"),
            ((Cpu, 3, 1), "3 on cpu"),
            ((Auto, 1, 2), "1 on cuda:0"),
            ((Auto, 2, 2), "2 on cuda:0 to cuda:1"),
            ((Cuda, 2, 3), "2 on cuda:0 to cuda:1"),
        ];
        for ((device, learners, cuda), text) in good {
            assert_eq!(
                finding(device, learners, cuda),
                Finding::Good(text.to_owned()),
                "{device:?} with {cuda} devices"
            );
        }
        let Finding::Problem(text) = finding(Cuda, 1, 0) else { panic!("there is none") };
        assert!(text.starts_with("learner.device = \"cuda\", but torch 2.11.0 at /x/"), "{text}");
        for device in [Auto, Cuda] {
            let Finding::Problem(text) = finding(device, 3, 2) else { panic!("two are too few") };
            for part in
                ["3 learners", "finds 2 here", "cuda:0, cuda:1, cpu", "--learners 2", "learner.device = \"cpu\""]
            {
                assert!(text.contains(part), "{part}: {text}");
            }
        }
    }
}
