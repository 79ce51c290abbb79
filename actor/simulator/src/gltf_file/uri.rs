//! Where a scene's files are: in its folder or below it, since they travel together.

use base64::Engine;
use base64::alphabet::STANDARD;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use percent_encoding::percent_decode_str;
use proto::bounded;
use std::ffi::OsStr;
use std::path::{Component, Path, PathBuf};
use unicode_normalization::UnicodeNormalization;

const OUTSIDE: &str = "it lies outside of the file's folder";

/// The relative path that a URI means (RFC 3986).
pub fn path(uri: &str) -> Result<PathBuf, String> {
    let decoded = percent_decode_str(uri).decode_utf8().map_err(|_| "its name is not UTF-8")?;
    plain(Path::new(decoded.as_ref())).ok_or(OUTSIDE.to_owned())
}

/// A relative path without `.` and `..`; none if it leads out of the folder, or to the folder itself.
pub fn plain(path: &Path) -> Option<PathBuf> {
    let mut plain = PathBuf::new();
    for component in path.components() {
        match component {
            Component::Normal(name) => plain.push(name),
            Component::CurDir => {}
            Component::ParentDir if plain.pop() => {}
            Component::ParentDir | Component::RootDir | Component::Prefix(_) => return None,
        }
    }
    (!plain.as_os_str().is_empty()).then_some(plain)
}

/// A relative path as its folder spells it: a name may be written composed (NFC) or decomposed (NFD), and is the same
/// name.
pub fn find(folder: &Path, path: &Path) -> PathBuf {
    let composed = |name: &OsStr| name.to_string_lossy().nfc().collect::<String>();
    let spelled = |found: PathBuf, name: &OsStr| {
        let exact = found.join(name);
        if folder.join(&exact).exists() {
            return exact;
        }
        let entries = std::fs::read_dir(folder.join(&found)).into_iter().flatten();
        let names = entries.filter_map(|entry| Some(entry.ok()?.file_name()));
        names.filter(|other| composed(other) == composed(name)).min().map_or(exact, |other| found.join(other))
    };
    path.iter().fold(PathBuf::new(), spelled)
}

/// Whether a file is in a folder or below it also where links are followed.
pub fn is_inside(folder: &Path, file: &Path) -> std::io::Result<bool> {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    Ok(file.canonicalize()?.starts_with(folder.canonicalize()?))
}

/// A file in or below a folder that has `most` bytes at most.
pub fn read(folder: &Path, relative: &Path, most: u64) -> Result<Vec<u8>, String> {
    let file = folder.join(relative);
    if !is_inside(folder, &file).map_err(|error| error.to_string())? {
        return Err(OUTSIDE.to_owned());
    }
    bounded::read(&file, most).map_err(|error| error.to_string())
}

/// The bytes of a `data:` URI (RFC 2397); none if it is another one.
pub fn data(uri: &str) -> Option<Result<Vec<u8>, String>> {
    let (scheme, rest) = uri.split_at_checked(5)?;
    if !scheme.eq_ignore_ascii_case("data:") {
        return None;
    }
    let Some((kind, data)) = rest.split_once(',') else { return Some(Err("has no comma".to_owned())) };
    let bytes: Vec<u8> = percent_decode_str(data).collect();
    let is_base64 = kind.rsplit(';').next().is_some_and(|last| last.eq_ignore_ascii_case("base64"));
    let padding = GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent);
    let decode = |bytes| GeneralPurpose::new(&STANDARD, padding).decode(bytes).map_err(|error| error.to_string());
    Some(if is_base64 { decode(bytes) } else { Ok(bytes) })
}
