//! Writes observations in place in shared memory: the only unsafe code of this crate.

use proto::camera::sum_windows;
use proto::step::{Current, Transition};
use std::mem::MaybeUninit;
use std::ptr::{addr_of_mut, slice_from_raw_parts_mut};
use wire::Ipc;
use wire::message::{Observation, ObservationHeader};

/// Fills one observation in place, every byte of it, and returns it as proof. `render` is given the depth frame,
/// row-major, and must write every pixel: it returns the written slice as proof. With `sums` the frame's sums are
/// written behind it.
///
/// # Panics
/// If what `render` returns is not the frame it was given.
pub fn write_observation(
    slot: &mut MaybeUninit<Observation>,
    environment: u32,
    transition: Transition,
    current: Current,
    sums: bool,
    render: impl FnOnce(&mut [MaybeUninit<u16>]) -> &[u16],
) -> &Observation {
    let observation = slot.as_mut_ptr();
    // SAFETY: `observation` points to memory of an Observation that we hold exclusively; each field is written
    // through a raw pointer, without a reference to anything that is not initialised yet.
    unsafe {
        addr_of_mut!((*observation).transition).write(transition);
        addr_of_mut!((*observation).current).write(current);
        addr_of_mut!((*observation).environment).write(environment);
        addr_of_mut!((*observation).has_sums).write(0);
        addr_of_mut!((*observation).reserved).write([0; 12]);
        // Also where the sums follow: their room is plain numbers then, and this takes 0.2 µs.
        addr_of_mut!((*observation).sums_mm).write_bytes(0, 1);
    }
    // SAFETY: the frame lies inside the slot, and MaybeUninit pixels need no initial value.
    let frame = unsafe {
        let pixels = addr_of_mut!((*observation).depth_mm).cast::<MaybeUninit<u16>>();
        &mut *slice_from_raw_parts_mut(pixels, proto::camera::FRAME_PIXELS)
    };
    let (start, length) = (frame.as_ptr().cast::<u16>(), frame.len());
    let written = render(frame);
    assert!(written.as_ptr() == start && written.len() == length, "the frame was rendered in place, whole");
    // SAFETY: every field was written above: the frame by `render`, whose slice of plain numbers is the frame's memory;
    // an Observation has no bytes besides its fields (it is `Pod`).
    let observation = unsafe { slot.assume_init_mut() };
    if sums {
        observation.has_sums = u32::from(sum_windows(&observation.depth_mm, &mut observation.sums_mm));
    }
    observation
}

/// Fills one observation with zeros, and returns it as proof.
pub fn write_zeros(slot: &mut MaybeUninit<Observation>) -> &Observation {
    // The frame is too large for the stack of a thread: it is not made there first.
    // SAFETY: the slot is writable memory of one Observation, for which zeros are a valid value.
    unsafe {
        slot.as_mut_ptr().write_bytes(0, 1);
        slot.assume_init_ref()
    }
}

/// A loaned sample.
type Loan = iceoryx2::sample_mut_uninit::SampleMutUninit<Ipc, [MaybeUninit<Observation>], ObservationHeader>;
/// A sample ready to be sent.
type Written = iceoryx2::sample_mut::SampleMut<Ipc, [Observation], ObservationHeader>;

/// Has every slot of a loaned sample written. `write` is given its number and the slot, and returns what it wrote there
/// as proof.
///
/// # Panics
/// If what `write` returns does not lie in the slot it was given.
pub fn fill(
    mut sample: Loan,
    mut write: impl for<'a> FnMut(usize, &'a mut MaybeUninit<Observation>) -> &'a Observation,
) -> Written {
    for (number, slot) in sample.payload_mut().iter_mut().enumerate() {
        let place = slot.as_ptr();
        let written = write(number, slot);
        assert!(std::ptr::eq(written, place), "an observation was written in its slot");
    }
    // SAFETY: a reference to an Observation in each slot's own memory proves that each slot holds one.
    unsafe { sample.assume_init() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_byte_of_an_observation_is_written_in_its_slot() {
        let mut slot = Box::new(MaybeUninit::<Observation>::uninit());
        let transition = Transition { episode: 3, ..Transition::default() };
        let current = Current { episode: 4, ..Current::default() };
        let frame = vec![1234; proto::camera::FRAME_PIXELS];
        for sums in [true, false] {
            let written =
                write_observation(&mut slot, 7, transition, current, sums, |room| room.write_copy_of_slice(&frame));
            assert_eq!((written.environment, written.transition, written.current), (7, transition, current));
            assert_eq!(written.frame().sums_mm.map(|sums_mm| sums_mm[5]), sums.then_some(4 * 1234));
            assert!(written.sums_mm.iter().all(|&sum_mm| sum_mm == if sums { 4 * 1234 } else { 0 }));
        }
        let far = vec![20_000; proto::camera::FRAME_PIXELS];
        let written = write_observation(&mut slot, 7, transition, current, true, |room| room.write_copy_of_slice(&far));
        assert_eq!((written.depth_mm[9], written.frame().sums_mm), (20_000, None), "sums that 16 bits do not hold");
        let sum: u64 = bytemuck::bytes_of(written).iter().map(|&byte| u64::from(byte)).sum();
        assert!(sum > 0);
        assert!(bytemuck::bytes_of(write_zeros(&mut slot)).iter().all(|&byte| byte == 0));
    }

    #[test]
    #[should_panic(expected = "in place, whole")]
    fn a_frame_that_was_rendered_elsewhere_is_no_proof() {
        static ELSEWHERE: [u16; proto::camera::FRAME_PIXELS] = [0; _];
        let mut slot = Box::new(MaybeUninit::<Observation>::uninit());
        write_observation(&mut slot, 0, Transition::default(), Current::default(), true, |_| &ELSEWHERE);
    }
}
