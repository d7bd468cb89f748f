//! The one file with `unsafe`: a file mapped read-only into memory.

use memmap2::Mmap;
use std::fs::File;
use std::io;
use std::ops::Deref;

/// A whole file, mapped read-only.
///
/// Packs are published by rename and never edited, so a mapped pack keeps its bytes when another takes
/// its name. If someone cuts the file itself short while it is mapped, touching the missing part ends
/// the process with SIGBUS; if someone writes into it, chunks read for the first time after that fail
/// their checksum.
#[derive(Debug)]
pub struct Mapping(Mmap);

impl Mapping {
    /// Maps a regular file that is not empty.
    ///
    /// # Errors
    /// When the system refuses, as it does beyond the address space that a process may have.
    #[allow(unsafe_code)]
    pub fn new(file: &File) -> io::Result<Mapping> {
        // SAFETY: the mapping is read-only, and its users hash every chunk when they first touch it.
        // That nobody truncates or edits the file meanwhile is the promise under which a pack is
        // opened (see the type); it cannot be enforced for ordinary files.
        let map = unsafe { Mmap::map(file)? };
        Ok(Mapping(map))
    }

    /// Tells the system that bytes will be read at once, so that it fetches them together.
    pub fn expect(&self, at: usize, length: usize) {
        // Advice that is not taken costs time, nothing else.
        #[cfg(unix)]
        let _ = self.0.advise_range(memmap2::Advice::WillNeed, at, length);
    }
}

impl Deref for Mapping {
    type Target = [u8];
    fn deref(&self) -> &[u8] {
        &self.0
    }
}
