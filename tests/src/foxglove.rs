//! A client of Foxglove's WebSocket protocol, from its description: frames of RFC 6455 by hand.

use crate::DEADLINE;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::Value;
use std::collections::{BTreeMap, VecDeque};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

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
    stream: TcpStream,
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

// Kinds of frames.
const TEXT: u8 = 1;
const PING: u8 = 9;
const PONG: u8 = 10;
/// What is drawn for a client is drawn at a low priority: on a busy machine that takes its time.
const PATIENCE: Duration = DEADLINE.saturating_mul(2);

impl Foxglove {
    /// Opens one; the refusal's status where there is none.
    pub fn connect(address: &str, path: &str, token: &str) -> Result<Self, u16> {
        let mut stream = TcpStream::connect(address).expect("the viewer listens");
        stream.set_read_timeout(Some(Duration::from_mins(2))).expect("a timeout");
        let join = if path.contains('?') { '&' } else { '?' };
        // The example of RFC 6455.
        let request = format!(
            "GET {path}{join}token={token} HTTP/1.1\r\nHost: {address}\r\nConnection: keep-alive, Upgrade\r\nUpgrade: websocket\r\n\
             Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
             Sec-WebSocket-Protocol: foxglove.sdk.v1, foxglove.websocket.v1\r\n\r\n"
        );
        stream.write_all(request.as_bytes()).expect("it reads");
        let mut head = Vec::new();
        while !head.ends_with(b"\r\n\r\n") {
            let mut byte = [0];
            stream.read_exact(&mut byte).expect("an answer");
            head.push(byte[0]);
        }
        let head = String::from_utf8_lossy(&head).to_ascii_lowercase();
        let status = head.split(' ').nth(1).and_then(|status| status.parse().ok()).expect("a status");
        if status != 101 {
            return Err(status);
        }
        assert!(head.contains("sec-websocket-accept: s3pplmbitxaq9kygzzhzrbk+xoo="), "{head}");
        assert!(head.contains("sec-websocket-protocol: foxglove.sdk.v1\r"), "{head}");
        let (channels, topics, waiting) = (BTreeMap::new(), BTreeMap::new(), VecDeque::new());
        Ok(Self { stream, begun: Instant::now(), channels, name: String::new(), next: 0, topics, waiting })
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
        self.say(&serde_json::json!({ "op": "subscribe", "subscriptions": [subscription] }));
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
        self.send(PING, b"");
        while self.receive() != PONG {}
    }

    /// Takes what comes next; its kind.
    fn receive(&mut self) -> u8 {
        // Some topics have a message each second, also while others have none.
        assert!(self.begun.elapsed() < PATIENCE, "what is awaited did not come within {} s", PATIENCE.as_secs());
        let (kind, content) = self.frame();
        match kind {
            PONG => {}
            TEXT => self.take(&serde_json::from_slice(&content).expect("JSON")),
            2 => {
                assert_eq!(content[0], 1, "a message of a channel");
                let subscription = u32::from_le_bytes(content[1..5].try_into().expect("four"));
                let at_ns = u64::from_le_bytes(content[5..13].try_into().expect("eight"));
                let topic = self.topics[&subscription].clone();
                self.waiting.push_back((topic, at_ns, content[13..].to_vec()));
            }
            kind => panic!("a frame of kind {kind}"),
        }
        kind
    }

    fn take(&mut self, told: &Value) {
        let text = |value: &Value| value.as_str().expect("a text").to_owned();
        match told["op"].as_str() {
            Some("serverInfo") => self.name = text(&told["name"]),
            Some("advertise") => {
                for channel in told["channels"].as_array().expect("channels") {
                    assert_eq!(
                        (&channel["encoding"], &channel["schemaEncoding"]),
                        (&"protobuf".into(), &"protobuf".into())
                    );
                    let schema = STANDARD.decode(channel["schema"].as_str().expect("a schema")).expect("base64");
                    let id = channel["id"].as_u64().expect("a number");
                    let offered = Channel { id, schema_name: text(&channel["schemaName"]), schema };
                    self.channels.insert(text(&channel["topic"]), offered);
                }
            }
            other => panic!("{other:?}"),
        }
    }

    fn frame(&mut self) -> (u8, Vec<u8>) {
        let mut read = |count: usize| {
            let mut bytes = vec![0; count];
            self.stream.read_exact(&mut bytes).expect("a frame");
            bytes
        };
        let head = read(2);
        assert_eq!(head[0] & 0xf0, 0x80, "frames are whole");
        let length = match head[1] {
            126 => usize::from(u16::from_be_bytes(read(2).try_into().expect("two"))),
            127 => u64::from_be_bytes(read(8).try_into().expect("eight")) as usize,
            length => usize::from(length),
        };
        (head[0] & 0x0f, read(length))
    }

    fn say(&mut self, value: &Value) {
        self.send(TEXT, value.to_string().as_bytes());
    }

    fn send(&mut self, kind: u8, content: &[u8]) {
        let length = u8::try_from(content.len()).ok().filter(|length| *length < 126).expect("a short text");
        // Masked, as clients must; with zeros.
        let mut frame = vec![0x80 | kind, 0x80 | length];
        frame.extend([0; 4]);
        frame.extend(content);
        self.stream.write_all(&frame).expect("it reads");
    }
}
