//! A folder in memory that knows what of it would survive a loss of power.
//!
//! Every file keeps the bytes that were synced and, apart from them, the writes since then; every
//! folder its synced names and the changes since then. [`Memory::after_power_loss`] keeps any of the
//! unsynced writes, torn into sectors, and any of the unsynced changes of names, in any order: more
//! than most file systems lose, so that nothing can be left to their kindness. A file that is made
//! anew is the old one cut to nothing, as on a disk: who writes over what was committed has lost it.

use super::{Input, Lock, LockError, Output, Storage};
use std::collections::BTreeMap;
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

/// Sizes in which a disk writes whole or not at all.
const SECTORS: [usize; 2] = [512, 4096];

/// A field's folder in memory.
pub struct Memory {
    place: PathBuf,
    names: Arc<Mutex<Names>>,
    writer: Mutex<Weak<()>>,
    capacity: Arc<AtomicU64>,
}

/// What was done to a file's bytes.
#[derive(Clone)]
enum Change {
    /// Cut to nothing.
    Cut,
    /// Bytes at a place; the length counts too.
    Bytes(usize, Vec<u8>),
}

#[derive(Clone, Default)]
struct File {
    live: Vec<u8>,
    synced: Vec<u8>,
    /// Since the last sync.
    pending: Vec<Change>,
}

type Shared = Arc<Mutex<File>>;

/// Files by name, `folder/file` or `file`; folders end with `/`.
type Tree = BTreeMap<String, Shared>;

#[derive(Default)]
struct Names {
    live: Tree,
    synced: Tree,
    /// Changes since the folder was synced, each all or nothing: names and what they then stand for.
    pending: Vec<Vec<(String, Option<Shared>)>>,
}

impl Names {
    fn used(&self) -> u64 {
        self.live.values().map(|f| lock(f).live.len() as u64).sum()
    }
}

/// Which folder's sync makes a name last.
fn folder_of(name: &str) -> &str {
    name.trim_end_matches('/').rsplit_once('/').map_or("", |(folder, _)| folder)
}

fn lock<T>(of: &Mutex<T>) -> MutexGuard<'_, T> {
    of.lock().unwrap_or_else(PoisonError::into_inner)
}

fn missing() -> io::Error {
    io::ErrorKind::NotFound.into()
}

impl Default for Memory {
    fn default() -> Memory {
        Memory::with_capacity(u64::MAX)
    }
}

impl Memory {
    /// An empty folder on a disk of so many bytes.
    pub fn with_capacity(capacity: u64) -> Memory {
        Memory {
            place: PathBuf::from("memory.field"),
            names: Arc::default(),
            writer: Mutex::default(),
            capacity: Arc::new(AtomicU64::new(capacity)),
        }
    }

    /// Makes the disk larger or smaller.
    pub fn set_capacity(&self, capacity: u64) {
        self.capacity.store(capacity, Ordering::Relaxed);
    }

    /// What a disk holds after the power went: all that was synced, and of the rest whatever `dice`
    /// (any number at each call) says.
    pub fn after_power_loss(&self, mut dice: impl FnMut() -> u64) -> Memory {
        let names = lock(&self.names);
        let mut tree = names.synced.clone();
        for change in &names.pending {
            if dice().is_multiple_of(2) {
                apply(&mut tree, change);
            }
        }
        // A file without its folder is lost.
        let folders: Vec<String> = tree.keys().filter(|n| n.ends_with('/')).cloned().collect();
        tree.retain(|name, _| {
            let folder = folder_of(name);
            folder.is_empty() || folders.iter().any(|f| f.trim_end_matches('/') == folder)
        });
        for file in tree.values_mut() {
            let torn = lock(file).torn(&mut dice);
            *file = Arc::new(Mutex::new(torn));
        }
        let after = Memory::with_capacity(self.capacity.load(Ordering::Relaxed));
        *lock(&after.names) = Names { live: tree.clone(), synced: tree, pending: Vec::new() };
        after
    }

    /// The bytes of a file, to be looked at or damaged.
    pub fn edit(&self, name: &str, change: impl FnOnce(&mut Vec<u8>)) {
        if let Some(file) = lock(&self.names).live.get(name) {
            change(&mut lock(file).live);
        }
    }

    /// Bytes of all files.
    pub fn used(&self) -> u64 {
        lock(&self.names).used()
    }

    fn file(&self, name: &str) -> io::Result<Shared> {
        lock(&self.names).live.get(name).cloned().ok_or_else(missing)
    }

    fn change(&self, change: Vec<(String, Option<Shared>)>) {
        let mut names = lock(&self.names);
        apply(&mut names.live, &change);
        names.pending.push(change);
    }
}

fn apply(tree: &mut Tree, change: &[(String, Option<Shared>)]) {
    for (name, file) in change {
        match file {
            Some(file) => tree.insert(name.clone(), file.clone()),
            None => tree.remove(name),
        };
    }
}

impl File {
    fn sync(&mut self) {
        self.synced = self.live.clone();
        self.pending.clear();
    }

    /// What of it a disk holds after the power went.
    fn torn(&self, dice: &mut impl FnMut() -> u64) -> File {
        let mut bytes = self.synced.clone();
        for change in &self.pending {
            let Change::Bytes(at, written) = change else {
                if dice().is_multiple_of(2) {
                    bytes.clear();
                }
                continue;
            };
            let sector = SECTORS[(dice() % 2) as usize];
            let mut from = 0;
            while from < written.len() {
                let to = written.len().min((at + from + sector) / sector * sector - at);
                if dice().is_multiple_of(2) {
                    put(&mut bytes, at + from, &written[from..to]);
                }
                from = to;
            }
        }
        File { live: bytes.clone(), synced: bytes, pending: Vec::new() }
    }
}

fn put(bytes: &mut Vec<u8>, at: usize, written: &[u8]) {
    if bytes.len() < at + written.len() {
        bytes.resize(at + written.len(), 0);
    }
    bytes[at..at + written.len()].copy_from_slice(written);
}

impl Storage for Memory {
    fn place(&self) -> &Path {
        &self.place
    }

    fn make(&self) -> io::Result<()> {
        Ok(())
    }

    fn lock(&self, _: &str) -> Result<Lock, LockError> {
        let mut writer = lock(&self.writer);
        if writer.upgrade().is_some() {
            return Err(LockError::Held(String::new()));
        }
        let held = Arc::new(());
        *writer = Arc::downgrade(&held);
        Ok(Box::new(held))
    }

    fn list(&self, folder: &str) -> io::Result<Vec<String>> {
        let names = lock(&self.names);
        if !folder.is_empty() && !names.live.contains_key(&format!("{folder}/")) {
            return Err(missing());
        }
        let inside = names.live.keys().filter(|n| folder_of(n) == folder);
        let bare =
            |n: &String| n.trim_end_matches('/').rsplit('/').next().unwrap_or_default().to_owned();
        Ok(inside.map(bare).collect())
    }

    fn open(&self, name: &str) -> io::Result<Box<dyn Input>> {
        Ok(Box::new(Reading(self.file(name)?)))
    }

    fn create(&self, name: &str, reserve: u64) -> io::Result<Box<dyn Output>> {
        let folder = folder_of(name);
        if !folder.is_empty() {
            self.file(&format!("{folder}/"))?;
        }
        let there = self.file(name).ok();
        if let Some(file) = &there {
            let mut file = lock(file);
            file.live.clear();
            file.pending.push(Change::Cut);
        }
        let file = there.unwrap_or_else(|| {
            let file = Shared::default();
            self.change(vec![(name.to_owned(), Some(file.clone()))]);
            file
        });
        if reserve > self.free().unwrap_or(0) {
            return Err(io::ErrorKind::StorageFull.into());
        }
        let (names, capacity) = (self.names.clone(), self.capacity.clone());
        Ok(Box::new(Writing { file, at: 0, names, capacity }))
    }

    fn rename(&self, from: &str, to: &str) -> io::Result<()> {
        let file = self.file(from)?;
        self.change(vec![(from.to_owned(), None), (to.to_owned(), Some(file))]);
        Ok(())
    }

    fn remove(&self, name: &str) -> io::Result<()> {
        self.file(name)?;
        self.change(vec![(name.to_owned(), None)]);
        Ok(())
    }

    fn create_folder(&self, folder: &str) -> io::Result<()> {
        let name = format!("{folder}/");
        if self.file(&name).is_err() {
            self.change(vec![(name, Some(Shared::default()))]);
        }
        Ok(())
    }

    fn remove_folder(&self, folder: &str) -> io::Result<()> {
        if !self.list(folder)?.is_empty() {
            return Err(io::ErrorKind::DirectoryNotEmpty.into());
        }
        self.change(vec![(format!("{folder}/"), None)]);
        Ok(())
    }

    fn sync_folder(&self, folder: &str) -> io::Result<()> {
        let mut names = lock(&self.names);
        let Names { synced, pending, .. } = &mut *names;
        pending.retain(|change| {
            let here = change.iter().all(|(name, _)| folder_of(name) == folder);
            if here {
                apply(synced, change);
            }
            !here
        });
        Ok(())
    }

    fn sync_file(&self, name: &str) -> io::Result<()> {
        lock(&*self.file(name)?).sync();
        Ok(())
    }

    fn free(&self) -> Option<u64> {
        Some(self.capacity.load(Ordering::Relaxed).saturating_sub(self.used()))
    }
}

struct Reading(Shared);

impl Input for Reading {
    fn length(&self) -> io::Result<u64> {
        Ok(lock(&self.0).live.len() as u64)
    }

    fn read_at(&mut self, at: u64, into: &mut [u8]) -> io::Result<usize> {
        let file = lock(&self.0);
        let from = usize::try_from(at).map_or(file.live.len(), |at| at.min(file.live.len()));
        let count = into.len().min(file.live.len() - from);
        into[..count].copy_from_slice(&file.live[from..from + count]);
        Ok(count)
    }
}

struct Writing {
    file: Shared,
    at: usize,
    names: Arc<Mutex<Names>>,
    capacity: Arc<AtomicU64>,
}

impl Write for Writing {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let capacity = self.capacity.load(Ordering::Relaxed);
        let used = if capacity == u64::MAX { 0 } else { lock(&self.names).used() };
        let mut file = lock(&self.file);
        let grown = (self.at + bytes.len()).saturating_sub(file.live.len()) as u64;
        if used.saturating_add(grown) > capacity {
            return Err(io::ErrorKind::StorageFull.into());
        }
        put(&mut file.live, self.at, bytes);
        file.pending.push(Change::Bytes(self.at, bytes.to_vec()));
        self.at += bytes.len();
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for Writing {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let SeekFrom::Start(at) = to else { return Err(io::ErrorKind::Unsupported.into()) };
        self.at = usize::try_from(at).map_err(|_| io::Error::from(io::ErrorKind::InvalidInput))?;
        Ok(at)
    }
}

impl Output for Writing {
    fn sync(&mut self) -> io::Result<()> {
        lock(&self.file).sync();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(disk: &Memory, name: &str, bytes: &[u8], sync: bool) {
        let mut file = disk.create(name, 0).unwrap();
        file.write_all(bytes).unwrap();
        if sync {
            file.sync().unwrap();
        }
    }

    fn read(disk: &Memory, name: &str) -> io::Result<Vec<u8>> {
        let mut file = disk.open(name)?;
        let mut bytes = vec![0; file.length()? as usize];
        file.read_exact_at(0, &mut bytes)?;
        Ok(bytes)
    }

    /// Nothing that was not synced stays, or all of it.
    fn none() -> u64 {
        1
    }

    fn all() -> u64 {
        0
    }

    #[test]
    fn a_file_lasts_when_it_and_its_name_are_synced() {
        for (file, name, lasts) in [(true, true, true), (true, false, false), (false, true, true)] {
            let disk = Memory::default();
            write(&disk, "a", b"letter", file);
            if name {
                disk.sync_folder("").unwrap();
            }
            let after = disk.after_power_loss(none);
            assert_eq!(read(&after, "a").is_ok(), lasts, "{file} {name}");
            if lasts {
                let expected: &[u8] = if file { b"letter" } else { b"" };
                assert_eq!(read(&after, "a").unwrap(), expected);
            }
            assert_eq!(read(&disk.after_power_loss(all), "a").unwrap(), b"letter");
        }
    }

    #[test]
    fn a_file_in_a_folder_that_is_lost_is_lost() {
        let disk = Memory::default();
        disk.create_folder("f").unwrap();
        write(&disk, "f/a", b"letter", true);
        disk.sync_folder("f").unwrap();
        assert!(read(&disk.after_power_loss(none), "f/a").is_err());
        disk.sync_folder("").unwrap();
        assert_eq!(read(&disk.after_power_loss(none), "f/a").unwrap(), b"letter");
        assert!(disk.create("g/a", 0).is_err(), "no such folder");
    }

    #[test]
    fn renaming_is_all_or_nothing_and_lasts_when_the_folder_is_synced() {
        let disk = Memory::default();
        write(&disk, "a", b"old", true);
        write(&disk, "a.tmp", b"new", true);
        disk.sync_folder("").unwrap();
        disk.rename("a.tmp", "a").unwrap();
        assert_eq!(read(&disk, "a").unwrap(), b"new");
        let lost = disk.after_power_loss(none);
        assert_eq!(
            (read(&lost, "a").unwrap(), read(&lost, "a.tmp").unwrap()),
            (b"old".to_vec(), b"new".to_vec())
        );
        let kept = disk.after_power_loss(all);
        assert_eq!(read(&kept, "a").unwrap(), b"new");
        assert!(read(&kept, "a.tmp").is_err());
        disk.sync_folder("").unwrap();
        assert_eq!(read(&disk.after_power_loss(none), "a").unwrap(), b"new");
    }

    #[test]
    fn what_was_not_synced_is_torn_into_sectors() {
        let disk = Memory::default();
        write(&disk, "a", &[7; 4096], true);
        disk.sync_folder("").unwrap();
        let mut file = disk.create("a", 0).unwrap();
        file.write_all(&[9; 4096]).unwrap();
        let mut seen = std::collections::BTreeSet::new();
        for seed in 0..200u64 {
            let mut state = seed;
            let after = disk.after_power_loss(|| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(99);
                state >> 33
            });
            let bytes = read(&after, "a").unwrap();
            for sector in bytes.chunks(512) {
                assert!(sector.iter().all(|b| *b == sector[0]), "torn inside a sector");
            }
            seen.insert(bytes);
        }
        assert!(seen.contains(&vec![7; 4096]) && seen.contains(&vec![9; 4096]));
        assert!(seen.contains(&Vec::new()), "never cut");
        assert!(seen.len() > 10, "only {} ways", seen.len());
    }

    /// The one thing that must never be done to a file that a commit names.
    #[test]
    fn a_file_made_anew_has_lost_its_old_bytes() {
        let disk = Memory::default();
        write(&disk, "a", b"committed", true);
        disk.sync_folder("").unwrap();
        drop(disk.create("a", 0).unwrap());
        assert_eq!(read(&disk, "a").unwrap(), b"");
        assert_eq!(read(&disk.after_power_loss(all), "a").unwrap(), b"");
    }

    #[test]
    fn a_full_disk_takes_no_more() {
        let disk = Memory::with_capacity(10);
        assert_eq!(disk.create("a", 11).err().unwrap().kind(), io::ErrorKind::StorageFull);
        let mut file = disk.create("a", 10).unwrap();
        file.write_all(&[1; 8]).unwrap();
        assert_eq!(file.write(&[1; 3]).unwrap_err().kind(), io::ErrorKind::StorageFull);
        assert_eq!((disk.used(), disk.free()), (8, Some(2)));
        // In place of bytes that are there others have room.
        file.seek(SeekFrom::Start(0)).unwrap();
        file.write_all(&[2; 10]).unwrap();
        disk.set_capacity(20);
        file.write_all(&[3; 10]).unwrap();
        disk.remove("a").unwrap();
        assert_eq!(disk.free(), Some(20));
    }

    #[test]
    fn one_writer_at_a_time() {
        let disk = Memory::default();
        let held = disk.lock("").unwrap();
        assert!(matches!(disk.lock(""), Err(LockError::Held(_))));
        drop(held);
        disk.lock("").unwrap();
    }

    #[test]
    fn folders_are_listed_and_removed_when_they_are_empty() {
        let disk = Memory::default();
        assert_eq!(disk.list("f").unwrap_err().kind(), io::ErrorKind::NotFound);
        disk.create_folder("f").unwrap();
        write(&disk, "f/b", b"", false);
        write(&disk, "f/a", b"", false);
        write(&disk, "c", b"", false);
        assert_eq!(disk.list("f").unwrap(), ["a", "b"]);
        assert_eq!(disk.list("").unwrap(), ["c", "f"]);
        assert!(disk.remove_folder("f").is_err());
        ["f/a", "f/b"].into_iter().for_each(|name| disk.remove(name).unwrap());
        disk.remove_folder("f").unwrap();
        assert_eq!(disk.list("").unwrap(), ["c"]);
    }
}
