//! A client of Foxglove's WebSocket protocol, from its description.

use crate::DEADLINE;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::Value;
use std::collections::{BTreeMap, VecDeque};
use std::net::TcpStream;
use std::time::{Duration, Instant};
use tungstenite::{ClientRequestBuilder, Error, HandshakeError, Message, WebSocket};

#[derive(Debug, Clone)]
pub struct Channel {
    pub id: u64,
    /// What its messages are called.
    pub schema_name: String,
    /// A set of descriptors of protobuf.
    pub schema: Vec<u8>,
}

#[derive(Debug)]
pub struct Foxglove {
    socket: WebSocket<TcpStream>,
    begun: Instant,
    pub channels: BTreeMap<String, Channel>,
    /// What the server is called.
    pub name: String,
    next: u32,
    topics: BTreeMap<u32, String>,
    /// What came while something else was awaited.
    waiting: VecDeque<Told>,
}

/// A message: its topic, when it was recorded (nanoseconds), its content.
type Told = (String, u64, Vec<u8>);

/// What is drawn for a client is drawn at a low priority: on a busy machine that takes its time.
const PATIENCE: Duration = DEADLINE.saturating_mul(2);

impl Foxglove {
    /// Opens one; the refusal's status where there is none.
    pub fn connect(address: &str, path: &str, token: &str) -> Result<Self, u16> {
        let stream = TcpStream::connect(address).expect("the viewer listens");
        stream.set_read_timeout(Some(Duration::from_mins(2))).expect("a timeout");
        let join = if path.contains('?') { '&' } else { '?' };
        let address = format!("ws://{address}{path}{join}token={token}").parse().expect("an address");
        let mut request = ClientRequestBuilder::new(address);
        for protocol in ["foxglove.sdk.v1", "foxglove.websocket.v1"] {
            request = request.with_sub_protocol(protocol);
        }
        match tungstenite::client(request, stream) {
            Ok((socket, answer)) => {
                assert_eq!(answer.headers()["sec-websocket-protocol"], "foxglove.sdk.v1");
                let (channels, topics, waiting) = (BTreeMap::new(), BTreeMap::new(), VecDeque::new());
                Ok(Self { socket, begun: Instant::now(), channels, name: String::new(), next: 0, topics, waiting })
            }
            Err(HandshakeError::Failure(Error::Http(refusal))) => Err(refusal.status().as_u16()),
            Err(error) => panic!("{error}"),
        }
    }

    /// Waits until this topic is offered, and subscribes to it.
    pub fn subscribe(&mut self, topic: &str) -> Channel {
        while !self.channels.contains_key(topic) {
            self.receive();
        }
        let channel = self.channels[topic].clone();
        self.next += 1;
        self.topics.insert(self.next, topic.to_owned());
        let subscription = serde_json::json!({ "id": self.next, "channelId": channel.id });
        let text = serde_json::json!({ "op": "subscribe", "subscriptions": [subscription] }).to_string();
        self.socket.send(Message::text(text)).expect("it reads");
        channel
    }

    /// The next message.
    pub fn message(&mut self) -> Told {
        loop {
            if let Some(message) = self.waiting.pop_front() {
                return message;
            }
            self.receive();
        }
    }

    /// Waits until the server has taken all that was said to it: it answers in order.
    pub fn settle(&mut self) {
        self.socket.send(Message::Ping(Vec::new().into())).expect("it reads");
        while !self.receive() {}
    }

    /// Takes what comes next; whether it answers a ping.
    fn receive(&mut self) -> bool {
        // Some topics have a message each second, also while others have none.
        assert!(self.begun.elapsed() < PATIENCE, "what is awaited did not come within {} s", PATIENCE.as_secs());
        match self.socket.read().expect("a message") {
            Message::Pong(_) => return true,
            Message::Text(text) => self.take(&serde_json::from_str(&text).expect("JSON")),
            Message::Binary(content) => {
                assert_eq!(content[0], 1, "a message of a channel");
                let subscription = u32::from_le_bytes(content[1..5].try_into().expect("four"));
                let at_ns = u64::from_le_bytes(content[5..13].try_into().expect("eight"));
                let topic = self.topics[&subscription].clone();
                self.waiting.push_back((topic, at_ns, content[13..].to_vec()));
            }
            other => panic!("{other:?}"),
        }
        false
    }

    fn take(&mut self, told: &Value) {
        let text = |value: &Value| value.as_str().expect("a text").to_owned();
        match told["op"].as_str() {
            Some("serverInfo") => self.name = text(&told["name"]),
            Some("advertise") => {
                for channel in told["channels"].as_array().expect("channels") {
                    assert_eq!([&channel["encoding"], &channel["schemaEncoding"]], ["protobuf"; 2]);
                    let schema = STANDARD.decode(text(&channel["schema"])).expect("base64");
                    let id = channel["id"].as_u64().expect("a number");
                    let offered = Channel { id, schema_name: text(&channel["schemaName"]), schema };
                    self.channels.insert(text(&channel["topic"]), offered);
                }
            }
            other => panic!("{other:?}"),
        }
    }
}
