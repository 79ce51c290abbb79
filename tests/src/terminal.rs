//! A terminal that nobody sits at: what a program writes to it, and keys pressed on it.

use crate::wait_until;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{Winsize, tcgetattr, tcsetwinsize};
use std::fs::File;
use std::io::{Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::process::Command;
use std::sync::{Arc, Mutex, PoisonError};

#[derive(Debug)]
pub struct Terminal {
    /// Our side.
    desk: File,
    /// The programs' side; kept, so that it can be looked at when they have ended.
    line: File,
    written: Arc<Mutex<Vec<u8>>>,
}

impl Terminal {
    /// One of this size.
    pub fn open(columns: u16, lines: u16) -> Self {
        let (desk, line) = sides();
        let written = Arc::new(Mutex::new(Vec::new()));
        let (mut reader, store) = (desk.try_clone().expect("a descriptor"), Arc::clone(&written));
        std::thread::spawn(move || {
            let mut block = [0; 4096];
            // It ends with an error when nobody is left on the other side.
            while let Ok(count @ 1..) = reader.read(&mut block) {
                store.lock().unwrap_or_else(PoisonError::into_inner).extend_from_slice(&block[..count]);
            }
        });
        let terminal = Self { desk, line, written };
        terminal.resize(columns, lines);
        terminal
    }

    /// The programs' side of one that was closed: whoever still writes to it gets EIO.
    pub fn closed() -> File {
        sides().1
    }

    /// Gives it another size.
    pub fn resize(&self, columns: u16, lines: u16) {
        let size = Winsize { ws_row: lines, ws_col: columns, ws_xpixel: 0, ws_ypixel: 0 };
        tcsetwinsize(&self.desk, size).expect("a size");
    }

    /// The same command as a session of its own on this terminal.
    pub fn session(&self, command: &Command) -> Command {
        let side = || self.line.try_clone().expect("a descriptor");
        let mut session = Command::new("setsid");
        session.args(["--ctty", "--wait"]).arg(command.get_program()).args(command.get_args());
        if let Some(folder) = command.get_current_dir() {
            session.current_dir(folder);
        }
        session.env_remove("STILLROOM_LOG").env_remove("STILLROOM_FAULT").env("TERM", "xterm-256color");
        session.stdin(side()).stdout(side()).stderr(side());
        session
    }

    /// Presses keys.
    pub fn press(&self, keys: &str) {
        (&self.desk).write_all(keys.as_bytes()).expect("somebody reads");
    }

    pub fn written(&self) -> String {
        let written = self.written.lock().unwrap_or_else(PoisonError::into_inner);
        String::from_utf8_lossy(&written).into_owned()
    }

    /// The same without colours and movements of the cursor, from this place of it on.
    fn text_from(&self, place: usize) -> String {
        let written = self.written();
        let mut text = String::new();
        let mut rest = written.get(place..).unwrap_or_default();
        while let Some((before, sequence)) = rest.split_once("\x1b[") {
            text.push_str(before);
            let end = sequence.find(|letter: char| letter.is_ascii_alphabetic()).map_or(sequence.len(), |end| end + 1);
            // Another line is another word.
            if sequence[..end].ends_with('H') {
                text.push(' ');
            }
            rest = &sequence[end..];
        }
        text + rest
    }

    /// Waits until all of these were written after this place.
    pub fn wait_for(&self, place: usize, words: &[&str]) {
        let missing = || {
            let text = self.text_from(place);
            words.iter().copied().filter(|word| !text.contains(word)).collect::<Vec<_>>()
        };
        let begun = std::time::Instant::now();
        wait_until("the words on the terminal", || {
            let late = begun.elapsed() > std::time::Duration::from_mins(2);
            assert!(!late || missing().is_empty(), "no {:?} in {:?}", missing(), self.text_from(place));
            missing().is_empty()
        });
    }

    /// How it treats keys and lines.
    pub fn modes(&self) -> String {
        format!("{:?}", tcgetattr(&self.line).expect("a terminal"))
    }
}

/// Both sides of a new terminal: ours, and that of the programs.
fn sides() -> (File, File) {
    let desk = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).expect("a terminal");
    grantpt(&desk).and_then(|()| unlockpt(&desk)).expect("a terminal of ours");
    let name = ptsname(&desk, Vec::new()).expect("its name").into_string().expect("text");
    // Without O_NOCTTY a test that leads a session of its own would have it as its terminal.
    let flags = i32::try_from(OpenptFlags::NOCTTY.bits()).expect("a flag");
    let line = File::options().read(true).write(true).custom_flags(flags).open(name).expect("its other side");
    (File::from(desk), line)
}
