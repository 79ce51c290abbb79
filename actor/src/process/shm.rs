//! Observations are written in place in shared memory: the only unsafe code of this crate.

use std::mem::MaybeUninit;
use wire::Ipc;
use wire::message::{Observation, ObservationHeader};

type Loan = iceoryx2::sample_mut_uninit::SampleMutUninit<Ipc, [MaybeUninit<Observation>], ObservationHeader>;
/// A sample ready to be sent.
type Written = iceoryx2::sample_mut::SampleMut<Ipc, [Observation], ObservationHeader>;

/// Has every slot of a loaned sample written: `write` is given its number and what lies there, zeros or an earlier
/// observation.
pub fn fill(mut sample: Loan, mut write: impl FnMut(usize, &mut Observation)) -> Written {
    for (number, slot) in sample.payload_mut().iter_mut().enumerate() {
        // SAFETY: shared memory is zeros when the system hands it out, and only plain numbers are ever written there. An
        // Observation is plain numbers (`Pod`): every value of these bytes is one.
        write(number, unsafe { slot.assume_init_mut() });
    }
    // SAFETY: the same.
    unsafe { sample.assume_init() }
}
