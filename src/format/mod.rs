//! Bytes on disk: containers, chunks, tile maps, the manifest. Knows nothing of light.
//!
//! Every file of a field and every pack is one *container*: a first block of 256 bytes, a directory
//! of its chunks, and the chunks, each framed by its length and an xxh3-64 hash that is bound to the
//! chunk's place. `format-spec/` describes every byte.
//!
//! Numbers are little-endian; sizes are checked before anything is allocated; nothing here is
//! `unsafe`, and no serde runs on tables or tiles. Arithmetic, casts and indexing that could fail are
//! denied where untrusted bytes are read; lookups in tile maps come behind a check of the whole map.

pub mod bytes;

pub mod container;

pub mod limits;

pub mod manifest;

pub mod names;

pub mod text;

pub mod tiles;

use limits::{Flag, in_brackets};
use std::fmt;

/// What is wrong with a file.
#[derive(Clone, Debug, thiserror::Error, PartialEq, Eq)]
#[error("{file}: {fault}")]
pub struct FormatError {
    /// The file, and the part of it where that is known.
    pub file: String,
    /// What is wrong there.
    pub fault: Fault,
}

/// Kinds of faults, each with what its message needs.
#[derive(Clone, Debug, thiserror::Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum Fault {
    /// Another kind of file.
    #[error("not a VLF file")]
    Foreign,
    /// A magic number mangled by a text-mode transfer.
    #[error("mangled by a text-mode transfer; copy it again in binary mode")]
    TextMode,
    /// The byte-order mark reads backwards.
    #[error("written in the other byte order, which this version cannot read")]
    ByteOrder,
    /// A later or unknown version.
    #[error("format version {major}.{minor}; this version reads {READS_MAJOR}.x")]
    Version {
        /// Breaking version.
        major: u16,
        /// Compatible version.
        minor: u16,
    },
    /// A feature that must be understood and is not.
    #[error("needs feature bit {0}, which this version does not have")]
    Feature(u32),
    /// A feature that must be understood to write and is not.
    #[error(
        "needs feature bit {0} to be changed, which this version does not have; it can be read"
    )]
    ReadOnlyFeature(u32),
    /// Shorter than its header says.
    #[error("truncated: its header says {expected} bytes, the file has {actual}")]
    Truncated {
        /// Length by the header, or the least a header takes.
        expected: u64,
        /// Length of the file.
        actual: u64,
    },
    /// Longer than its header says.
    #[error("{0} unexpected bytes after the end")]
    Surplus(u64),
    /// A hash that does not fit.
    #[error("{what}: checksum mismatch at offset {offset:#x}")]
    Checksum {
        /// Which part.
        what: String,
        /// Where it begins.
        offset: u64,
    },
    /// A number above a limit.
    #[error("{what} {value} exceeds limit {limit}{}", in_brackets(.flag))]
    Limit {
        /// Which number.
        what: &'static str,
        /// What it says.
        value: u64,
        /// What is allowed.
        limit: u64,
        /// What allows more.
        flag: Flag,
    },
    /// More memory than the system gives.
    #[error("{what}: no memory for its {bytes} bytes")]
    Memory {
        /// Which part.
        what: String,
        /// What was asked for.
        bytes: u64,
    },
    /// A chunk that must be there and is not.
    #[error("{0} is missing")]
    Missing(String),
    /// Numbers that contradict each other or a rule of the format.
    #[error("{0}")]
    Invalid(String),
}

/// The major version this code reads and writes.
pub const READS_MAJOR: u16 = 1;

impl Fault {
    /// Puts the name of the file before the fault.
    pub fn in_file(self, file: impl fmt::Display) -> FormatError {
        FormatError { file: file.to_string(), fault: self }
    }

    /// Shorthand for [`Fault::Invalid`].
    pub fn invalid(what: impl Into<String>) -> Fault {
        Fault::Invalid(what.into())
    }

    /// Whether the file may be good but is beyond this version.
    pub fn is_unsupported(&self) -> bool {
        use Fault::{ByteOrder, Feature, ReadOnlyFeature, Version};
        matches!(self, Version { .. } | Feature(_) | ReadOnlyFeature(_) | ByteOrder)
    }

    /// Whether the file may be good but is beyond a limit that a flag raises.
    pub fn is_limited(&self) -> bool {
        matches!(self, Fault::Limit { flag: Some(_), .. })
    }
}

/// Room for `count` items that a file asks for, or an error where infallible allocation would end the
/// process; `what` is for the message.
///
/// # Errors
/// When the system does not give that much.
pub fn room_for<T>(count: u64, what: impl FnOnce() -> String) -> Result<Vec<T>, Fault> {
    let mut room = Vec::new();
    match usize::try_from(count).map(|count| room.try_reserve_exact(count)) {
        Ok(Ok(())) => Ok(room),
        _ => {
            let bytes = count.saturating_mul(size_of::<T>() as u64);
            Err(Fault::Memory { what: what(), bytes })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_that_there_is_not_is_an_error() {
        for count in [1 << 50, u64::MAX] {
            let fault = room_for::<u64>(count, || "a table".into()).unwrap_err();
            assert!(matches!(&fault, Fault::Memory { what, .. } if what == "a table"), "{fault}");
        }
        assert!(room_for::<u64>(3, || unreachable!()).unwrap().capacity() >= 3);
    }
}
