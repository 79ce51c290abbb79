//! `orchestrator view` as a running process, and a client of it.

use crate::{Printed, Workshop, finish, signal, start};
use rustix::process::Signal;
use serde_json::Value;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::PathBuf;
use std::process::{Child, Command};
use std::time::Duration;

/// A viewer; interrupted when this is dropped.
#[derive(Debug)]
pub struct Viewer {
    child: Option<Child>,
    /// Its address, e.g. `127.0.0.1:8765`.
    pub address: String,
    /// What a request must show.
    pub token: String,
}

#[derive(Debug)]
pub struct Answer {
    pub status: u16,
    /// What comes after the head.
    pub body: Vec<u8>,
}

impl Answer {
    pub fn json(&self) -> Value {
        let text = String::from_utf8_lossy(&self.body);
        serde_json::from_slice(&self.body).unwrap_or_else(|error| panic!("{error}: {text}"))
    }
}

impl Workshop {
    /// Gives a command a home folder, `home`, and a desktop: it copies the file that it is asked to open to the path that
    /// comes back, and runs until that file is removed.
    pub fn with_desktop(&self, command: &mut Command) -> PathBuf {
        let script = "#!/bin/sh\ncp \"$1\" \"$0.new\" && mv \"$0.new\" \"$0.html\"\n\
                      while [ -e \"$1\" ]; do sleep 0.1; done\n";
        for folder in ["bin", "home"] {
            std::fs::create_dir(self.path(folder)).expect("a folder");
        }
        let opener = self.script("bin/xdg-open", script);
        let path = std::env::var("PATH").unwrap_or_default();
        command.env("PATH", format!("{}:{path}", self.path("bin").display())).env("HOME", self.path("home"));
        opener.with_extension("html")
    }
}

impl Viewer {
    /// Starts one in a workshop, on any port.
    pub fn start(workshop: &Workshop, arguments: &[&str]) -> Self {
        Self::of(workshop.orchestrator(&[&["view", "--port", "0"], arguments].concat()))
    }

    /// Starts this command, which is one.
    pub fn of(command: Command) -> Self {
        let mut child = start(command);
        let mut lines = BufReader::new(child.stdout.take().expect("a pipe")).lines();
        let line = lines.next().expect("a line").expect("text");
        let place = line.strip_prefix("view: http://").and_then(|place| place.split_once("/#token="));
        let (address, token) =
            place.map(|(address, token)| (address.to_owned(), token.to_owned())).expect("an address");
        Self { child: Some(child), address, token }
    }

    /// The address that it printed.
    pub fn page(&self) -> String {
        format!("http://{}/#token={}", self.address, self.token)
    }

    pub fn get(&self, path: &str) -> Answer {
        let token = &self.token;
        let mut stream = TcpStream::connect(&self.address).expect("the viewer listens");
        stream.set_read_timeout(Some(Duration::from_mins(3))).expect("a timeout");
        let headers = format!("Host: {}\r\nAuthorization: Bearer {token}\r\nConnection: close\r\n", self.address);
        write!(stream, "GET {path} HTTP/1.1\r\n{headers}\r\n").expect("it reads");
        let mut bytes = Vec::new();
        stream.read_to_end(&mut bytes).expect("an answer");
        let end = bytes.windows(4).position(|window| window == b"\r\n\r\n");
        let end = end.unwrap_or_else(|| panic!("{path}: the connection is closed after {} bytes", bytes.len()));
        let head = String::from_utf8_lossy(&bytes[..end]).to_ascii_lowercase();
        let status = head.split(' ').nth(1).and_then(|status| status.parse().ok()).expect("a status");
        let body = bytes.split_off(end + 4);
        let body = if head.contains("transfer-encoding: chunked") { unchunked(&body) } else { body };
        Answer { status, body }
    }

    pub fn json(&self, path: &str) -> Value {
        let answer = self.get(path);
        assert_eq!(answer.status, 200, "{path}: {}", String::from_utf8_lossy(&answer.body));
        answer.json()
    }

    /// Interrupts it; whether it ended well.
    pub fn stop(self) -> bool {
        self.end(Signal::INT).success
    }

    /// Ends it by a signal; what it printed.
    pub fn end(mut self, by: Signal) -> Printed {
        let child = self.child.take().expect("it is stopped once");
        signal(child.id(), by);
        finish(child)
    }

    /// Waits for its own end.
    pub fn wait(mut self) -> Printed {
        finish(self.child.take().expect("it is waited for once"))
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        if let Some(mut child) = self.child.take() {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// The content of a body that comes in chunks.
fn unchunked(mut body: &[u8]) -> Vec<u8> {
    let mut content = Vec::new();
    while let Some(end) = body.windows(2).position(|window| window == b"\r\n") {
        let size = usize::from_str_radix(&String::from_utf8_lossy(&body[..end]), 16).unwrap_or(0);
        let Some(chunk) = body.get(end + 2..end + 2 + size).filter(|_| size > 0) else { break };
        content.extend_from_slice(chunk);
        body = body.get(end + 4 + size..).unwrap_or_default();
    }
    content
}
