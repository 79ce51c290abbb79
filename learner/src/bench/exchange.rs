//! `learner exchange`: how long learners take to sum a gradient, on one machine or over a network, by the code of training.

use super::time::{percentile, synchronise};
use crate::device;
use crate::peers::{Meeting, Peers};
use anyhow::{Context, Result, bail, ensure};
use proto::config::{Config, DeviceChoice};
use proto::device::{VISIBLE_DEVICES, device_name};
use serde_json::{Value, json};
use std::io::Write;
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::os::fd::IntoRawFd;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Instant;
use tch::{Cuda, Device, Kind, Tensor};

const WARM_UP: u32 = 3;

/// What `learner exchange` is asked.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
A sum is measured from the moment at which all learners are there until this one has it. An update makes one for each
epoch, of all weights. Pieces are summed one after the other: so they show what dividing a gradient costs, which
summing while the backward pass still runs would have to win back.

Examples:
  learner exchange                                     two learners on this machine, on its GPUs if it has two
  learner exchange --device cpu --learners 4 --pieces 1,25
On each of two machines, with --rank 0 on the first, whose address is 10.0.0.1:
  learner exchange --rank 0 --meet 10.0.0.1:29500 --address 10.0.0.1
  learner exchange --rank 1 --meet 10.0.0.1:29500 --address 10.0.0.2")]
pub struct Arguments {
    /// Learners; this program starts all of them, unless --rank is given
    #[arg(long, value_name = "R", default_value_t = 2, value_parser = clap::value_parser!(u32).range(2..=512))]
    learners: u32,
    /// Where they compute: cpu (Gloo), cuda (NCCL, a GPU for each) or auto
    #[arg(long, value_name = "D", default_value = "auto", value_parser = device::parse_choice)]
    device: DeviceChoice,
    /// Numbers in a gradient, of 32 bits [default: the weights of the full network]
    #[arg(long, value_name = "W", default_value_t = 5_800_000, value_parser = clap::value_parser!(u32).range(1..))]
    weights: u32,
    /// Pieces in which it is summed, with commas between
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_value = "1,4,16",
        value_parser = clap::value_parser!(u32).range(1..=4096))]
    pieces: Vec<u32>,
    /// Sums that are measured
    #[arg(long, value_name = "N", default_value_t = 50, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    sums: u32,
    /// This learner's rank, where each is started by hand
    #[arg(long, value_name = "K", requires_all = ["meet", "address"])]
    rank: Option<u32>,
    /// Where they meet: an address of the first one's machine, and a free port there
    #[arg(long, value_name = "ADDRESS:PORT", requires = "rank")]
    meet: Option<SocketAddr>,
    /// This machine's own address, on which Gloo listens
    #[arg(long, value_name = "ADDRESS", requires = "rank")]
    address: Option<IpAddr>,
    /// Where those meet that one program has started
    #[arg(long, hide = true, conflicts_with = "rank")]
    file: Option<PathBuf>,
    /// Rank of one that was started so
    #[arg(long, hide = true, requires = "file")]
    started: Option<u32>,
    /// Print JSON in place of the table
    #[arg(long)]
    json: bool,
}

/// A folder that is removed with what is in it, and learners that end with it.
struct Started {
    folder: PathBuf,
    learners: Vec<Child>,
}

impl Drop for Started {
    fn drop(&mut self) {
        for learner in &mut self.learners {
            let _ = learner.kill();
            let _ = learner.wait();
        }
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// Sums of a gradient in so many pieces.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Sums {
    pieces: u32,
    p50_s: f64,
    p99_s: f64,
}

/// Measures and prints; of several learners the first one prints.
pub fn run(arguments: &Arguments, output: impl Write) -> Result<()> {
    match (arguments, arguments.started) {
        (Arguments { file: Some(file), .. }, Some(rank)) => {
            member(arguments, rank, &Meeting::File(file.clone()), output)
        }
        (&Arguments { rank: Some(rank), meet: Some(store), address: Some(own), learners, .. }, _) => {
            ensure!(rank < learners, "--rank {rank}: {learners} learners have ranks 0 to {}", learners - 1);
            let bind = || TcpListener::bind(store).with_context(|| format!("cannot listen at {store}"));
            // The store takes the descriptor over.
            let listener = (rank == 0).then(bind).transpose()?.map(IntoRawFd::into_raw_fd);
            member(arguments, rank, &Meeting::Network { store, listener, own, key: "exchange".to_owned() }, output)
        }
        _ => start_all(arguments),
    }
}

/// Starts all learners on this machine and waits for them.
fn start_all(arguments: &Arguments) -> Result<()> {
    let folder = std::env::temp_dir().join(format!("stillroom-exchange-{}", std::process::id()));
    std::fs::create_dir(&folder).with_context(|| folder.display().to_string())?;
    let mut started = Started { folder, learners: vec![] };
    let gpus = match arguments.device {
        DeviceChoice::Cpu => 0,
        DeviceChoice::Cuda | DeviceChoice::Auto => Cuda::device_count(),
    };
    let on_gpus = gpus >= i64::from(arguments.learners);
    if arguments.device == DeviceChoice::Cuda && !on_gpus {
        bail!("{} learners need a GPU each, and there are {gpus}: --device cpu", arguments.learners);
    }
    for rank in 0..arguments.learners {
        started.learners.push(start(arguments, rank, &started.folder, on_gpus)?);
    }
    // Whoever loses another one fails, too.
    let failed =
        started.learners.iter_mut().map(|learner| Ok(!learner.wait()?.success())).collect::<Result<Vec<_>>>()?;
    let failed = failed.into_iter().filter(|failed| *failed).count();
    ensure!(failed == 0, "{failed} of {} learners failed; what they say stands above", arguments.learners);
    Ok(())
}

fn start(arguments: &Arguments, rank: u32, folder: &Path, on_gpu: bool) -> Result<Child> {
    let Arguments { learners, weights, sums, .. } = arguments;
    let pieces: Vec<String> = arguments.pieces.iter().map(u32::to_string).collect();
    let mut command = Command::new(std::env::current_exe()?);
    command.args(["exchange", "--started", &rank.to_string(), "--learners", &learners.to_string()]);
    command.args(["--weights", &weights.to_string(), "--sums", &sums.to_string(), "--pieces", &pieces.join(",")]);
    command.args(["--device", if on_gpu { "cuda" } else { "cpu" }]).arg("--file").arg(folder.join("meeting"));
    if arguments.json {
        command.arg("--json");
    }
    if on_gpu {
        let visible = std::env::var(VISIBLE_DEVICES).ok();
        command.env(VISIBLE_DEVICES, device_name(rank as usize, visible.as_deref()));
    }
    if rank > 0 {
        command.stdout(Stdio::null());
    }
    command.stdin(Stdio::null()).spawn().context("cannot start a learner")
}

fn member(arguments: &Arguments, rank: u32, meeting: &Meeting, mut output: impl Write) -> Result<()> {
    let mut config = Config::default().learner;
    config.device = arguments.device;
    let device = device::choose(&config)?;
    let peers = Peers::join(meeting, [rank, arguments.learners], device)?;
    let gradient = Tensor::zeros([i64::from(arguments.weights)], (Kind::Float, device));
    let measure = |&pieces: &u32| measure(&peers, &gradient, device, [pieces, arguments.sums]);
    let measured = arguments.pieces.iter().map(measure).collect::<Result<Vec<_>>>()?;
    // Nobody leaves while another one still sums.
    peers.barrier()?;
    if rank > 0 {
        return Ok(());
    }
    let place = if device.is_cuda() { "GPUs, NCCL" } else { "CPUs, Gloo" };
    let text = if arguments.json {
        format!("{:#}", as_json(arguments, place, &measured))
    } else {
        table(arguments, place, &measured)
    };
    writeln!(output, "{text}")?;
    Ok(())
}

fn measure(peers: &Peers, gradient: &Tensor, device: Device, [pieces, sums]: [u32; 2]) -> Result<Sums> {
    let mut parts = gradient.chunk(i64::from(pieces), 0);
    let mut times = vec![];
    for sum in 0..WARM_UP + sums {
        synchronise(device);
        peers.barrier()?;
        let began = Instant::now();
        for part in &mut parts {
            peers.sum_gradients(part)?;
        }
        synchronise(device);
        peers.count_anew();
        if sum >= WARM_UP {
            times.push(began.elapsed().as_secs_f64());
        }
    }
    times.sort_by(f64::total_cmp);
    Ok(Sums { pieces, p50_s: percentile(&times, 0.5), p99_s: percentile(&times, 0.99) })
}

/// Bytes that a ring sends from each learner, a second.
fn bus_bytes_per_s(arguments: &Arguments, p50_s: f64) -> f64 {
    let learners = f64::from(arguments.learners);
    2.0 * (learners - 1.0) / learners * bytes(arguments) as f64 / p50_s
}

fn bytes(arguments: &Arguments) -> u64 {
    u64::from(arguments.weights) * size_of::<f32>() as u64
}

fn table(arguments: &Arguments, place: &str, measured: &[Sums]) -> String {
    let size = bytes(arguments) as f64 / 1e6;
    let mut lines = vec![format!("a gradient of {size:.1} MB, {} learners on {place}", arguments.learners)];
    lines.push(format!("{:<8} {:>9} {:>9} {:>8}", "pieces", "p50 ms", "p99 ms", "GB/s *"));
    for Sums { pieces, p50_s, p99_s } in measured {
        let rate = bus_bytes_per_s(arguments, *p50_s) / 1e9;
        lines.push(format!("{pieces:<8} {:>9.3} {:>9.3} {rate:>8.2}", 1e3 * p50_s, 1e3 * p99_s));
    }
    lines.push("* what a ring sends from each learner, 2 (R - 1) / R times the gradient, in p50".to_owned());
    lines.join("\n")
}

fn as_json(arguments: &Arguments, place: &str, measured: &[Sums]) -> Value {
    let row = |&Sums { pieces, p50_s, p99_s }: &Sums| {
        let rate = bus_bytes_per_s(arguments, p50_s);
        json!({ "pieces": pieces, "p50_s": p50_s, "p99_s": p99_s, "bus_bytes_per_s": rate })
    };
    json!({
        "learners": arguments.learners,
        "on": place,
        "bytes": bytes(arguments),
        "sums": measured.iter().map(row).collect::<Vec<_>>(),
    })
}
