//! A connection between two orchestrators: messages with their length before them, and heartbeats both ways. One from
//! which nothing comes for a while is lost, whatever the kernel thinks of it.
//!
//! Two threads serve it, one for each direction, so that neither a full buffer nor a silent peer stops anybody else.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::io::{Error, ErrorKind, Read, Result, Write};
use std::net::{Shutdown, TcpStream};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// No message of the run is longer: the longest are a process's last words.
const LONGEST: usize = 4 << 20;
const BEATS: u32 = 5;

#[derive(Serialize, Deserialize)]
enum Frame<M> {
    Beat,
    Message(M),
}

pub fn send(stream: &mut TcpStream, message: &impl Serialize) -> Result<()> {
    send_bytes(stream, &serde_json::to_vec(message)?)
}

pub fn send_bytes(mut stream: &TcpStream, bytes: &[u8]) -> Result<()> {
    let length =
        u32::try_from(bytes.len()).map_err(|_| Error::new(ErrorKind::InvalidInput, "a message is too long"))?;
    // In one piece: a length alone would wait for its answer.
    let mut whole = length.to_le_bytes().to_vec();
    whole.extend(bytes);
    stream.write_all(&whole)
}

pub fn receive<M: DeserializeOwned>(stream: &mut TcpStream, longest: usize, deadline: Instant) -> Result<M> {
    Ok(serde_json::from_slice(&receive_bytes(stream, longest, deadline)?)?)
}

pub fn receive_bytes(stream: &mut TcpStream, longest: usize, deadline: Instant) -> Result<Vec<u8>> {
    let mut length = [0; 4];
    fill(stream, &mut length, deadline)?;
    let length = u32::from_le_bytes(length) as usize;
    if length > longest {
        return Err(Error::new(
            ErrorKind::InvalidData,
            format!("a message of {length} bytes: at most {longest} are read"),
        ));
    }
    let mut bytes = vec![0; length];
    fill(stream, &mut bytes, deadline)?;
    Ok(bytes)
}

/// Reads until all of it is there. The deadline is for all of it: one that sends a byte now and then gains nothing.
fn fill(stream: &mut TcpStream, mut bytes: &mut [u8], deadline: Instant) -> Result<()> {
    while !bytes.is_empty() {
        let left = deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(ErrorKind::TimedOut.into());
        }
        stream.set_read_timeout(Some(left))?;
        match stream.read(bytes) {
            Ok(0) => return Err(Error::new(ErrorKind::UnexpectedEof, "the connection was closed")),
            Ok(count) => bytes = &mut bytes[count..],
            Err(error) if matches!(error.kind(), ErrorKind::Interrupted | ErrorKind::WouldBlock) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// The end of a link at which one speaks. When it is dropped, what was said is sent, and the link closes.
pub struct Mouth<M> {
    messages: Option<Sender<M>>,
    writer: Option<JoinHandle<()>>,
}

impl<M> Mouth<M> {
    /// Says something. Whether it arrives is not known; a link that is lost is told of at the other end.
    pub fn say(&self, message: M) {
        if let Some(messages) = &self.messages {
            let _ = messages.send(message);
        }
    }
}

impl<M> Drop for Mouth<M> {
    fn drop(&mut self) {
        drop(self.messages.take());
        if let Some(writer) = self.writer.take() {
            let _ = writer.join();
        }
    }
}

/// Serves a connection from now on: `hear` gets every message, and at the end why it ended; it returns whether to go on.
/// A link is lost after `silence` without a sign of life.
pub fn serve<In, Out>(
    stream: TcpStream,
    silence: Duration,
    mut hear: impl FnMut(std::result::Result<In, String>) -> bool + Send + 'static,
) -> Result<Mouth<Out>>
where
    In: DeserializeOwned,
    Out: Serialize + Send + 'static,
{
    stream.set_nodelay(true)?;
    stream.set_write_timeout(Some(silence))?;
    let mut ear = stream.try_clone()?;
    let listen = move || {
        loop {
            match receive::<Frame<In>>(&mut ear, LONGEST, Instant::now() + silence) {
                Ok(Frame::Beat) => {}
                Ok(Frame::Message(message)) => {
                    if !hear(Ok(message)) {
                        break;
                    }
                }
                Err(error) => {
                    hear(Err(words(&error, silence)));
                    break;
                }
            }
        }
        let _ = ear.shutdown(Shutdown::Both);
    };
    std::thread::Builder::new().name("link-in".into()).spawn(listen)?;
    let (messages, outbox) = channel();
    let mut mouth = stream;
    let speak = move || {
        loop {
            let frame = match outbox.recv_timeout(silence / BEATS) {
                Ok(message) => Frame::Message(message),
                Err(RecvTimeoutError::Timeout) => Frame::Beat,
                Err(RecvTimeoutError::Disconnected) => {
                    let _ = mouth.shutdown(Shutdown::Write);
                    return;
                }
            };
            if send(&mut mouth, &frame).is_err() {
                // The listener notices, and tells why.
                let _ = mouth.shutdown(Shutdown::Both);
                return;
            }
        }
    };
    let writer = std::thread::Builder::new().name("link-out".into()).spawn(speak)?;
    Ok(Mouth { messages: Some(messages), writer: Some(writer) })
}

fn words(error: &Error, silence: Duration) -> String {
    match error.kind() {
        ErrorKind::TimedOut => format!("nothing came from it for {:.0} s", silence.as_secs_f64()),
        _ => error.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::TcpListener;

    fn pair() -> [TcpStream; 2] {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let guest = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        [listener.accept().unwrap().0, guest]
    }

    fn soon() -> Instant {
        Instant::now() + Duration::from_secs(20)
    }

    #[test]
    fn one_that_is_silent_is_lost_and_one_that_beats_is_not() {
        let [door, guest] = pair();
        let silence = Duration::from_millis(300);
        let (said, heard) = channel::<std::result::Result<String, String>>();
        let _at_door: Mouth<u32> = serve(door, silence, move |message| said.send(message).is_ok()).unwrap();
        let beats: Mouth<String> = serve(guest, silence, |_: std::result::Result<u32, String>| true).unwrap();
        assert!(heard.recv_timeout(4 * silence).is_err(), "it lives");
        drop(beats);
        assert!(heard.recv().unwrap().is_err());

        let [door, _mute] = pair();
        let (said, heard) = channel::<std::result::Result<String, String>>();
        let _at_door: Mouth<u32> = serve(door, silence, move |message| said.send(message).is_ok()).unwrap();
        let reason = heard.recv_timeout(Duration::from_secs(20)).unwrap().unwrap_err();
        assert!(reason.contains("nothing came from it"), "{reason}");
    }

    #[test]
    fn what_is_too_long_or_too_late_is_not_read() {
        let [mut door, guest] = pair();
        send_bytes(&guest, &[b'x'; 100]).unwrap();
        let message = receive_bytes(&mut door, 99, soon()).unwrap_err().to_string();
        assert!(message.contains("a message of 100 bytes: at most 99"), "{message}");
        let [mut door, mut guest] = pair();
        let drip = std::thread::spawn(move || {
            for byte in 20u32.to_le_bytes().into_iter().chain([b'x'; 16]) {
                let _ = guest.write_all(&[byte]);
                std::thread::sleep(Duration::from_millis(40));
            }
        });
        let deadline = Instant::now() + Duration::from_millis(300);
        let error = receive_bytes(&mut door, 99, deadline).unwrap_err();
        assert!(matches!(error.kind(), ErrorKind::TimedOut), "{error}");
        assert!(Instant::now() < deadline + Duration::from_secs(1));
        drip.join().unwrap();
    }
}
