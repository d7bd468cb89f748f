//! The real disk.

use super::{Input, Lock, LockError, Output, Storage};
use fs4::FileExt;
use std::fs::{self, File, TryLockError};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use crate::format::names;

/// A folder of the file system.
pub struct Disk {
    root: PathBuf,
}

impl Disk {
    /// The folder at a path, which need not be there yet.
    pub fn new(root: &Path) -> Disk {
        Disk { root: root.to_owned() }
    }

    fn path(&self, name: &str) -> PathBuf {
        if name.is_empty() { self.root.clone() } else { self.root.join(name) }
    }

    /// A handle that a lock can be put on: the folder itself, whose name may change while the lock
    /// stands, or a file in it where folders cannot be opened.
    fn lockable(&self) -> io::Result<File> {
        if cfg!(unix) {
            return File::open(&self.root);
        }
        File::options().create(true).truncate(false).write(true).open(self.path(names::LOCK))
    }
}

impl Storage for Disk {
    fn place(&self) -> &Path {
        &self.root
    }

    fn make(&self) -> io::Result<()> {
        if self.root.is_dir() {
            return Ok(());
        }
        fs::create_dir_all(&self.root)?;
        match self.root.parent() {
            Some(parent) if parent != Path::new("") => sync_folder(parent),
            _ => sync_folder(Path::new(".")),
        }
    }

    fn lock(&self, note: &str) -> Result<Lock, LockError> {
        let file = self.lockable().map_err(LockError::Unsupported)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let note = fs::read_to_string(self.path(names::LOCK)).unwrap_or_default();
                return Err(LockError::Held(note.chars().take(200).collect()));
            }
            Err(TryLockError::Error(e)) => return Err(LockError::Unsupported(e)),
        }
        // For people only: no note is no harm.
        let _ = fs::write(self.path(names::LOCK), note);
        Ok(Box::new(file))
    }

    fn list(&self, folder: &str) -> io::Result<Vec<String>> {
        let mut all = Vec::new();
        let entries = fs::read_dir(self.path(folder)).map_err(|e| match e.kind() {
            // A file on the way to the field is no field.
            io::ErrorKind::NotADirectory if fs::symlink_metadata(&self.root).is_err() => {
                io::ErrorKind::NotFound.into()
            }
            _ => e,
        })?;
        for entry in entries {
            all.push(entry?.file_name().to_string_lossy().into_owned());
        }
        all.sort();
        Ok(all)
    }

    fn open(&self, name: &str) -> io::Result<Box<dyn Input>> {
        let file = File::open(self.path(name))?;
        if !file.metadata()?.is_file() {
            return Err(io::Error::other("not a regular file"));
        }
        Ok(Box::new(file))
    }

    fn create(&self, name: &str, reserve: u64) -> io::Result<Box<dyn Output>> {
        let file = File::create(self.path(name))?;
        if reserve > 0 {
            match FileExt::allocate(&file, reserve) {
                // Some file systems cannot; then running full is found out while writing.
                Err(e) if e.kind() == io::ErrorKind::Unsupported => {}
                result => result?,
            }
        }
        Ok(Box::new(file))
    }

    fn rename(&self, from: &str, to: &str) -> io::Result<()> {
        fs::rename(self.path(from), self.path(to))
    }

    fn remove(&self, name: &str) -> io::Result<()> {
        fs::remove_file(self.path(name))
    }

    fn create_folder(&self, folder: &str) -> io::Result<()> {
        fs::create_dir_all(self.path(folder))
    }

    fn remove_folder(&self, folder: &str) -> io::Result<()> {
        fs::remove_dir(self.path(folder))
    }

    fn sync_folder(&self, folder: &str) -> io::Result<()> {
        sync_folder(&self.path(folder))
    }

    fn free(&self) -> Option<u64> {
        // The folder itself may not be there yet.
        let there = self.root.ancestors().find(|p| p.is_dir()).unwrap_or(Path::new("."));
        fs4::available_space(there).ok()
    }
}

fn sync_folder(path: &Path) -> io::Result<()> {
    // Elsewhere folders cannot be opened, and renaming is as lasting as it gets.
    if cfg!(unix) { File::open(path)?.sync_all() } else { Ok(()) }
}

impl Input for File {
    fn length(&self) -> io::Result<u64> {
        Ok(self.metadata()?.len())
    }

    fn read_at(&mut self, at: u64, into: &mut [u8]) -> io::Result<usize> {
        self.seek(SeekFrom::Start(at))?;
        self.read(into)
    }
}

impl Output for File {
    fn sync(&mut self) -> io::Result<()> {
        self.flush()?;
        self.sync_all()
    }
}
