//! How two orchestrators that meet prove that they belong to the same run, before either believes anything else: the guest
//! says which host it is, both draw random words, first the door proves the token and then the guest.

use super::link::{receive, send};
use super::token::{Drawn, Token, draw};
use serde::{Deserialize, Serialize};
use std::net::TcpStream;
use std::time::Instant;

const VERSION: u32 = 3;
/// The most that is read of one who has proved nothing.
const STRANGER: usize = 2048;

#[derive(Debug, Serialize, Deserialize)]
struct Hello {
    version: u32,
    host: u32,
    drawn: String,
}

#[derive(Debug, Serialize, Deserialize)]
struct Challenge {
    version: u32,
    drawn: String,
    proof: String,
}

#[derive(Debug, Serialize, Deserialize)]
struct Answer {
    proof: String,
}

#[derive(Debug, thiserror::Error)]
pub enum HandshakeError {
    #[error("{0}")]
    Connection(#[from] std::io::Error),
    #[error(
        "it speaks version {theirs} of the protocol between hosts, this program version {VERSION}: use one version"
    )]
    Version { theirs: u32 },
    #[error("it does not have this run's token")]
    Stranger,
    #[error("{0:#}")]
    Source(anyhow::Error),
}

/// Host 0's side: the number of the host that came.
pub fn admit(stream: &mut TcpStream, token: &Token, deadline: Instant) -> Result<u32, HandshakeError> {
    let Hello { version, host, drawn: guest } = receive(stream, STRANGER, deadline)?;
    let door = draw().map_err(HandshakeError::Source)?;
    let drawn = Drawn { host, guest: &guest, door: &door };
    send(stream, &Challenge { version: VERSION, drawn: door.clone(), proof: token.door_proof(&drawn) })?;
    if version != VERSION {
        return Err(HandshakeError::Version { theirs: version });
    }
    let Answer { proof } = receive(stream, STRANGER, deadline)?;
    if token.is_guests(&drawn, &proof) { Ok(host) } else { Err(HandshakeError::Stranger) }
}

pub fn ask(stream: &mut TcpStream, token: &Token, host: u32, deadline: Instant) -> Result<(), HandshakeError> {
    let guest = draw().map_err(HandshakeError::Source)?;
    send(stream, &Hello { version: VERSION, host, drawn: guest.clone() })?;
    let Challenge { version, drawn: door, proof } = receive(stream, STRANGER, deadline)?;
    if version != VERSION {
        return Err(HandshakeError::Version { theirs: version });
    }
    let drawn = Drawn { host, guest: &guest, door: &door };
    if !token.is_doors(&drawn, &proof) {
        return Err(HandshakeError::Stranger);
    }
    Ok(send(stream, &Answer { proof: token.guest_proof(&drawn) })?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use std::net::TcpListener;
    use std::time::Duration;

    fn token(text: &str) -> Token {
        Token::new(text.as_bytes()).unwrap()
    }

    #[test]
    fn who_has_not_the_token_is_refused_by_either_side() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let mut stranger = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let mut door = listener.accept().unwrap().0;
        send(&mut stranger, &Hello { version: VERSION, host: 1, drawn: "x".into() }).unwrap();
        send(&mut stranger, &Answer { proof: "00".repeat(32) }).unwrap();
        let deadline = Instant::now() + Duration::from_secs(20);
        let refused = admit(&mut door, &token("the token of a run"), deadline);
        assert!(matches!(refused, Err(HandshakeError::Stranger)), "{refused:?}");

        // Host 0 proves itself first.
        let address = listener.local_addr().unwrap();
        let other = token("the token of another");
        let guest = std::thread::spawn(move || ask(&mut TcpStream::connect(address).unwrap(), &other, 3, deadline));
        admit(&mut listener.accept().unwrap().0, &token("the token of a run"), deadline).unwrap_err();
        let refused = guest.join().unwrap();
        assert!(matches!(refused, Err(HandshakeError::Stranger)), "{refused:?}");

        // One that is no orchestrator at all.
        let mut stranger = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let mut door = listener.accept().unwrap().0;
        stranger.write_all(b"GET / HTTP/1.1\r\n\r\n").unwrap();
        let refused = admit(&mut door, &token("the token of a run"), deadline).unwrap_err().to_string();
        assert!(refused.contains("at most 2048 are read"), "{refused}");
    }
}
