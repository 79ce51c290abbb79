//! Foxglove's WebSocket protocol, the part that a server needs which only sends: what it offers, what a client wants of it, and
//! the messages. Pure. Described at <https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md>.

use crate::feed::{Recorded, Topic};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::sync::Arc;

/// Names of the protocol, the newest first: what we use of it is the same in both.
const NAMES: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
const MESSAGE_DATA: u8 = 1;
const SUBSCRIPTIONS: usize = 4096;

pub fn agreed(offered: &str) -> Option<&'static str> {
    let offered: Vec<&str> = offered.split(',').map(str::trim).collect();
    NAMES.into_iter().find(|name| offered.contains(name))
}

#[derive(Debug, Serialize)]
#[serde(tag = "op", rename_all = "camelCase")]
enum Told<'a> {
    #[serde(rename_all = "camelCase")]
    ServerInfo {
        name: &'a str,
        capabilities: [&'a str; 0],
        session_id: &'a str,
    },
    Advertise {
        channels: Vec<Channel<'a>>,
    },
    #[serde(rename_all = "camelCase")]
    Unadvertise {
        channel_ids: Vec<u64>,
    },
}

#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
struct Channel<'a> {
    id: u64,
    topic: &'a str,
    encoding: &'a str,
    schema_name: &'a str,
    schema_encoding: &'a str,
    schema: String,
}

#[derive(Debug, Deserialize)]
#[serde(tag = "op", rename_all = "camelCase")]
enum Asked {
    Subscribe {
        subscriptions: Vec<Subscription>,
    },
    #[serde(rename_all = "camelCase")]
    Unsubscribe {
        subscription_ids: Vec<u32>,
    },
    #[serde(other)]
    Other,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
struct Subscription {
    id: u32,
    channel_id: u64,
}

#[derive(Debug, Default)]
pub struct Subscriptions {
    channels: HashMap<String, (u64, Arc<Topic>)>,
    last: u64,
    wanted: HashMap<u32, u64>,
    is_new: bool,
}

impl Subscriptions {
    pub fn greeting(name: &str, session_id: &str) -> String {
        crate::answer::text(&Told::ServerInfo { name, capabilities: [], session_id })
    }

    /// Messages that offer the topics that were not offered yet. One that carries something else than before is another
    /// channel.
    pub fn offer(&mut self, topics: &[Arc<Topic>]) -> Vec<String> {
        let is_known = |topic: &&Arc<Topic>| self.channels.get(&topic.name).is_some_and(|(_, known)| known == *topic);
        let new: Vec<Arc<Topic>> = topics.iter().filter(|topic| !is_known(topic)).cloned().collect();
        if new.is_empty() {
            return Vec::new();
        }
        let (mut channels, mut channel_ids) = (Vec::new(), Vec::new());
        for topic in &new {
            self.last += 1;
            if let Some((void, _)) = self.channels.insert(topic.name.clone(), (self.last, Arc::clone(topic))) {
                self.wanted.retain(|_, channel| *channel != void);
                channel_ids.push(void);
            }
            channels.push(Channel {
                id: self.last,
                topic: &topic.name,
                encoding: &topic.encoding,
                schema_name: &topic.schema_name,
                schema_encoding: &topic.schema_encoding,
                schema: STANDARD.encode(&topic.schema),
            });
        }
        let void = (!channel_ids.is_empty()).then(|| crate::answer::text(&Told::Unadvertise { channel_ids }));
        void.into_iter().chain([crate::answer::text(&Told::Advertise { channels })]).collect()
    }

    pub fn take(&mut self, text: &str) {
        match serde_json::from_str(text) {
            Ok(Asked::Subscribe { subscriptions }) => {
                for Subscription { id, channel_id } in subscriptions {
                    let is_offered = self.channels.values().any(|(channel, _)| *channel == channel_id);
                    if is_offered && self.wanted.len() < SUBSCRIPTIONS {
                        self.wanted.insert(id, channel_id);
                        self.is_new = true;
                    }
                }
            }
            Ok(Asked::Unsubscribe { subscription_ids }) => {
                self.wanted.retain(|id, _| !subscription_ids.contains(id));
            }
            Ok(Asked::Other) | Err(_) => {}
        }
    }

    pub fn wants(&self, topic: &Topic) -> bool {
        self.subscriptions(&topic.name).next().is_some()
    }

    pub fn has_newcomers(&mut self) -> bool {
        std::mem::take(&mut self.is_new)
    }

    pub fn messages(&self, recorded: &Recorded) -> Vec<Vec<u8>> {
        let message = |id: u32| {
            let mut bytes = Vec::with_capacity(13 + recorded.data.len());
            bytes.push(MESSAGE_DATA);
            bytes.extend(id.to_le_bytes());
            bytes.extend(recorded.at_ns.to_le_bytes());
            bytes.extend(&recorded.data);
            bytes
        };
        self.subscriptions(&recorded.topic.name).map(message).collect()
    }

    fn subscriptions(&self, topic: &str) -> impl Iterator<Item = u32> + '_ {
        let channel = self.channels.get(topic).map(|(channel, _)| *channel);
        self.wanted.iter().filter(move |(_, wanted)| Some(**wanted) == channel).map(|(id, _)| *id)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    fn topic(name: &str, schema: &[u8]) -> Arc<Topic> {
        Arc::new(Topic {
            name: name.to_owned(),
            encoding: "protobuf".to_owned(),
            schema_name: "a.B".to_owned(),
            schema_encoding: "protobuf".to_owned(),
            schema: schema.to_vec(),
        })
    }

    fn parsed(text: &str) -> Value {
        serde_json::from_str(text).unwrap()
    }

    #[test]
    fn the_newest_protocol_that_both_know_is_agreed_on() {
        assert_eq!(agreed("foxglove.websocket.v1, foxglove.sdk.v1"), Some("foxglove.sdk.v1"));
        assert_eq!(agreed("foxglove.websocket.v1"), Some("foxglove.websocket.v1"));
        assert_eq!(agreed("foxglove.sdk.v1.1"), None);
        assert_eq!(agreed(""), None);
    }

    #[test]
    fn messages_are_as_the_protocol_describes_them() {
        let greeting = parsed(&Subscriptions::greeting("Stillroom", "a/1"));
        assert_eq!(greeting, json!({"op": "serverInfo", "name": "Stillroom", "capabilities": [], "sessionId": "a/1"}));
        let mut subscriptions = Subscriptions::default();
        let [offer] = &subscriptions.offer(&[topic("/step", b"\x00\xff")])[..] else { panic!("one message") };
        let channel = json!({"id": 1, "topic": "/step", "encoding": "protobuf", "schemaName": "a.B",
            "schemaEncoding": "protobuf", "schema": "AP8="});
        assert_eq!(parsed(offer), json!({"op": "advertise", "channels": [channel]}));
        subscriptions.take(r#"{"op": "subscribe", "subscriptions": [{"id": 7, "channelId": 1}]}"#);
        let recorded = Recorded { topic: topic("/step", b""), at_ns: 0x0102, data: vec![9, 8] };
        assert_eq!(subscriptions.messages(&recorded), [[1, 7, 0, 0, 0, 2, 1, 0, 0, 0, 0, 0, 0, 9, 8]]);
    }

    #[test]
    fn only_what_is_wanted_is_told_and_only_what_is_new_is_offered() {
        let mut subscriptions = Subscriptions::default();
        let (step, log) = (topic("/step", b"1"), topic("/log", b"1"));
        assert_eq!(subscriptions.offer(&[Arc::clone(&step), Arc::clone(&log)]).len(), 1);
        assert!(subscriptions.offer(&[Arc::clone(&step), Arc::clone(&log)]).is_empty());
        for nonsense in ["", "{}", "[]", r#"{"op": "subscribe"}"#, r#"{"op": "getParameters", "id": "1"}"#] {
            subscriptions.take(nonsense);
        }
        subscriptions
            .take(r#"{"op": "subscribe", "subscriptions": [{"id": 0, "channelId": 2}, {"id": 1, "channelId": 3}]}"#);
        assert!(
            !subscriptions.wants(&step)
                && subscriptions.wants(&log)
                && subscriptions.has_newcomers()
                && !subscriptions.has_newcomers()
        );
        // A newer version of the program goes on with the run.
        let other = topic("/log", b"2");
        let changed = subscriptions.offer(&[step, Arc::clone(&other)]);
        let [void, offer] = &changed[..] else { panic!("{changed:?}") };
        assert_eq!(parsed(void), json!({"op": "unadvertise", "channelIds": [2]}));
        assert_eq!(parsed(offer)["channels"][0]["id"], 3);
        assert!(!subscriptions.wants(&other));
        subscriptions.take(r#"{"op": "subscribe", "subscriptions": [{"id": 0, "channelId": 3}]}"#);
        assert!(subscriptions.wants(&other));
        subscriptions.take(r#"{"op": "unsubscribe", "subscriptionIds": [0]}"#);
        assert!(!subscriptions.wants(&other));
    }
}
