//! The file of fixed episodes: little-endian, six bytes an episode.
//!
//! Header: magic `STLEPISO`, version u16, number of kitchens u16. Then for each kitchen its number u16, three u16 of
//! zeros, its fingerprint u64, and 720 records {start u16, goal u16, stand u16}: numbers among the category's spots and
//! among the kitchen's robot stands. The category follows from the record's number.

use proto::kitchen::KitchenId;

pub const EPISODES_PER_KITCHEN: usize = proto::evaluation::EPISODES_PER_KITCHEN as usize;

const MAGIC: &[u8; 8] = b"STLEPISO";
const VERSION: u16 = 1;
const HEADER_BYTES: usize = 12;
const SECTION_HEADER_BYTES: usize = 16;
const RECORD_BYTES: usize = 6;
const SECTION_BYTES: usize = SECTION_HEADER_BYTES + RECORD_BYTES * EPISODES_PER_KITCHEN;

#[derive(Debug, Clone, thiserror::Error, PartialEq, Eq)]
pub enum FormatError {
    #[error("it does not begin with the magic bytes")]
    Magic,
    #[error("it is of version {0}, not {VERSION}")]
    Version(u16),
    #[error("it has {found} bytes, not {expected}")]
    Length { expected: usize, found: usize },
    #[error("it names kitchen {0}, which does not exist")]
    Kitchen(u16),
}

/// One episode: numbers of places in its kitchen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Record {
    /// Among the category's spots.
    pub start: u16,
    /// Among the category's spots.
    pub goal: u16,
    /// Among the kitchen's robot stands.
    pub stand: u16,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Section {
    pub kitchen: KitchenId,
    pub fingerprint: u64,
    /// Its episodes; [`EPISODES_PER_KITCHEN`] of them.
    pub records: Vec<Record>,
}

#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct File {
    pub sections: Vec<Section>,
}

impl File {
    pub fn parse(bytes: &[u8]) -> Result<Self, FormatError> {
        if bytes.get(..8) != Some(MAGIC) {
            return Err(FormatError::Magic);
        }
        let short = |expected| FormatError::Length { expected, found: bytes.len() };
        let word = |at: usize| {
            bytes.get(at..at + 2).map(|pair| u16::from_le_bytes([pair[0], pair[1]])).ok_or_else(|| short(at + 2))
        };
        let version = word(8)?;
        if version != VERSION {
            return Err(FormatError::Version(version));
        }
        let count = usize::from(word(10)?);
        let expected = HEADER_BYTES + count * SECTION_BYTES;
        if bytes.len() != expected {
            return Err(short(expected));
        }
        let mut sections = Vec::with_capacity(count);
        for section in 0..count {
            let at = HEADER_BYTES + section * SECTION_BYTES;
            let number = word(at)?;
            let kitchen = KitchenId::new(u32::from(number)).ok();
            let kitchen = kitchen.ok_or(FormatError::Kitchen(number))?;
            let mut fingerprint = 0;
            for part in 0..4 {
                fingerprint |= u64::from(word(at + 8 + 2 * part)?) << (16 * part);
            }
            let mut records = Vec::with_capacity(EPISODES_PER_KITCHEN);
            for record in 0..EPISODES_PER_KITCHEN {
                let at = at + SECTION_HEADER_BYTES + record * RECORD_BYTES;
                records.push(Record { start: word(at)?, goal: word(at + 2)?, stand: word(at + 4)? });
            }
            sections.push(Section { kitchen, fingerprint, records });
        }
        Ok(Self { sections })
    }

    /// The file's bytes. Panics if a section does not hold [`EPISODES_PER_KITCHEN`] episodes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(HEADER_BYTES + self.sections.len() * SECTION_BYTES);
        bytes.extend_from_slice(MAGIC);
        let mut word = |value: u16| bytes.extend_from_slice(&value.to_le_bytes());
        word(VERSION);
        word(self.sections.len() as u16);
        for section in &self.sections {
            assert_eq!(section.records.len(), EPISODES_PER_KITCHEN, "a section holds all episodes of its kitchen");
            word(section.kitchen.number() as u16);
            (0..3).for_each(|_| word(0));
            (0..4).for_each(|part| word((section.fingerprint >> (16 * part)) as u16));
            for record in &section.records {
                [record.start, record.goal, record.stand].into_iter().for_each(&mut word);
            }
        }
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file() -> File {
        let records = (0..EPISODES_PER_KITCHEN as u16)
            .map(|number| Record { start: number, goal: u16::MAX - number, stand: 7 * number })
            .collect();
        let kitchen = KitchenId::new(8).unwrap();
        File { sections: vec![Section { kitchen, fingerprint: 0x0123_4567_89ab_cdef, records }] }
    }

    #[test]
    fn a_file_is_read_as_it_was_written() {
        assert_eq!(File::parse(&file().to_bytes()), Ok(file()));
    }

    #[test]
    fn a_damaged_file_is_refused() {
        let bytes = file().to_bytes();
        assert_eq!(File::parse(b""), Err(FormatError::Magic));
        assert!(matches!(File::parse(&bytes[..bytes.len() - 1]), Err(FormatError::Length { .. })));
        let mut other = bytes.clone();
        other[8] = 9;
        assert_eq!(File::parse(&other), Err(FormatError::Version(9)));
        let mut other = bytes.clone();
        other[HEADER_BYTES] = 28;
        assert_eq!(File::parse(&other), Err(FormatError::Kitchen(28)));
    }
}
