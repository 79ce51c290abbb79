use sha2::{Digest, Sha256};
use std::fmt::Write;

/// Bytes as lower-case hex digits, two each.
pub fn hex(bytes: impl AsRef<[u8]>) -> String {
    let bytes = bytes.as_ref();
    bytes.iter().fold(String::with_capacity(2 * bytes.len()), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    })
}

pub fn sha256(bytes: &[u8]) -> String {
    hex(Sha256::digest(bytes))
}

/// The same of bytes that come in pieces.
#[derive(Debug, Default)]
pub struct Digest256(Sha256);

impl Digest256 {
    pub fn add(&mut self, piece: &[u8]) {
        self.0.update(piece);
    }

    pub fn finish(self) -> String {
        hex(self.0.finalize())
    }
}
