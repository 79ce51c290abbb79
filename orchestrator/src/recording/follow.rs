//! A run's newest recording as it grows: every message that is new in it, as it was recorded.

use super::episode_index::{Next, each_record, next};
use super::is_growing;
use mcap::records::Record;
use proto::run_folder::RunFolder;
use std::borrow::Cow;
use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};
use view::feed::{Recorded, Topic};

pub struct Follower {
    folder: RunFolder,
    file: Option<(PathBuf, u64)>,
    schemas: HashMap<u16, (String, String, Vec<u8>)>,
    topics: HashMap<u16, Arc<Topic>>,
    caught_up: bool,
    /// Until then the newest message of each topic.
    latest: HashMap<String, Recorded>,
}

enum Read {
    Messages(Vec<Recorded>),
    NotYet,
    End,
}

impl Follower {
    pub fn of(folder: RunFolder) -> Self {
        Self {
            folder,
            file: None,
            schemas: HashMap::new(),
            topics: HashMap::new(),
            caught_up: false,
            latest: HashMap::new(),
        }
    }

    /// Reads on for about as long as this. Of what was there before the first call only the newest message of each topic
    /// is returned.
    pub fn read(&mut self, patience: Duration) -> Vec<Recorded> {
        let began = Instant::now();
        let mut told = Vec::new();
        while began.elapsed() < patience {
            match self.record() {
                Read::Messages(found) if self.caught_up => told.extend(found),
                Read::Messages(found) => {
                    self.latest.extend(found.into_iter().map(|recorded| (recorded.topic.name.clone(), recorded)));
                }
                Read::NotYet => break,
                Read::End => {
                    if !std::mem::replace(&mut self.caught_up, true) {
                        told = std::mem::take(&mut self.latest).into_values().collect();
                        told.sort_by_key(|recorded| recorded.at_ns);
                    }
                    break;
                }
            }
        }
        told
    }

    pub fn topics(&self) -> Vec<Arc<Topic>> {
        let mut topics: Vec<Arc<Topic>> = self.topics.values().cloned().collect();
        topics.sort_by(|a, b| a.name.cmp(&b.name));
        topics
    }

    fn record(&mut self) -> Read {
        let Ok(files) = super::files_in(&self.folder) else { return Read::NotYet };
        let mut files: Vec<PathBuf> = files.into_iter().map(|item| item.path).collect();
        // Each host writes a sequence of files of its own: one host's is followed, host 0's if it has any.
        let host = self.file.as_ref().map_or(&files[0], |(path, _)| path).parent().map(std::path::Path::to_owned);
        files.retain(|file| file.parent() == host.as_deref());
        let Some(last) = files.last() else { return Read::NotYet };
        let (path, offset) = match self.file.clone() {
            Some(known) => known,
            None => self.begin(last.clone()),
        };
        match self.folder.open(&path).and_then(|file| next(&file, offset, file.metadata()?.len())) {
            Ok(Next::Chunk(body, end)) => match self.messages(&body) {
                Some(found) => self.go_on(path, end, found),
                // A flush that is seen half is whole a moment later; a damaged chunk never is.
                None if is_growing(&self.folder, &path) => Read::NotYet,
                None => self.go_on(path, end, Vec::new()),
            },
            Ok(Next::Other(end)) => self.go_on(path, end, Vec::new()),
            Ok(Next::End | Next::Damaged) | Err(_) if path != *last => {
                let following = files.iter().position(|file| *file == path).and_then(|at| files.get(at + 1));
                self.begin(following.unwrap_or(last).clone());
                Read::Messages(Vec::new())
            }
            Ok(Next::End | Next::Damaged) | Err(_) => Read::End,
        }
    }

    fn go_on(&mut self, path: PathBuf, offset: u64, found: Vec<Recorded>) -> Read {
        self.file = Some((path, offset));
        Read::Messages(found)
    }

    fn begin(&mut self, path: PathBuf) -> (PathBuf, u64) {
        self.schemas.clear();
        self.topics.clear();
        let begun = (path, mcap::MAGIC.len() as u64);
        self.file = Some(begun.clone());
        begun
    }

    fn messages(&mut self, body: &[u8]) -> Option<Vec<Recorded>> {
        let mut found = Vec::new();
        each_record(body, |record| match record {
            Record::Schema { header, data } => {
                self.schemas.insert(header.id, (header.name, header.encoding, Cow::into_owned(data)));
            }
            Record::Channel(channel) => {
                let schema = self.schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                let (schema_name, schema_encoding, schema) = schema;
                let encoding = channel.message_encoding;
                let topic = Topic { name: channel.topic, encoding, schema_name, schema_encoding, schema };
                self.topics.insert(channel.id, Arc::new(topic));
            }
            Record::Message { header, data } => {
                if let Some(topic) = self.topics.get(&header.channel_id) {
                    let topic = Arc::clone(topic);
                    found.push(Recorded { topic, at_ns: header.log_time, data: data.into_owned() });
                }
            }
            _ => {}
        })?;
        Some(found)
    }
}
