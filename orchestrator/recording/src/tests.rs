//! Recordings as files of which something is missing or wrong: what is said of them.

mod shelved;

use super::declared::Declared;
use super::episodes::{Recorded, gather};
use super::form::{Carries, Told};
use super::reader::{Extent, RecordingError, read_with_trust};
use super::recorder::segment::{CONFIG_ATTACHMENT, IDENTITY_METADATA, RECORDING_VERSION, identity};
use super::repair::{Repair, repair};
use super::schema::Schema;
use super::schema::stillroom::StageSwitch;
use super::wanted::Wanted;
use mcap::Attachment;
use mcap::records::{MessageHeader, Metadata, Record};
use prost::Message;
use proto::config::Config;
use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

pub static ARM: LazyLock<Declared> = LazyLock::new(|| Declared::of(&Config::default()).unwrap());

/// One message of a recording.
pub type Said = (Carries, Told);

/// What the messages about episodes in a file say, in their order.
pub fn said(path: &Path, declared: &Declared) -> Vec<Said> {
    let (mut schemas, mut channels, mut said) = (HashMap::new(), HashMap::new(), vec![]);
    read::<RecordingError>(path, |record| {
        match record {
            Record::Schema { header, data } => drop(schemas.insert(header.id, data.into_owned())),
            Record::Channel(channel) => {
                if let Some((carries, form)) = declared.forms.of_topic(&channel.topic) {
                    let reading = super::reading::Reading::of(form, &schemas[&channel.schema_id]).unwrap();
                    channels.insert(channel.id, (carries, reading));
                }
            }
            Record::Message { header, data } => {
                if let Some((carries, reading)) = channels.get(&header.channel_id) {
                    said.push((*carries, reading.read(&data).unwrap()));
                }
            }
            _ => {}
        }
        Ok(())
    })
    .unwrap();
    said
}

/// Those on one topic.
pub fn those(said: &[Said], carries: Carries) -> impl Iterator<Item = &Told> {
    said.iter().filter(move |(of, _)| *of == carries).map(|(_, told)| told)
}

pub fn read<E: From<RecordingError>>(
    path: &Path,
    mut visit: impl FnMut(Record<'_>) -> Result<(), E>,
) -> Result<Extent, E> {
    read_with_trust(path, |record, _| visit(record))
}

/// Four episodes of three steps in one environment, the last one unfinished after two; under this learner.
fn episodes(learner_incarnation: u32) -> Vec<Said> {
    let mut said = Vec::new();
    for episode in 0..4 {
        let mut say = |carries: Carries, edit: &dyn Fn(&mut Told)| {
            let forms = &ARM.forms;
            let mut told = match carries {
                Carries::Start => forms.start.empty.clone(),
                Carries::Step => forms.step.empty.clone(),
                Carries::End => forms.end.empty.clone(),
            };
            let engine = &mut told.engine;
            (engine.kitchen, engine.episode, engine.incarnation) = (1, episode, 1);
            engine.learner_incarnation = learner_incarnation;
            edit(&mut told);
            said.push((carries, told));
        };
        say(Carries::Start, &|_| {});
        for step in 0..if episode == 3 { 2 } else { 3 } {
            let ended = step == 2;
            say(Carries::Step, &|told| (told.engine.step, told.engine.terminated) = (step, ended));
            if ended {
                say(Carries::End, &|told| (told.engine.length, told.engine.terminated) = (3, true));
            }
        }
    }
    said
}

fn step(episode: u32, step: u32) -> impl Fn(&Said) -> bool {
    move |(carries, told)| *carries == Carries::Step && (told.engine.episode, told.engine.step) == (episode, step)
}

fn end(episode: u32) -> impl Fn(&Said) -> bool {
    move |(carries, told)| *carries == Carries::End && told.engine.episode == episode
}

struct RecordingsFolder(tempfile::TempDir);

impl RecordingsFolder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    /// Writes a segment of the run's first incarnation; `edit` alters the configuration after the identity was made.
    fn segment(&self, segment: u32, config: &Config, said: &[Said], edit: impl Fn(String) -> String) -> PathBuf {
        self.staged(segment, config, said, edit, None, 0)
    }

    /// A segment from this time on, which begins with a stage of this reward, if any.
    fn staged(
        &self,
        segment: u32,
        config: &Config,
        said: &[Said],
        edit: impl Fn(String) -> String,
        reward: Option<&str>,
        begins_ns: u64,
    ) -> PathBuf {
        let path = self.0.path().join(format!("{segment}.mcap"));
        let mut writer = mcap::Writer::new(std::fs::File::create(&path).unwrap()).unwrap();
        let pairs = [
            (identity::RUN_ID, "run".to_owned()),
            (identity::INCARNATION, "1".to_owned()),
            (identity::SEGMENT, segment.to_string()),
            (identity::VERSION, RECORDING_VERSION.to_string()),
            (identity::SEED, config.seed.to_string()),
        ];
        let metadata = pairs.map(|(key, value)| (key.to_owned(), value)).into();
        writer.write_metadata(&Metadata { name: IDENTITY_METADATA.to_owned(), metadata }).unwrap();
        let config = edit(config.to_toml());
        let data = Cow::Borrowed(config.as_bytes());
        let (name, media_type) = (CONFIG_ATTACHMENT.to_owned(), "application/toml".to_owned());
        writer.attach(&Attachment { log_time: 0, create_time: 0, name, media_type, data }).unwrap();
        let forms = &ARM.forms;
        let forms = [("/step", &forms.step), ("/episode/start", &forms.start), ("/episode/end", &forms.end)];
        let channels = forms.map(|(topic, form)| {
            let described = form.schema();
            let schema = writer.add_schema(&described.name, "protobuf", &described.descriptor).unwrap();
            writer.add_channel(schema, topic, "protobuf", &BTreeMap::new()).unwrap()
        });
        if let Some(reward) = reward {
            let described = Schema::of("stillroom.StageSwitch");
            let schema = writer.add_schema(&described.name, "protobuf", &described.descriptor).unwrap();
            let channel_id = writer.add_channel(schema, "/stage", "protobuf", &BTreeMap::new()).unwrap();
            let header = MessageHeader { channel_id, sequence: 0, log_time: begins_ns, publish_time: begins_ns };
            let switch = StageSwitch { reward: reward.to_owned(), ..StageSwitch::default() };
            writer.write_to_known_channel(&header, &switch.encode_to_vec()).unwrap();
        }
        for (number, (carries, told)) in said.iter().enumerate() {
            let (channel_id, mut room) = (channels[*carries as usize], vec![]);
            let data = forms[*carries as usize].1.write(told, &mut room);
            let time = begins_ns + number as u64;
            let header = MessageHeader { channel_id, sequence: 0, log_time: time, publish_time: time };
            writer.write_to_known_channel(&header, data).unwrap();
        }
        writer.finish().unwrap();
        path
    }

    /// What is gathered of one segment that says this.
    fn of(&self, said: &[Said]) -> Recorded {
        gather(&[self.segment(0, &Config::default(), said, |config| config)], Wanted::default()).unwrap()
    }
}

fn without(gone: impl Fn(&Said) -> bool) -> Vec<Said> {
    episodes(1).into_iter().filter(|said| !gone(said)).collect()
}

fn same(config: String) -> String {
    config
}

#[test]
fn nothing_is_missing_of_a_recording_that_was_not_altered() {
    let recorded = RecordingsFolder::new().of(&episodes(1));
    assert_eq!((recorded.faults, recorded.damaged_files, recorded.headless), (Vec::new(), 0, 0));
    assert_eq!(recorded.episodes.len(), 4);
    assert!(recorded.from_the_start && recorded.complaints.is_empty());
}

#[test]
fn steps_ends_and_episodes_that_are_missing_are_named() {
    let episode_index = RecordingsFolder::new();
    let place = |episode: u32| format!("kitchen 1, environment 0, episode {episode}");
    let mut short = episodes(1);
    short.iter_mut().filter(|said| end(1)(said)).for_each(|(_, told)| told.engine.length = 2);
    let cases: Vec<(Vec<Said>, String)> = vec![
        (without(step(1, 2)), format!("{}: 1 of its 3 steps are missing at its end", place(1))),
        (without(step(1, 1)), format!("{}: step 1 is missing, and what comes after it cannot be replayed", place(1))),
        (without(end(2)), format!("{}: its message on /episode/end is missing", place(2))),
        (
            without(|said| step(2, 2)(said) || end(2)(said)),
            format!("{}: its steps from 2 on and its end are missing", place(2)),
        ),
        (short, format!("{}: it has 3 steps, but /episode/end says 2", place(1))),
        (without(|(_, told)| told.engine.episode == 1), format!("{}: not recorded, though episode 2 is", place(1))),
        (without(|(_, told)| told.engine.episode < 2), format!("{} to 1: not recorded, though episode 2 is", place(0))),
    ];
    for (said, fault) in cases {
        assert_eq!(episode_index.of(&said).faults, [fault]);
    }
    // An episode that runs when a recording ends has no end yet; where only failures are kept, others are not there.
    assert_eq!(episode_index.of(&without(step(3, 1))).faults, Vec::<String>::new());
    let mut config = Config::default();
    config.recording.failures_only = true;
    let said = without(|(_, told)| told.engine.episode < 2);
    let recorded = gather(&[episode_index.segment(0, &config, &said, same)], Wanted::default()).unwrap();
    assert_eq!(recorded.faults, Vec::<String>::new());
}

#[test]
fn what_a_rewind_made_void_is_not_missing() {
    // The learner goes back to the second step of episode 1 and stops there: episodes 2 and 3 are void.
    let mut said = episodes(1);
    said.extend(episodes(2).into_iter().filter(step(1, 1)));
    let recorded = RecordingsFolder::new().of(&said);
    assert_eq!(recorded.faults, Vec::<String>::new());
    let handed_out: Vec<_> = recorded.episodes.iter().map(|one| (one.episode, one.actions.len())).collect();
    assert_eq!(handed_out, [(0, 3), (1, 2)], "and nobody plays what never happened");
}

#[test]
fn a_segment_that_is_missing_is_named() {
    let (episode_index, config) = (RecordingsFolder::new(), Config::default());
    let [first, rest] = [&episodes(1)[..7], &episodes(1)[7..]];
    let files = [episode_index.segment(0, &config, first, same), episode_index.segment(2, &config, rest, same)];
    let recorded = gather(&files, Wanted::default()).unwrap();
    assert_eq!(recorded.faults, ["incarnation-001.001.mcap is missing"]);
    let last = gather(&files[1..], Wanted::default()).unwrap();
    assert!(!last.from_the_start);
    let second = episode_index.segment(1, &config, rest, same);
    let [first, _] = files;
    assert_eq!(gather(&[first, second], Wanted::default()).unwrap().faults, Vec::<String>::new());
}

#[test]
fn each_file_s_own_configuration_belongs_to_its_episodes() {
    let episode_index = RecordingsFolder::new();
    let seeded = |seed| Config { seed, ..Config::default() };
    let of = |episode: u32| without(move |(_, told)| told.engine.episode != episode);
    let files =
        [episode_index.segment(0, &seeded(1), &of(0), same), episode_index.segment(1, &seeded(2), &of(1), same)];
    let recorded = gather(&files, Wanted::default()).unwrap();
    assert_eq!((recorded.config_of, recorded.faults), (vec![0, 1], Vec::new()));
    assert!(recorded.configs[0].contains("seed = 1") && recorded.configs[1].contains("seed = 2"));

    // One episode under two: its beginning is kept, and what has changed is named.
    let cut: Vec<Said> = of(0).into_iter().filter(|said| said.0 != Carries::Start && !step(0, 0)(said)).collect();
    let begun: Vec<Said> = of(0).into_iter().take(2).collect();
    let files = [episode_index.segment(0, &seeded(1), &begun, same), episode_index.segment(1, &seeded(2), &cut, same)];
    let recorded = gather(&files, Wanted::default()).unwrap();
    assert_eq!(recorded.episodes[0].actions.len(), 1);
    let fault =
        "kitchen 1, environment 0, episode 0: from step 1 on under another configuration (seed = 2 instead of 1)";
    assert_eq!(recorded.faults, [fault]);
    // Another budget is no other world.
    let mut longer = seeded(1);
    longer.stages[0].frames += 1;
    let files = [episode_index.segment(0, &seeded(1), &begun, same), episode_index.segment(1, &longer, &cut, same)];
    let recorded = gather(&files, Wanted::default()).unwrap();
    assert_eq!((recorded.episodes[0].actions.len(), recorded.faults), (3, Vec::new()));
}

#[test]
fn a_configuration_that_is_not_the_one_recorded_under_is_refused() {
    let episode_index = RecordingsFolder::new();
    let edited =
        episode_index.segment(0, &Config::default(), &episodes(1), |config| config.replace("seed = 1\n", "seed = 2\n"));
    let refused = gather(&[edited], Wanted::default()).unwrap_err().to_string();
    assert!(refused.contains("recorded with seed 1, but its configuration says 2"), "{refused}");
}

/// Alters one byte of the configuration in a file.
fn alter_configuration(path: &Path) {
    let mut bytes = std::fs::read(path).unwrap();
    let place = bytes.windows(5).position(|five| five == b"seed ").unwrap();
    bytes[place] ^= 1;
    std::fs::write(path, bytes).unwrap();
}

#[test]
fn a_damaged_configuration_is_taken_from_where_it_is_whole() {
    let (episode_index, config) = (RecordingsFolder::new(), Config::default());
    let files = [
        episode_index.segment(0, &config, &episodes(1)[..7], same),
        episode_index.segment(1, &config, &episodes(1)[7..], same),
    ];
    alter_configuration(&files[0]);
    let recorded = gather(&files, Wanted::default()).unwrap();
    assert_eq!((recorded.episodes.len(), recorded.configs.len()), (4, 1));
    assert_eq!(recorded.damaged_files, 1);
    let alone = gather(&files[..1], Wanted::default()).unwrap_err().to_string();
    assert!(alone.contains("0.mcap") && alone.contains("give the run's folder"), "{alone}");
    // In a run's folder that folder has it.
    let recordings = episode_index.0.path().join("recordings");
    std::fs::create_dir(&recordings).unwrap();
    std::fs::write(episode_index.0.path().join("config.toml"), config.to_toml()).unwrap();
    let moved = recordings.join("0.mcap");
    std::fs::copy(&files[0], &moved).unwrap();
    assert_eq!(gather(&[moved], Wanted::default()).unwrap().configs, [config.to_toml()]);
}

#[test]
fn a_file_that_is_being_written_is_called_that_and_not_damaged() {
    let episode_index = RecordingsFolder::new();
    let path = episode_index.segment(0, &Config::default(), &episodes(1), same);
    let writer = std::fs::File::options().write(true).open(&path).unwrap();
    let length = writer.metadata().unwrap().len();
    writer.set_len(length - 100).unwrap();
    writer.try_lock().unwrap();
    let recorded = gather(std::slice::from_ref(&path), Wanted::default()).unwrap();
    assert_eq!(recorded.damaged_files, 0);
    assert!(recorded.complaints[0].ends_with("is being written: read up to message 18"), "{:?}", recorded.complaints);
    assert!(repair(&path, None).unwrap_err().to_string().contains("is still being written"));
    drop(writer);
    let recorded = gather(std::slice::from_ref(&path), Wanted::default()).unwrap();
    assert!(recorded.complaints[0].contains("was cut off"), "{:?}", recorded.complaints);
    // Its messages are all there, but no replay calls such a file complete.
    assert!(recorded.complaints[0].contains("nothing was lost"), "{:?}", recorded.complaints);
    assert_eq!(recorded.damaged_files, 1);
}

#[test]
fn a_repaired_file_says_what_it_lost_and_is_never_called_complete_by_a_replay() {
    let episode_index = RecordingsFolder::new();
    let path = episode_index.segment(0, &Config::default(), &episodes(1), same);
    alter_configuration(&path);
    let Repair::Repaired { extent, .. } = repair(&path, None).unwrap() else { panic!("it is damaged") };
    assert!(extent.is_incomplete());
    assert!(extent.complaints(&path).iter().any(|line| line.contains("checksum of attachment `config.toml`")));
    let again = episode_index.segment(1, &Config::default(), &[], same);
    let recorded = gather(&[path, again], Wanted::default()).unwrap();
    assert_eq!(recorded.damaged_files, 1);
    assert!(recorded.complaints[0].contains("was repaired, and not all was there"), "{:?}", recorded.complaints);
    assert_eq!(recorded.episodes.len(), 4);
}

/// Recordings of before, whose fields were those of one task.
#[test]
fn an_older_recording_is_refused_with_the_version_that_reads_it() {
    let episode_index = RecordingsFolder::new();
    let path = episode_index.segment(0, &Config::default(), &episodes(1), same);
    let bytes = std::fs::read(&path).unwrap();
    let key = b"schema_version";
    let place = bytes.windows(key.len()).position(|window| window == key).unwrap() + key.len() + 4;
    assert_eq!(bytes[place], b'4');
    let refused = |version: u8| {
        let mut other = bytes.clone();
        other[place] = version;
        std::fs::write(&path, other).unwrap();
        gather(std::slice::from_ref(&path), Wanted::default()).unwrap_err().to_string()
    };
    assert!(
        refused(b'3').ends_with("recorded by an older version; the programs of commit 0e4cae3e and before read it")
    );
    assert!(refused(b'5').contains("it has version 5, this program reads 4"));
}

/// What was recorded under another declaration has no digests to compare: it is refused by the field's name.
#[test]
fn a_recording_without_a_channel_of_the_task_is_refused_by_its_name() {
    let spec = proto::task::Spec::parse(&ARM.spec.text().replace("\"farthest_m\"", "\"nearest_m\"")).unwrap();
    let other = Declared::task(Box::leak(Box::new(spec)), &BTreeMap::new()).unwrap();
    let refused = super::reading::Reading::of(&ARM.forms.step, &other.forms.step.schema().descriptor).unwrap_err();
    assert!(refused.to_string().contains("no field `farthest_m` as the task declares it"), "{refused}");
}
