//! Reports that contradict the learner's record.

use super::*;

#[test]
fn an_outcome_that_does_not_follow_from_the_action_is_an_error() {
    let (column_map, mut collector, mut actor) = one();
    let (header, sample) = actor.turn(column_map).unwrap().remove(0);
    collector.receive(&header, sample).unwrap();
    let in_force = reward("r");
    collector.begin(RolloutShape { steps: 2, environments_in_last_step: 1, frames: 2 }, in_force, 1);
    let first = due(&collector);
    assert!(collector.settle(&first).is_empty(), "the first observation belongs to no action of this rollout");
    let batch = collector.answer(&first, &[4]).remove(0);
    actor.actions.push_back(batch);
    let (header, sample) = actor.turn(column_map).unwrap().remove(0);
    let changes: [(fn(&mut FakeSample), _); 9] = [
        (|sample| sample.header_mut().flags = 0, "reports nothing of action 4"),
        (|sample| Line::bytes_mut(&mut sample.0[0])[64] = 5, "action 5; sent was episode 0, step 0, action 4"),
        (|sample| sample.header_mut().acted_step = 1, "step 1, action 4; sent was"),
        (|sample| sample.header_mut().flags |= flag::TERMINATED | flag::TRUNCATED, "flags are 0x7"),
        (|sample| sample.header_mut().flags |= flag::TERMINATED, "must be at episode 1, step 0"),
        (|sample| sample.reals("wrist_object_progress_m")[0] = f32::INFINITY, "not finite"),
        (|sample| sample.reals("wrist_object_m")[0] = f32::NAN, "not finite"),
        (|sample| sample.reals("goal_success")[0] = 1000.0, "goal_success is 1000"),
        (|sample| sample.reals("disturbance_m")[0] = 3e38, "disturbance_m is"),
    ];
    for (change, expected) in changes {
        let mut sample = sample.clone();
        change(&mut sample);
        let error = collector.receive(&header, sample).unwrap_err();
        let text = error.to_string();
        assert!(text.contains(expected), "{text}");
        assert_eq!(error.is_non_finite(), expected == "not finite", "{text}");
    }
    assert_eq!(collector.receive(&header, sample.clone()), Ok(Received::Kept));
    let second = due(&collector);
    let settled = collector.settle(&second);
    assert_eq!((settled.len(), settled[0].t, settled[0].column), (1, 0, 0));
    let layout = Config::default().spec().layout();
    let part = |index| layout.part(sample.record(0), index);
    assert_eq!(settled[0].outcome.reward, reward("r").composition.of(part, 0.0));
    assert_eq!(settled[0].outcome.label, sample.clone().reals("disturbance_progress_m")[0] <= -0.001);
    assert!(collector.settle(&second).is_empty(), "an outcome is taken in once");
}

/// What allows nothing is refused where an action is to be chosen, and what is forbidden is not sent.
#[test]
fn a_record_allows_an_action_and_only_such_are_sent() {
    let mask = "[[channels]]\nname = \"action_mask\"\nrole = \"mask\"\ndtype = \"u8\"\nshape = [2]\ndoc = \"\"";
    let actions = "[actions]\nkind = \"discrete\"\nnames = [\"a\", \"b\"]";
    let task = proto::task::Spec::kept(&format!("name = \"masked\"\n{actions}\n{mask}\n")).unwrap();
    let settings = Settings { task, ..settings(ColumnMap::new(0, 1, 1), 1) };
    let boundary = Boundary::start(1);
    let mut environments = Environments::new(&settings, boundary.environments, boundary.running);
    let mut lines = vec![Line([0; 64]); task.layout().bytes / size_of::<Line>()];
    RecordHeader::of_mut(Line::bytes_mut(&mut lines)).begin(0, 0, false);
    let error = environments.check(0, Line::bytes(&lines)).unwrap_err();
    assert!(error.problem.contains("its action_mask allows no option of a choice"), "{error}");
    task.mask().unwrap().of_mut::<u8>(Line::bytes_mut(&mut lines))[1] = 1;
    environments.check(0, Line::bytes(&lines)).unwrap();
    let mut forbidden = environments.clone();
    let record = lines.clone();
    let sent = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| forbidden.act(0, &[0], Line::bytes(&record))));
    assert!(sent.is_err());
    environments.act(0, &[1], Line::bytes(&lines));
}
