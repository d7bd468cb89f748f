//! Where a field's files lie. All that a bake writes and reads again goes through [`Storage`], so that
//! a test can put a disk in its place that fails, loses power or runs full.
//!
//! [`disk`] is the real one, [`memory`] keeps files in memory and knows what of them would have
//! survived a loss of power, [`faulty`] breaks the operations of another.
//!
//! Names are relative to the field's folder, with `/` between folder and file; see
//! [`crate::format::names`].

pub mod disk;

pub mod memory;

pub mod faulty;

use crate::format::limits::Limits;
use std::any::Any;
use std::io;
use std::path::Path;

/// A folder of files, of which one process at a time may be the writer.
pub trait Storage: Send + Sync {
    /// What the folder is called in messages.
    fn place(&self) -> &Path;

    /// What its files may state.
    fn limits(&self) -> Limits {
        Limits::default()
    }

    /// Makes the folder itself, unless it is there.
    ///
    /// # Errors
    /// Of the system.
    fn make(&self) -> io::Result<()>;

    /// Becomes the one writer, until what is returned is dropped. `note` says who, for those who come
    /// too late.
    ///
    /// # Errors
    /// Another holds the lock, or there are no locks here.
    fn lock(&self, note: &str) -> Result<Lock, LockError>;

    /// Names in a folder of the field, or in the field itself (`""`), in order.
    ///
    /// # Errors
    /// Of the system; a folder that is not there is [`io::ErrorKind::NotFound`].
    fn list(&self, folder: &str) -> io::Result<Vec<String>>;

    /// Opens a file for reading.
    ///
    /// # Errors
    /// When it is missing or no regular file, or of the system.
    fn open(&self, name: &str) -> io::Result<Box<dyn Input>>;

    /// Makes an empty file, in place of one that is there, with room for `reserve` bytes if that many
    /// are known to come.
    ///
    /// # Errors
    /// Of the system; no room for so many bytes is [`io::ErrorKind::StorageFull`].
    fn create(&self, name: &str, reserve: u64) -> io::Result<Box<dyn Output>>;

    /// Gives a file another name, in place of one that is there.
    ///
    /// # Errors
    /// Of the system.
    fn rename(&self, from: &str, to: &str) -> io::Result<()>;

    /// Removes a file.
    ///
    /// # Errors
    /// Of the system.
    fn remove(&self, name: &str) -> io::Result<()>;

    /// Makes a folder in the field, unless it is there.
    ///
    /// # Errors
    /// Of the system.
    fn create_folder(&self, folder: &str) -> io::Result<()>;

    /// Removes an empty folder.
    ///
    /// # Errors
    /// Of the system.
    fn remove_folder(&self, folder: &str) -> io::Result<()>;

    /// Returns when the names in a folder (`""`: the field itself) have reached the disk.
    ///
    /// # Errors
    /// Of the system.
    fn sync_folder(&self, folder: &str) -> io::Result<()>;

    /// Returns when a file that is there has reached the disk, whoever wrote it.
    ///
    /// # Errors
    /// As [`Output::sync`].
    fn sync_file(&self, name: &str) -> io::Result<()>;

    /// Bytes that are free for more files, where that is known.
    fn free(&self) -> Option<u64>;
}

/// Held by the one writer.
pub type Lock = Box<dyn Any + Send + Sync>;

/// Why a lock was not given.
#[derive(Debug)]
pub enum LockError {
    /// Another holds it; the note it left.
    Held(String),
    /// There are no locks here, or the system refused.
    Unsupported(io::Error),
}

/// A file that is being read.
pub trait Input: Send {
    /// Its length.
    ///
    /// # Errors
    /// Of the system.
    fn length(&self) -> io::Result<u64>;

    /// Reads at a place as much as comes at once, 0 at the end.
    ///
    /// # Errors
    /// Of the system.
    fn read_at(&mut self, at: u64, into: &mut [u8]) -> io::Result<usize>;

    /// Reads at a place until `into` is full.
    ///
    /// # Errors
    /// Of the system; an end that comes too early is [`io::ErrorKind::UnexpectedEof`].
    fn read_exact_at(&mut self, mut at: u64, mut into: &mut [u8]) -> io::Result<()> {
        while !into.is_empty() {
            match self.read_at(at, into) {
                Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
                Ok(n) => {
                    at += n as u64;
                    into = &mut into[n..];
                }
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) => return Err(e),
            }
        }
        Ok(())
    }
}

/// A file that is being written.
pub trait Output: io::Write + io::Seek + Send {
    /// Returns when all that was written has reached the disk.
    ///
    /// # Errors
    /// Of the system. What was written since the last success must not be trusted then, and trying
    /// again proves nothing.
    fn sync(&mut self) -> io::Result<()>;
}
