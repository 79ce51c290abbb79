//! Arrays as NPY files (version 1.0, little endian, row-major): they carry their own shape and type, and `NumPy` maps
//! them into memory as they are.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// An element of an array.
pub trait Element: Copy {
    /// `NumPy`'s name of the type.
    const NAME: &'static str;
    /// Its bytes in little-endian order.
    fn write(self, out: &mut impl Write) -> io::Result<()>;
}

macro_rules! element {
    ($type:ty, $name:literal) => {
        impl Element for $type {
            const NAME: &'static str = $name;
            fn write(self, out: &mut impl Write) -> io::Result<()> {
                out.write_all(&self.to_le_bytes())
            }
        }
    };
}

element!(f32, "<f4");
element!(u16, "<u2");
element!(u32, "<u4");
element!(i32, "<i4");

/// Writes an array of this shape, whose first dimension follows from the number of elements.
///
/// # Panics
/// If the elements do not fill whole rows.
pub fn write<T: Element>(path: &Path, elements: &[T], row: &[usize]) -> io::Result<()> {
    let row_length: usize = row.iter().product();
    assert!(row_length > 0 && elements.len().is_multiple_of(row_length), "elements fill whole rows");
    let mut out = BufWriter::new(File::create(path)?);
    out.write_all(&header::<T>(elements.len() / row_length, row))?;
    for &element in elements {
        element.write(&mut out)?;
    }
    out.flush()
}

/// Magic, version, length and description, padded so that the data begins at a multiple of 64 bytes.
fn header<T: Element>(rows: usize, row: &[usize]) -> Vec<u8> {
    let lengths: Vec<String> = row.iter().map(|length| format!(" {length},")).collect();
    let description =
        format!("{{'descr': '{}', 'fortran_order': False, 'shape': ({rows},{}), }}", T::NAME, lengths.concat());
    // Ten bytes stand before the description, a line feed ends it.
    let padded = (10 + description.len() + 1).next_multiple_of(64) - 10;
    let mut header = b"\x93NUMPY\x01\x00".to_vec();
    header.extend_from_slice(&(padded as u16).to_le_bytes());
    header.extend_from_slice(format!("{description:<width$}\n", width = padded - 1).as_bytes());
    header
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn header_is_aligned_and_names_the_shape() {
        let header = header::<f32>(12, &[5, 7]);
        assert_eq!(header.len() % 64, 0);
        assert_eq!(usize::from(u16::from_le_bytes([header[8], header[9]])), header.len() - 10);
        let text = std::str::from_utf8(&header[10..]).unwrap();
        assert!(text.starts_with("{'descr': '<f4', 'fortran_order': False, 'shape': (12, 5, 7,), }"), "{text}");
        assert!(text.ends_with('\n'));
    }

    #[test]
    fn data_follows_the_header() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        write(&path, &[1u16, 2, 3, 4, 5, 6], &[2]).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        assert_eq!(&bytes[bytes.len() - 12..], &[1, 0, 2, 0, 3, 0, 4, 0, 5, 0, 6, 0]);
        assert_eq!((bytes.len() - 12) % 64, 0);
    }
}
