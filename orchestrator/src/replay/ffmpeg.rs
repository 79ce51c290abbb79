use crate::preflight::programs;
use proto::replay::Ffmpeg;
use std::process::{Command, Stdio};

/// H.264 encoders in software, the better one first: those of a graphics card need one.
const ENCODERS: [&str; 2] = ["libx264", "libopenh264"];

pub fn find() -> Option<Ffmpeg> {
    let program = programs::on_path("ffmpeg")?;
    let listed = Command::new(&program)
        .args(["-hide_banner", "-encoders"])
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .output()
        .ok()?;
    let encoder = encoder(&String::from_utf8_lossy(&listed.stdout))?;
    Some(Ffmpeg { program: program.to_str()?.to_owned(), encoder: encoder.to_owned() })
}

fn encoder(listing: &str) -> Option<&'static str> {
    let listed = |name: &str| listing.lines().any(|line| line.split_whitespace().nth(1) == Some(name));
    ENCODERS.into_iter().find(|name| listed(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_encoder_is_taken_by_its_whole_name() {
        let head = "Encoders:\n V..... = Video\n ------\n";
        let line = |name: &str| format!(" V....D {name:<20} an encoder (codec h264)\n");
        assert_eq!(encoder(&format!("{head}{}", line("libx264rgb"))), None);
        assert_eq!(encoder(&format!("{head}{}{}", line("libopenh264"), line("libx264"))), Some("libx264"));
        assert_eq!(encoder(&format!("{head}{}", line("libopenh264"))), Some("libopenh264"));
    }
}
