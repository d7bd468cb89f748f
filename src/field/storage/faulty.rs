//! A storage that breaks the operations of another: the k-th, once or for ever, or cuts reads and
//! writes short.

use super::{Input, Lock, LockError, Output, Storage};
use crate::format::limits::Limits;
use std::io::{self, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// What goes wrong.
#[derive(Clone, Copy, Debug, Default)]
pub struct Faults {
    /// The number of the operation that fails, from 0; `None`: none does.
    pub fail: Option<u64>,
    /// Whether all operations after that one fail too, as after a loss of power.
    pub for_ever: bool,
    /// What the failure is called. `WriteZero` and `UnexpectedEof` are not said: the write takes
    /// nothing, the read brings nothing.
    pub kind: Option<io::ErrorKind>,
    /// Reads and writes take a part of what they are given, or are interrupted.
    pub short: bool,
    /// Syncs that the system says it has done and has not: told the operations so far, this one last.
    pub unsynced: Option<fn(&[String]) -> bool>,
    /// The file system has no locks.
    pub no_locks: bool,
}

/// Counts operations, and breaks some.
pub struct Faulty<S> {
    inner: Arc<S>,
    hurt: Arc<Hurt>,
}

struct Hurt {
    faults: Faults,
    count: AtomicU64,
    log: Mutex<Vec<String>>,
}

impl<S: Storage> Faulty<S> {
    /// Over a storage that stays at hand for a look at what is left.
    pub fn new(inner: Arc<S>, faults: Faults) -> Faulty<S> {
        let hurt = Hurt { faults, count: AtomicU64::new(0), log: Mutex::default() };
        Faulty { inner, hurt: Arc::new(hurt) }
    }

    /// Operations so far.
    pub fn operations(&self) -> u64 {
        self.hurt.count.load(Ordering::Relaxed)
    }

    /// What was done so far, one line an operation.
    pub fn log(&self) -> Vec<String> {
        self.hurt.log.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Hurt {
    fn step(&self, what: &str, name: &str) -> io::Result<()> {
        let mut log = self.log.lock().unwrap_or_else(PoisonError::into_inner);
        let now = self.count.fetch_add(1, Ordering::Relaxed);
        let hit = |k| if self.faults.for_ever { now >= k } else { now == k };
        if self.faults.fail.is_some_and(hit) {
            log.push(format!("{what} {name}: failed"));
            return Err(self.faults.kind.unwrap_or(io::ErrorKind::Other).into());
        }
        log.push(format!("{what} {name}"));
        Ok(())
    }

    /// How much of `length` bytes a read or write takes.
    fn part(&self, length: usize) -> io::Result<usize> {
        if !self.faults.short || length < 2 {
            return Ok(length);
        }
        match self.count.load(Ordering::Relaxed) % 3 {
            0 => Err(io::ErrorKind::Interrupted.into()),
            1 => Ok(1 + length / 3),
            _ => Ok(length),
        }
    }

    /// Whether the last operation, a sync, is only said to be done.
    fn skips(&self) -> bool {
        let log = self.log.lock().unwrap_or_else(PoisonError::into_inner);
        self.faults.unsynced.is_some_and(|is_skipped| is_skipped(&log))
    }
}

impl<S: Storage> Storage for Faulty<S> {
    fn place(&self) -> &Path {
        self.inner.place()
    }

    fn limits(&self) -> Limits {
        self.inner.limits()
    }

    fn make(&self) -> io::Result<()> {
        self.inner.make()
    }

    fn lock(&self, note: &str) -> Result<Lock, LockError> {
        match self.hurt.faults.no_locks {
            true => Err(LockError::Unsupported(io::ErrorKind::Unsupported.into())),
            false => self.inner.lock(note),
        }
    }

    fn list(&self, folder: &str) -> io::Result<Vec<String>> {
        self.hurt.step("list", folder)?;
        self.inner.list(folder)
    }

    fn open(&self, name: &str) -> io::Result<Box<dyn Input>> {
        self.hurt.step("open", name)?;
        let inner = self.inner.open(name)?;
        Ok(Box::new(Reading { inner, hurt: self.hurt.clone(), name: name.to_owned() }))
    }

    fn create(&self, name: &str, reserve: u64) -> io::Result<Box<dyn Output>> {
        self.hurt.step("create", name)?;
        let inner = self.inner.create(name, reserve)?;
        Ok(Box::new(Writing { inner, hurt: self.hurt.clone(), name: name.to_owned() }))
    }

    fn rename(&self, from: &str, to: &str) -> io::Result<()> {
        self.hurt.step("rename", to)?;
        self.inner.rename(from, to)
    }

    fn remove(&self, name: &str) -> io::Result<()> {
        self.hurt.step("remove", name)?;
        self.inner.remove(name)
    }

    fn create_folder(&self, folder: &str) -> io::Result<()> {
        self.hurt.step("create folder", folder)?;
        self.inner.create_folder(folder)
    }

    fn remove_folder(&self, folder: &str) -> io::Result<()> {
        self.hurt.step("remove folder", folder)?;
        self.inner.remove_folder(folder)
    }

    fn sync_folder(&self, folder: &str) -> io::Result<()> {
        self.hurt.step("sync folder", folder)?;
        if self.hurt.skips() { Ok(()) } else { self.inner.sync_folder(folder) }
    }

    fn sync_file(&self, name: &str) -> io::Result<()> {
        self.hurt.step("sync", name)?;
        if self.hurt.skips() { Ok(()) } else { self.inner.sync_file(name) }
    }

    fn free(&self) -> Option<u64> {
        self.inner.free()
    }
}

struct Reading {
    inner: Box<dyn Input>,
    hurt: Arc<Hurt>,
    name: String,
}

impl Input for Reading {
    fn length(&self) -> io::Result<u64> {
        self.inner.length()
    }

    fn read_at(&mut self, at: u64, into: &mut [u8]) -> io::Result<usize> {
        match self.hurt.step("read", &self.name) {
            Err(e) if e.kind() == io::ErrorKind::UnexpectedEof => return Ok(0),
            result => result?,
        }
        let part = self.hurt.part(into.len())?;
        self.inner.read_at(at, &mut into[..part])
    }
}

struct Writing {
    inner: Box<dyn Output>,
    hurt: Arc<Hurt>,
    name: String,
}

impl Write for Writing {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self.hurt.step("write", &self.name) {
            Err(e) if e.kind() == io::ErrorKind::WriteZero => return Ok(0),
            result => result?,
        }
        let part = self.hurt.part(bytes.len())?;
        self.inner.write(&bytes[..part])
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

impl Seek for Writing {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.inner.seek(to)
    }
}

impl Output for Writing {
    fn sync(&mut self) -> io::Result<()> {
        self.hurt.step("sync", &self.name)?;
        if self.hurt.skips() { Ok(()) } else { self.inner.sync() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::storage::memory::Memory;

    fn faulty(faults: Faults) -> Faulty<Memory> {
        Faulty::new(Arc::new(Memory::default()), faults)
    }

    #[test]
    fn one_operation_fails_or_all_from_it_on() {
        for for_ever in [false, true] {
            let kind = Some(io::ErrorKind::StorageFull);
            let disk = faulty(Faults { fail: Some(1), for_ever, kind, ..Faults::default() });
            let made = [0, 1, 2, 3].map(|_| disk.create_folder("f").map_err(|e| e.kind()));
            let later = if for_ever { Err(io::ErrorKind::StorageFull) } else { Ok(()) };
            assert_eq!(made, [Ok(()), Err(io::ErrorKind::StorageFull), later, later]);
            assert_eq!(disk.operations(), 4);
            assert_eq!(disk.log()[..2], ["create folder f", "create folder f: failed"]);
        }
    }

    #[test]
    fn what_comes_in_parts_is_whole_in_the_end() {
        let disk = faulty(Faults { short: true, ..Faults::default() });
        let whole: Vec<u8> = (0..=255).collect();
        disk.create("a", 0).unwrap().write_all(&whole).unwrap();
        let mut bytes = vec![0; 256];
        disk.open("a").unwrap().read_exact_at(0, &mut bytes).unwrap();
        assert_eq!(bytes, whole);
        assert!(disk.operations() > 4, "nothing came in parts");
    }

    #[test]
    fn nothing_taken_and_nothing_brought_end_in_an_error() {
        let hurt = |kind| Faults { fail: Some(1), kind: Some(kind), ..Faults::default() };
        let disk = faulty(hurt(io::ErrorKind::WriteZero));
        let written = disk.create("a", 0).unwrap().write_all(b"letter");
        assert_eq!(written.unwrap_err().kind(), io::ErrorKind::WriteZero);
        disk.create("a", 0).unwrap().write_all(b"letter").unwrap();
        let disk = Faulty::new(disk.inner.clone(), hurt(io::ErrorKind::UnexpectedEof));
        let read = disk.open("a").unwrap().read_exact_at(0, &mut [0]);
        assert_eq!(read.unwrap_err().kind(), io::ErrorKind::UnexpectedEof);
    }

    #[test]
    fn a_sync_that_is_left_out_is_said_to_be_done() {
        let last = |log: &[String]| log.last().is_some_and(|l| l == "sync a");
        let disk = faulty(Faults { unsynced: Some(last), ..Faults::default() });
        for name in ["a", "b"] {
            let mut file = disk.create(name, 0).unwrap();
            file.write_all(b"letter").unwrap();
            file.sync().unwrap();
        }
        disk.sync_folder("").unwrap();
        let after = disk.inner.after_power_loss(|| 1);
        let lengths = ["a", "b"].map(|name| after.open(name).unwrap().length().unwrap());
        assert_eq!(lengths, [0, 6]);
    }
}
