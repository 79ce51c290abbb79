//! Chunks unpacked, up to a limit.

use std::io::Read;

/// What came out of packed bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unpacked {
    Whole,
    /// What came before something that cannot be unpacked, or before the end of truncated bytes.
    Part,
    /// As much as the limit allows.
    Limit,
    /// Nothing: no such compression is known.
    Unknown,
}

/// Whether chunks with this compression can be unpacked.
pub fn is_known(compression: &str) -> bool {
    matches!(compression, "" | "zstd" | "lz4")
}

/// Unpacks into `out`, which has no more than `limit` bytes afterwards.
pub fn unpack(compression: &str, packed: &[u8], limit: u64, out: &mut Vec<u8>) -> Unpacked {
    out.clear();
    match compression {
        "" => {
            let limit = usize::try_from(limit).unwrap_or(usize::MAX).min(packed.len());
            out.extend_from_slice(&packed[..limit]);
            if limit < packed.len() { Unpacked::Limit } else { Unpacked::Whole }
        }
        // The decoder itself refuses frames that want more than 128 MiB of memory.
        "zstd" => match zstd::stream::read::Decoder::with_buffer(packed) {
            Ok(decoder) => pour(decoder, limit, out),
            Err(_) => Unpacked::Part,
        },
        "lz4" => pour(lz4_flex::frame::FrameDecoder::new(packed), limit, out),
        _ => Unpacked::Unknown,
    }
}

fn pour(mut decoder: impl Read, limit: u64, out: &mut Vec<u8>) -> Unpacked {
    const PORTION: usize = 128 << 10;
    let mut portion = vec![0; PORTION];
    loop {
        match decoder.read(&mut portion) {
            Ok(0) => return Unpacked::Whole,
            Ok(read) => {
                let room = usize::try_from(limit).unwrap_or(usize::MAX) - out.len();
                out.extend_from_slice(&portion[..read.min(room)]);
                if read > room {
                    return Unpacked::Limit;
                }
            }
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            Err(_) => return Unpacked::Part,
        }
    }
}
