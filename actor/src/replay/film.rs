//! An episode as it is simulated again, kept moment by moment, and its pictures.
//!
//! Pictures are drawn when the episode is over: its file is called by the outcome, and the view from outside is chosen
//! for the whole way.

use super::picture::Sink;
use anyhow::Result;
use picture::{Moment, Storyboard, Task};
use proto::episode::EnvironmentId;
use proto::kitchen::TargetCategory;
use proto::record::End;
use proto::replay::{ImageFormat, ReplayImages};
use proto::reward::UNDISTURBED_THRESHOLD_M;
use rapier3d::math::Pose3;
use simulator::depth::DepthCamera;
use simulator::tasks::arm_point_nav::Environment;
use simulator::tasks::arm_point_nav::Transition;
use std::path::Path;
use std::sync::Arc;

/// Who played the episode: its name, without target and outcome.
#[derive(Debug, Clone, Copy)]
pub struct Played {
    /// Environment it ran in.
    pub environment: EnvironmentId,
    /// Episode number within the environment.
    pub episode: u32,
    /// In an evaluation: number of the fixed episode, as in the table of episodes.
    pub fixed: Option<u32>,
}

impl Played {
    /// Name of the file or folder of its pictures, without an ending: kitchen, episode, target, outcome. The words are
    /// those of an evaluation's table.
    fn name(self, target: TargetCategory, outcome: Outcome) -> String {
        let (kitchen, target, outcome) = (self.environment.kitchen.number(), target.name(), outcome.word());
        let of = match (self.fixed, self.environment.number, self.episode) {
            (Some(fixed), ..) => format!("episode-{fixed:03}"),
            (None, number, episode) => format!("environment-{number}-episode-{episode:06}"),
        };
        format!("kitchen-{kitchen:02}-{of}-{target}-{outcome}")
    }

    fn title(self, target: TargetCategory) -> String {
        let (kitchen, target) = (self.environment.kitchen, target.name());
        match self.fixed {
            Some(fixed) => format!("Kitchen {kitchen}, episode {fixed}: bring the {target}"),
            None => {
                format!(
                    "Kitchen {kitchen}, environment {}, episode {}: bring the {target}",
                    self.environment.number, self.episode
                )
            }
        }
    }
}

/// How an episode ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// With less disturbance than counts.
    SuccessWithoutDisturbance,
    /// With disturbance.
    Success,
    /// Done was declared elsewhere than at the goal.
    Failure,
    /// The last step that there may be.
    TimeLimit,
    /// The recording stops before its end.
    Unfinished,
}

impl Outcome {
    /// What the last transition tells of it, and how it ended the episode.
    pub fn of(last: Option<&Transition>, end: Option<End>) -> Self {
        match (last, end) {
            (Some(last), Some(End::Terminated)) if last.succeeded() => {
                let undisturbed = last.disturbance_m < UNDISTURBED_THRESHOLD_M;
                if undisturbed { Self::SuccessWithoutDisturbance } else { Self::Success }
            }
            (_, Some(End::Terminated)) => Self::Failure,
            (_, Some(End::Truncated)) => Self::TimeLimit,
            (_, None) => Self::Unfinished,
        }
    }

    /// As names of files have it.
    pub fn word(self) -> &'static str {
        match self {
            Self::SuccessWithoutDisturbance => "success-without-disturbance",
            Self::Success => "success",
            Self::Failure => "failure",
            Self::TimeLimit => "time-limit",
            Self::Unfinished => "unfinished",
        }
    }

    /// For the caption, and whether it is good news.
    fn words(self) -> (String, bool) {
        let words = match self {
            Self::SuccessWithoutDisturbance => "success, nothing disturbed",
            Self::Success => "success, with disturbance",
            Self::Failure => "failure: Done away from the goal",
            Self::TimeLimit => "failure: time limit",
            Self::Unfinished => "the recording ends here",
        };
        (words.to_owned(), matches!(self, Self::SuccessWithoutDisturbance | Self::Success))
    }
}

/// The moments of one episode.
pub struct Film {
    played: Played,
    moments: Vec<Moment>,
    last: Option<Transition>,
}

impl Film {
    /// An episode that is about to be simulated.
    pub fn new(played: Played) -> Self {
        Self { played, moments: Vec::new(), last: None }
    }

    /// Keeps the moment that the environment is in; `transition`: what led there, none at the start.
    pub fn keep(&mut self, environment: &Environment, transition: Option<Transition>) {
        self.last = transition.or(self.last);
        self.moments.push(Moment::of(environment, transition.as_ref()));
    }

    /// Draws and writes everything; returns the number of pictures.
    pub fn develop(
        mut self,
        images: &ReplayImages,
        environment: &Environment,
        camera: &mut DepthCamera,
    ) -> Result<u64> {
        let (kitchen, episode) = (environment.kitchen(), environment.episode());
        let count = self.moments.len() - 1;
        for (step, moment) in self.moments.iter_mut().enumerate() {
            moment.words.action = match step {
                0 => format!("step 0 of {count}"),
                _ => format!("step {step} of {count}: {}", moment.words.action),
            };
        }
        let outcome = Outcome::of(self.last.as_ref(), environment.end());
        if let Some(last) = self.moments.last_mut() {
            last.words.outcome = Some(outcome.words());
        }
        let side = images.side as usize;
        let name = self.played.name(episode.category, outcome);
        let mut sink = Sink::create(images, Path::new(&images.folder), &name, self.moments.len())?;
        let story = (images.format != ImageFormat::Png).then(|| {
            let target = kitchen.target_movable(episode.category);
            let task = Task { target, goal: episode.goal, title: self.played.title(episode.category) };
            Storyboard::new(Arc::clone(kitchen), task, &self.moments, side)
        });
        let mut depth_mm = vec![0; side * side];
        let mut bodies: Vec<Pose3> = Vec::new();
        for moment in &self.moments {
            moment.world_from_bodies(kitchen, &mut bodies);
            camera.render(&bodies, moment.world_from_camera, side, &mut depth_mm);
            match &story {
                Some(story) => sink.moment(&story.draw(moment, &depth_mm))?,
                None => sink.depth(side, &depth_mm)?,
            }
        }
        sink.finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::kitchen::KitchenId;
    use simulator::tasks::arm_point_nav::RewardParts;

    #[test]
    fn files_are_called_by_kitchen_episode_target_and_outcome() {
        let environment = EnvironmentId { kitchen: KitchenId::new(26).unwrap(), number: 1 };
        let mut played = Played { environment, episode: 4, fixed: Some(7) };
        let last = |goal_success: f32, disturbance_m: f32| {
            let reward = RewardParts { goal_success, ..RewardParts::default() };
            Some(Transition { reward, disturbance_m, ..Transition::default() })
        };
        let cases = [
            (last(1.0, 0.0), Some(End::Terminated), "success-without-disturbance"),
            (last(1.0, 0.02), Some(End::Terminated), "success"),
            (last(0.0, 0.0), Some(End::Terminated), "failure"),
            (last(0.0, 0.0), Some(End::Truncated), "time-limit"),
            (last(0.0, 0.0), None, "unfinished"),
            (None, None, "unfinished"),
        ];
        for (last, end, outcome) in cases {
            let name = played.name(TargetCategory::SoapBottle, Outcome::of(last.as_ref(), end));
            assert_eq!(name, format!("kitchen-26-episode-007-SoapBottle-{outcome}"));
        }
        played.fixed = None;
        let name = played.name(TargetCategory::Mug, Outcome::Failure);
        assert_eq!(name, "kitchen-26-environment-1-episode-000004-Mug-failure");
    }
}
