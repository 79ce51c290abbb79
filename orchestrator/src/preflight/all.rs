//! Every check of one configuration, for a run that is to begin.

use super::tools::Tools;
use super::{cores, descriptors, device, disk, memory, processor, shared_memory, temporary};
use anyhow::{Context, Result};
use proto::config::Config;
use proto::run_folder::RunFolder;

/// Looks at everything that could keep this configuration from running here.
pub fn demand_all(config: &Config, folder: &RunFolder, tools: &Tools) -> Result<()> {
    processor::check().demand()?;
    device::check(config, &tools.torch).demand()?;
    cores::check(config, &tools.torch).demand()?;
    let on_gpu = device::is_cuda(config, &tools.torch);
    memory::check(config, on_gpu, memory::available().context("/proc/meminfo")?).demand()?;
    shared_memory::check(config).demand()?;
    temporary::check_for_run().demand()?;
    descriptors::check(config).demand()?;
    disk::check(config, folder.root()).demand()
}
