use super::programs::Tools;
use super::{Finding, descriptors, device, disk, memory, placement, processor, services, shared_memory, temporary};
use anyhow::Result;
use proto::config::Config;
use proto::device::Torch;
use proto::run_folder::RunFolder;
use std::path::Path;

const FIT: &str = " is the most that fits";

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
    agree(&mut found);
    found
}

/// Where several say how many actors fit, all say the number that fits everywhere.
fn agree(found: &mut [(&str, Finding)]) {
    let number = |text: &str| -> Option<u32> { text.split_once(FIT)?.0.rsplit(' ').next()?.parse().ok() };
    let said = found.iter().filter_map(|(_, finding)| match finding {
        Finding::Problem(text) => number(text),
        Finding::Good(_) | Finding::Warning(_) => None,
    });
    let Some(least) = said.min() else { return };
    for (_, finding) in found {
        if let Finding::Problem(text) = finding
            && let Some(most) = number(text)
        {
            *text = text.replace(&format!(" {most}{FIT}"), &format!(" {least}{FIT}"));
        }
    }
}

pub fn demand_all(config: &Config, folder: &RunFolder, tools: &Tools) -> Result<()> {
    check_all(config, folder.root(), Some(&tools.torch)).into_iter().try_for_each(|(_, finding)| finding.demand())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_number_of_actors_fits_everywhere() {
        let problem = |number: u32| Finding::Problem(format!("too little. --actors {number}{FIT} as it is"));
        let other = || Finding::Problem("no disk".to_owned());
        let mut found = [("memory", problem(10)), ("disk", other()), ("shared memory", problem(109))];
        agree(&mut found);
        assert_eq!(found, [("memory", problem(10)), ("disk", other()), ("shared memory", problem(10))]);
    }
}
