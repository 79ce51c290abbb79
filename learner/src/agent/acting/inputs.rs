//! What a step reads besides the network, its store and its table: one behind the other, so that one copy takes all of it
//! to the GPU.

use crate::ffi;
use crate::rollout::Step;
use std::ops::Range;
use tch::{Kind, Tensor};

/// The rows of a batch.
#[derive(Debug, Clone, Copy)]
pub(super) struct Inputs<'a> {
    /// Where kernels find the frames, or all rows' first image, then all second ones; none where they are elsewhere.
    pub addresses: &'a [i64],
    /// These and noise: as [`crate::agent::StepInput`] has them. What the host applies is left out.
    pub masks: &'a [bool],
    pub noise: &'a [f32],
    /// Rows of the store that get the observations.
    pub places: &'a [i64],
    /// Rows of the table of beliefs: where they are now, and where they go.
    pub columns: &'a [i64],
    pub beliefs_to: &'a [i64],
    /// Numbers, previous actions, episode starts.
    pub steps: &'a [Step],
}

/// Where each input lies among the bytes of all.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Layout {
    pub rows: usize,
    pub addresses: Range<usize>,
    pub masks: Range<usize>,
    pub noise: Range<usize>,
    pub places: Range<usize>,
    pub columns: Range<usize>,
    pub beliefs_to: Range<usize>,
    pub previous_actions: Range<usize>,
    pub numbers: Range<usize>,
    pub carried: Range<usize>,
}

impl Layout {
    pub fn of(inputs: &Inputs) -> Self {
        let mut end = 0;
        let mut next = |bytes: usize| {
            let start = end;
            end += bytes.next_multiple_of(16);
            start..start + bytes
        };
        let rows = inputs.steps.len();
        Self {
            rows,
            addresses: next(size_of_val(inputs.addresses)),
            masks: next(inputs.masks.len()),
            noise: next(size_of_val(inputs.noise)),
            places: next(rows * 8),
            columns: next(rows * 8),
            beliefs_to: next(rows * 8),
            previous_actions: next(rows * 8),
            numbers: next(rows * inputs.steps[0].numbers.len() * 4),
            carried: next(rows * 4),
        }
    }

    pub fn bytes(&self) -> usize {
        self.carried.end
    }
}

impl Inputs<'_> {
    /// Writes them into the memory of a tensor of bytes, which nobody reads meanwhile.
    pub fn write(&self, layout: &Layout, to: &mut Tensor) {
        fn put<const BYTES: usize>(to: &mut [u8], numbers: impl Iterator<Item = [u8; BYTES]>) {
            for (to, number) in to.chunks_exact_mut(BYTES).zip(numbers) {
                to.copy_from_slice(&number);
            }
        }
        // SAFETY: no other tensor shares this memory, and the caller has waited for the last step, which read it.
        let bytes = unsafe { ffi::bytes_mut(to) };
        let integers = |to: &mut [u8], numbers: &[i64]| put(to, numbers.iter().map(|number| number.to_ne_bytes()));
        integers(&mut bytes[layout.addresses.clone()], self.addresses);
        put(&mut bytes[layout.masks.clone()], self.masks.iter().map(|&mask| [u8::from(mask)]));
        put(&mut bytes[layout.noise.clone()], self.noise.iter().map(|number| number.to_ne_bytes()));
        integers(&mut bytes[layout.places.clone()], self.places);
        integers(&mut bytes[layout.columns.clone()], self.columns);
        integers(&mut bytes[layout.beliefs_to.clone()], self.beliefs_to);
        let steps = self.steps.iter();
        put(&mut bytes[layout.previous_actions.clone()], steps.clone().map(|step| step.previous_action.to_ne_bytes()));
        let numbers = steps.clone().flat_map(|step| &step.numbers);
        put(&mut bytes[layout.numbers.clone()], numbers.map(|number| number.to_ne_bytes()));
        let carried = steps.map(|step| if step.episode_start { 0.0f32 } else { 1.0 });
        put(&mut bytes[layout.carried.clone()], carried.map(f32::to_ne_bytes));
    }
}

/// The inputs on the device.
#[derive(Debug)]
pub(super) struct There<'a> {
    pub layout: &'a Layout,
    pub bytes: Tensor,
}

impl There<'_> {
    /// One of them, \[numbers\].
    pub fn part(&self, range: &Range<usize>, kind: Kind) -> Tensor {
        self.bytes.narrow(0, range.start as i64, range.len() as i64).view_dtype(kind)
    }

    /// The same by row, \[rows, numbers\].
    pub fn table(&self, range: &Range<usize>, kind: Kind) -> Tensor {
        let part = self.part(range, kind);
        let rows = self.layout.rows as i64;
        part.view([rows, part.size()[0] / rows])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tch::Device;

    #[test]
    fn inputs_lie_one_after_the_other_on_16_bytes() {
        let of_rows = [5, 6, 7];
        let step = Step { numbers: vec![0.5, -1.5, 2.0], previous_action: 9, ..Step::default() };
        let steps = [step.clone(), Step { episode_start: true, ..step.clone() }, step];
        let inputs = Inputs {
            addresses: &of_rows,
            masks: &[true, false, false, true, true, true],
            noise: &[0.25; 3 * 21],
            places: &of_rows,
            columns: &of_rows,
            beliefs_to: &of_rows,
            steps: &steps,
        };
        let layout = Layout::of(&inputs);
        let Layout { rows, addresses, masks, noise, places, columns, beliefs_to, .. } = layout.clone();
        let Layout { previous_actions, numbers, carried, .. } = layout.clone();
        let parts = [addresses, masks, noise, places, columns, beliefs_to, previous_actions, numbers, carried];
        assert!(parts.is_sorted_by(|a, b| a.end <= b.start && b.start - a.end < 16));
        assert!(parts.iter().all(|part| part.start.is_multiple_of(16)));
        assert_eq!((rows, layout.bytes()), (3, parts[8].end));

        let mut bytes = Tensor::zeros([layout.bytes() as i64], (Kind::Uint8, Device::Cpu));
        inputs.write(&layout, &mut bytes);
        let there = There { layout: &layout, bytes };
        let floats = |range| Vec::<f32>::try_from(there.part(range, Kind::Float)).unwrap();
        assert_eq!(floats(&layout.noise), [0.25; 63]);
        assert_eq!(floats(&layout.carried), [1.0, 0.0, 1.0]);
        assert_eq!(floats(&layout.numbers), [0.5, -1.5, 2.0].repeat(3));
        let integers = |range| Vec::<i64>::try_from(there.part(range, Kind::Int64)).unwrap();
        assert_eq!([integers(&layout.addresses), integers(&layout.beliefs_to)], [of_rows; 2]);
        assert_eq!(integers(&layout.previous_actions), [9; 3]);
        let masks = there.table(&layout.masks, Kind::Bool);
        assert_eq!((masks.size(), Vec::<bool>::try_from(masks.select(0, 1)).unwrap()), (vec![3, 2], vec![false, true]));
    }
}
