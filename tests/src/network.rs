//! Hosts as network namespaces of this machine, each with a cable to a switch. A cable can be cut and mended; a switch can
//! delay and lose packets. Nobody needs to be root where users may make namespaces of their own.

use crate::{is_held, tell, wait_until};
use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

/// The switch for kernels without netem: it carries the frames itself.
const SLOW_SWITCH: &str = include_str!("slow_switch.py");

/// How a network carries packets.
#[derive(Debug, Clone, Copy)]
pub struct Quality {
    /// From one host to another, ms.
    pub delay_ms: f64,
    /// More or less than that, ms.
    pub jitter_ms: f64,
    /// Share of packets that do not arrive, percent.
    pub loss_percent: f64,
}

/// A namespace, there as long as the process in it, and this is.
#[derive(Debug)]
struct Namespace(Child);

impl Drop for Namespace {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Some hosts and the switch between them; gone when dropped. Host k has the address 10.77.0.(k + 1).
#[derive(Debug)]
pub struct Network {
    hosts: Vec<Namespace>,
    /// What carries the frames, where the kernel does not.
    carrier: Option<Namespace>,
    middle: Namespace,
}

impl Network {
    /// So many hosts. None where this user or this container may not make them; then it says so.
    pub fn new(hosts: u32, quality: Option<Quality>) -> Option<Self> {
        Self::make(hosts, quality)
            .inspect_err(|reason| tell(&format!("skipped: no network of namespaces here: {reason}")))
            .ok()
    }

    fn make(count: u32, quality: Option<Quality>) -> Result<Self, String> {
        let middle = held(Command::new("unshare").args(["--user", "--map-root-user", "--net"]))?;
        let hosts = (0..count).map(|_| held(inside(&middle).args(["unshare", "--net"]))).collect::<Result<_, _>>()?;
        let mut network = Self { hosts, carrier: None, middle };
        match quality.map(|quality| (quality, network.try_netem(quality))) {
            Some((quality, Err(reason))) => {
                tell(&format!("netem: not in this kernel ({reason}): a program delays and loses the packets"));
                network.connect_by_program(quality)?;
            }
            _ => network.connect_by_cables(quality)?,
        }
        for (host, namespace) in network.hosts.iter().enumerate() {
            ip(namespace, &["addr", "add", &format!("{}/24", Self::address(host)), "dev", "eth0"])?;
            ip(namespace, &["link", "set", "eth0", "up"])?;
            ip(namespace, &["link", "set", "lo", "up"])?;
        }
        Ok(network)
    }

    fn connect_by_cables(&self, quality: Option<Quality>) -> Result<(), String> {
        ip(&self.middle, &["link", "add", "bridge", "type", "bridge"])?;
        ip(&self.middle, &["link", "set", "bridge", "up"])?;
        for (host, namespace) in self.hosts.iter().enumerate() {
            let (port, pid) = (port(host), namespace.0.id().to_string());
            ip(&self.middle, &["link", "add", &port, "type", "veth", "peer", "name", "eth0", "netns", &pid])?;
            ip(&self.middle, &["link", "set", &port, "master", "bridge", "up"])?;
            if let Some(quality) = quality {
                run(inside(&self.middle).args(netem(&port, quality)))?;
            }
        }
        Ok(())
    }

    /// Each host gets one end of a tunnel of which a program has the other.
    fn connect_by_program(&mut self, quality: Quality) -> Result<(), String> {
        let Quality { delay_ms, jitter_ms, loss_percent } = quality;
        let mut command = inside(&self.middle);
        command.args(["python3", "-c", SLOW_SWITCH]).args([delay_ms, jitter_ms, loss_percent].map(|it| it.to_string()));
        command
            .args((0..self.hosts.len()).map(port))
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let mut carrier = Namespace(command.spawn().map_err(|error| format!("python3: {error}"))?);
        let mut word = String::new();
        if let Some(output) = carrier.0.stdout.take() {
            let _ = BufReader::new(output).read_line(&mut word);
        }
        if word.trim() != "ready" {
            return Err("neither netem nor a program in its place can slow a network down".to_owned());
        }
        for (host, namespace) in self.hosts.iter().enumerate() {
            let pid = namespace.0.id().to_string();
            ip(&self.middle, &["link", "set", &port(host), "netns", &pid, "name", "eth0"])?;
        }
        self.carrier = Some(carrier);
        Ok(())
    }

    /// Has this kernel delay and lose packets, and stop that again; its reason where it cannot.
    fn try_netem(&self, quality: Quality) -> Result<(), String> {
        run(inside(&self.middle).args(netem("lo", quality)))?;
        run(inside(&self.middle).args(["tc", "qdisc", "del", "dev", "lo", "root"]))
    }

    pub fn address(host: usize) -> String {
        format!("10.77.0.{}", host + 1)
    }

    /// A program on a host: `ARGUMENTS` are to follow.
    pub fn on(&self, host: usize) -> Command {
        inside(&self.hosts[host])
    }

    /// Unplugs a host's cable: nothing arrives any more, and nobody is told.
    pub fn cut(&self, host: usize) {
        ip(&self.middle, &["link", "set", &port(host), "down"]).expect("ip works");
    }

    /// Plugs it in again.
    pub fn mend(&self, host: usize) {
        ip(&self.middle, &["link", "set", &port(host), "up"]).expect("ip works");
    }

    /// The processes of a host whose command line holds `word`.
    pub fn processes(&self, host: usize, word: &str) -> Vec<u32> {
        let holder = self.hosts[host].0.id();
        let here = std::fs::read_link(format!("/proc/{holder}/ns/net")).expect("the host's namespace is there");
        let pids = std::fs::read_dir("/proc").into_iter().flatten().flatten();
        let pids = pids.filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
        let is_wanted = |pid: &u32| {
            let line = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
            let line = String::from_utf8_lossy(&line).replace('\0', " ");
            std::fs::read_link(format!("/proc/{pid}/ns/net")).is_ok_and(|net| net == here) && line.contains(word)
        };
        pids.filter(|&pid| pid != holder).filter(is_wanted).collect()
    }

    /// Waits until a process of this host is held at a fault point (`STILLROOM_FAULT=hold=POINT`).
    pub fn wait_until_held(&self, host: usize, word: &str) {
        wait_until(&format!("a process `{word}` of host {host} is held"), || {
            self.processes(host, word).into_iter().any(is_held)
        });
    }
}

fn port(host: usize) -> String {
    format!("port{host}")
}

fn netem(device: &str, Quality { delay_ms, jitter_ms, loss_percent }: Quality) -> Vec<String> {
    let words = format!(
        "tc qdisc add dev {device} root netem delay {delay_ms}ms {jitter_ms}ms loss {loss_percent}% limit 100000"
    );
    words.split(' ').map(str::to_owned).collect()
}

fn held(command: &mut Command) -> Result<Namespace, String> {
    // An hour: longer than any test, should nobody end it.
    command.args(["sleep", "3600"]).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    let mut namespace = Namespace(command.spawn().map_err(|error| format!("{command:?}: {error}"))?);
    let comm = PathBuf::from(format!("/proc/{}/comm", namespace.0.id()));
    let mut ended = None;
    wait_until("a namespace is made", || {
        ended = namespace.0.try_wait().ok().flatten();
        ended.is_some() || std::fs::read_to_string(&comm).is_ok_and(|name| name.trim() == "sleep")
    });
    if ended.is_none() {
        return Ok(namespace);
    }
    let mut words = String::new();
    if let Some(errors) = namespace.0.stderr.take() {
        let _ = BufReader::new(errors).read_line(&mut words);
    }
    Err(words.trim().to_owned())
}

/// A program in a namespace: `ARGUMENTS` are to follow.
fn inside(Namespace(holder): &Namespace) -> Command {
    let mut command = Command::new("nsenter");
    command.args(["--target", &holder.id().to_string(), "--user", "--net", "--preserve-credentials", "--"]);
    command
}

fn ip(namespace: &Namespace, arguments: &[&str]) -> Result<(), String> {
    run(inside(namespace).arg("ip").args(arguments))
}

fn run(command: &mut Command) -> Result<(), String> {
    let output = command.stdin(Stdio::null()).output().map_err(|error| format!("{command:?}: {error}"))?;
    if output.status.success() { Ok(()) } else { Err(String::from_utf8_lossy(&output.stderr).trim().to_owned()) }
}
