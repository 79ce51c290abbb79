//! Which host of how many this is, from flags and the variables of whatever started it. Pure.
//!
//! Flags win over torchrun's variables, and those over Slurm's: torchrun may itself run in a Slurm job.

use std::fmt::{Display, Formatter};

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Flags {
    pub hosts: Option<u32>,
    pub host_rank: Option<u32>,
    pub rendezvous: Option<String>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Launcher {
    Flags,
    /// torchrun, or what sets its variables (Kubernetes' trainers).
    Torchrun,
    Slurm,
}

impl Display for Launcher {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Flags => "the command line",
            Self::Torchrun => "torchrun's variables",
            Self::Slurm => "Slurm's variables",
        })
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Membership {
    pub hosts: u32,
    pub host: u32,
    /// Name or address of host 0 and the port at which the others find it; empty where there is one host.
    pub rendezvous: String,
    pub by: Launcher,
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MembershipError {
    #[error("the variable {variable} is `{value}`, which is no {wanted}")]
    Variable { variable: &'static str, value: String, wanted: &'static str },
    #[error(
        "{variable} is {value}: a host has one orchestrator, which starts all learners and actors there ({}, or `--hosts 1` \
         for a run of its own)", .instead
    )]
    Crowded { variable: &'static str, value: u32, instead: &'static str },
    #[error("{missing} is missing: with several hosts each needs --hosts N, --host-rank K and --rendezvous HOST:PORT")]
    Missing { missing: &'static str },
    #[error("host {host} of {hosts} hosts does not exist ({by}): hosts count from 0")]
    Beyond { host: u32, hosts: u32, by: Launcher },
    #[error("`{0}` is no rendezvous: it is HOST:PORT, the name or address of host 0 and a free port there")]
    Rendezvous(String),
    #[error(
        "this Slurm job has {nodes} nodes, but srun did not start this program on them: use `srun orchestrator up ...`, \
         or `--hosts 1` for a run on this node alone"
    )]
    NotStarted { nodes: u32 },
}

type Variables<'a> = &'a dyn Fn(&str) -> Option<String>;

/// Which host this is; none where nobody says anything: then it is the only one, and nobody restarts it.
pub fn membership(flags: &Flags, variables: Variables<'_>) -> Result<Option<Membership>, MembershipError> {
    if flags.hosts == Some(1) {
        let by = Launcher::Flags;
        return checked(Membership { hosts: 1, host: flags.host_rank.unwrap_or(0), rendezvous: String::new(), by })
            .map(|alone| (flags.host_rank.is_some()).then_some(alone));
    }
    let launched = match torchrun(variables)? {
        Some(found) => Some(found),
        None if flags.hosts.is_some() && flags.host_rank.is_some() => None,
        None => slurm(variables)?,
    };
    let missing = |missing| MembershipError::Missing { missing };
    let found = match launched {
        None if *flags == Flags::default() => return Ok(None),
        None => Membership {
            hosts: flags.hosts.ok_or(missing("--hosts"))?,
            host: flags.host_rank.ok_or(missing("--host-rank"))?,
            rendezvous: flags.rendezvous.clone().ok_or(missing("--rendezvous"))?,
            by: Launcher::Flags,
        },
        Some(found) => Membership {
            hosts: flags.hosts.unwrap_or(found.hosts),
            host: flags.host_rank.unwrap_or(found.host),
            rendezvous: flags.rendezvous.clone().unwrap_or(found.rendezvous),
            by: found.by,
        },
    };
    checked(found).map(Some)
}

fn checked(found: Membership) -> Result<Membership, MembershipError> {
    let Membership { hosts, host, by, .. } = found;
    if host >= hosts {
        return Err(MembershipError::Beyond { host, hosts, by });
    }
    if hosts > 1 {
        let port = found.rendezvous.rsplit_once(':').filter(|(name, _)| !name.is_empty());
        if port.and_then(|(_, port)| port.parse::<u16>().ok()).is_none_or(|port| port == 0) {
            return Err(MembershipError::Rendezvous(found.rendezvous));
        }
    }
    Ok(found)
}

/// By torchrun's contract. Its own store may listen at `MASTER_PORT`, so the hosts meet one port above.
fn torchrun(variables: Variables<'_>) -> Result<Option<Membership>, MembershipError> {
    let group = (number(variables, "GROUP_RANK")?, number(variables, "GROUP_WORLD_SIZE")?);
    let world = (number(variables, "RANK")?, number(variables, "WORLD_SIZE")?);
    let crowded = |variable, value| MembershipError::Crowded { variable, value, instead: "--nproc-per-node=1" };
    match (number(variables, "LOCAL_RANK")?, number(variables, "LOCAL_WORLD_SIZE")?) {
        (Some(rank), _) if rank > 0 && world.0.is_some() => return Err(crowded("LOCAL_RANK", rank)),
        (_, Some(size)) if size > 1 && world.0.is_some() => return Err(crowded("LOCAL_WORLD_SIZE", size)),
        _ => {}
    }
    if let ((_, Some(groups)), (_, Some(size))) = (group, world)
        && groups != size
    {
        return Err(crowded("WORLD_SIZE", size));
    }
    let (Some(host), Some(hosts)) = (group.0.or(world.0), group.1.or(world.1)) else { return Ok(None) };
    let master = (variables("MASTER_ADDR"), number(variables, "MASTER_PORT")?);
    let rendezvous = match master {
        (Some(address), Some(port)) => format!("{address}:{}", port.saturating_add(1)),
        _ if hosts == 1 => String::new(),
        (None, _) => return Err(MembershipError::Missing { missing: "MASTER_ADDR" }),
        (_, None) => return Err(MembershipError::Missing { missing: "MASTER_PORT" }),
    };
    Ok(Some(Membership { hosts, host, rendezvous, by: Launcher::Torchrun }))
}

/// By srun's variables: the first node of the step is host 0. Slurm gives no port, so it is made from the job's number.
fn slurm(variables: Variables<'_>) -> Result<Option<Membership>, MembershipError> {
    let Some(nodes) = number(variables, "SLURM_NNODES")? else { return Ok(None) };
    let Some(list) = variables("SLURM_STEP_NODELIST") else {
        return if nodes > 1 { Err(MembershipError::NotStarted { nodes }) } else { Ok(None) };
    };
    let hosts = number(variables, "SLURM_STEP_NUM_NODES")?.unwrap_or(nodes);
    let host = number(variables, "SLURM_NODEID")?.ok_or(MembershipError::Missing { missing: "SLURM_NODEID" })?;
    if let Some(value) = number(variables, "SLURM_LOCALID")?.filter(|&task| task > 0) {
        let instead = "`srun --ntasks-per-node=1`";
        return Err(MembershipError::Crowded { variable: "SLURM_LOCALID", value, instead });
    }
    let job = number(variables, "SLURM_JOB_ID")?.unwrap_or(0);
    let rendezvous = format!("{}:{}", first_node(&list), SLURM_PORTS.0 + job % SLURM_PORTS.1);
    Ok(Some(Membership { hosts, host, rendezvous, by: Launcher::Slurm }))
}

/// First of the ports that jobs use, and how many there are: below those that the kernel gives to connections.
const SLURM_PORTS: (u32, u32) = (23_000, 8_000);

fn number(variables: Variables<'_>, variable: &'static str) -> Result<Option<u32>, MembershipError> {
    let wrong = |value| MembershipError::Variable { variable, value, wanted: "number" };
    variables(variable).map(|value| value.trim().parse().map_err(|_| wrong(value))).transpose()
}

/// The first name of Slurm's list: of `n[001-004,7],m3` it is `n001`.
fn first_node(list: &str) -> String {
    let mut name = String::new();
    let mut rest = list;
    while let Some(at) = rest.find([',', '[']) {
        name.push_str(&rest[..at]);
        if rest[at..].starts_with(',') {
            return name;
        }
        let inside = &rest[at + 1..];
        let end = inside.find(']').unwrap_or(inside.len());
        name.push_str(inside[..end].split([',', '-']).next().unwrap_or_default());
        rest = inside.get(end + 1..).unwrap_or_default();
    }
    name + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(flags: &Flags, set: &[(&str, &str)]) -> Result<Option<Membership>, MembershipError> {
        let variables = |name: &str| set.iter().find(|(key, _)| *key == name).map(|(_, value)| (*value).to_owned());
        membership(flags, &variables)
    }

    fn flags(hosts: Option<u32>, host_rank: Option<u32>, rendezvous: Option<&str>) -> Flags {
        Flags { hosts, host_rank, rendezvous: rendezvous.map(str::to_owned) }
    }

    const TORCHRUN: [(&str, &str); 7] = [
        ("RANK", "1"),
        ("WORLD_SIZE", "2"),
        ("LOCAL_RANK", "0"),
        ("GROUP_RANK", "1"),
        ("GROUP_WORLD_SIZE", "2"),
        ("MASTER_ADDR", "10.0.0.1"),
        ("MASTER_PORT", "29500"),
    ];
    const SLURM: [(&str, &str); 6] = [
        ("SLURM_JOB_ID", "8017"),
        ("SLURM_NNODES", "4"),
        ("SLURM_NODEID", "2"),
        ("SLURM_LOCALID", "0"),
        ("SLURM_JOB_NODELIST", "n[01-04]"),
        ("SLURM_STEP_NODELIST", "n[01-04]"),
    ];

    fn member(hosts: u32, host: u32, rendezvous: &str, by: Launcher) -> Membership {
        Membership { hosts, host, rendezvous: rendezvous.into(), by }
    }

    #[test]
    fn every_launcher_says_which_host_it_is_and_flags_win() {
        let nothing = Flags::default();
        assert_eq!(found(&nothing, &[]), Ok(None));
        let all = flags(Some(4), Some(2), Some("first:7000"));
        assert_eq!(found(&all, &[]), Ok(Some(member(4, 2, "first:7000", Launcher::Flags))));
        assert_eq!(found(&nothing, &TORCHRUN), Ok(Some(member(2, 1, "10.0.0.1:29501", Launcher::Torchrun))));
        // Without groups, as Kubernetes' trainers set them.
        let plain = [TORCHRUN[0], TORCHRUN[1], TORCHRUN[5], TORCHRUN[6]];
        assert_eq!(found(&nothing, &plain), Ok(Some(member(2, 1, "10.0.0.1:29501", Launcher::Torchrun))));
        assert_eq!(found(&nothing, &SLURM), Ok(Some(member(4, 2, "n01:23017", Launcher::Slurm))));
        let both: Vec<_> = SLURM.into_iter().chain(TORCHRUN).collect();
        assert_eq!(found(&nothing, &both), Ok(Some(member(2, 1, "10.0.0.1:29501", Launcher::Torchrun))));
        let port = flags(None, None, Some("n01:9000"));
        assert_eq!(found(&port, &SLURM), Ok(Some(member(4, 2, "n01:9000", Launcher::Slurm))));
        assert_eq!(
            found(&flags(Some(3), Some(0), Some("a:1")), &TORCHRUN),
            Ok(Some(member(3, 0, "a:1", Launcher::Torchrun)))
        );
        // One node is one host, which its launcher restarts; outside of it nobody does.
        let one = [("RANK", "0"), ("WORLD_SIZE", "1")];
        assert_eq!(found(&nothing, &one), Ok(Some(member(1, 0, "", Launcher::Torchrun))));
        assert_eq!(found(&flags(Some(1), None, None), &TORCHRUN), Ok(None));
        assert_eq!(found(&nothing, &[("SLURM_NNODES", "1")]), Ok(None));
    }

    #[test]
    fn contradictions_are_one_error_that_says_what_to_do() {
        let with = |changed: &[(&'static str, &'static str)], of: &[(&'static str, &'static str)]| {
            let kept = of.iter().filter(|(key, _)| changed.iter().all(|(other, _)| other != key));
            let set: Vec<_> = kept.chain(changed).copied().collect();
            found(&Flags::default(), &set).unwrap_err().to_string()
        };
        let cases = [
            (with(&[("LOCAL_RANK", "1")], &TORCHRUN), "LOCAL_RANK is 1: a host has one orchestrator"),
            (with(&[("WORLD_SIZE", "4")], &TORCHRUN), "--nproc-per-node=1"),
            (with(&[("GROUP_RANK", "5")], &TORCHRUN), "host 5 of 2 hosts does not exist (torchrun's variables)"),
            (with(&[("MASTER_PORT", "x")], &TORCHRUN), "the variable MASTER_PORT is `x`, which is no number"),
            (with(&[("SLURM_LOCALID", "3")], &SLURM), "--ntasks-per-node=1"),
            (with(&[], &SLURM[..5]), "4 nodes, but srun did not start"),
            (with(&[], &TORCHRUN[..5]), "MASTER_ADDR is missing"),
        ];
        for (message, part) in cases {
            assert!(message.contains(part), "{part}: {message}");
        }
        let refused = |flags: Flags| found(&flags, &[]).unwrap_err().to_string();
        assert!(refused(flags(Some(2), None, Some("a:1"))).starts_with("--host-rank is missing"));
        assert!(refused(flags(None, Some(1), None)).starts_with("--hosts is missing"));
        assert!(refused(flags(Some(2), Some(1), None)).starts_with("--rendezvous is missing"));
        for rendezvous in ["first", "first:", ":80", "first:0", "first:70000"] {
            let message = refused(flags(Some(2), Some(1), Some(rendezvous)));
            assert!(message.contains("is no rendezvous"), "{rendezvous}: {message}");
        }
    }

    #[test]
    fn the_first_node_of_a_list() {
        for (list, first) in [
            ("n1", "n1"),
            ("n1,n2", "n1"),
            ("n[3-9]", "n3"),
            ("n[001-004,7],m3", "n001"),
            ("rack[2-3]n[07-08]-ib", "rack2n07-ib"),
            ("n[1", "n1"),
            ("", ""),
        ] {
            assert_eq!(first_node(list), first, "{list}");
        }
    }
}
