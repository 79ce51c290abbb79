//! Records are written in place in shared memory: the only unsafe code of this crate.

use std::mem::MaybeUninit;
use wire::Ipc;
use wire::message::{Line, ObservationHeader};

type Loan = iceoryx2::sample_mut_uninit::SampleMutUninit<Ipc, [MaybeUninit<Line>], ObservationHeader>;
/// A sample ready to be sent.
type Written = iceoryx2::sample_mut::SampleMut<Ipc, [Line], ObservationHeader>;

/// Has every record of a loaned sample written, each of so many lines: `write` is given its number and what lies there,
/// zeros or an earlier record.
pub fn fill<E>(
    loan: Loan,
    record_lines: usize,
    mut write: impl FnMut(usize, &mut [u8]) -> Result<(), E>,
) -> Result<Written, E> {
    // SAFETY: shared memory is zeros when the system hands it out, and only plain numbers are ever written there. A Line
    // is plain bytes (`Pod`): every value of these bytes is one.
    let mut written = unsafe { loan.assume_init() };
    for (number, record) in written.payload_mut().chunks_exact_mut(record_lines).enumerate() {
        write(number, Line::bytes_mut(record))?;
    }
    Ok(written)
}
