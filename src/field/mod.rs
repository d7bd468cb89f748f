//! Act one, kept: a field in the making, as a directory of immutable files.
//!
//! In: what the bake makes; out: files, each written under a temporary name and renamed, and one
//! commit record, the manifest. What the manifest does not name is not there. One writer at a time
//! holds the lock; readers take nothing.

pub mod files;

pub mod pages;

pub mod writer;

use crate::format::container::{
    self, ChunkId, ChunkKind, Codec, Directory, FileKind, Header, NO_DIRECTION,
};
use crate::format::manifest::{Manifest, Parameters, Phase, Statistics, header};
use crate::format::{Fault, FormatError, names};
use crate::radiance::Rgb;
use crate::scene::{Scene, stored};
use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use twox_hash::XxHash3_128;

/// Revision of the algorithm: raised whenever the same scene and parameters give other bits.
pub const REVISION: u32 = 1;

/// What can go wrong with a field.
#[derive(Clone, Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FieldError {
    /// The system refused an operation on a file.
    #[error("{path}: cannot {doing}: {source}")]
    Io {
        /// What was being done.
        doing: &'static str,
        /// To which file.
        path: PathBuf,
        /// The system's answer.
        source: Arc<io::Error>,
    },
    /// A file of the field is damaged or not what it should be.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// Another process bakes it.
    #[error("{0}: is being baked by another process; wait for it or stop it")]
    Locked(PathBuf),
    /// Something else is where the field should be.
    #[error("{0}: exists and is not a VLF field; nothing was changed. Choose another name")]
    Foreign(PathBuf),
    /// The field there was begun with another scene or other parameters.
    #[error(
        "{path}: was begun with {what}; nothing was changed. Start a new field, or ask for the \
         same bake to go on with it"
    )]
    Identity {
        /// The field.
        path: PathBuf,
        /// The difference.
        what: String,
    },
}

impl FieldError {
    /// For `map_err` on an operation on a file.
    pub fn io<'a>(doing: &'static str, path: &'a Path) -> impl FnOnce(io::Error) -> Self + use<'a> {
        move |e| FieldError::Io { doing, path: path.to_owned(), source: Arc::new(e) }
    }
}

/// A field that this process may write.
pub struct Field {
    path: PathBuf,
    manifest: Manifest,
    header: Header,
    bytes_written: AtomicU64,
    /// Held, not read: closing it gives the lock back.
    _lock: File,
}

/// Texture maps of one generation, two values a texel.
pub struct Textures {
    /// P^T.
    pub total: Vec<Rgb>,
    /// P^C, what is still to be shot.
    pub current: Vec<Rgb>,
}

fn hash(bytes: &[u8]) -> [u8; 16] {
    XxHash3_128::oneshot(bytes).to_le_bytes()
}

/// Names the first difference between what a field was begun with and what is asked for.
fn difference(old: &Manifest, new: &Manifest) -> Option<String> {
    let (a, b) = (&old.parameters, &new.parameters);
    let differs = |what: &str, a: &dyn std::fmt::Debug, b: &dyn std::fmt::Debug| {
        let (a, b) = (format!("{a:?}"), format!("{b:?}"));
        (a != b).then(|| format!("{what} {a}, not {b}"))
    };
    differs("algorithm revision", &old.revision, &new.revision)
        .or_else(|| (old.scene_hash != new.scene_hash).then(|| "another scene".to_owned()))
        .or_else(|| differs("directions", &a.directions, &b.directions))
        .or_else(|| differs("resolution", &a.resolution, &b.resolution))
        .or_else(|| differs("tile", &a.tile, &b.tile))
        .or_else(|| differs("cycles", &a.cycles, &b.cycles))
        .or_else(|| differs("perturbations", &a.perturbations, &b.perturbations))
        .or_else(|| differs("parameters", a, b))
}

impl Field {
    /// Begins a field at `path`, or takes up the unfinished or finished one that is there if it is
    /// the same bake. `exponent` scales stored radiance, see [`crate::format::tiles::exponent_for`].
    ///
    /// # Errors
    /// When something else is there, another process bakes it, it was begun differently, its commit
    /// record is damaged, or the system refuses. Nothing that was there is changed then.
    pub fn create_or_resume(
        path: &Path,
        scene: &Scene,
        parameters: &Parameters,
        exponent: i32,
    ) -> Result<Field, FieldError> {
        let scene_bytes = stored::to_bytes(scene);
        let fresh = Manifest {
            revision: REVISION,
            parameters: parameters.clone(),
            scene_hash: hash(&scene_bytes),
            phase: Phase::Propagating,
            cycle: 0,
            done: vec![0; (parameters.directions as usize).div_ceil(8)],
            sequence: 0,
            has_sums: false,
            ledger: Vec::new(),
            statistics: Statistics::default(),
            digest: [0; 16],
        };
        let record = crate::format::manifest::record_to_bytes(&(
            fresh.revision,
            &fresh.parameters,
            fresh.scene_hash,
        ))
        .map_err(|f| f.in_file(path.display()))?;
        let surfaces = scene.surfaces.len() as u32;
        let place = (0, NO_DIRECTION);
        let manifest_header =
            header(FileKind::Manifest, hash(&record), parameters, surfaces, exponent, place);

        match fs::symlink_metadata(path) {
            Err(e) if e.kind() == io::ErrorKind::NotFound => {
                fs::create_dir_all(path).map_err(FieldError::io("create the field", path))?;
            }
            Err(e) => return Err(FieldError::io("look at", path)(e)),
            Ok(_) if path.is_dir() && files::only_ours(path)? => {}
            Ok(_) => return Err(FieldError::Foreign(path.to_owned())),
        }
        let lock_path = path.join(names::LOCK);
        let lock = File::options()
            .create(true)
            .truncate(false)
            .write(true)
            .open(&lock_path)
            .map_err(FieldError::io("create", &lock_path))?;
        lock.try_lock().map_err(|e| match e {
            TryLockError::WouldBlock => FieldError::Locked(path.to_owned()),
            TryLockError::Error(e) => FieldError::io("lock", &lock_path)(e),
        })?;

        let manifest_path = path.join(names::MANIFEST);
        let (manifest, header, begun) = if manifest_path.exists() {
            let (header, manifest) = read_manifest(path)?;
            if let Some(what) = difference(&manifest, &fresh) {
                return Err(FieldError::Identity { path: path.to_owned(), what });
            }
            (manifest, header, true)
        } else {
            (fresh, manifest_header, false)
        };
        let bytes_written = AtomicU64::new(0);
        let mut field =
            Field { path: path.to_owned(), manifest, header, bytes_written, _lock: lock };
        if !begun {
            let id = ChunkId { kind: ChunkKind::Scene, cycle: 0, direction: NO_DIRECTION };
            let head = field.header_of(FileKind::Scene, place);
            field.publish(names::SCENE, head, &[(id, Codec::Zstd, &scene_bytes)])?;
            field.commit()?;
        }
        Ok(field)
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What is committed, with changes that the next commit will write.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// For changes that the next commit will write.
    pub fn manifest_mut(&mut self) -> &mut Manifest {
        &mut self.manifest
    }

    /// First block of the field's files, apart from what the file is.
    pub fn header_of(&self, kind: FileKind, (generation, direction): (u32, u32)) -> Header {
        Header { kind, generation, direction, ..self.header.clone() }
    }

    fn encode(
        &self,
        path: &Path,
        header: Header,
        chunks: &[(ChunkId, Codec, &[u8])],
    ) -> Result<Vec<u8>, FieldError> {
        let bytes =
            container::to_bytes(header, chunks).map_err(FieldError::io("compress", path))?;
        self.bytes_written.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        Ok(bytes)
    }

    fn publish(
        &self,
        name: &str,
        header: Header,
        chunks: &[(ChunkId, Codec, &[u8])],
    ) -> Result<(), FieldError> {
        let path = self.path.join(name);
        files::publish(&path, &self.encode(&path, header, chunks)?)
    }

    /// Writes the tile file of a direction into a folder that is not published yet; see
    /// [`Field::begin_folder`].
    ///
    /// # Errors
    /// Of the system.
    pub fn write_tiles(
        &self,
        folder: &str,
        (generation, direction): (u32, u32),
        maps: &[(ChunkKind, &[u8])],
    ) -> Result<(), FieldError> {
        let chunks: Vec<_> = maps
            .iter()
            .map(|(kind, bytes)| {
                (ChunkId { kind: *kind, cycle: generation, direction }, Codec::Raw, *bytes)
            })
            .collect();
        let header = self.header_of(FileKind::Tiles, (generation, direction));
        let path = names::tiles(&self.path, &names::unpublished(folder), direction);
        let bytes = self.encode(&path, header, &chunks)?;
        fs::write(&path, bytes).map_err(FieldError::io("write", &path))
    }

    /// Makes a folder for tile files. What is written there is not part of the field before
    /// [`Field::publish_folder`].
    ///
    /// # Errors
    /// Of the system.
    pub fn begin_folder(&self, folder: &str) -> Result<(), FieldError> {
        let (path, published) =
            (self.path.join(names::unpublished(folder)), self.path.join(folder));
        // A run that was killed between publishing and its commit: the commit does not know of it.
        if published.is_dir() {
            return fs::rename(&published, &path).map_err(FieldError::io("take back", &published));
        }
        fs::create_dir_all(&path).map_err(FieldError::io("create", &path))
    }

    /// Gives a folder whose tile files are all written its name.
    ///
    /// # Errors
    /// Of the system.
    pub fn publish_folder(&self, folder: &str) -> Result<(), FieldError> {
        let (from, to) = (self.path.join(names::unpublished(folder)), self.path.join(folder));
        match fs::rename(&from, &to) {
            // A run that was killed right after the renaming did not come to its commit.
            Err(e) if e.kind() == io::ErrorKind::NotFound && to.is_dir() => Ok(()),
            result => result.map_err(FieldError::io("publish", &from)),
        }
    }

    /// Writes the texture maps of a generation.
    ///
    /// # Errors
    /// Of the system.
    pub fn write_textures(&self, generation: u32, textures: &Textures) -> Result<(), FieldError> {
        let id = |kind| ChunkId { kind, cycle: generation, direction: NO_DIRECTION };
        let bytes = |values: &[Rgb]| crate::scene::texels::to_bytes(values);
        let (total, current) = (bytes(&textures.total), bytes(&textures.current));
        // Stored as they are: the field's digest must not depend on a compressor's version.
        let chunks = [
            (id(ChunkKind::TotalTexture), Codec::Raw, total.as_slice()),
            (id(ChunkKind::CurrentTexture), Codec::Raw, current.as_slice()),
        ];
        let header = self.header_of(FileKind::Textures, (generation, NO_DIRECTION));
        self.publish(&names::textures(generation), header, &chunks)
    }

    /// Reads the texture maps of a generation.
    ///
    /// # Errors
    /// When the file is missing, damaged, or does not hold `values` values.
    pub fn read_textures(&self, generation: u32, values: usize) -> Result<Textures, FieldError> {
        let path = self.path.join(names::textures(generation));
        let read = |kind| -> Result<Vec<Rgb>, FieldError> {
            let bytes = read_chunk(&path, FileKind::Textures, kind, NO_DIRECTION)?;
            let values = crate::scene::texels::from_bytes(&bytes, values);
            Ok(values.map_err(|f| f.in_file(path.display()))?)
        };
        let total = read(ChunkKind::TotalTexture)?;
        Ok(Textures { total, current: read(ChunkKind::CurrentTexture)? })
    }

    /// Writes the sums of the cycle under way for the next commit.
    ///
    /// # Errors
    /// Of the system.
    pub fn write_sums(&mut self, bytes: &[u8]) -> Result<(), FieldError> {
        let cycle = self.manifest.cycle;
        let id = ChunkId { kind: ChunkKind::Sums, cycle, direction: NO_DIRECTION };
        let header = self.header_of(FileKind::Sums, (cycle, NO_DIRECTION));
        let name = names::sums(self.manifest.sequence + 1);
        self.publish(&name, header, &[(id, Codec::Zstd, bytes)])?;
        self.manifest.has_sums = true;
        Ok(())
    }

    /// Reads the committed sums.
    ///
    /// # Errors
    /// When the file is missing or damaged.
    pub fn read_sums(&self) -> Result<Vec<u8>, FieldError> {
        let path = self.path.join(names::sums(self.manifest.sequence));
        read_chunk(&path, FileKind::Sums, ChunkKind::Sums, NO_DIRECTION)
    }

    /// Commits the manifest: from here on this is the state of the field.
    ///
    /// # Errors
    /// Of the system; the commit before stands then.
    pub fn commit(&mut self) -> Result<(), FieldError> {
        let mut next = self.manifest.clone();
        next.sequence += 1;
        next.statistics.bytes_written += self.bytes_written.swap(0, Ordering::Relaxed);
        let path = self.path.join(names::MANIFEST);
        let bytes = next
            .to_file(self.header_of(FileKind::Manifest, (0, NO_DIRECTION)))
            .map_err(|f| f.in_file(path.display()))?;
        files::publish(&path, &bytes)?;
        self.manifest = next;
        Ok(())
    }

    /// Removes the tile files of a generation that the committed state no longer needs.
    ///
    /// # Errors
    /// Of the system.
    pub fn remove_maps(&self, generation: u32) -> Result<(), FieldError> {
        let folder = self.path.join(names::generation(generation));
        if folder.is_dir() {
            fs::remove_dir_all(&folder).map_err(FieldError::io("remove", &folder))?;
        }
        Ok(())
    }

    /// Removes the texture maps of a generation that the committed state no longer needs.
    ///
    /// # Errors
    /// Of the system.
    pub fn remove_textures(&self, generation: u32) -> Result<(), FieldError> {
        let textures = self.path.join(names::textures(generation));
        if textures.is_file() {
            fs::remove_file(&textures).map_err(FieldError::io("remove", &textures))?;
        }
        Ok(())
    }

    /// Removes what a run that was killed right after a commit did not come to remove.
    ///
    /// # Errors
    /// Of the system.
    pub fn remove_stale(&self) -> Result<(), FieldError> {
        let Manifest { cycle, phase, has_sums, .. } = self.manifest;
        if cycle > 0 {
            self.remove_maps(cycle - 1)?;
            self.remove_textures(cycle - 1)?;
        }
        if phase == Phase::Finished {
            self.remove_maps(cycle)?;
        }
        if has_sums { Ok(()) } else { self.remove_sums() }
    }

    /// Removes the files of sums.
    ///
    /// # Errors
    /// Of the system.
    pub fn remove_sums(&self) -> Result<(), FieldError> {
        for sequence in 0..2 {
            let path = self.path.join(names::sums(sequence));
            if path.is_file() {
                fs::remove_file(&path).map_err(FieldError::io("remove", &path))?;
            }
        }
        Ok(())
    }

    /// Digest of the finished field: a hash over the scene's, the textures' and every direction's
    /// chunk hashes, in order. The same scene and parameters give the same digest on every run.
    ///
    /// # Errors
    /// When a file is missing or damaged.
    pub fn digest(&self) -> Result<[u8; 16], FieldError> {
        let mut hashes = self.manifest.scene_hash.to_vec();
        let mut add = |path: PathBuf| -> Result<(), FieldError> {
            for entry in read_directory(&path)?.entries {
                hashes.extend(entry.hash.to_le_bytes());
            }
            Ok(())
        };
        add(self.path.join(names::textures(self.manifest.cycle)))?;
        for direction in 0..self.manifest.parameters.directions {
            add(names::tiles(&self.path, names::TOTAL, direction))?;
        }
        Ok(hash(&hashes))
    }
}

/// The commit record of the field at `path`.
///
/// # Errors
/// When there is none, or it is damaged.
pub fn read_manifest(path: &Path) -> Result<(Header, Manifest), FieldError> {
    let file = path.join(names::MANIFEST);
    let bytes = files::read(&file)?;
    Ok(Manifest::from_file(&file.display().to_string(), &bytes)?)
}

/// First block and directory of a file.
///
/// # Errors
/// When it is missing or damaged.
pub fn read_directory(path: &Path) -> Result<Directory, FieldError> {
    let head = files::read_head(path)?;
    let parse = || {
        let length = Directory::length(&head.bytes, head.file_len)?;
        let start = if length <= head.bytes.len() { None } else { Some(length) };
        Ok(start)
    };
    let longer: Option<usize> = parse().map_err(|f: Fault| f.in_file(path.display()))?;
    let bytes = match longer {
        None => head.bytes,
        Some(length) => files::read_first(path, length)?,
    };
    Directory::parse(&bytes, head.file_len).map_err(|f| f.in_file(path.display()).into())
}

/// One chunk of a file, verified and decoded.
///
/// # Errors
/// When the file is missing, damaged or of another kind, or has no such chunk.
pub fn read_chunk(
    path: &Path,
    file: FileKind,
    kind: ChunkKind,
    direction: u32,
) -> Result<Vec<u8>, FieldError> {
    let bytes = files::read(path)?;
    let directory = container::open(&path.display().to_string(), &bytes, file)?;
    let chunk = || directory.chunk(&bytes, directory.find(kind, direction)?);
    Ok(chunk().map_err(|f| f.in_file(path.display()))?.into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::tiles::exponent_for;
    use tempfile::TempDir;

    fn parameters() -> Parameters {
        Parameters {
            directions: 9,
            resolution: 16,
            tile: 16,
            cycles: Some(1),
            unshot_fraction: 1e-3,
            perturbations: vec![1],
            texel_cells: 1.0,
            filter: 0,
            one_sided: false,
        }
    }

    fn create(path: &Path, parameters: &Parameters) -> Result<Field, FieldError> {
        let (scene, _) = Scene::bundled("cornell").unwrap();
        Field::create_or_resume(path, &scene, parameters, exponent_for(1.0))
    }

    #[test]
    fn what_is_not_committed_is_not_there_after_a_crash() {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("a.field");
        let mut field = create(&path, &parameters()).unwrap();
        let sums = |field: &Field| field.read_sums().unwrap();
        field.write_sums(b"first").unwrap();
        field.manifest_mut().mark_done(3);
        field.commit().unwrap();
        // Written and never committed: the next commit's sums are under the other name.
        field.write_sums(b"second").unwrap();
        field.manifest_mut().mark_done(4);
        drop(field);
        let mut field = create(&path, &parameters()).unwrap();
        assert_eq!(sums(&field), b"first");
        assert!(field.manifest().is_done(3) && !field.manifest().is_done(4));
        field.write_sums(b"third").unwrap();
        field.commit().unwrap();
        assert_eq!(sums(&field), b"third");
    }

    #[test]
    fn a_folder_is_there_whole_or_not_at_all() {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("a.field");
        let field = create(&path, &parameters()).unwrap();
        field.begin_folder("unshot-0001").unwrap();
        field.write_tiles("unshot-0001", (1, 5), &[(ChunkKind::Unshot, b"x")]).unwrap();
        assert!(!path.join("unshot-0001").exists());
        field.publish_folder("unshot-0001").unwrap();
        let file = names::tiles(&path, "unshot-0001", 5);
        let chunk = read_chunk(&file, FileKind::Tiles, ChunkKind::Unshot, 5).unwrap();
        assert_eq!(chunk, b"x");
        // Killed before its commit, a run publishes it again, or goes on writing into it.
        field.publish_folder("unshot-0001").unwrap();
        field.begin_folder("unshot-0001").unwrap();
        assert!(!path.join("unshot-0001").exists());
        field.publish_folder("unshot-0001").unwrap();
        assert!(file.is_file());
    }

    #[test]
    fn leftovers_of_a_killed_run_go_and_what_is_needed_stays() {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("a.field");
        let mut field = create(&path, &parameters()).unwrap();
        for generation in [1, 2] {
            field.begin_folder(&names::generation(generation)).unwrap();
            field.publish_folder(&names::generation(generation)).unwrap();
            let maps = Textures { total: vec![Rgb::BLACK], current: vec![Rgb::BLACK] };
            field.write_textures(generation, &maps).unwrap();
        }
        let there = || {
            let all = [1, 2].map(|g| [names::generation(g), names::textures(g)]).concat();
            all.iter().map(|n| path.join(n).exists()).collect::<Vec<_>>()
        };
        field.manifest_mut().cycle = 2;
        field.commit().unwrap();
        field.remove_stale().unwrap();
        assert_eq!(there(), [false, false, true, true]);
        field.manifest_mut().phase = Phase::Finished;
        field.commit().unwrap();
        field.remove_stale().unwrap();
        assert_eq!(there(), [false, false, false, true]);
        assert_eq!(field.read_textures(2, 1).unwrap().total, [Rgb::BLACK]);
        assert!(field.read_textures(2, 2).is_err());
    }

    #[test]
    fn one_writer_one_bake_and_nothing_of_others() {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("a.field");
        let first = create(&path, &parameters()).unwrap();
        assert!(matches!(create(&path, &parameters()), Err(FieldError::Locked(_))));
        drop(first);
        let other = Parameters { tile: 8, ..parameters() };
        let Err(FieldError::Identity { what, .. }) = create(&path, &other) else { panic!() };
        assert_eq!(what, "tile 16, not 8");
        create(&path, &parameters()).unwrap();
        let theirs = folder.path().join("theirs");
        fs::create_dir(&theirs).unwrap();
        fs::write(theirs.join("letter"), "Dear reader").unwrap();
        assert!(matches!(create(&theirs, &parameters()), Err(FieldError::Foreign(_))));
        assert_eq!(fs::read_dir(&theirs).unwrap().count(), 1);
    }
}
