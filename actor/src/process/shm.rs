//! Writes observations in place in shared memory: the only unsafe code of this crate.

use proto::step::{Current, Transition};
use std::mem::MaybeUninit;
use std::ptr::{addr_of_mut, slice_from_raw_parts_mut};
use wire::Ipc;
use wire::message::{Observation, ObservationHeader};

/// Fills one observation in place, every byte of it. `render` is given the depth frame, row-major, and must write every
/// pixel: it returns the written slice as proof.
///
/// # Panics
/// If what `render` returns is not the frame it was given.
pub fn write_observation(
    slot: &mut MaybeUninit<Observation>,
    environment: u32,
    transition: Transition,
    current: Current,
    render: impl FnOnce(&mut [MaybeUninit<u16>]) -> &[u16],
) {
    let observation = slot.as_mut_ptr();
    // SAFETY: `observation` points to memory of an Observation that we hold exclusively; each field is written
    // through a raw pointer, without a reference to anything that is not initialised yet.
    unsafe {
        addr_of_mut!((*observation).transition).write(transition);
        addr_of_mut!((*observation).current).write(current);
        addr_of_mut!((*observation).environment).write(environment);
        addr_of_mut!((*observation).reserved).write([0; 13]);
    }
    // SAFETY: the frame lies inside the slot, and MaybeUninit pixels need no initial value.
    let frame = unsafe {
        let pixels = addr_of_mut!((*observation).depth_mm).cast::<MaybeUninit<u16>>();
        &mut *slice_from_raw_parts_mut(pixels, proto::camera::FRAME_PIXELS)
    };
    let (start, length) = (frame.as_ptr().cast::<u16>(), frame.len());
    let written = render(frame);
    assert!(written.as_ptr() == start && written.len() == length, "the frame was rendered in place, whole");
}

/// Fills one observation with zeros.
pub fn write_zeros(slot: &mut MaybeUninit<Observation>) {
    // SAFETY: the slot is writable memory of one Observation.
    unsafe { slot.as_mut_ptr().write_bytes(0, 1) };
}

/// A loaned sample.
type Loan = iceoryx2::sample_mut_uninit::SampleMutUninit<Ipc, [MaybeUninit<Observation>], ObservationHeader>;
/// A sample ready to be sent.
type Written = iceoryx2::sample_mut::SampleMut<Ipc, [Observation], ObservationHeader>;

/// Declares a loaned sample written. Each of its slots went through [`write_observation`] or [`write_zeros`].
pub fn assume_written(sample: Loan) -> Written {
    // SAFETY: `Link::send_observations`, the only caller, has every slot filled by one of the functions above; both
    // leave no byte unwritten, and an Observation of any bytes is valid: it holds integers and floats only.
    unsafe { sample.assume_init() }
}
