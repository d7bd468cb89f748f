//! Reading a field's files: whole, by chunk, or block by block.

use super::FieldError;
use super::storage::disk::Disk;
use super::storage::{Input, Storage};
use crate::format::container::{
    self, ALIGN, ChunkEntry, ChunkHasher, ChunkKind, Codec, Directory, FileKind, Header,
};
use crate::format::limits::Limits;
use crate::format::{Fault, FormatError, room_for};
use std::path::{Path, PathBuf};

/// Bytes that are read at once where a chunk comes in blocks; a multiple of everything's size.
pub const BLOCK: usize = 1 << 18;

/// First bytes that most files' directories fit into.
const HEAD: u64 = 4096;

/// A file of a field, its first block and directory checked.
pub struct Opened {
    /// Its place, for messages.
    pub path: PathBuf,
    /// First block and directory.
    pub directory: Directory,
    /// Its bytes.
    pub length: u64,
    input: Box<dyn Input>,
}

/// Opens a file and checks its first block and directory, and that it is of a kind.
///
/// # Errors
/// When it is missing, damaged or of another kind.
pub fn open(storage: &dyn Storage, name: &str, kind: FileKind) -> Result<Opened, FieldError> {
    let path = storage.place().join(name);
    let failed = |e| FieldError::io("read", &path)(e);
    let mut input = storage.open(name).map_err(failed)?;
    let length = input.length().map_err(failed)?;
    let mut read = |bytes: u64| {
        let mut head = vec![0; length.min(bytes) as usize];
        input.read_exact_at(0, &mut head).map_err(FieldError::io("read", &path))?;
        Ok::<_, FieldError>(head)
    };
    let in_file = |f: Fault| FieldError::Format(f.in_file(path.display()));
    let mut head = read(HEAD)?;
    let limits = storage.limits();
    let needed = Directory::length(&head, length, &limits).map_err(in_file)?;
    if needed > head.len() {
        head = read(needed as u64)?;
    }
    let directory = Directory::parse(&head, length, &limits).map_err(in_file)?;
    directory.is_of(kind).map_err(in_file)?;
    Ok(Opened { directory, length, input, path })
}

/// The same for a file anywhere, such as a pack.
///
/// # Errors
/// As [`open`].
pub fn open_at(path: &Path, kind: FileKind, limits: &Limits) -> Result<Opened, FieldError> {
    let folder = path.parent().filter(|p| *p != Path::new("")).unwrap_or(Path::new("."));
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    open(&Disk::within(folder, *limits), &name, kind)
}

impl Opened {
    /// Refuses a sound file that has come from another place: of another field, generation or
    /// direction than `header`'s.
    ///
    /// # Errors
    /// When it has.
    pub fn belongs(self, header: &Header) -> Result<Opened, FieldError> {
        let place = (header.generation, header.direction);
        let checked = self.directory.header.check_place(&header.field, place);
        checked.map_err(|f| self.fault(f)).map(|()| self)
    }

    /// The entry of a chunk.
    ///
    /// # Errors
    /// When there is none of that kind and direction.
    pub fn find(&self, kind: ChunkKind, direction: u32) -> Result<ChunkEntry, FieldError> {
        Ok(*self.directory.find(kind, direction).map_err(|f| self.fault(f))?)
    }

    /// A chunk, verified and decoded.
    ///
    /// # Errors
    /// When it is damaged, or the system refuses.
    pub fn chunk(&mut self, entry: &ChunkEntry) -> Result<Vec<u8>, FieldError> {
        self.chunk_into(entry, Vec::new())
    }

    /// The same in memory that is at hand. A raw chunk needs its length and [`ALIGN`] bytes; with less,
    /// there will be more.
    ///
    /// # Errors
    /// As [`Opened::chunk`].
    pub fn chunk_into(
        &mut self,
        entry: &ChunkEntry,
        mut stored: Vec<u8>,
    ) -> Result<Vec<u8>, FieldError> {
        self.stored_into(entry, &mut stored)?;
        match container::decode(&self.directory.header.field, entry, &stored) {
            Ok(std::borrow::Cow::Borrowed(_)) => {}
            Ok(std::borrow::Cow::Owned(raw)) => return Ok(raw),
            Err(f) => return Err(self.fault(f)),
        }
        Ok(stored)
    }

    /// A chunk's stored bytes as they are, for [`container::decode`] to verify.
    ///
    /// # Errors
    /// When the padding behind it is damaged, there is no memory for it, or the system refuses.
    pub fn stored(&mut self, entry: &ChunkEntry) -> Result<Vec<u8>, FieldError> {
        let mut stored = Vec::new();
        self.stored_into(entry, &mut stored)?;
        Ok(stored)
    }

    fn stored_into(&mut self, entry: &ChunkEntry, stored: &mut Vec<u8>) -> Result<(), FieldError> {
        let length = entry.stored as usize + entry.padding();
        if stored.capacity() < length {
            let room = room_for(length as u64, || entry.id.to_string());
            *stored = room.map_err(|f| self.fault(f))?;
        }
        stored.resize(length, 0);
        self.read(entry.offset, stored)?;
        let padding = entry.check_padding(&stored[entry.stored as usize..]);
        padding.map_err(|f| self.fault(f))?;
        stored.truncate(entry.stored as usize);
        Ok(())
    }

    /// Hands a raw chunk over in blocks of [`BLOCK`] bytes. Whether it is sound is known at the end.
    ///
    /// # Errors
    /// When it is damaged or not raw, `take` does not like it, or the system refuses.
    pub fn blocks(
        &mut self,
        entry: &ChunkEntry,
        mut take: impl FnMut(&[u8]) -> Result<(), Fault>,
    ) -> Result<(), FieldError> {
        if entry.codec != Codec::Raw {
            return Err(self.fault(Fault::invalid(format!("{:?} is not raw", entry.id.kind))));
        }
        let mut hasher = ChunkHasher::new(&self.directory.header.field, entry.id);
        let mut block = vec![0; BLOCK.min(entry.stored as usize)];
        let (mut at, end) = (entry.offset, entry.offset + entry.stored);
        let mut liked = Ok(());
        while at < end {
            let length = (end - at).min(BLOCK as u64) as usize;
            let part = &mut block[..length];
            self.input.read_exact_at(at, part).map_err(FieldError::io("read", &self.path))?;
            hasher.write(part);
            if liked.is_ok() {
                liked = take(part);
            }
            at += length as u64;
        }
        if hasher.finish() != entry.hash {
            let what = entry.id.to_string();
            return Err(self.fault(Fault::Checksum { what, offset: entry.offset }));
        }
        let mut padding = [0; ALIGN];
        let padding = &mut padding[..entry.padding()];
        self.read(end, padding)?;
        liked.and_then(|()| entry.check_padding(padding)).map_err(|f| self.fault(f))
    }

    fn read(&mut self, at: u64, into: &mut [u8]) -> Result<(), FieldError> {
        self.input.read_exact_at(at, into).map_err(FieldError::io("read", &self.path))
    }

    fn fault(&self, fault: Fault) -> FieldError {
        FieldError::Format(FormatError { file: self.path.display().to_string(), fault })
    }
}

/// A whole file.
///
/// # Errors
/// When it is missing, no regular file, or the system refuses.
pub fn read(storage: &dyn Storage, name: &str) -> Result<Vec<u8>, FieldError> {
    let path = storage.place().join(name);
    let whole = || {
        let mut input = storage.open(name)?;
        let mut bytes = Vec::new();
        let length = input.length()?;
        bytes.try_reserve_exact(length as usize).map_err(std::io::Error::other)?;
        bytes.resize(length as usize, 0);
        input.read_exact_at(0, &mut bytes)?;
        Ok(bytes)
    };
    whole().map_err(FieldError::io("read", &path))
}

/// One chunk of a file, verified and decoded.
///
/// # Errors
/// When the file is missing, damaged or of another kind, or has no such chunk.
pub fn read_chunk(
    storage: &dyn Storage,
    name: &str,
    file: FileKind,
    (kind, direction): (ChunkKind, u32),
) -> Result<Vec<u8>, FieldError> {
    let mut opened = open(storage, name, file)?;
    let entry = opened.find(kind, direction)?;
    opened.chunk(&entry)
}
