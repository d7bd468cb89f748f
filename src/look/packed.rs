//! The file of a pack: mapped, or read piece by piece.
//!
//! A mapping is quickest, and the system forgets what is not looked at. Where it does not give the
//! address space, or where the file may be cut short by others, pieces are read as they are wanted.

use super::mapping::Mapping;
use crate::format::container::{ChunkEntry, Directory, FIRST_BLOCK, FileKind};
use crate::format::limits::Limits;
use crate::format::{Fault, FormatError, room_for};
use std::borrow::Cow;
use std::fs::File;
use std::io;
use std::ops::Range;
use std::path::Path;

/// How a pack is looked into.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Mapped, where the system lets it be.
    Mapped,
    /// Read piece by piece.
    Read,
}

/// An opened pack.
pub struct PackFile {
    name: String,
    length: u64,
    bytes: Bytes,
}

enum Bytes {
    Mapped(Mapping),
    Read(File),
}

impl PackFile {
    /// Opens a regular file.
    ///
    /// # Errors
    /// When it cannot be opened, or is no regular file. A mapping that the system refuses is none.
    pub fn open(path: &Path, access: Access) -> io::Result<PackFile> {
        // Before it is opened: a pipe would let its reader wait.
        if !std::fs::metadata(path)?.is_file() {
            return Err(io::Error::other("not a regular file"));
        }
        let file = File::open(path)?;
        let name = path.display().to_string();
        // Nothing cannot be mapped.
        let mapping = match (access, file.metadata()?.len()) {
            (Access::Read, _) | (_, 0) => None,
            (Access::Mapped, _) => Mapping::new(&file)
                .inspect_err(|e| tracing::info!("{name}: not mapped ({e}), read instead"))
                .ok(),
        };
        Ok(match mapping {
            Some(mapping) => {
                PackFile { name, length: mapping.len() as u64, bytes: Bytes::Mapped(mapping) }
            }
            None => {
                let length = file.metadata()?.len();
                PackFile { name, length, bytes: Bytes::Read(file) }
            }
        })
    }

    /// Its name, for messages.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its first block and directory, checked against its length.
    ///
    /// # Errors
    /// The first fault found.
    pub fn directory(&self, limits: &Limits) -> Result<Directory, FormatError> {
        let directory = || {
            let head = self.piece(0, self.length.min(FIRST_BLOCK as u64))?;
            let needed = Directory::length(&head, self.length, limits)?;
            let directory = Directory::parse(&self.piece(0, needed as u64)?, self.length, limits)?;
            directory.is_of(FileKind::Pack).map(|()| directory)
        };
        directory().map_err(|f| f.in_file(&self.name))
    }

    /// A chunk, verified and decoded. What is borrowed lies in the mapping.
    ///
    /// # Errors
    /// When it is damaged, or the system refuses.
    pub fn chunk(&self, directory: &Directory, entry: &ChunkEntry) -> Result<Cow<'_, [u8]>, Fault> {
        match &self.bytes {
            Bytes::Mapped(mapping) => {
                mapping.expect(entry.offset as usize, entry.stored as usize);
                directory.chunk(mapping, entry)
            }
            Bytes::Read(_) => {
                let framed = self.piece(entry.offset, entry.stored + entry.padding() as u64)?;
                directory.chunk_read(framed.into_owned(), entry).map(Cow::Owned)
            }
        }
    }

    /// Bytes that [`PackFile::chunk`] has found in the mapping.
    pub fn mapped(&self, range: &Range<usize>) -> &[u8] {
        match &self.bytes {
            Bytes::Mapped(mapping) => &mapping[range.clone()],
            Bytes::Read(_) => &[],
        }
    }

    fn piece(&self, at: u64, length: u64) -> Result<Cow<'_, [u8]>, Fault> {
        let file = match &self.bytes {
            Bytes::Mapped(mapping) => {
                return Ok(Cow::Borrowed(&mapping[at as usize..(at + length) as usize]));
            }
            Bytes::Read(file) => file,
        };
        let mut piece = room_for(length, || format!("{length} bytes at {at:#x}"))?;
        piece.resize(length as usize, 0);
        read_at(file, &mut piece, at).map_err(|e| match (e.kind(), file.metadata()) {
            (io::ErrorKind::UnexpectedEof, Ok(now)) => {
                Fault::Truncated { expected: self.length, actual: now.len() }
            }
            _ => Fault::invalid(format!("cannot be read: {e}")),
        })?;
        Ok(Cow::Owned(piece))
    }
}

/// Fills a piece from a place of a file, while other threads read others.
#[cfg(unix)]
fn read_at(file: &File, piece: &mut [u8], at: u64) -> io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, piece, at)
}

/// The same where a read moves the file's one position: nobody else relies on that.
#[cfg(windows)]
fn read_at(file: &File, mut piece: &mut [u8], mut at: u64) -> io::Result<()> {
    while !piece.is_empty() {
        match std::os::windows::fs::FileExt::seek_read(file, piece, at)? {
            0 => return Err(io::ErrorKind::UnexpectedEof.into()),
            read => (piece, at) = (&mut piece[read..], at + read as u64),
        }
    }
    Ok(())
}
