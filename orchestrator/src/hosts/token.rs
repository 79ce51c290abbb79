//! The secret that all hosts of a run have and nobody else. It never crosses the network: each side proves that it has
//! it, by an HMAC over what both have drawn at random.

use crate::supervisor::process::{TOKEN, TOKEN_FILE};
use anyhow::{Context, Result, ensure};
use hmac::{Hmac, Mac};
use proto::digest::hex;
use sha2::Sha256;
use std::fs::{File, Metadata};
use std::io::Read;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// A shorter one could be guessed by who has seen a proof.
const SHORTEST: usize = 16;
const LONGEST: u64 = 4096;

#[derive(Clone)]
pub struct Token(Vec<u8>);

impl std::fmt::Debug for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Token")
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Drawn<'a> {
    pub host: u32,
    pub guest: &'a str,
    pub door: &'a str,
}

impl Token {
    pub fn find(file: Option<&Path>) -> Result<Self> {
        let named = file.map(Path::to_path_buf).or_else(|| std::env::var_os(TOKEN_FILE).map(PathBuf::from));
        if let Some(path) = named {
            let mut bytes = Vec::new();
            let file = File::open(&path).and_then(|file| Ok((file.metadata()?, file)));
            let read = file.and_then(|(metadata, file)| file.take(LONGEST).read_to_end(&mut bytes).map(|_| metadata));
            let metadata = read.with_context(|| {
                format!("cannot read the token in {0} (`openssl rand -hex 32 > {0}` makes one)", path.display())
            })?;
            refuse_public(&path, &metadata)?;
            return Self::new(&bytes).with_context(|| format!("the token in {}", path.display()));
        }
        let text = std::env::var(TOKEN).ok().with_context(|| {
            format!(
                "several hosts need a token, which keeps strangers out: make one (`openssl rand -hex 32 > token`), give \
                 it to every host, and name it by --token-file token, or by the variable {TOKEN_FILE} or {TOKEN}"
            )
        })?;
        Self::new(text.as_bytes()).with_context(|| format!("the token in the variable {TOKEN}"))
    }

    pub fn new(bytes: &[u8]) -> Result<Self> {
        let token = bytes.trim_ascii();
        ensure!(
            token.len() >= SHORTEST,
            "has {} characters: at least {SHORTEST} keep it from being guessed",
            token.len()
        );
        Ok(Self(token.to_vec()))
    }

    pub fn door_proof(&self, drawn: &Drawn<'_>) -> String {
        self.code(&words("door", drawn))
    }

    pub fn guest_proof(&self, drawn: &Drawn<'_>) -> String {
        self.code(&words("guest", drawn))
    }

    /// What keys in the learners' store begin with: it tells nothing of the token, and nobody else can make it.
    pub fn meeting_key(&self, run: &str, incarnation: u32) -> String {
        self.code(&["meeting".to_owned(), run.to_owned(), incarnation.to_string()])
    }

    fn code(&self, words: &[String]) -> String {
        hex(self.mac(words).finalize().into_bytes())
    }

    fn mac(&self, words: &[String]) -> Hmac<Sha256> {
        let mut mac = Hmac::<Sha256>::new_from_slice(&self.0).expect("a key has any length");
        for word in words {
            // Each with its length: two words are never read as others.
            mac.update(&(word.len() as u64).to_le_bytes());
            mac.update(word.as_bytes());
        }
        mac
    }

    /// Whether this is host 0's proof. Takes the same time wherever it differs.
    pub fn is_doors(&self, drawn: &Drawn<'_>, proof: &str) -> bool {
        self.verifies(&words("door", drawn), proof)
    }

    pub fn is_guests(&self, drawn: &Drawn<'_>, proof: &str) -> bool {
        self.verifies(&words("guest", drawn), proof)
    }

    fn verifies(&self, words: &[String], proof: &str) -> bool {
        let byte = |at| proof.get(at..at + 2).and_then(|digits| u8::from_str_radix(digits, 16).ok());
        let bytes: Option<Vec<u8>> = (0..proof.len()).step_by(2).map(byte).collect();
        bytes.is_some_and(|bytes| self.mac(words).verify_slice(&bytes).is_ok())
    }
}

/// Refuses a token's file that every user may read or write. Its group may, as in a secret that Kubernetes mounts.
pub fn refuse_public(path: &Path, file: &Metadata) -> Result<()> {
    let is_public = file.is_file() && file.mode() & 0o007 != 0;
    ensure!(!is_public, "every user of this machine may use the token in {0}: chmod 600 {0}", path.display());
    Ok(())
}

fn words(side: &str, drawn: &Drawn<'_>) -> [String; 4] {
    [side.to_owned(), drawn.host.to_string(), drawn.guest.to_owned(), drawn.door.to_owned()]
}

/// What others cannot guess: 256 bits of the kernel's, as hex digits.
pub fn draw() -> Result<String> {
    let mut bytes = [0u8; 32];
    File::open("/dev/urandom").and_then(|mut source| source.read_exact(&mut bytes)).context("/dev/urandom")?;
    Ok(hex(bytes))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn a_proof_is_of_one_side_one_host_one_meeting_and_one_token() {
        let [ours, others] = [b"0123456789abcdef", b"fedcba9876543210"].map(|token| Token::new(token).unwrap());
        let (guest, door) = (draw().unwrap(), draw().unwrap());
        assert_ne!(guest, door);
        let drawn = Drawn { host: 1, guest: &guest, door: &door };
        let proof = ours.guest_proof(&drawn);
        assert!(ours.is_guests(&drawn, &proof) && ours.is_doors(&drawn, &ours.door_proof(&drawn)));
        assert!(!ours.is_doors(&drawn, &proof) && !ours.is_guests(&drawn, &ours.door_proof(&drawn)), "sent back");
        assert!(!others.is_guests(&drawn, &proof));
        assert!(!ours.is_guests(&Drawn { host: 2, ..drawn.clone() }, &proof));
        assert!(!ours.is_guests(&Drawn { door: &guest, ..drawn.clone() }, &proof), "of another meeting");
        for wrong in ["", "00", "zz", &proof[..62], &format!("{proof}00"), "ü"] {
            assert!(!ours.is_guests(&drawn, wrong), "{wrong}");
        }
        assert_ne!(ours.meeting_key("run", 1), ours.meeting_key("run", 2));
        assert_ne!(ours.meeting_key("run", 1), others.meeting_key("run", 1));
    }

    #[test]
    fn a_token_is_read_from_its_file_without_the_line_end_and_a_short_or_public_one_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("token");
        std::fs::write(&path, "0123456789abcdef\n").unwrap();
        let set_mode = |mode| std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
        for public in [0o644, 0o602] {
            set_mode(public);
            let refused = Token::find(Some(&path)).unwrap_err().to_string();
            assert!(refused.contains("every user of this machine") && refused.contains("chmod 600"), "{refused}");
        }
        set_mode(0o440);
        let drawn = Drawn { host: 1, guest: "a", door: "b" };
        let proof = Token::find(Some(&path)).unwrap().guest_proof(&drawn);
        assert!(Token::new(b"0123456789abcdef").unwrap().is_guests(&drawn, &proof));
        set_mode(0o600);
        std::fs::write(&path, "secret\n").unwrap();
        let message = format!("{:#}", Token::find(Some(&path)).unwrap_err());
        assert!(message.contains("token") && message.contains("has 6 characters"), "{message}");
        assert!(Token::find(Some(&folder.path().join("none"))).is_err());
    }
}
