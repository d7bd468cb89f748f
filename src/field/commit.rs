//! Writing: files, the commit that makes them part of the field, and the removal of old ones.
//!
//! The order of a commit (Pillai et al. 2014, "All file systems are not created equal", for why each
//! step is there): files written and synced, their folders synced, the manifest written under another
//! name, synced, renamed, its folder synced. Only then goes what neither this commit nor the one
//! before needs. The first operation that fails is the last: a sync that failed once may succeed the
//! second time without having done anything.

use super::storage::Output;
use super::{Field, FieldError, files};
use crate::format::container::{
    self, ChunkId, ChunkKind, Codec, ContainerWriter, FileKind, Header, NO_DIRECTION,
};
use crate::format::manifest::{Manifest, Phase};
use crate::format::{Fault, names};
use crate::radiance::Rgb;
use crate::scene::texels;
use std::io::{self, BufWriter};
use std::path::Path;
use std::sync::atomic::Ordering;
use std::sync::{Arc, PoisonError};

/// Bytes gathered before they are written; larger parts are written as they come.
const BUFFER: usize = 1 << 16;

type Chunks = ContainerWriter<BufWriter<Box<dyn Output>>>;

impl Field {
    /// Runs an operation that writes; after the first that fails, none is.
    fn guarded<T>(
        &self,
        doing: &'static str,
        path: &Path,
        operation: impl FnOnce() -> io::Result<T>,
    ) -> Result<T, FieldError> {
        if self.poisoned.load(Ordering::SeqCst) {
            return Err(FieldError::Poisoned(path.to_owned()));
        }
        operation().map_err(|e| {
            self.poisoned.store(true, Ordering::SeqCst);
            match FieldError::io(doing, path)(e) {
                FieldError::Io { doing: "sync", path, source } => {
                    FieldError::Flush { path, source }
                }
                error => error,
            }
        })
    }

    /// Writes a file of so many chunks; `reserve` is its length where that is known.
    fn write(
        &self,
        name: &str,
        (header, chunks, reserve): (Header, usize, u64),
        fill: impl FnOnce(&mut Chunks) -> io::Result<()>,
    ) -> Result<(), FieldError> {
        let path = self.path().join(name);
        let mut out = self.guarded("write", &path, || {
            let out = BufWriter::with_capacity(BUFFER, self.storage.create(name, reserve)?);
            let mut writer = ContainerWriter::new(out, header, chunks)?;
            fill(&mut writer)?;
            self.bytes_written.fetch_add(writer.length(), Ordering::Relaxed);
            writer.finish()?.into_inner().map_err(io::IntoInnerError::into_error)
        })?;
        if self.terms.sync || name.ends_with(names::TEMPORARY) {
            self.guarded("sync", &path, || out.sync())?;
        }
        let folder = name.rsplit_once('/').map_or("", |(folder, _)| folder);
        self.name_changed_in(folder);
        Ok(())
    }

    /// Makes sure that the disk has room for so many bytes, where that can be known; returns how many it has. A write that is not
    /// begun leaves the field as it is, and what was done can still be committed.
    ///
    /// # Errors
    /// [`FieldError::Full`] when it has not.
    pub fn check_room(&self, bytes: u64) -> Result<u64, FieldError> {
        let free = self.storage.free().unwrap_or(u64::MAX);
        if free >= bytes {
            return Ok(free);
        }
        let [free, bytes] = [free, bytes].map(|b| bytesize::ByteSize::b(b).display().iec());
        let why = format!("{free} free, {bytes} kept for what is under way and its commit");
        Err(FieldError::Full {
            path: self.path().join(names::manifest(self.manifest.sequence + 1)),
            source: Arc::new(io::Error::new(io::ErrorKind::StorageFull, why)),
        })
    }

    fn name_changed_in(&self, folder: &str) {
        let mut unsynced = self.unsynced.lock().unwrap_or_else(PoisonError::into_inner);
        if !unsynced.contains(folder) {
            unsynced.insert(folder.to_owned());
        }
    }

    pub(super) fn write_scene(&self, bytes: &[u8]) -> Result<(), FieldError> {
        let id = ChunkId { kind: ChunkKind::Scene, cycle: 0, direction: NO_DIRECTION };
        let header = self.header_of(FileKind::Scene, (0, NO_DIRECTION));
        self.write(names::SCENE, (header, 1, 0), |w| w.chunk(id, Codec::Zstd, bytes))
    }

    /// Writes the tile file of a direction into a folder; see [`Field::begin_folder`].
    ///
    /// # Errors
    /// Of the system.
    pub fn write_tiles(
        &self,
        folder: &str,
        (generation, direction): (u32, u32),
        maps: &[(ChunkKind, Vec<u8>)],
    ) -> Result<(), FieldError> {
        let header = self.header_of(FileKind::Tiles, (generation, direction));
        let length = container::length(maps.iter().map(|(_, bytes)| bytes.len() as u64));
        let name = names::tile_file(folder, direction);
        self.write(&name, (header, maps.len(), length), |w| {
            maps.iter().try_for_each(|(kind, bytes)| {
                let id = ChunkId { kind: *kind, cycle: generation, direction };
                w.chunk(id, Codec::Raw, bytes)
            })
        })
    }

    /// Makes a folder for tile files, unless it is there.
    ///
    /// # Errors
    /// Of the system.
    pub fn begin_folder(&self, folder: &str) -> Result<(), FieldError> {
        let path = self.path().join(folder);
        self.guarded("create", &path, || self.storage.create_folder(folder))?;
        self.name_changed_in("");
        Ok(())
    }

    /// Writes the texture maps of a generation: P^T, P^C, and P^T of half of the lines, two values a
    /// texel.
    ///
    /// # Errors
    /// Of the system.
    pub fn write_textures(
        &self,
        generation: u32,
        total: &[Rgb],
        current: &[Rgb],
        half: &[Rgb],
    ) -> Result<(), FieldError> {
        let id = |kind| ChunkId { kind, cycle: generation, direction: NO_DIRECTION };
        // Stored as they are: the field's digest must not depend on a compressor's version.
        let blocks = |values| <[Rgb]>::chunks(values, files::BLOCK / 12).map(texels::to_bytes);
        let header = self.header_of(FileKind::Textures, (generation, NO_DIRECTION));
        let maps = [total, current, half];
        let length = container::length(maps.map(|v| 12 * v.len() as u64).into_iter());
        self.write(&names::textures(generation), (header, maps.len(), length), |w| {
            w.raw_chunk(id(ChunkKind::TotalTexture), blocks(total))?;
            w.raw_chunk(id(ChunkKind::CurrentTexture), blocks(current))?;
            w.raw_chunk(id(ChunkKind::HalfTexture), blocks(half))
        })
    }

    /// Reads a texture map of a generation, of `count` values.
    ///
    /// # Errors
    /// When the file is missing, damaged, or does not hold so many values.
    pub fn read_texture(
        &self,
        generation: u32,
        kind: ChunkKind,
        count: usize,
    ) -> Result<Vec<Rgb>, FieldError> {
        let name = names::textures(generation);
        let header = self.header_of(FileKind::Textures, (generation, NO_DIRECTION));
        let mut file = files::open(&*self.storage, &name, header.kind)?.belongs(&header)?;
        let entry = file.find(kind, NO_DIRECTION)?;
        if entry.raw != 12 * count as u64 {
            let what = format!("texture map: {} bytes for {count} values", entry.raw);
            return Err(Fault::invalid(what).in_file(file.path.display()).into());
        }
        let mut values = Vec::with_capacity(count);
        let mut rest = Vec::new();
        file.blocks(&entry, |block| {
            rest.extend_from_slice(block);
            let whole = rest.len() / 12 * 12;
            texels::read_values(&rest[..whole], &mut values)?;
            rest.drain(..whole);
            Ok(())
        })?;
        Ok(values)
    }

    /// Writes the sums of the cycle under way for the next commit, `length` bytes in blocks.
    ///
    /// # Errors
    /// Of the system.
    pub fn write_sums(
        &mut self,
        length: u64,
        blocks: impl Iterator<Item = Vec<u8>>,
    ) -> Result<(), FieldError> {
        let cycle = self.manifest.cycle;
        let id = ChunkId { kind: ChunkKind::Sums, cycle, direction: NO_DIRECTION };
        let header = self.header_of(FileKind::Sums, (cycle, NO_DIRECTION));
        let length = container::length([length].into_iter());
        let name = names::sums(self.manifest.sequence + 1);
        self.write(&name, (header, 1, length), |w| w.raw_chunk(id, blocks))?;
        self.manifest.has_sums = true;
        Ok(())
    }

    /// Hands the committed sums over in blocks; whether they are sound is known at the end.
    ///
    /// # Errors
    /// When the file is missing or damaged, or `take` does not like a block.
    pub fn read_sums(
        &self,
        take: impl FnMut(&[u8]) -> Result<(), Fault>,
    ) -> Result<(), FieldError> {
        let name = names::sums(self.manifest.sequence);
        let header = self.header_of(FileKind::Sums, (self.manifest.cycle, NO_DIRECTION));
        let mut file = files::open(&*self.storage, &name, header.kind)?.belongs(&header)?;
        let entry = file.find(ChunkKind::Sums, NO_DIRECTION)?;
        file.blocks(&entry, take)
    }

    /// Commits the manifest: from here on this is the state of the field.
    ///
    /// # Errors
    /// Of the system; the commit before stands then.
    pub fn commit(&mut self) -> Result<(), FieldError> {
        let mut next = self.manifest.clone();
        next.sequence += 1;
        next.statistics.bytes_written += self.bytes_written.swap(0, Ordering::Relaxed);
        let record = crate::format::manifest::record_to_bytes(&next)
            .map_err(|f| f.in_file(self.path().display()))?;
        self.sync_folders()?;
        let name = names::manifest(next.sequence);
        let (temporary, path) = (names::temporary(name), self.path().join(name));
        let header = self.header_of(FileKind::Manifest, (0, NO_DIRECTION));
        self.write(&temporary, (header, 1, 0), |w| w.chunk(Manifest::ID, Codec::Raw, &record))?;
        self.guarded("publish", &path, || self.storage.rename(&temporary, name))?;
        self.sync_folders()?;
        self.manifest = next.clone();
        self.committed.push(next);
        if self.committed.len() > 2 {
            self.committed.remove(0);
        }
        self.collect()
    }

    fn sync_folders(&self) -> Result<(), FieldError> {
        let mut unsynced = self.unsynced.lock().unwrap_or_else(PoisonError::into_inner);
        for folder in std::mem::take(&mut *unsynced) {
            let path = self.path().join(&folder);
            if self.terms.sync {
                self.guarded("sync", &path, || self.storage.sync_folder(&folder))?;
            }
        }
        Ok(())
    }

    /// Removes what neither of the last two commits needs: old generations, and what a run that was
    /// stopped before its commit has left.
    ///
    /// # Errors
    /// Of the system.
    pub fn collect(&self) -> Result<(), FieldError> {
        let needed: Vec<String> = self.committed.iter().flat_map(needed_by).collect();
        let names = self.storage.list("").map_err(FieldError::io("list", self.path()))?;
        let is_old = |n: &&String| {
            let is_begun = names::is_ours(n) && n.ends_with(names::TEMPORARY);
            is_begun || names::is_of_a_commit(n) && !needed.contains(n)
        };
        names.iter().filter(is_old).try_for_each(|name| self.remove(name))
    }

    /// Removes a file, or a folder of tile files; what else someone has put into one stays.
    fn remove(&self, name: &str) -> Result<(), FieldError> {
        use io::ErrorKind::{DirectoryNotEmpty, NotADirectory, NotFound};
        let path = self.path().join(name);
        self.guarded("remove", &path, || {
            let mut files = match self.storage.list(name) {
                Err(e) if matches!(e.kind(), NotADirectory | NotFound) => {
                    return self.storage.remove(name);
                }
                files => files?,
            };
            files.retain(|f| names::is_tile_file(f));
            files.iter().try_for_each(|f| self.storage.remove(&format!("{name}/{f}")))?;
            match self.storage.remove_folder(name) {
                Err(e) if e.kind() == DirectoryNotEmpty => Ok(()),
                result => result,
            }
        })
    }

    /// Makes sure of what this run goes on from. The run before may have been killed before the last
    /// sync of its commit, or have left syncing to the system; the next commit says that all it names
    /// has reached the disk.
    pub(super) fn make_lasting(&self) -> Result<(), FieldError> {
        let last = &self.manifest;
        if !self.terms.sync || last.phase == Phase::Finished {
            return Ok(());
        }
        self.name_changed_in("");
        if last.statistics.sync.is_some() {
            return self.sync_folders();
        }
        let sync = |name: &str| {
            let path = self.path().join(name);
            self.guarded("sync", &path, || self.storage.sync_file(name))
        };
        let names = self.storage.list("").map_err(FieldError::io("list", self.path()))?;
        for name in names.iter().filter(|n| names::is_ours(n) && *n != names::LOCK) {
            // A file is no folder.
            let Ok(files) = self.storage.list(name) else {
                sync(name)?;
                continue;
            };
            let ours = files.iter().filter(|f| names::is_tile_file(f));
            { ours }.try_for_each(|f| sync(&format!("{name}/{f}")))?;
            self.name_changed_in(name);
        }
        self.sync_folders()
    }

    /// Tidies a finished field up after a run that was stopped at its very end.
    ///
    /// # Errors
    /// Of the system; the field is finished all the same.
    pub fn settle(&mut self) -> Result<(), FieldError> {
        // The commit before the end needs what a finished field does not.
        match self.committed.iter().all(|m| m.phase == Phase::Finished) {
            true => self.collect(),
            false => self.commit(),
        }
    }

    /// Digest of the finished field: a hash over the scene's, the textures' and every direction's
    /// chunk hashes, in order. The same scene and parameters give the same digest on every run. All
    /// that it stands for is read again: some of it may have been written days ago.
    ///
    /// # Errors
    /// When a file is missing or damaged.
    pub fn digest(&self) -> Result<[u8; 16], FieldError> {
        let verify = |name: &str, kind| -> Result<(), FieldError> {
            let mut file = files::open(&*self.storage, name, kind)?;
            let entries = file.directory.entries.clone();
            entries.iter().try_for_each(|entry| file.chunk(entry).map(|_| ()))
        };
        verify(names::SCENE, FileKind::Scene)?;
        verify(&names::textures(self.manifest.cycle), FileKind::Textures)?;
        for direction in 0..self.manifest.parameters.directions {
            verify(&names::tile_file(names::TOTAL, direction), FileKind::Tiles)?;
        }
        digest(&*self.storage, &self.manifest)
    }
}

/// Digest of the finished field with that manifest; see [`Field::digest`].
///
/// # Errors
/// When a file is missing or damaged.
pub fn digest(
    storage: &dyn super::storage::Storage,
    manifest: &Manifest,
) -> Result<[u8; 16], FieldError> {
    let mut hashes = manifest.scene_hash.to_vec();
    let mut add = |name: &str, kind| -> Result<(), FieldError> {
        for entry in files::open(storage, name, kind)?.directory.entries {
            hashes.extend(entry.hash.to_le_bytes());
        }
        Ok(())
    };
    add(&names::textures(manifest.cycle), FileKind::Textures)?;
    for direction in 0..manifest.parameters.directions {
        add(&names::tile_file(names::TOTAL, direction), FileKind::Tiles)?;
    }
    Ok(super::hash(&hashes))
}

/// Files and folders that a commit needs and others may not.
fn needed_by(m: &Manifest) -> Vec<String> {
    let mut needed = Vec::new();
    if m.has_sums {
        needed.push(names::sums(m.sequence));
    }
    needed.push(names::textures(m.cycle));
    if m.phase != Phase::Finished {
        needed.push(names::generation(m.cycle));
    }
    if m.phase == Phase::Propagating {
        needed.push(names::generation(m.cycle + 1));
    }
    needed
}
