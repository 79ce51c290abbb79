//! A task that nobody has: its actions are numbers, it has neither images nor a robot with a pose.

use super::*;
use crate::declared::Declared;
use crate::form::Told;
use crate::recorder::message_writer::MessageWriter;
use crate::recorder::segment::{Preamble, Segments};
use proptest::prelude::*;
use prost_reflect::{DescriptorPool, DynamicMessage, Value};
use proto::record::{End, RecordHeader};
use proto::task::Spec;
use wire::message::{Line, ObservationHeader};

const TASK: &str = r#"
name = "made_up"
actions = { kind = "box", bounds = [[-1.0, 1.0], [0.0, 2.0]] }
rewards = [
    { name = "near", constant = -0.5, terms = [["nearer_m", 2.0]] },
    { name = "held_down", base = "near", terms = [["nearer_m", "multiplier"]] },
]
cost = { part = "nearer_m", weight = -1.0 }
channels = [
    { name = "nearer_m", role = "part", dtype = "f32", range = [-10, 10], doc = "Nearer." },
    { name = "offset", role = "outcome", dtype = "i32", range = [-100, 100], doc = "A negative number." },
    { name = "kinds", role = "outcome", dtype = "u8", shape = [2], names = ["square", "round"], doc = "Two names." },
    { name = "pair", role = "observation", dtype = "f64", shape = [2], range = [-1e9, 1e9], doc = "Two numbers." },
    { name = "ticks", role = "state", dtype = "u64", doc = "More than 32 bits." },
    { name = "counts", role = "state", dtype = "u16", shape = [3], doc = "Three counts." },
]
metrics = [
    { name = "round", over = "last", all_of = [{ channel = "offset", below = 0 }], doc = "It ended below 0." },
    { name = "way_m", over = "sum", value = "nearer_m", doc = "All of the way." },
]
"#;

fn made_up() -> Declared {
    let spec = Box::leak(Box::new(Spec::parse(TASK).unwrap()));
    Declared::task(spec, &BTreeMap::new()).unwrap()
}

/// A record after so many actions of the one episode, the third of which ends it.
fn record(spec: &Spec, step: u32) -> Vec<Line> {
    let layout = spec.layout();
    let mut lines = vec![Line([0; 64]); layout.bytes / 64];
    let bytes = Line::bytes_mut(&mut lines);
    let field = |name: &str| spec.channel(name).unwrap().1;
    layout.action.of_mut::<f32>(bytes).copy_from_slice(&[0.5, step as f32]);
    field("nearer_m").of_mut::<f32>(bytes)[0] = -0.25 * step as f32;
    field("offset").of_mut::<i32>(bytes)[0] = -7;
    field("kinds").of_mut::<u8>(bytes)[1] = 1;
    field("pair").of_mut::<f64>(bytes).copy_from_slice(&[1e-300, f64::from(step)]);
    field("ticks").of_mut::<u64>(bytes)[0] = u64::MAX - u64::from(step);
    field("counts").of_mut::<u16>(bytes).copy_from_slice(&[0, 300, 65_535]);
    let header = RecordHeader::of_mut(bytes);
    header.begin(0, 10, true);
    for step in 1..=step {
        header.act(10 + u64::from(step), (step == 3).then_some(End::Truncated));
    }
    lines
}

/// Three steps, as a recorder writes them.
fn recorded(folder: &Path) -> (Declared, PathBuf) {
    let config = Config::default();
    let preamble = Preamble { run_id: "made-up".to_owned(), host: 0, incarnation: 1, config: config.clone() };
    let segments = Segments::create(RunFolder::new(folder), preamble, 0).unwrap();
    let path = segments.files[0].clone();
    let declared = made_up();
    let shape = WireShape::new(Shares::of_one(1), 1, declared.spec);
    let spec = declared.spec;
    let mut message_writer = MessageWriter::new(segments, shape, 1, &config, declared);
    for step in 0..=3 {
        let header = ObservationHeader { step: step.into(), learner_incarnation: 1, ..Default::default() };
        message_writer.observations(u64::from(step), &header, &record(spec, step), step > 0).unwrap();
    }
    message_writer.segments().finish().unwrap();
    (made_up(), path)
}

#[test]
fn it_is_recorded_and_read_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let (declared, path) = recorded(folder.path());
    let said = said(&path, &declared);
    let steps: Vec<&Told> = those(&said, Carries::Step).collect();
    let layout = declared.spec.layout();
    for (number, told) in (1..).zip(&steps) {
        let (now, before) = (record(declared.spec, number), record(declared.spec, number - 1));
        let (now, before) = (Line::bytes(&now), Line::bytes(&before));
        for range in [layout.action.range(), layout.of_action.clone()] {
            assert_eq!(told.record[range.clone()], now[range], "step {number}");
        }
        assert!(told.seen && told.record[layout.seen.clone()] == before[layout.seen.clone()]);
        assert_eq!(told.rewards, [-0.5 - 0.5 * number as f32]);
        assert_eq!(told.engine.end(), (number == 3).then_some(End::Truncated));
    }
    let start = those(&said, Carries::Start).next().unwrap();
    assert!(start.engine.bulk_recorded && start.engine.state_hash == 10);
    let end = those(&said, Carries::End).next().unwrap();
    assert_eq!((end.engine.length, &end.returns), (3, &vec![Some(-4.5)]));
    assert_eq!(end.metrics, [Some(1.0), Some(-1.5)]);
    let topics: Vec<String> = messages(&path).into_keys().collect();
    assert_eq!(topics, ["/episode/end", "/episode/start", "/step"], "no image, no pose");
}

/// By a reader of protobuf that knows nothing of this program.
#[test]
fn its_messages_are_protobuf_for_others() {
    let folder = tempfile::tempdir().unwrap();
    let (declared, path) = recorded(folder.path());
    for spec in Spec::built_in().iter().chain([declared.spec]) {
        let forms = Declared::task(spec, &BTreeMap::new()).unwrap().forms;
        for form in [&forms.step, &forms.start, &forms.end] {
            let schema = form.schema();
            let pool = DescriptorPool::decode(&*schema.descriptor).unwrap();
            let fields = pool.get_message_by_name(&schema.name).unwrap();
            // A name of the engine's can be none of the task's.
            for field in fields.fields() {
                let text = TASK.replace("\"offset\"", &format!("{:?}", field.name()));
                let own =
                    spec.channel(field.name()).is_some() || spec.metrics.iter().any(|one| one.name == field.name());
                assert!(own || Spec::parse(&text).is_err(), "{}", field.name());
            }
        }
    }
    let schema = declared.forms.step.schema();
    let pool = DescriptorPool::decode(&*schema.descriptor).unwrap();
    let data = &messages(&path)["/step"][2];
    let step = DynamicMessage::decode(pool.get_message_by_name(&schema.name).unwrap(), &**data).unwrap();
    let value = |name: &str| step.get_field_by_name(name).unwrap().into_owned();
    let list = |values: &[Value]| Value::List(values.to_vec());
    assert_eq!(value("action"), list(&[Value::F32(0.5), Value::F32(3.0)]));
    assert_eq!(value("nearer_m"), Value::F32(-0.75));
    assert_eq!(value("offset"), Value::I32(-7));
    assert_eq!(value("kinds"), list(&[Value::EnumNumber(0), Value::EnumNumber(1)]));
    assert_eq!(value("pair"), list(&[Value::F64(1e-300), Value::F64(2.0)]));
    assert_eq!(value("ticks"), Value::U64(u64::MAX - 2));
    assert_eq!(value("counts"), list(&[Value::U32(0), Value::U32(300), Value::U32(65_535)]));
    assert_eq!((value("reward_near"), value("state_hash")), (Value::F32(-2.0), Value::U64(13)));
    assert_eq!((value("truncated"), value("step")), (Value::Bool(true), Value::U32(2)));
    assert!(step.unknown_fields().next().is_none());
}

proptest! {
    /// Whatever bytes a message has: it is read, or it is refused; and what is read is written the same.
    #[test]
    fn any_bytes_are_a_message_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..64)) {
        let declared = made_up();
        for form in [&declared.forms.step, &declared.forms.end] {
            let reading = crate::reading::Reading::of(form, &form.schema().descriptor).unwrap();
            if let Ok(told) = reading.read(&bytes) {
                let mut room = vec![];
                let again = form.write(&told, &mut room);
                prop_assert_eq!(format!("{:?}", reading.read(again).unwrap()), format!("{told:?}"));
            }
        }
    }
}
