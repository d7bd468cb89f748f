//! A folder in memory that knows what of it would survive a loss of power.
//!
//! Every file keeps the bytes that were synced and, apart from them, the writes since then; every
//! folder its synced names and the changes since then. [`Memory::after_power_loss`] keeps any of the
//! unsynced writes, torn into sectors, and any of the unsynced changes of names, in any order: more
//! than most file systems lose, so that nothing can be left to their kindness.

use super::{Input, Lock, LockError, Output, Storage};
use std::collections::BTreeMap;
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

/// Sizes in which a disk writes whole or not at all.
const SECTORS: [usize; 2] = [512, 4096];

/// A field's folder in memory.
pub struct Memory {
    place: PathBuf,
    names: Mutex<Names>,
    writer: Mutex<Weak<()>>,
    capacity: u64,
}

#[derive(Clone, Default)]
struct File {
    live: Vec<u8>,
    synced: Vec<u8>,
    /// Since the last sync: places and bytes; the length counts too.
    pending: Vec<(usize, Vec<u8>)>,
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
            names: Mutex::default(),
            writer: Mutex::default(),
            capacity,
        }
    }

    /// What a disk holds after the power went: all that was synced, and of the rest whatever `dice`
    /// (any number at each call) says.
    pub fn after_power_loss(&self, mut dice: impl FnMut() -> u64) -> Memory {
        let names = lock(&self.names);
        let mut tree = names.synced.clone();
        for change in &names.pending {
            if dice() % 2 == 0 {
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
        let after = Memory::with_capacity(self.capacity);
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
        lock(&self.names).live.values().map(|f| lock(f).live.len() as u64).sum()
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
    /// What of it a disk holds after the power went.
    fn torn(&self, dice: &mut impl FnMut() -> u64) -> File {
        let mut bytes = self.synced.clone();
        for (at, written) in &self.pending {
            let sector = SECTORS[(dice() % 2) as usize];
            let mut from = 0;
            while from < written.len() {
                let to = written.len().min((at + from + sector) / sector * sector - at);
                if dice() % 2 == 0 {
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
        if self.used().saturating_add(reserve) > self.capacity {
            return Err(io::ErrorKind::StorageFull.into());
        }
        let file = Shared::default();
        self.change(vec![(name.to_owned(), Some(file.clone()))]);
        Ok(Box::new(Writing { file, at: 0 }))
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

    fn free(&self) -> Option<u64> {
        Some(self.capacity.saturating_sub(self.used()))
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
}

impl Write for Writing {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut file = lock(&self.file);
        put(&mut file.live, self.at, bytes);
        file.pending.push((self.at, bytes.to_vec()));
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
        let mut file = lock(&self.file);
        file.synced = file.live.clone();
        file.pending.clear();
        Ok(())
    }
}
