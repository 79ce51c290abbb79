use super::programs::Tools;
use super::{Finding, descriptors, device, disk, memory, placement, processor, services, shared_memory, temporary};
use crate::wrong::judged;
use anyhow::Result;
use proto::config::Config;
use proto::device::Torch;
use proto::run_folder::RunFolder;
use std::path::Path;

pub fn check_all(config: &Config, folder: &Path, torch: Option<&Torch>) -> Vec<(&'static str, Finding)> {
    let mut found = vec![("processor", processor::check())];
    if let Some(torch) = torch {
        found.extend([("learners", device::check(config, torch)), ("cores", placement::check(config, torch))]);
    }
    let on_gpu = torch.is_some_and(|torch| device::is_cuda(config, torch));
    let memory = match memory::available() {
        Ok(available) => memory::check(config, on_gpu, available),
        Err(error) => Finding::Warning(format!("/proc/meminfo: {error}")),
    };
    let places = [("temporary", temporary::check_for_run()), ("shared memory", shared_memory::check(config))];
    let sound = places.iter().all(|(_, place)| !matches!(place, Finding::Problem(_)));
    found.push(("memory", memory));
    found.extend(places);
    // What is known to be wrong with these places is said once.
    found.extend(sound.then(|| ("services", services::check())));
    found.extend([("open files", descriptors::check(config)), ("disk", disk::check(config, folder))]);
    found
}

pub fn demand_all(config: &Config, folder: &RunFolder, tools: &Tools) -> Result<()> {
    // What is asked for is not there, and will not be there at the next call.
    judged(device::check(config, &tools.torch).demand())?;
    check_all(config, folder.root(), Some(&tools.torch)).into_iter().try_for_each(|(_, finding)| finding.demand())
}
