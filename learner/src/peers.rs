//! The learners of a run, from the side of one of them: DD-PPO's all-reduce and everything else that they exchange.
//!
//! Every learner trains on the rollouts of its own actors. Losses are sums over its frames divided by the frames of all
//! learners, so gradients add up to those of one learner that had all the actors; all take the same optimiser step with
//! the sum, and their weights stay the same bit for bit. With equal shares this is DD-PPO's mean. Only contrastive
//! prediction (`cpca16`) changes with the number of learners: a learner draws its negative samples from its own rows.
//! With `learner.shards` nothing changes with it ([`crate::shards`]).
//!
//! All learners make the same calls in the same order. When one dies, the calls of the others fail, or block until the
//! orchestrator ends them. A group is never repaired: all learners restart together from the last checkpoint.

pub use crate::ffi::group::Meeting;
use crate::ffi::group::ProcessGroup;
use crate::ffi::nccl::{Communicator, Invitation, Nccl, NcclError};
use std::cell::Cell;
use std::time::{Duration, Instant};
use tch::{Device, Kind, TchError, Tensor};
use wire::fault;

const JOINING: Duration = Duration::from_secs(90);
/// Longest time of a later operation, in which a learner waits for the others' rollout or update. A last resort: the
/// orchestrator ends a run without progress much earlier.
const PATIENCE: Duration = Duration::from_hours(24);
/// The note that holds NCCL's invitation.
const INVITATION: &str = "nccl";

#[derive(Debug)]
pub enum Peers {
    Alone,
    Group(Group),
}

#[derive(Debug)]
pub struct Group {
    rank: u32,
    learners: u32,
    gloo: ProcessGroup,
    /// Between GPUs.
    gpus: Option<Communicator>,
    /// Without the time of sums on GPUs, which the communicator's stopwatch has.
    exchanged: Cell<Exchanged>,
}

/// What sums of gradients took since [`Peers::count_anew`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Exchanged {
    /// From this learner's gradient to the sum; waiting for the slowest learner is in it.
    pub seconds: f64,
    /// Of the gradients that this learner gave.
    pub bytes: u64,
}

/// How far the learners of a run are with the rollout in progress.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Finished {
    /// Learners that have taken all steps of it.
    pub finished: u32,
    /// Learners in all, this one included.
    pub learners: u32,
}

/// The learners cannot reach one another, or are not at the same point.
#[derive(Debug, thiserror::Error)]
pub enum PeerError {
    #[error("learner {rank} has lost the others: {cause}")]
    Lost { rank: u32, cause: TchError },
    #[error("the learners' GPUs cannot reach one another: {0}")]
    Gpus(#[from] NcclError),
    #[error("another learner cannot go on")]
    Elsewhere,
    #[error("the learners have come apart: {what} differ ({values:x?}, by rank)")]
    Apart { what: &'static str, values: Vec<u64> },
}

impl Peers {
    pub fn join(meeting: &Meeting, [rank, learners]: [u32; 2], device: Device) -> Result<Self, PeerError> {
        if learners == 1 {
            return Ok(Self::Alone);
        }
        let lost = |cause| PeerError::Lost { rank, cause };
        let gloo = ProcessGroup::join(meeting, [rank, learners], [JOINING, PATIENCE]).map_err(lost)?;
        let gpus = if device.is_cuda() {
            let nccl = Nccl::open()?;
            let mut invitation: Invitation = [0; 128];
            if rank == 0 {
                gloo.note(INVITATION, &nccl.invite()?).map_err(lost)?;
            }
            gloo.read(INVITATION, &mut invitation).map_err(lost)?;
            Some(nccl.join(invitation, rank, learners)?)
        } else {
            None
        };
        let peers = Self::Group(Group { rank, learners, gloo, gpus, exchanged: Cell::default() });
        // A barrier: no learner leaves before all have joined.
        peers.barrier()?;
        Ok(peers)
    }

    /// Replaces a number by the first learner's.
    pub fn first(&self, number: &mut f64) -> Result<(), PeerError> {
        if matches!(self, Self::Group(group) if group.rank > 0) {
            *number = 0.0;
        }
        self.sum(std::slice::from_mut(number))
    }

    /// The same for a scalar in double on any device. Nobody waits for it unless learners on CPUs do.
    pub(crate) fn first_scalar(&self, number: &mut Tensor) -> Result<(), PeerError> {
        match self {
            Self::Alone => {}
            Self::Group(Group { rank, gpus: Some(gpus), .. }) => {
                if *rank > 0 {
                    *number = number.zeros_like();
                }
                gpus.sum(number)?;
            }
            Self::Group(_) => {
                let mut value = number.double_value(&[]);
                self.first(&mut value)?;
                *number = number.full_like(value);
            }
        }
        Ok(())
    }

    pub fn count(&self) -> u32 {
        match self {
            Self::Alone => 1,
            Self::Group(group) => group.learners,
        }
    }

    /// Replaces numbers by their sums over all learners.
    pub fn sum(&self, numbers: &mut [f64]) -> Result<(), PeerError> {
        let Self::Group(group) = self else { return Ok(()) };
        let mut tensor = Tensor::from_slice(numbers);
        group.gloo.sum(&mut tensor).map_err(|cause| group.lost(cause))?;
        tensor.copy_data(numbers, numbers.len());
        Ok(())
    }

    /// Returns when every learner has called it: an all-reduce ends nowhere before it has begun everywhere.
    pub(crate) fn barrier(&self) -> Result<(), PeerError> {
        self.sum(&mut [0.0])
    }

    pub fn total(&self, own: u64) -> Result<u64, PeerError> {
        Ok(self.totals([own])?[0])
    }

    /// Several counts over all learners, in one exchange.
    pub(crate) fn totals(&self, own: impl IntoIterator<Item = u64>) -> Result<Vec<u64>, PeerError> {
        let mut totals: Vec<f64> = own.into_iter().map(|count| count as f64).collect();
        self.sum(&mut totals)?;
        Ok(totals.into_iter().map(|total| total as u64).collect())
    }

    pub(crate) fn sum_gradients(&self, gradient: &mut Tensor) -> Result<(), PeerError> {
        // One that is held here has the others wait in the middle of their exchange.
        fault::reach("learner.before_exchange");
        match self {
            Self::Alone => Ok(()),
            Self::Group(group) => group.exchange(gradient),
        }
    }

    /// The flat gradients of all learners by rank, \[learners, W\], the same bits on all. Each fills its own row of zeros
    /// and all are added up, which changes no number but -0: that becomes 0.
    pub(crate) fn gather_gradients(&self, own: &Tensor) -> Result<Tensor, PeerError> {
        fault::reach("learner.before_exchange");
        let Self::Group(group) = self else { return Ok(own.unsqueeze(0)) };
        let mut all = Tensor::zeros([i64::from(group.learners), own.size()[0]], (own.kind(), own.device()));
        all.select(0, i64::from(group.rank)).copy_(own);
        group.exchange(&mut all)?;
        Ok(all)
    }

    /// What is counted from now on is another update's.
    pub(crate) fn count_anew(&self) {
        if let Self::Group(group) = self {
            group.exchanged.take();
            if let Some(gpus) = &group.gpus {
                gpus.stopwatch().reset();
            }
        }
    }

    /// What the sums of gradients took; nothing with one learner. Waits for the last of them.
    pub(crate) fn exchanged(&self) -> Result<Exchanged, PeerError> {
        let Self::Group(group) = self else { return Ok(Exchanged::default()) };
        let Exchanged { mut seconds, bytes } = group.exchanged.get();
        if let Some(gpus) = &group.gpus {
            seconds += gpus.stopwatch().total_s().map_err(NcclError::from)?;
        }
        Ok(Exchanged { seconds, bytes })
    }

    /// Tells the others that this learner has taken all steps of a rollout.
    pub(crate) fn note_finished(&self, rollout: u64) -> Result<(), PeerError> {
        let Self::Group(group) = self else { return Ok(()) };
        group.gloo.note(&finished(rollout, group.rank), &[1]).map_err(|cause| group.lost(cause))
    }

    /// How many learners have noted this.
    pub fn finished(&self, rollout: u64) -> Result<Finished, PeerError> {
        let Self::Group(group) = self else { return Ok(Finished { finished: 0, learners: 1 }) };
        let mut count = 0;
        for rank in 0..group.learners {
            let noted = group.gloo.noted(&finished(rollout, rank)).map_err(|cause| group.lost(cause))?;
            count += u32::from(noted);
        }
        Ok(Finished { finished: count, learners: group.learners })
    }

    /// Sends every learner's part to rank 0. Returns the parts of the others there, in the order of their ranks, and
    /// nothing on the other ranks.
    pub fn gather(&self, part: &[u8]) -> Result<Vec<Vec<u8>>, PeerError> {
        let Self::Group(group) = self else { return Ok(vec![]) };
        let lost = |cause| group.lost(cause);
        if group.rank > 0 {
            group.gloo.send(&Tensor::from(part.len() as i64), 0).map_err(lost)?;
            group.gloo.send(&Tensor::from_slice(part), 0).map_err(lost)?;
            return Ok(vec![]);
        }
        let mut parts = vec![];
        for rank in 1..group.learners {
            let mut length = Tensor::from(0_i64);
            group.gloo.receive(&mut length, rank).map_err(lost)?;
            let mut bytes = Tensor::zeros([length.int64_value(&[])], (Kind::Uint8, Device::Cpu));
            group.gloo.receive(&mut bytes, rank).map_err(lost)?;
            parts.push(Vec::try_from(&bytes).map_err(lost)?);
        }
        Ok(parts)
    }

    /// The first learner's bytes, on all. What the others give is not used.
    pub(crate) fn broadcast(&self, own: Vec<u8>) -> Result<Vec<u8>, PeerError> {
        let Self::Group(group) = self else { return Ok(own) };
        let lost = |cause| group.lost(cause);
        let mut length = Tensor::from(own.len() as i64);
        group.gloo.broadcast(&mut length).map_err(lost)?;
        let length = length.int64_value(&[]);
        let mut bytes = if group.rank == 0 {
            Tensor::from_slice(&own)
        } else {
            Tensor::zeros([length], (Kind::Uint8, Device::Cpu))
        };
        if length > 0 {
            group.gloo.broadcast(&mut bytes).map_err(lost)?;
        }
        if group.rank == 0 {
            return Ok(own);
        }
        Vec::try_from(&bytes).map_err(lost)
    }

    pub(crate) fn agree(&self, what: &'static str, value: u64) -> Result<(), PeerError> {
        let Self::Group(group) = self else { return Ok(()) };
        // Each learner fills its own two places: halves of 32 bits are exact in a double.
        let mut halves = vec![0.0; 2 * group.learners as usize];
        let own = 2 * group.rank as usize;
        (halves[own], halves[own + 1]) = ((value >> 32) as f64, (value & 0xffff_ffff) as f64);
        self.sum(&mut halves)?;
        let values: Vec<u64> = halves.chunks_exact(2).map(|pair| (pair[0] as u64) << 32 | pair[1] as u64).collect();
        if values.iter().all(|&other| other == value) { Ok(()) } else { Err(PeerError::Apart { what, values }) }
    }
}

impl Group {
    /// Replaces numbers of gradients by their sums over all learners, and counts what that takes.
    fn exchange(&self, numbers: &mut Tensor) -> Result<(), PeerError> {
        let Exchanged { mut seconds, mut bytes } = self.exchanged.get();
        if let Some(gpus) = &self.gpus {
            gpus.stopwatch().measure(|| gpus.sum(numbers))?;
        } else {
            let began = Instant::now();
            self.gloo.sum(numbers).map_err(|cause| self.lost(cause))?;
            seconds += began.elapsed().as_secs_f64();
        }
        bytes += (numbers.numel() * size_of::<f32>()) as u64;
        self.exchanged.set(Exchanged { seconds, bytes });
        Ok(())
    }

    fn lost(&self, cause: TchError) -> PeerError {
        PeerError::Lost { rank: self.rank, cause }
    }
}

/// The note of one learner about one rollout.
fn finished(rollout: u64, rank: u32) -> String {
    format!("finished/{rollout}/{rank}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::to_vec;
    use std::collections::BTreeSet;
    use std::net::TcpListener;
    use std::os::fd::IntoRawFd;
    use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
    use std::sync::{PoisonError, RwLock};

    /// A test that looks at the sockets of the process is alone in it; groups of the others may live side by side.
    static ONE_GROUP: RwLock<()> = RwLock::new(());

    /// What each of `learners` learners, threads here, makes of it.
    fn among<T: Send>(learners: u32, work: impl Fn(u32, &Peers) -> T + Sync) -> Vec<T> {
        let _beside = ONE_GROUP.read().unwrap_or_else(PoisonError::into_inner);
        together(learners, work)
    }

    fn together<T: Send>(learners: u32, work: impl Fn(u32, &Peers) -> T + Sync) -> Vec<T> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("joining");
        meeting_at(learners, |_| Meeting::File(file.clone()), work)
    }

    fn meeting_at<T: Send>(
        learners: u32,
        meeting: impl Fn(u32) -> Meeting,
        work: impl Fn(u32, &Peers) -> T + Sync,
    ) -> Vec<T> {
        std::thread::scope(|scope| {
            let threads: Vec<_> = (0..learners)
                .map(|rank| {
                    let (meeting, work) = (meeting(rank), &work);
                    scope.spawn(move || work(rank, &Peers::join(&meeting, [rank, learners], Device::Cpu).unwrap()))
                })
                .collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect()
        })
    }

    /// Two at two addresses of this machine, which meet at a socket that listens before they start; and once more, as
    /// after a death. Strangers could fill the store, the log and the first one's table of descriptors.
    #[test]
    fn over_a_network_they_meet_in_the_first_ones_store_which_then_lets_in_nobody() {
        let socket = TcpListener::bind("127.0.0.1:0").unwrap();
        for _ in 0..2 {
            meet_at(&socket);
            assert!(!is_let_in(socket.local_addr().unwrap().port()));
        }
    }

    fn meet_at(socket: &TcpListener) {
        let _beside = ONE_GROUP.read().unwrap_or_else(PoisonError::into_inner);
        let store = socket.local_addr().unwrap();
        // The store takes the first one's descriptor over.
        let listener = socket.try_clone().unwrap().into_raw_fd();
        let meeting = |rank| Meeting::Network {
            store,
            listener: (rank == 0).then_some(listener),
            own: format!("127.0.0.{}", rank + 1).parse().unwrap(),
            key: "a run's".into(),
        };
        let seen = meeting_at(2, meeting, |rank, peers| {
            let mut numbers = [f64::from(rank + 1)];
            peers.sum(&mut numbers).unwrap();
            peers.note_finished(3).unwrap();
            peers.barrier().unwrap();
            assert_eq!(peers.finished(3).unwrap().finished, 2);
            assert!(rank > 0 || !is_let_in(store.port()));
            let nothing = peers.broadcast(vec![]).unwrap();
            (numbers[0], nothing.len(), peers.broadcast(vec![rank as u8 + 7; 3]).unwrap())
        });
        assert_eq!(seen, [(3.0, 0, vec![7; 3]), (3.0, 0, vec![7; 3])]);
    }

    #[test]
    fn three_add_up_gather_and_agree() {
        let seen = among(3, |rank, peers| {
            let mut numbers = [f64::from(rank), 0.1];
            peers.sum(&mut numbers).unwrap();
            let mut gradient = Tensor::from_slice(&[rank as f32, 1e-3]);
            peers.sum_gradients(&mut gradient).unwrap();
            let Exchanged { seconds, bytes } = peers.exchanged().unwrap();
            assert!(seconds > 0.0 && bytes == 8, "two floats: {seconds}, {bytes}");
            peers.count_anew();
            assert_eq!(peers.exchanged().unwrap(), Exchanged::default());
            peers.agree("numbers", 1 << 63 | 5).unwrap();
            let apart = peers.agree("ranks", u64::from(rank)).unwrap_err().to_string();
            assert!(apart.ends_with("ranks differ ([0, 1, 2], by rank)"), "{apart}");
            (numbers, to_vec(&gradient), peers.gather(&vec![rank as u8; rank as usize]).unwrap())
        });
        for (numbers, gradient, _) in &seen {
            assert_eq!(numbers[0], 3.0);
            assert!((numbers[1] - 0.3).abs() < 1e-15);
            assert_eq!((numbers, gradient), (&seen[0].0, &seen[0].1), "the same bits everywhere");
        }
        assert_eq!(seen[0].2, [vec![1], vec![2, 2]]);
        assert!(seen[1].2.is_empty() && seen[2].2.is_empty());
    }

    #[test]
    fn who_has_finished_a_rollout_is_known_to_the_others_and_to_nobody_of_another() {
        let counts = among(3, |rank, peers| {
            if rank > 0 {
                peers.note_finished(7).unwrap();
            }
            peers.barrier().unwrap();
            [7, 8].map(|rollout| peers.finished(rollout).unwrap())
        });
        for [seventh, eighth] in counts {
            assert_eq!(seventh, Finished { finished: 2, learners: 3 });
            assert_eq!(eighth, Finished { finished: 0, learners: 3 });
        }
    }

    #[test]
    fn nobody_passes_a_barrier_before_all_have_come() {
        let come = AtomicU32::new(0);
        let seen = among(3, |rank, peers| {
            std::thread::sleep(Duration::from_millis(20 * u64::from(rank)));
            come.fetch_add(1, Ordering::SeqCst);
            peers.barrier().unwrap();
            come.load(Ordering::SeqCst)
        });
        assert_eq!(seen, [3, 3, 3]);
    }

    /// It would corrupt its table where two groups of a process begin at the same moment.
    #[test]
    fn c10ds_flight_recorder_is_off() {
        among(2, |_, peers| peers.barrier().unwrap());
        assert_eq!(std::env::var("TORCH_FR_BUFFER_SIZE").as_deref(), Ok("0"));
    }

    /// TCP ports of this process that listen.
    fn listening() -> BTreeSet<u16> {
        let own: Vec<String> = std::fs::read_dir("/proc/self/fd")
            .unwrap()
            .filter_map(|entry| Some(std::fs::read_link(entry.unwrap().path()).ok()?.to_str()?.to_owned()))
            .collect();
        let table = std::fs::read_to_string("/proc/self/net/tcp").unwrap();
        let port = |line: &str| {
            let words: Vec<&str> = line.split_whitespace().collect();
            let ours = own.contains(&format!("socket:[{}]", words.get(9)?));
            let (_, port) = words[1].split_once(':')?;
            (ours && words[3] == "0A").then(|| u16::from_str_radix(port, 16).ok())?
        };
        table.lines().filter_map(port).collect()
    }

    fn is_let_in(port: u16) -> bool {
        let address = std::net::SocketAddr::from(([127, 0, 0, 1], port));
        std::net::TcpStream::connect_timeout(&address, Duration::from_millis(300)).is_ok()
    }

    /// Gloo would accept whoever comes, and end the process when it has no descriptors left.
    #[test]
    fn nobody_else_is_let_in_once_all_have_met_and_other_sockets_stay_open() {
        // Other groups of this process would listen, too.
        let _alone = ONE_GROUP.write().unwrap_or_else(PoisonError::into_inner);
        let foreign = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let foreign_port = foreign.local_addr().unwrap().port();
        let seen = together(2, |rank, peers| {
            // What is opened now is not closed by a learner that comes late.
            let own = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
            peers.barrier().unwrap();
            let knocks: Vec<(bool, bool)> = listening()
                .into_iter()
                .filter(|_| rank == 0)
                .map(|port| (port == foreign_port || port == own.local_addr().unwrap().port(), is_let_in(port)))
                .collect();
            // The group itself goes on, and nobody leaves before all have looked.
            let mut numbers = [1.0];
            peers.sum(&mut numbers).unwrap();
            assert_eq!(numbers, [2.0]);
            knocks
        });
        let count = |wanted: (bool, bool)| seen[0].iter().filter(|&&knock| knock == wanted).count();
        assert_eq!(count((true, true)), 2, "sockets that are not the group's: {seen:?}");
        // Both learners' sockets of Gloo are closed; the other learner's own one is open.
        assert_eq!((count((false, false)), count((false, true))), (2, 1), "{seen:?}");
    }

    /// While learners meet, other threads open sockets.
    #[test]
    fn a_socket_that_is_opened_meanwhile_is_not_taken_for_the_groups() {
        let _alone = ONE_GROUP.write().unwrap_or_else(PoisonError::into_inner);
        let over = AtomicBool::new(false);
        let (kept, _) = std::thread::scope(|scope| {
            let opener = scope.spawn(|| {
                let mut kept = Vec::new();
                while !over.load(Ordering::SeqCst) && kept.len() < 200 {
                    kept.push(std::net::TcpListener::bind("127.0.0.1:0").unwrap());
                    std::thread::sleep(Duration::from_micros(300));
                }
                kept
            });
            let met = together(3, |_, peers| peers.barrier().unwrap());
            over.store(true, Ordering::SeqCst);
            (opener.join().unwrap(), met)
        });
        assert!(!kept.is_empty());
        assert!(kept.iter().all(|socket| is_let_in(socket.local_addr().unwrap().port())));
    }

    #[test]
    fn one_who_leaves_is_an_error_to_the_others() {
        let errors = among(2, |rank, peers| if rank == 0 { None } else { peers.sum(&mut [1.0]).err() });
        assert!(errors[1].as_ref().unwrap().to_string().starts_with("learner 1 has lost the others"), "{errors:?}");
    }
}
