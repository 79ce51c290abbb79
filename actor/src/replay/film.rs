//! An episode as it is simulated again, kept moment by moment, and its pictures.
//!
//! Pictures are drawn when the episode is over: its file is called by the outcome, and the view from outside is chosen
//! for the whole way.

use super::picture::Sink;
use anyhow::Result;
use picture::{Captions, Moment, Storyboard, is_displaced};
use proto::episode::EnvironmentId;
use proto::replay::{ImageFormat, ReplayImages, Rules, Seen};
use proto::task::UNFINISHED;
use rapier3d::math::Pose3;
use simulator::depth::DepthCamera;
use simulator::environment::Base;
use simulator::kitchen::Kitchen;
use std::path::Path;
use std::sync::Arc;

/// Who played the episode: its name, without target and outcome.
#[derive(Debug, Clone, Copy)]
pub struct Played {
    pub environment: EnvironmentId,
    pub episode: u32,
    /// In an evaluation: number of the fixed episode, as in the table of episodes.
    pub fixed: Option<u32>,
}

impl Played {
    /// Name of the file or folder of its pictures, without an ending: kitchen, episode, target if the task has one,
    /// outcome. The words are those of an evaluation's table.
    fn name(self, target: Option<&str>, outcome: &str) -> String {
        let kitchen = self.environment.kitchen.number();
        let of = match (self.fixed, self.environment.number, self.episode) {
            (Some(fixed), ..) => format!("episode-{fixed:03}"),
            (None, number, episode) => format!("environment-{number}-episode-{episode:06}"),
        };
        let words = [Some(of.as_str()), target, Some(outcome)];
        format!("kitchen-{kitchen:02}-{}", words.into_iter().flatten().collect::<Vec<_>>().join("-"))
    }

    fn title(self, target: Option<&str>) -> String {
        let EnvironmentId { kitchen, number } = self.environment;
        let title = match self.fixed {
            Some(fixed) => format!("Kitchen {kitchen}, episode {fixed}"),
            None => format!("Kitchen {kitchen}, environment {number}, episode {}", self.episode),
        };
        target.map_or_else(|| title.clone(), |target| format!("{title}: {target}"))
    }
}

/// An outcome in the name of a file: `success` beside `success-without-disturbance` is `success-with-disturbance`.
fn file_word(rules: &Rules, outcome: &str) -> String {
    let lacking = |good: String| good.strip_prefix(outcome)?.strip_prefix("-without-").map(str::to_owned);
    let lacking = rules.spec.good_outcomes().find_map(lacking);
    lacking.map_or_else(|| outcome.to_owned(), |lacking| format!("{outcome}-with-{lacking}"))
}

/// An outcome for the caption, and its place among the successes.
fn outcome_in_words(rules: &Rules, outcome: &str) -> (String, Option<usize>) {
    if outcome == UNFINISHED {
        ("the recording ends here".to_owned(), None)
    } else {
        (file_word(rules, outcome).replace('-', " "), rules.spec.good_outcomes().position(|good| good == outcome))
    }
}

/// Caption of a moment, without its number and the episode's end.
fn words(rules: &Rules, seen: &Seen) -> Captions {
    seen.rewards.map_or_else(Captions::default, |_| picture::captions(rules.spec, seen.record))
}

pub(crate) fn moment(environment: &Base, words: Captions) -> Moment {
    Moment::of(environment.simulation(), environment.world_from_camera(), words)
}

/// What is displaced most, other than the target: `Mug moved 0.12 m`.
fn farthest(kitchen: &Kitchen, target: Option<usize>, first: &[Pose3], now: &[Pose3]) -> Option<String> {
    let places = first.iter().zip(now).map(|(first, now)| (first.translation, now.translation)).enumerate();
    let others = places.filter(|&(thing, (from, to))| Some(thing) != target && is_displaced(from, to));
    let far = others.map(|(thing, (from, to))| (thing, (to - from).length()));
    let (most, far_m) = far.max_by(|(_, one), (_, other)| one.total_cmp(other))?;
    Some(format!("{} moved {far_m:.2} m", kitchen.bodies()[kitchen.movable_bodies()][most].category))
}

pub struct Film {
    played: Played,
    moments: Vec<Moment>,
    /// The last one's record.
    record: Vec<u8>,
}

impl Film {
    /// An episode that is about to be simulated.
    pub fn new(played: Played) -> Self {
        Self { played, moments: Vec::new(), record: Vec::new() }
    }

    pub fn keep(&mut self, rules: &Rules, environment: &Base, seen: &Seen) {
        seen.record.clone_into(&mut self.record);
        let mut moment = moment(environment, words(rules, seen));
        let target = picture::target(rules.spec, environment, seen.record);
        let first = self.moments.first().unwrap_or(&moment);
        if let Some(moved) = farthest(environment.kitchen(), target, &first.things, &moment.things) {
            moment.captions.measures.extend([", ", &moved]);
        }
        self.moments.push(moment);
    }

    /// Draws it; `drawn` is called after each moment. Returns how many pictures there are, and the name of a film's file.
    pub fn develop(
        mut self,
        images: &ReplayImages,
        rules: &Rules,
        outcome: &str,
        environment: &Base,
        camera: &mut DepthCamera,
        mut drawn: impl FnMut() -> Result<()>,
    ) -> Result<(u64, Option<String>)> {
        let kitchen = environment.kitchen();
        let count = self.moments.len() - 1;
        for (step, moment) in self.moments.iter_mut().enumerate() {
            moment.captions.action = match step {
                0 => format!("step 0 of {count}"),
                _ => format!("step {step} of {count}: {}", moment.captions.action),
            };
        }
        let target = picture::target_name(rules.spec, &self.record);
        // At the start there is nothing to measure yet.
        if let (Some(target), Some(first)) = (target, self.moments.first_mut()) {
            first.captions.measures = format!("to do: bring the {target} to the goal, and displace nothing else");
        }
        if let Some(last) = self.moments.last_mut() {
            last.captions.outcome = Some(outcome_in_words(rules, outcome));
        }
        let side = images.side as usize;
        let name = self.played.name(target, &file_word(rules, outcome));
        let mut sink = Sink::create(images, Path::new(&images.folder), &name, self.moments.len())?;
        let story = (images.format != ImageFormat::Png).then(|| {
            let task = picture::task(rules.spec, environment, &self.record, self.played.title(target));
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
            drawn()?;
        }
        sink.finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::config::Config;
    use proto::kitchen::KitchenId;

    #[test]
    fn files_are_called_by_kitchen_episode_target_and_outcome() {
        let environment = EnvironmentId { kitchen: KitchenId::new(26).unwrap(), number: 1 };
        let mut played = Played { environment, episode: 4, fixed: Some(7) };
        assert_eq!(played.name(Some("SoapBottle"), "success"), "kitchen-26-episode-007-SoapBottle-success");
        assert_eq!(played.title(None), "Kitchen 26, episode 7");
        played.fixed = None;
        assert_eq!(played.name(None, "failure"), "kitchen-26-environment-1-episode-000004-failure");
        assert_eq!(played.title(Some("Mug")), "Kitchen 26, environment 1, episode 4: Mug");
    }

    #[test]
    fn a_caption_names_what_is_displaced_most_but_not_the_target() {
        let kitchen = Kitchen::build(KitchenId::new(1).unwrap(), &Config::default().simulation).unwrap();
        let first = kitchen.settled_poses()[kitchen.movable_bodies()].to_vec();
        let mut now = first.clone();
        let of = |target, now: &[Pose3]| farthest(&kitchen, target, &first, now);
        assert_eq!(of(None, &now), None);
        for (thing, way_m) in [0.02, 0.118, 0.3].into_iter().enumerate() {
            now[thing].translation.x += way_m;
        }
        let moved = |thing: usize, far: &str| {
            Some(format!("{} moved {far} m", kitchen.bodies()[kitchen.movable_bodies()][thing].category))
        };
        assert_eq!([of(Some(2), &now), of(None, &now)], [moved(1, "0.12"), moved(2, "0.30")]);
    }

    #[test]
    fn a_caption_says_what_the_action_did_and_how_it_ended() {
        let rules = Rules::of(&Config::default()).unwrap();
        let mut record = vec![0; rules.spec.layout().small_bytes];
        let mut set = |name: &str, number: f32| {
            rules.spec.channel(name).unwrap().1.of_mut::<f32>(&mut record)[0] = number;
        };
        set("picked_up", 1.0);
        set("disturbance_m", 0.25);
        let said = words(&rules, &Seen { record: &record, rewards: Some(&[]) });
        assert_eq!(
            (said.action.as_str(), &said.remarks[..]),
            ("move arm height +", &[("picked up".to_owned(), true)][..])
        );
        assert_eq!(said.measures, "disturbance 0.250 m");
        assert_eq!(words(&rules, &Seen { record: &record, rewards: None }).action, "");
        // While it is held, and where it is to be picked up again.
        let mut again = record.clone();
        rules.spec.channel("picked_up").unwrap().1.of_mut::<f32>(&mut again)[0] = 0.0;
        rules.spec.channel("held").unwrap().1.of_mut::<u32>(&mut again)[0] = 1;
        let says = |record: &[u8]| words(&rules, &Seen { record, rewards: Some(&[]) });
        assert!(says(&again).measures.starts_with("holding Apple, "), "{}", says(&again).measures);
        let pick_up = rules.spec.actions.names().iter().position(|name| name == "PickUpMidLevel").unwrap();
        let place = rules.spec.layout().action.offset;
        again[place] = pick_up as u8;
        assert_eq!(says(&again).remarks, [("already holding".to_owned(), false)]);
        assert!(!says(&again).measures.contains("holding"), "it is said once");
        let outcome = |word| outcome_in_words(&rules, word);
        assert_eq!(outcome("success-without-disturbance"), ("success without disturbance".to_owned(), Some(0)));
        assert_eq!(outcome("success"), ("success with disturbance".to_owned(), Some(1)));
        assert_eq!([outcome("time-limit").1, outcome(UNFINISHED).1], [None, None]);
        let names = ["success", "success-without-disturbance", "failure"].map(|word| file_word(&rules, word));
        assert_eq!(names, ["success-with-disturbance", "success-without-disturbance", "failure"]);
    }
}
