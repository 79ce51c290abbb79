//! Records are written in place in shared memory: the only unsafe code of this crate.

use std::mem::MaybeUninit;
use wire::Ipc;
use wire::message::{Line, ObservationHeader};

type Loan = iceoryx2::sample_mut_uninit::SampleMutUninit<Ipc, [MaybeUninit<Line>], ObservationHeader>;
/// A sample whose records can be written.
pub type Written = iceoryx2::sample_mut::SampleMut<Ipc, [Line], ObservationHeader>;

/// A loaned sample with what lies there: zeros, or earlier records.
pub fn as_it_lies(loan: Loan) -> Written {
    // SAFETY: shared memory is zeros when the system hands it out, and only plain numbers are ever written there. A Line
    // is plain bytes (`Pod`): every value of these bytes is one.
    unsafe { loan.assume_init() }
}
