use super::*;
use proptest::prelude::*;
use std::collections::BTreeMap;

/// A small task: an image, a vector, a scalar of eight bytes, two parts.
const SMALL: &str = r#"
name = "small"
weights = { price = 2.0 }
actions = { kind = "box", bounds = [[-1.0, 1.0], [0.0, 2.0]] }
rewards = [
    { name = "r", constant = -0.5, terms = [["near_m", 1.0]] },
    { name = "priced", base = "r", constant = 0.25, terms = [["pushed_m", "price"]] },
    { name = "counted", base = "r", terms = [{ part = "pushed_m", at_most = -0.1, weight = -3.0 }] },
    { name = "constrained", base = "r", terms = [["pushed_m", "multiplier"]] },
]
cost = { part = "pushed_m", weight = -1.0 }
label = { part = "pushed_m", at_most = -0.1 }
channels = [
    { name = "near_m", role = "part", dtype = "f32", range = [-10, 10], doc = "Nearer." },
    { name = "image", role = "observation", dtype = "u16", shape = [8, 8], sums = 2, doc = "An image." },
    { name = "pushed_m", role = "part", dtype = "f32", range = [-10, 10], doc = "Pushed back." },
    { name = "goal_m", role = "observation", dtype = "f32", shape = [3], range = [-100, 100], doc = "Where it is." },
    { name = "kind", role = "outcome", dtype = "u8", names = ["square", "round"], doc = "What it is." },
    { name = "done", role = "outcome", dtype = "f64", values = [0, 1], doc = "Whether it is there." },
]
metrics = [
    { name = "success", over = "last", doc = "There, and little pushed.", all_of = [
        { channel = "done" }, { channel = "pushed_m", at_least = -0.5, below = 1 },
    ] },
    { name = "pushed", over = "sum", value = "pushed_m", doc = "Pushed in all." },
    { name = "ever", over = "any", all_of = [{ channel = "done" }], doc = "There once." },
    { name = "when", over = "first", curve = false, doc = "The action that led there.", all_of = [
        { channel = "done", above = "pushed_m", at_most = 1 }, { channel = "done" },
    ] },
    { name = "never", over = "first", curve = false, doc = "A kind that is more than done.", all_of = [
        { channel = "kind", above = "done" },
    ] },
    { name = "how_long", over = "sum", all_of = [{ channel = "done" }], doc = "Steps there." },
]
figures = [
    { name = "share_there", of = "how_long", per = "length", where = ["terminated"], doc = "Share of the steps." },
]
curves = [
    { name = "by_push", label = "Pushed", of = "pushed", where = ["success"], at_most = [0.0, 1.0], doc = "At most." },
]
"#;

/// Its actions.
const BOX: &str = "\"box\", bounds = [[-1.0, 1.0], [0.0, 2.0]]";

fn small() -> Spec {
    Spec::parse(SMALL).unwrap()
}

/// A record in which these channels have these numbers.
fn record(spec: &Spec, numbers: &[(&str, f32)]) -> Vec<u8> {
    let mut record = vec![0; spec.layout().bytes];
    for &(name, number) in numbers {
        let (_, field) = spec.channel(name).unwrap();
        match field.dtype {
            Dtype::F32 => record[field.offset..][..4].copy_from_slice(&number.to_ne_bytes()),
            Dtype::F64 => record[field.offset..][..8].copy_from_slice(&f64::from(number).to_ne_bytes()),
            _ => record[field.offset] = number as u8,
        }
    }
    record
}

/// The numbers of a record, as rewards and metrics take them.
fn parts<'a>(spec: &'a Spec, record: &'a [u8]) -> impl Fn(usize) -> f32 + Copy + 'a {
    |index| spec.layout().fields[index].f32(record)
}

#[test]
fn everything_has_its_place() {
    let spec = small();
    let layout = spec.layout();
    let place = |name: &str| spec.channel(name).unwrap().1.range();
    assert_eq!((layout.action.range(), layout.previous_action.range()), (64..72, 72..80));
    assert_eq!(["near_m", "pushed_m", "kind", "done"].map(place), [80..84, 84..88, 88..89, 96..104]);
    assert_eq!((layout.of_action.clone(), place("goal_m"), layout.seen.clone()), (80..104, 104..116, 104..120));
    assert_eq!(
        (layout.small_bytes, place("image"), layout.images[1].range(), layout.bytes),
        (128, 128..256, 256..288, 320)
    );
}

/// Bytes of actions of each kind, those that the task has and those that it has not; and what heads of policies choose.
#[test]
fn an_action_of_any_kind_is_checked_and_told_from_standing_still() {
    let actions = |kind: &str| Spec::parse(&SMALL.replacen(BOX, kind, 1)).unwrap().actions;
    let numbers = |numbers: &[f32]| numbers.iter().flat_map(|number| number.to_ne_bytes()).collect::<Vec<_>>();
    let whole = |numbers: &[i32]| numbers.iter().flat_map(|number| number.to_ne_bytes()).collect::<Vec<_>>();
    for (kind, sound, strange, text) in [
        (
            BOX,
            [numbers(&[-1.0, 2.0]), numbers(&[0.5, 0.0])],
            [numbers(&[0.0, -0.1]), numbers(&[f32::NAN, 0.0])],
            "[-1.0, 2.0]",
        ),
        (
            "\"multi_discrete\", counts = [3, 2]",
            [whole(&[2, 0]), whole(&[0, 1])],
            [whole(&[0, 2]), whole(&[-1, 0])],
            "[2.0, 0.0]",
        ),
        ("\"discrete\", names = [\"a\", \"b\"]", [vec![1], vec![0]], [vec![2], vec![0, 1]], "1"),
    ] {
        let actions = actions(kind);
        let [first, second] = &sound;
        assert!(actions.has(first) && actions.has(second), "{kind}");
        assert!(!strange.iter().chain([&actions.hold(), &vec![]]).any(|action| actions.has(action)), "{kind}");
        assert_eq!((actions.hold().len(), first.len()), (actions.bytes(), actions.bytes()));
        assert_eq!(actions.text(first), text);
        let head = ActionHead::of(ActionSpace::default(), &actions).unwrap();
        let mut written = vec![];
        let chosen = match kind {
            BOX => PolicyAction::Numbers(vec![-7.0, 2.0]),
            _ => {
                PolicyAction::Options(first.chunks(actions.numbers().0.bytes()).map(|bytes| bytes[0].into()).collect())
            }
        };
        head.write(&chosen, &mut written);
        assert_eq!(&written, first, "clipped, or by number");
        assert_eq!((head.is_gaussian(), head.outputs()), (kind == BOX, if kind.contains("multi") { 5 } else { 2 }));
        assert_eq!(ActionHead::of(ActionSpace::named("small").unwrap(), &actions), None);
    }
}

/// The same task without its image.
fn blind() -> Spec {
    let image = SMALL.lines().find(|line| line.contains("\"image\"")).unwrap();
    Spec::parse(&SMALL.replacen(image, "", 1)).unwrap()
}

#[test]
fn a_truncated_episode_has_its_last_observation_where_there_are_no_images() {
    assert!(small().layout().last_seen.is_empty());
    let spec = blind();
    let layout = spec.layout();
    assert_eq!((layout.seen.clone(), layout.last_seen.clone(), layout.small_bytes), (104..120, 120..136, 192));
    let mut record = record(&spec, &[("goal_m", 1.0)]);
    record[120..124].copy_from_slice(&7.0f32.to_ne_bytes());
    let inputs = spec.inputs().unwrap();
    let read = |inputs: &Inputs| {
        let mut lines = [[0u64; LINE_BYTES / 8]; 3];
        bytemuck::cast_slice_mut(&mut lines).copy_from_slice(&record);
        let mut numbers = vec![];
        inputs.read(bytemuck::cast_slice(&lines), &mut numbers);
        numbers
    };
    assert_eq!(
        [read(&inputs), read(&inputs.last(layout).unwrap())],
        [[1.0, 0.0, 0.0].to_vec(), [7.0, 0.0, 0.0].to_vec()]
    );

    let refused = |record: &[u8]| Check::of(&spec).record(record, true).unwrap_err().to_string();
    assert_eq!(refused(&record), "its reserved byte is 224, which cannot be: it is 0");
    let flags = std::mem::offset_of!(crate::record::RecordHeader, flags);
    record[flags] = (crate::record::flag::ACTED | crate::record::flag::TRUNCATED) as u8;
    assert_eq!(Check::of(&spec).record(&record, true), Ok(()));
    record[120..124].copy_from_slice(&f32::NAN.to_ne_bytes());
    assert_eq!(refused(&record), "its last goal_m[0] is not finite");
}

/// What other people's tools depend on: an unchanged task has an unchanged layout.
#[test]
fn the_built_in_tasks_are_sound() {
    let arm = Spec::named("arm_point_nav").unwrap();
    let layout = arm.layout();
    assert_eq!((layout.of_action.clone(), layout.seen.clone(), layout.small_bytes), (72..136, 136..232, 256));
    assert_eq!(layout.bytes, 125_696);
    assert_eq!(
        arm.channel("target").unwrap().0.names,
        crate::kitchen::TargetCategory::ALL.map(crate::kitchen::TargetCategory::name)
    );
}

/// The paper's equations 1 and 2, written by hand, in their order of additions.
#[test]
fn the_papers_rewards_have_every_bit_of_its_equations() {
    let arm = Spec::named("arm_point_nav").unwrap();
    let composition = |name: &str| arm.composition(name, &[], &BTreeMap::new()).unwrap();
    let [r, r_prime, lagrangian] = ["r", "r_prime", "lagrangian"].map(composition);
    assert_eq!([&r, &r_prime, &lagrangian].map(Composition::has_multiplier), [false, false, true]);
    for case in 0u32..1000 {
        // Any numbers of any last bits.
        let number = |salt: u32| (case.wrapping_mul(2_654_435_761).wrapping_add(salt) as f32).sin() * 0.3;
        let [wrist, object, disturbance] = [1, 2, 3].map(number);
        let flags = [case & 1, case >> 1 & 1, case >> 2 & 1].map(|flag| flag as f32);
        let record = record(
            arm,
            &[
                ("wrist_object_progress_m", wrist),
                ("object_goal_progress_m", object),
                ("disturbance_progress_m", disturbance),
                ("failed_action", flags[0]),
                ("picked_up", flags[1]),
                ("goal_success", flags[2]),
            ],
        );
        let task = -0.01 + -0.03 * flags[0] + 5.0 * flags[1] + 10.0 * flags[2] + wrist + object;
        assert_eq!(r.of(parts(arm, &record), 7.0).to_bits(), task.to_bits());
        assert_eq!(r_prime.of(parts(arm, &record), 7.0).to_bits(), (task + 15.0 * disturbance).to_bits());
        assert_eq!(lagrangian.of(parts(arm, &record), 0.7).to_bits(), (task + 0.7 * disturbance).to_bits());
        assert_eq!(arm.label().unwrap().holds(parts(arm, &record)), disturbance <= -0.001);
    }
}

/// Figures of rollouts and checkpoints have these four, in this order.
#[test]
fn what_is_of_evaluations_alone_is_no_figure_of_rollouts() {
    let arm = Spec::named("arm_point_nav").unwrap();
    let names: Vec<_> = arm.rollout_metrics().map(|(metric, _)| &*metric.name).collect();
    assert_eq!(names, ["success", "success_without_disturbance", "picked_up", "disturbance_m"]);
    let ranking: Vec<_> = arm.ranking().iter().map(|metric| &*metric.label).collect();
    assert_eq!(ranking, ["SRwoD", "SR"]);
}

#[test]
fn a_reward_is_its_base_and_its_terms() {
    let spec = small();
    let near = record(&spec, &[("near_m", 1.0), ("pushed_m", -0.25)]);
    let reward = |name: &str, own: &[Reward], weights: &[(&str, f32)]| {
        let weights = weights.iter().map(|&(name, weight)| (name.to_owned(), weight)).collect();
        spec.composition(name, own, &weights).map(|composition| composition.of(parts(&spec, &near), 10.0))
    };
    assert_eq!(reward("r", &[], &[]), Ok(0.5));
    assert_eq!(reward("priced", &[], &[]), Ok(0.25));
    assert_eq!(reward("priced", &[], &[("price", 4.0)]), Ok(-0.25));
    assert_eq!(reward("counted", &[], &[]), Ok(-2.5));
    assert_eq!(reward("constrained", &[], &[]), Ok(-2.0));
    let own: Reward = toml::from_str("name = \"mine\"\nbase = \"priced\"\nterms = [[\"near_m\", 1.0]]").unwrap();
    assert_eq!(reward("mine", std::slice::from_ref(&own), &[]), Ok(1.25));
    assert_eq!(spec.cost().map(|(index, weight)| weight * parts(&spec, &near)(index)), Some(0.25));
    let refused = |text: &str| {
        let own: Reward = toml::from_str(text).unwrap();
        reward(&own.name, std::slice::from_ref(&own), &[]).unwrap_err().to_string()
    };
    assert_eq!(refused("name = \"mine\"\nbase = \"mine\""), "reward `mine`: its base is itself");
    assert_eq!(
        refused("name = \"mine\"\nterms = [[\"near\", 1.0]]"),
        "reward `mine`: there is no part `near` (did you mean `near_m`?); parts of this task: near_m, pushed_m"
    );
    assert_eq!(
        refused("name = \"mine\"\nterms = [[\"near_m\", \"prize\"]]"),
        "reward `mine`: there is no weight `prize` (did you mean `price`?); a number or one of: price, multiplier, \
         -multiplier"
    );
    assert!(refused("name = \"mine\"\nterms = [[\"near_m\", nan]]").contains("not a finite number"));
    assert!(
        refused("name = \"mine\"\nterms = [{part = \"near_m\", weight = 1.0}]").contains("either at_most or at_least")
    );
    assert_eq!(
        reward("best", &[], &[]).unwrap_err().to_string(),
        "task `small` has no reward `best`, and neither has the configuration; rewards: r, priced, counted, constrained"
    );
}

/// A task with other observations panicked in a learner.
#[test]
fn observations_that_networks_cannot_take_are_refused_with_their_names() {
    let frame = SMALL.replacen("[8, 8]", "[224, 224]", 1);
    let inputs = |from: &str, to: &str| Spec::parse(&frame.replacen(from, to, 1)).unwrap().inputs();
    let spec = Spec::parse(&frame).unwrap();
    let whole = inputs("", "").unwrap();
    assert_eq!((whole.frame, whole.are_coordinates()), (Some(spec.channel("image").unwrap().1), true));
    let other = inputs("shape = [3]", "shape = [2]").unwrap();
    assert_eq!((other.width(), other.are_coordinates()), (2, false));
    let more = inputs("shape = [3]", "shape = [4]").unwrap();
    assert_eq!((more.width(), more.are_coordinates()), (4, true), "what is behind a vector stays");
    let (seen, unseen) = ("\"observation\", dtype = \"u16\"", "\"state\", dtype = \"u16\"");
    assert_eq!(inputs(seen, unseen).unwrap().frame, None);
    for (from, to) in [("[224, 224]", "[112, 112]"), ("sums = 2, ", "")] {
        let images = inputs(from, to).map(|inputs| (inputs.frame, inputs.images.len()));
        assert_eq!(images, Ok((None, 1)), "{to}: an image like any other");
    }
    let error = inputs("[224, 224]", "[24, 24]").unwrap_err().to_string();
    let rule =
        ": an image has 36 to 512 pixels each way, and 1 to 12 channels first or last; make numbers of a smaller one";
    let image = "task `small`: networks cannot take its image `image` of the shape [24, 24]";
    assert!(error.starts_with(&format!("{image}{rule}")) && error.contains("FlattenObservation"), "{error}");
}

#[test]
fn a_metric_follows_an_episode() {
    let spec = small();
    let steps: [&[(&str, f32)]; 3] =
        [&[("pushed_m", -0.25)], &[("done", 1.0), ("pushed_m", -0.75)], &[("done", 1.0), ("pushed_m", -0.5)]];
    let mut after = vec![vec![0.0; 6]];
    for step in steps {
        let before = after.last().unwrap().clone();
        let record = record(&spec, step);
        let measures = spec.measures();
        after.push(
            measures
                .iter()
                .zip(before)
                .map(|(measure, before)| measure.after(|index| spec.layout().fields[index].number(&record), before))
                .collect(),
        );
    }
    let measures = spec.measures();
    let of_episode = |known: &Vec<f64>| -> Vec<_> {
        measures.iter().zip(known).map(|(measure, &known)| measure.of_episode(known)).collect()
    };
    let of_episodes: Vec<_> = after[1..].iter().map(of_episode).collect();
    let [zero, one] = [0.0, 1.0].map(Some);
    assert_eq!(
        of_episodes,
        [
            [zero, Some(-0.25), zero, None, None, zero],
            [zero, Some(-1.0), one, Some(2.0), None, one],
            [one, Some(-1.5), one, Some(2.0), None, Some(2.0)],
        ]
    );
    let kinds: Vec<_> = spec.described().iter().map(|one| (one.name.clone(), one.kind)).collect();
    for (name, kind) in [
        ("return_priced", Kind::F64),
        ("success", Kind::Share),
        ("pushed", Kind::F64),
        ("when", Kind::Count),
        ("how_long", Kind::Count),
        ("share_there", Kind::Share),
    ] {
        assert!(kinds.contains(&(name.to_owned(), kind)), "{name}: {kinds:?}");
    }
    assert_eq!((spec.column("return_constrained"), spec.column("by_push")), (None, None));
}

#[test]
fn figures_of_evaluations_and_words_are_nothing_that_a_run_depends_on() {
    let means = |from: &str, to: &str| {
        assert!(SMALL.contains(from), "{from}");
        Spec::parse(&SMALL.replacen(from, to, 1)).unwrap().means(&small())
    };
    assert!(means("per = \"length\", ", "") && means("[0.0, 1.0], doc", "[0.0], doc"));
    assert!(means("above = \"done\"", "at_most = 0") && means("name = \"never\"", "name = \"not\", label = \"no\""));
    assert!(
        !means("name = \"ever\"", "name = \"once\"")
            && !means("name = \"small\"", "name = \"small\"\nheadline = \"ever\"")
    );
}

#[test]
fn a_declaration_that_is_not_sound_is_refused_with_its_place() {
    let refused = |from: &str, to: &str| {
        assert!(SMALL.contains(from), "{from}");
        Spec::parse(&SMALL.replacen(from, to, 1)).map_err(|error| error.to_string()).unwrap_err()
    };
    for (from, to, problem) in [
        ("name = \"small\"", "name = \"Small\"", "name `Small`"),
        ("name = \"goal_m\"", "name = \"near_m\"", "two of the name `near_m`"),
        ("name = \"goal_m\"", "name = \"kitchen\"", "`kitchen` is a name of the engine's own"),
        ("name = \"ever\"", "name = \"reward_ever\"", "`reward_ever` is a name of the engine's own"),
        ("range = [-10, 10]", "range = [10, -10]", "the lower first"),
        ("range = [-10, 10], ", "", "a floating-point number has a range"),
        ("range = [-10, 10]", "range = [nan, 10]", "the lower first"),
        ("shape = [3]", "shape = [3, 0]", "no numbers"),
        ("shape = [3]", "shape = [9223372036854775807, 8]", "more than 2^27"),
        ("sums = 2", "sums = 3", "multiples of the windows' side"),
        ("sums = 2", "range = [0, 1]", "not checked on arrival"),
        ("role = \"part\", dtype = \"f32\"", "role = \"part\", dtype = \"f64\"", "a scalar f32"),
        ("[[-1.0, 1.0]", "[[1.0, 1.0]", "the lower first"),
        (BOX, "\"box\", bounds = []", "a box has 1 to 1024 numbers"),
        (BOX, "\"multi_discrete\", counts = []", "each choice has options, 1 to 1024 in all"),
        (BOX, "\"multi_discrete\", counts = [3, 0]", "each choice has options"),
        (BOX, "\"multi_discrete\", counts = [1000, 25]", "each choice has options"),
        (BOX, "\"multi_discrete\", counts = [4294967295, 2]", "each choice has options"),
        ("base = \"r\"", "base = \"s\"", "no reward `s`"),
        ("[\"near_m\", 1.0]", "[\"near_m\", true]", "part with its weight"),
        ("value = \"pushed_m\"", "value = \"goal_m\"", "`goal_m` is no scalar"),
        ("over = \"sum\"", "over = \"any\"", "`any` and `first` are of clauses"),
        ("over = \"first\", curve = false", "over = \"first\"", "curve = false"),
        ("at_least = -0.5", "at_least = nan", "a limit is a number"),
        ("at_least = -0.5", "at_lest = -0.5", "at_lest"),
        ("above = \"done\"", "above = \"goal_m\"", "`goal_m` is no scalar"),
        ("name = \"ever\"", "name = \"length\"", "a name of the engine's own"),
        ("name = \"share_there\"", "name = \"return_r\"", "two of the name `return_r`"),
        ("of = \"how_long\"", "of = \"so_long\"", "there is no number `so_long`"),
        ("per = \"length\"", "per = \"length\", take = \"max\"", "of means alone"),
        ("at_most = [0.0, 1.0]", "at_most = [1.0, 0.0]", "ascending numbers"),
        ("at_most = [0.0, 1.0], ", "", "ascending numbers"),
        ("name = \"small\"", "name = \"small\"\nheadline = \"never_ever\"", "the headline is no metric"),
        ("label = { part = \"pushed_m\"", "label = { part = \"kind\"", "no part `kind`"),
        ("weights = {", "weight = {", "weight"),
    ] {
        let error = refused(from, to);
        assert!(error.contains(problem), "{to}: {error}");
    }
}

#[test]
fn a_quotient_of_means_is_shown_beside_the_metrics() {
    let arm = Spec::built_in().iter().find(|spec| spec.name == "arm_point_nav").unwrap();
    let names = |metrics: Vec<Described>| metrics.into_iter().map(|metric| metric.name).collect::<Vec<_>>();
    assert_eq!(names(arm.shown()).last().unwrap(), "disturbance_per_success_m");
    assert!(!names(arm.charted()).contains(&"disturbance_per_success_m".to_owned()), "no rollout has it");
    let means =
        |success: f64| [("disturbance_m", 0.06), ("success", success)].map(|(name, mean)| (name.to_owned(), mean));
    let of = |success| arm.with_quotients(means(success).into()).get("disturbance_per_success_m").copied();
    assert_eq!((of(0.5), of(0.0)), (Some(0.12), None));
    let length_shown = arm.text().replacen("\"disturbance_per_success_m\"]", "\"failed_action_share\"]", 1);
    assert!(Spec::parse(&length_shown).unwrap_err().to_string().contains("neither a metric of training"));
}

#[test]
fn unlike_layouts_have_unlike_hashes() {
    let hash = |from: &str, to: &str| Spec::parse(&SMALL.replacen(from, to, 1)).unwrap().layout_hash();
    let same = small().layout_hash();
    assert_eq!(hash("Where it is.", "Where it lies."), same);
    let continues = |from: &str, to: &str| small().continues(&SMALL.replacen(from, to, 1));
    assert!(continues("Where it is.", "Where it lies.") && !continues("\"price\"", "1.0"));
    let former = SMALL.replacen("\"price\"", "1.0", 1);
    let named = format!("formerly = [\"{}\"]\n{SMALL}", crate::digest::sha256(former.as_bytes()));
    assert!(Spec::parse(&named).unwrap().continues(&former) && small().continues(&named));
    assert_eq!(hash("\"price\"", "1.0"), same);
    for (from, to) in
        [("goal_m", "goal_mm"), ("[3]", "[4]"), ("sums = 2, ", ""), ("[0.0, 2.0]", "[0.0, 2.0], [0.0, 1.0]")]
    {
        assert_ne!(hash(from, to), same, "{to}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(20_000))]

    /// Whatever bytes come: what passes has a reward that training can bear, and nothing that the task does not declare.
    #[test]
    fn what_passes_can_be_trained_on(words in proptest::collection::vec((0usize..48, any::<u32>()), 0..4)) {
        let arm = Spec::named("arm_point_nav").unwrap();
        let mut record = vec![0; arm.layout().bytes];
        for (place, word) in words {
            record[64 + 4 * place..][..4].copy_from_slice(&word.to_ne_bytes());
        }
        if Check::of(arm).record(&record, true).is_ok() {
            for name in ["r", "r_prime", "lagrangian"] {
                let reward = arm.composition(name, &[], &BTreeMap::new()).unwrap().of(parts(arm, &record), 15.0);
                prop_assert!(reward.abs() < 2e6, "{reward}");
            }
            let number = |name: &str| arm.channel(name).unwrap().1.number(&record);
            prop_assert!((0.0..=1e5).contains(&number("disturbance_m")));
            prop_assert!(number("target") < 12.0 && [0.0, 1.0].contains(&number("picked_up")));
            prop_assert!(record[232..256].iter().all(|&byte| byte == 0));
        }
    }
}

#[test]
fn numbers_that_a_task_does_not_declare_are_named() {
    let spec = small();
    let refused = |numbers: &[(&str, f32)], acted: bool| {
        Check::of(&spec).record(&record(&spec, numbers), acted).map_err(|error| error.to_string())
    };
    assert_eq!(refused(&[("near_m", -10.0), ("done", 1.0), ("kind", 1.0), ("goal_m", 100.0)], true), Ok(()));
    assert_eq!(refused(&[("near_m", 11.0)], false), Ok(()), "no action was taken");
    assert_eq!(
        refused(&[("near_m", 11.0)], true).unwrap_err(),
        "its near_m is 11, which cannot be: its range is -10 to 10"
    );
    assert_eq!(refused(&[("done", 0.5)], true).unwrap_err(), "its done is 0.5, which cannot be: its values are 0, 1");
    assert_eq!(refused(&[("kind", 2.0)], true).unwrap_err(), "its kind is 2, which cannot be: its range is 0 to 1");
    assert_eq!(refused(&[("goal_m", f32::NAN)], false).unwrap_err(), "its goal_m[0] is not finite");
    assert_eq!(refused(&[("pushed_m", f32::INFINITY)], true).unwrap_err(), "its pushed_m is not finite");
    let mut gap = record(&spec, &[]);
    gap[90] = 1;
    assert_eq!(
        Check::of(&spec).record(&gap, false).unwrap_err().to_string(),
        "its reserved byte is 1, which cannot be: it is 0"
    );
}

#[test]
fn a_mask_is_of_the_options_and_allows_one_of_each_choice() {
    let spec = |actions: &str, mask: &str| {
        let channel = "[[channels]]\nrole = \"mask\"\ndoc = \"\"";
        Spec::parse(&format!("name = \"masked\"\n[actions]\n{actions}\n{channel}\nname = \"legal\"\n{mask}\n"))
    };
    let [two, three] = ["kind = \"discrete\"\nnames = [\"a\", \"b\"]", "kind = \"multi_discrete\"\ncounts = [2, 3]"];
    let again = "[[channels]]\nname = \"again\"\nrole = \"mask\"\ndoc = \"\"\ndtype = \"u8\"\nshape = [2]";
    for (actions, mask, problem) in [
        (two, "dtype = \"u8\"\nshape = [3]", "its shape is how many options the actions have in all"),
        (two, "dtype = \"u8\"", "its shape is how many options"),
        (two, "dtype = \"i32\"\nshape = [2]", "a mask is u8"),
        (two, "dtype = \"u8\"\nshape = [2]\nrange = [0, 1]", "it has neither range, values nor names"),
        (two, &format!("dtype = \"u8\"\nshape = [2]\n{again}"), "channel `again`: a task has one mask"),
        (&format!("{two}\nsubsets = {{ some = [\"a\"] }}"), "dtype = \"u8\"\nshape = [2]", "without subsets"),
        ("kind = \"box\"\nbounds = [[-1, 1]]", "dtype = \"u8\"\nshape = [1]", "discrete or multi_discrete actions"),
    ] {
        let error = spec(actions, mask).unwrap_err().to_string();
        assert!(error.contains(problem), "{mask}: {error}");
    }
    let spec = spec(three, "dtype = \"u8\"\nshape = [5]").unwrap();
    let found = |mask: [u8; 5]| {
        let mut record = vec![0; spec.layout().bytes];
        record[spec.mask().unwrap().range()].copy_from_slice(&mask);
        let check = Check::of(&spec);
        check.record(&record, false).and_then(|()| check.choice(&record)).map_err(|error| error.to_string())
    };
    assert_eq!(found([0, 1, 1, 0, 0]), Ok(()));
    assert_eq!(found([0, 2, 1, 0, 0]).unwrap_err(), "its legal[1] is 2, which cannot be: its range is 0 to 1");
    for mask in [[0; 5], [0, 0, 1, 1, 1], [1, 1, 0, 0, 0]] {
        assert!(found(mask).unwrap_err().starts_with("its legal allows no option of a choice"), "{mask:?}");
    }
    let allowed = |chosen: [i32; 2]| {
        let action: Vec<u8> = chosen.iter().flat_map(|option| option.to_ne_bytes()).collect();
        spec.actions.allows(&[0, 1, 1, 0, 1], &action)
    };
    assert!(allowed([1, 0]) && allowed([1, 2]) && !allowed([0, 0]) && !allowed([1, 1]));
}
