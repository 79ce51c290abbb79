//! A step of several shards: each is inferred by itself, as the network's last bits depend on how many rows go through it
//! together.

use super::{Agent, AgentError, StepInput, StepOutput};
use crate::shards::Shards;

impl Agent {
    /// [`Agent::step_each`] for columns that are all at row `t` of the rollout. Panics outside a rollout, or when the
    /// input's slices differ in length.
    pub fn step(&mut self, t: usize, input: &StepInput) -> Result<StepOutput, AgentError> {
        self.step_each(&vec![t; input.columns.len()], input)
    }

    /// Infers some columns, each at its row of the rollout, stores what was seen and chosen, and advances their beliefs.
    ///
    /// After its last action, at a row that is as many as the rollout has, a column is valued for the bootstrap and
    /// nothing else: its belief stays, and its action in the output means nothing.
    ///
    /// A column that holds in the rollout's last step is inferred, too: its last action bootstraps from this value. Its
    /// action must not be sent. Its belief does not change, because the same observation comes again. Panics outside a
    /// rollout, or when the slices differ in length.
    pub(crate) fn step_each(&mut self, rows: &[usize], input: &StepInput) -> Result<StepOutput, AgentError> {
        assert_eq!(rows.len(), input.columns.len(), "a row for each column");
        let mut output = StepOutput::default();
        let mut at = rows;
        for part in parts(&self.shards, input) {
            let of_part = at.split_off(..part.columns.len()).expect("the parts are all columns");
            let StepOutput { actions, log_probs, values } = self.step_together(of_part, &part)?;
            output.actions.extend(actions);
            output.log_probs.extend(log_probs);
            output.values.extend(values);
        }
        Ok(output)
    }

    /// Computes the values of the observations after the last action, at rows of their own. Beliefs stay where they
    /// are. Columns that held may be left out. Panics as [`Agent::step`] does.
    pub fn bootstrap(&mut self, input: &StepInput) -> Result<(), AgentError> {
        let steps = self.rollout.as_ref().expect("a rollout is bootstrapped").shape().steps;
        self.step(steps, input).map(drop)
    }
}

/// The input of each shard that has columns in it. Columns ascend, so those of a shard follow one another.
fn parts<'a>(shards: &Shards, input: &StepInput<'a>) -> Vec<StepInput<'a>> {
    if !shards.are_fixed() {
        return vec![*input];
    }
    let rows = input.columns.len();
    let [draws, width] = [input.gumbel, input.numbers].map(|numbers| numbers.len() / rows.max(1));
    let [options, images] = [input.masks.len(), input.images.len()].map(|count| count / rows.max(1));
    let place = |column: usize| input.columns.partition_point(|&other| other < column);
    let of_shards = shards.columns().iter().map(|shard| place(shard.start)..place(shard.end));
    let of_shards = of_shards.filter(|rows| !rows.is_empty());
    of_shards
        .map(|rows| StepInput {
            columns: &input.columns[rows.clone()],
            frames: input.frames.get(rows.clone()).unwrap_or_default(),
            images: &input.images[rows.start * images..rows.end * images],
            numbers: &input.numbers[rows.start * width..rows.end * width],
            previous_action: &input.previous_action[rows.clone()],
            episode_start: &input.episode_start[rows.clone()],
            masks: &input.masks[rows.start * options..rows.end * options],
            gumbel: &input.gumbel[rows.start * draws..rows.end * draws],
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::RawFrame;
    use proto::camera::DepthFrame;
    use proto::config::Config;

    #[test]
    fn each_shard_has_its_rows_of_everything() {
        let mut config = Config::default();
        (config.actors.count, config.actors.environments_per_actor, config.learner.shards) = (4, 2, 4);
        let shards = Shards::of(&config, &(2..8));
        let raw = vec![0; size_of::<RawFrame>() / 2];
        let frame: &RawFrame = raw.as_slice().try_into().unwrap();
        // The second halves of two actors, and one column more; the shard between has none.
        let (columns, rows) = ([1, 4, 5], 3);
        let numbers: Vec<f32> = (0..6u8).map(f32::from).collect();
        let input = StepInput {
            columns: &columns,
            frames: &vec![DepthFrame::Whole(frame); rows],
            images: &[&[1], &[1, 1], &[4], &[4, 4], &[5], &[5, 5]],
            numbers: &[1.0, 1.0, 4.0, 4.0, 5.0, 5.0],
            previous_action: &[1, 4, 5],
            episode_start: &[true, false, true],
            masks: &[true, false, false, true, true, true],
            gumbel: &numbers,
        };
        let parts = parts(&shards, &input);
        assert_eq!(parts.iter().map(|part| part.columns).collect::<Vec<_>>(), [&[1][..], &[4, 5]]);
        assert_eq!(parts.iter().map(|part| part.previous_action).collect::<Vec<_>>(), [&[1][..], &[4, 5]]);
        assert_eq!(parts.iter().map(|part| part.episode_start).collect::<Vec<_>>(), [&[true][..], &[false, true]]);
        assert_eq!(
            parts.iter().map(|part| part.masks).collect::<Vec<_>>(),
            [&[true, false][..], &[false, true, true, true]]
        );
        assert_eq!(parts.iter().map(|part| part.gumbel).collect::<Vec<_>>(), [&[0.0, 1.0][..], &[2.0, 3.0, 4.0, 5.0]]);
        assert_eq!(
            parts.iter().map(|part| (part.frames.len(), part.images, part.numbers)).collect::<Vec<_>>(),
            [
                (1, &[&[1][..], &[1, 1]][..], &[1.0, 1.0][..]),
                (2, &[&[4], &[4, 4], &[5], &[5, 5]], &[4.0, 4.0, 5.0, 5.0])
            ]
        );
        let whole = super::parts(&Shards::one(6), &StepInput { gumbel: &[], ..input });
        assert_eq!((whole.len(), whole[0].columns), (1, &columns[..]));
    }
}
