//! Act one, kept: a field in the making, as a directory of immutable files.
//!
//! In: what the bake makes; out: files, each written once, and a commit record, the manifest. What the
//! manifest does not name is not there. The commit before is kept whole until the next one has
//! reached the disk. One writer at a time; readers take nothing.
//!
//! [`storage`] is where the files lie, [`files`] reads them, [`commit`] writes them, [`writer`] does so
//! behind the bake's back, and [`pages`] reads ahead of it.

pub mod storage;

pub mod files;

pub mod commit;

pub mod pages;

pub mod writer;

use crate::format::container::{FieldId, FileKind, Header, MAGIC, NO_DIRECTION};
use crate::format::manifest::{
    ErrorEstimate, Manifest, Parameters, Phase, Statistics, header, record_to_bytes,
};
use crate::format::text::inert;
use crate::format::{Fault, FormatError, names};
use crate::scene::{Scene, stored};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64};
use storage::{Lock, LockError, Storage};
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
    /// No room for a file.
    #[error(
        "{path}: the disk is full ({source}). The field is intact as of its last commit; free some \
         space and run the same command again"
    )]
    Full {
        /// The file that was being written.
        path: PathBuf,
        /// The system's answer.
        source: Arc<io::Error>,
    },
    /// The disk did not take what the system had taken for it.
    #[error(
        "{path}: the storage reported a failed flush ({source}). What was done since the last commit \
         is not trusted; check the disk, then run the same command again"
    )]
    Flush {
        /// The file or folder.
        path: PathBuf,
        /// The system's answer.
        source: Arc<io::Error>,
    },
    /// Nothing is written after a write has failed.
    #[error("{0}: not written, since an earlier write failed")]
    Poisoned(PathBuf),
    /// A file of the field is damaged or not what it should be.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// Another process bakes it.
    #[error("{path}: is being baked by {who}; wait for it or stop it")]
    Locked {
        /// The field.
        path: PathBuf,
        /// Who holds it, as it says itself.
        who: String,
    },
    /// Two bakes could not be kept apart.
    #[error(
        "{path}: this filesystem has no locks ({source}); use --no-lock if you are sure that no other \
         bake writes there"
    )]
    NoLocks {
        /// The field.
        path: PathBuf,
        /// The system's answer.
        source: Arc<io::Error>,
    },
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
    /// A reader found no moment at which all of it was there.
    #[error("{0}: is being written faster than it can be checked; wait for the bake or stop it")]
    Moving(PathBuf),
}

impl FieldError {
    /// For `map_err` on an operation on a file.
    pub fn io<'a>(doing: &'static str, path: &'a Path) -> impl FnOnce(io::Error) -> Self + use<'a> {
        move |e| {
            let (path, source) = (path.to_owned(), Arc::new(e));
            match source.kind() {
                io::ErrorKind::StorageFull
                | io::ErrorKind::QuotaExceeded
                | io::ErrorKind::FileTooLarge => FieldError::Full { path, source },
                _ => FieldError::Io { doing, path, source },
            }
        }
    }
}

/// A field that this process may write.
pub struct Field {
    storage: Arc<dyn Storage>,
    manifest: Manifest,
    /// The last two commits, the newer one last; their files are kept.
    committed: Vec<Manifest>,
    header: Header,
    terms: Terms,
    bytes_written: AtomicU64,
    /// Whether a write has failed. Nothing is written then any more.
    poisoned: AtomicBool,
    /// Folders with names that have not been synced.
    unsynced: std::sync::Mutex<std::collections::BTreeSet<String>>,
    /// What the user should know of how it was found.
    notice: Option<String>,
    /// Held, not read: dropping it gives the lock back.
    _lock: Option<Lock>,
}

/// On what terms a field is written. None of it changes a bit of the field.
#[derive(Clone, Copy, Debug)]
pub struct Terms {
    /// Whether a commit, and all that it names, has reached the disk when it is done.
    pub sync: bool,
    /// Whether the folder is locked against other writers.
    pub lock: bool,
}

impl Default for Terms {
    fn default() -> Terms {
        Terms { sync: true, lock: true }
    }
}

/// The 128-bit hash that scenes, digests and identities are.
pub fn hash(bytes: &[u8]) -> [u8; 16] {
    XxHash3_128::oneshot(bytes).to_le_bytes()
}

/// Identity of the field that a manifest is of: the same for every bake of the same thing.
///
/// # Errors
/// When its parameters take more bytes than a record may.
pub fn identity(manifest: &Manifest) -> Result<FieldId, Fault> {
    let Manifest { revision, parameters, scene_hash, .. } = manifest;
    Ok(hash(&record_to_bytes(&(revision, parameters, scene_hash))?))
}

/// Names the first difference between what a field was begun with and what is asked for.
fn difference(old: &Manifest, new: &Manifest) -> Option<String> {
    let (a, b) = (&old.parameters, &new.parameters);
    let differs = |what: &str, a: &dyn std::fmt::Debug, b: &dyn std::fmt::Debug| {
        let (a, b) = (format!("{a:?}"), format!("{b:?}"));
        (a != b).then(|| format!("{what} {a}, not {b}"))
    };
    differs("algorithm revision", &old.revision, &new.revision)
        .or_else(|| differs("times as many texels", &a.refined, &b.refined))
        .or_else(|| (old.scene_hash != new.scene_hash).then(|| "another scene".to_owned()))
        .or_else(|| differs("directions", &a.directions, &b.directions))
        .or_else(|| differs("resolution", &a.resolution, &b.resolution))
        .or_else(|| differs("tile", &a.tile, &b.tile))
        .or_else(|| differs("cycles", &a.cycles, &b.cycles))
        .or_else(|| differs("perturbations", &a.perturbations, &b.perturbations))
        .or_else(|| differs("target error", &a.target_error, &b.target_error))
        .or_else(|| differs("parameters", a, b))
}

impl Field {
    /// Begins a field, or takes up the unfinished or finished one that is there if it is the same
    /// bake. `exponent` scales stored radiance, see [`crate::format::tiles::exponent_for`].
    ///
    /// # Errors
    /// When something else is there, another process bakes it, it was begun differently, its commit
    /// records are damaged, or the system refuses. Nothing that was there is changed then.
    pub fn create_or_resume(
        storage: Arc<dyn Storage>,
        scene: &Scene,
        parameters: &Parameters,
        exponent: i32,
        terms: Terms,
    ) -> Result<Field, FieldError> {
        let path = storage.place().to_owned();
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
            grids: Vec::new(),
            error: ErrorEstimate::default(),
            statistics: Statistics::default(),
            digest: [0; 16],
        };
        let id = identity(&fresh).map_err(|f| f.in_file(path.display()))?;
        let surfaces = scene.surfaces.len() as u32;
        let place = (0, NO_DIRECTION);
        let fresh_header = header(FileKind::Manifest, id, parameters, surfaces, exponent, place);

        if !may_be_field(&*storage)? {
            return Err(FieldError::Foreign(path));
        }
        storage.make().map_err(FieldError::io("create the field", &path))?;
        let lock = if terms.lock { Some(locked(&*storage)?) } else { None };

        let files = manifest_files(&*storage)?;
        let (manifest, header, notice, begun) = if files.iter().any(Option::is_some) {
            let (header, manifest, fault) =
                Manifest::newest(&path.display().to_string(), files, &storage.limits())?;
            header.check_writable().map_err(|f| f.in_file(path.display()))?;
            if let Some(what) = difference(&manifest, &fresh) {
                return Err(FieldError::Identity { path, what });
            }
            let notice = fault.map(|fault| {
                let sequence = manifest.sequence;
                format!(
                    "a commit record is damaged, using the other one (commit {sequence}): {fault}"
                )
            });
            (manifest, header, notice, true)
        } else {
            (fresh, fresh_header, None, false)
        };
        let mut field = Field {
            storage,
            committed: if begun { vec![manifest.clone()] } else { Vec::new() },
            manifest,
            header,
            terms,
            bytes_written: AtomicU64::new(0),
            poisoned: AtomicBool::new(false),
            unsynced: std::sync::Mutex::default(),
            notice,
            _lock: lock,
        };
        if begun {
            field.keep_previous()?;
            field.try_to_write()?;
            field.make_lasting()?;
        } else {
            field.write_scene(&scene_bytes)?;
            field.commit()?;
        }
        Ok(field)
    }

    /// The commit before the one taken up, if it is sound: its files stay until the next commit.
    fn keep_previous(&mut self) -> Result<(), FieldError> {
        for (name, bytes) in manifest_files(&*self.storage)?.into_iter().flatten() {
            match Manifest::from_file(&name, &bytes, &self.storage.limits()) {
                Ok((_, m)) if m.sequence < self.manifest.sequence => self.committed.insert(0, m),
                _ => {}
            }
        }
        Ok(())
    }

    /// Finds out whether an unfinished field can be gone on with here before much is computed for it.
    fn try_to_write(&self) -> Result<(), FieldError> {
        if self.manifest.phase == Phase::Finished {
            return Ok(());
        }
        // The next commit makes this file anew.
        let name = names::temporary(names::manifest(self.manifest.sequence + 1));
        let path = self.path().join(&name);
        self.storage.create(&name, 0).map_err(FieldError::io("write", &path))?;
        Ok(())
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        self.storage.place()
    }

    /// Its files.
    pub fn storage(&self) -> &dyn Storage {
        &*self.storage
    }

    /// Its files, for someone who outlives this.
    pub fn shared_storage(&self) -> Arc<dyn Storage> {
        self.storage.clone()
    }

    /// What is committed, with changes that the next commit will write.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// For changes that the next commit will write.
    pub fn manifest_mut(&mut self) -> &mut Manifest {
        &mut self.manifest
    }

    /// What the user should know of the state it was found in.
    pub fn notice(&self) -> Option<&str> {
        self.notice.as_deref()
    }

    /// First block of the field's files, apart from what the file is.
    pub fn header_of(&self, kind: FileKind, (generation, direction): (u32, u32)) -> Header {
        Header { kind, generation, direction, ..self.header.clone() }
    }
}

/// Whether a field is there, or may be made there: nothing, an empty folder, a field, or one whose
/// making was stopped before its first commit. Beside a commit record, files of others are left alone:
/// file managers and editors put theirs everywhere.
fn may_be_field(storage: &dyn Storage) -> Result<bool, FieldError> {
    let names = match storage.list("") {
        Ok(names) => names,
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(true),
        Err(e) if e.kind() == io::ErrorKind::NotADirectory => return Ok(false),
        Err(e) => return Err(FieldError::io("list", storage.place())(e)),
    };
    if names.iter().any(|n| names::MANIFESTS.contains(&n.as_str())) {
        let records = manifest_files(storage)?.into_iter().flatten();
        let mut ours = records.map(|(_, bytes)| bytes.starts_with(&MAGIC[..4]));
        return Ok(ours.any(|ours| ours) || names.iter().all(|n| names::is_ours(n)));
    }
    let is_first =
        |n: &String| n == names::LOCK || n == names::SCENE || n.ends_with(names::TEMPORARY);
    Ok(names.iter().all(|n| names::is_ours(n) && is_first(n)))
}

fn locked(storage: &dyn Storage) -> Result<Lock, FieldError> {
    let since = std::time::UNIX_EPOCH.elapsed().map_or(0, |t| t.as_secs()) % 86_400;
    let note = format!(
        "process {} on {} since {:02}:{:02} UTC",
        std::process::id(),
        gethostname::gethostname().to_string_lossy(),
        since / 3600,
        since / 60 % 60
    );
    let path = storage.place().to_owned();
    storage.lock(&note).map_err(|e| match e {
        LockError::Held(who) if who.is_empty() => {
            FieldError::Locked { path, who: "another process".to_owned() }
        }
        LockError::Held(who) => FieldError::Locked { path, who: inert(&who, 200) },
        LockError::Unsupported(e) => FieldError::NoLocks { path, source: Arc::new(e) },
    })
}

type ManifestFiles = [Option<(String, Vec<u8>)>; 2];

/// The files of both commit records, where they are there.
fn manifest_files(storage: &dyn Storage) -> Result<ManifestFiles, FieldError> {
    let read = |name: &str| match files::read(storage, name) {
        Ok(bytes) => Ok(Some((storage.place().join(name).display().to_string(), bytes))),
        Err(FieldError::Io { source, .. }) if source.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(e) => Err(e),
    };
    let [first, second] = names::MANIFESTS;
    Ok([read(first)?, read(second)?])
}

/// The state of the field in a storage: its newest sound commit record.
///
/// # Errors
/// When there is none, or none is sound.
pub fn read_manifest(storage: &dyn Storage) -> Result<(Header, Manifest), FieldError> {
    let files = manifest_files(storage)?;
    if files.iter().all(Option::is_none) {
        // A folder without a field is another mistake than none at all.
        storage.list("").map_err(FieldError::io("read", storage.place()))?;
    }
    let (header, manifest, _) =
        Manifest::newest(&storage.place().display().to_string(), files, &storage.limits())?;
    Ok((header, manifest))
}

#[cfg(test)]
mod tests {
    use super::storage::memory::Memory;
    use super::*;
    use crate::format::container::ChunkKind;
    use crate::format::manifest::Specular;
    use crate::format::tiles::exponent_for;
    use crate::radiance::Rgb;
    use std::io::Write;

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
            specular: Specular::Maps,
            resample: false,
            ..Parameters::default()
        }
    }

    fn create(storage: &Arc<Memory>, parameters: &Parameters) -> Result<Field, FieldError> {
        let (scene, _) = Scene::bundled("cornell").unwrap();
        let (storage, terms) = (storage.clone(), Terms::default());
        Field::create_or_resume(storage, &scene, parameters, exponent_for(1.0), terms)
    }

    fn sums(field: &Field) -> Vec<u8> {
        let mut all = Vec::new();
        field
            .read_sums(|block| {
                all.extend_from_slice(block);
                Ok(())
            })
            .unwrap();
        all
    }

    fn write_sums(field: &mut Field, bytes: &[u8]) {
        field.write_sums(bytes.len() as u64, [bytes.to_vec()].into_iter()).unwrap();
    }

    #[test]
    fn what_is_not_committed_is_not_there_after_a_crash() {
        let storage = Arc::new(Memory::default());
        let mut field = create(&storage, &parameters()).unwrap();
        write_sums(&mut field, b"first");
        field.manifest_mut().mark_done(3);
        field.commit().unwrap();
        // Written and never committed.
        write_sums(&mut field, b"second");
        field.manifest_mut().mark_done(4);
        drop(field);
        let mut field = create(&storage, &parameters()).unwrap();
        assert_eq!(sums(&field), b"first");
        assert!(field.manifest().is_done(3) && !field.manifest().is_done(4));
        write_sums(&mut field, b"third");
        field.commit().unwrap();
        assert_eq!(sums(&field), b"third");
    }

    #[test]
    fn a_damaged_commit_record_costs_one_commit() {
        let storage = Arc::new(Memory::default());
        let mut field = create(&storage, &parameters()).unwrap();
        for text in ["one", "two", "three"] {
            write_sums(&mut field, text.as_bytes());
            field.commit().unwrap();
        }
        let newest = names::manifest(field.manifest().sequence);
        drop(field);
        storage.edit(newest, |bytes| bytes[300] ^= 1);
        let field = create(&storage, &parameters()).unwrap();
        assert_eq!(sums(&field), b"two");
        assert!(field.notice().unwrap().contains("commit 3"), "{:?}", field.notice());
        drop(field);
        let other = names::MANIFESTS.into_iter().find(|m| *m != newest).unwrap();
        storage.edit(other, |bytes| bytes[300] ^= 1);
        let before = storage.list("").unwrap();
        let Err(error) = create(&storage, &parameters()) else { panic!("begun anew") };
        assert!(error.to_string().contains("no valid commit record"), "{error}");
        assert_eq!(storage.list("").unwrap(), before);
    }

    #[test]
    fn files_of_the_last_two_commits_stay_and_older_ones_go() {
        let storage = Arc::new(Memory::default());
        let mut field = create(&storage, &parameters()).unwrap();
        let there = || storage.list("").unwrap().into_iter().filter(|n| names::is_of_a_commit(n));
        for generation in 1..=3 {
            field.begin_folder(&names::generation(generation)).unwrap();
            let maps = [(ChunkKind::Unshot, b"x".to_vec())];
            let place = (generation, 5);
            field.write_tiles(&names::generation(generation), place, &maps).unwrap();
            let black = [Rgb::BLACK];
            field.write_textures(generation, &black, &black, &black).unwrap();
            field.manifest_mut().cycle = generation;
            field.commit().unwrap();
        }
        let expected = ["textures-0002", "textures-0003", "unshot-0002", "unshot-0003"];
        assert_eq!(there().collect::<Vec<_>>(), expected);
        let read = |count| field.read_texture(3, ChunkKind::TotalTexture, count);
        assert_eq!(read(1).unwrap(), [Rgb::BLACK]);
        assert!(read(2).is_err());
        field.manifest_mut().phase = Phase::Finished;
        field.commit().unwrap();
        assert_eq!(there().collect::<Vec<_>>(), ["textures-0003", "unshot-0003"]);
        field.commit().unwrap();
        assert_eq!(there().collect::<Vec<_>>(), ["textures-0003"]);
    }

    #[test]
    fn one_writer_one_bake_and_nothing_of_others() {
        let folder = tempfile::TempDir::new().unwrap();
        let (scene, _) = Scene::bundled("cornell").unwrap();
        let create = |name: &str, parameters: &Parameters| {
            let storage = Arc::new(storage::disk::Disk::new(&folder.path().join(name)));
            Field::create_or_resume(storage, &scene, parameters, 0, Terms::default())
        };
        let first = create("a.field", &parameters()).unwrap();
        let Err(error) = create("a.field", &parameters()) else { panic!("two writers") };
        let own = format!("process {}", std::process::id());
        assert!(error.to_string().contains(&own), "{error}");
        // The lock is on the folder: a lock file that is gone or new makes no difference.
        std::fs::remove_file(folder.path().join("a.field").join(names::LOCK)).unwrap();
        assert!(matches!(create("a.field", &parameters()), Err(FieldError::Locked { .. })));
        drop(first);
        let other = Parameters { tile: 8, ..parameters() };
        let Err(FieldError::Identity { what, .. }) = create("a.field", &other) else { panic!() };
        assert_eq!(what, "tile 16, not 8");
        create("a.field", &parameters()).unwrap();
        let theirs = folder.path().join("theirs");
        std::fs::create_dir(&theirs).unwrap();
        std::fs::write(theirs.join("letter"), "Dear reader").unwrap();
        assert!(matches!(create("theirs", &parameters()), Err(FieldError::Foreign(_))));
        assert!(matches!(create("theirs/letter", &parameters()), Err(FieldError::Foreign(_))));
        assert_eq!(std::fs::read_dir(&theirs).unwrap().count(), 1);
        // A name of ours makes nobody's folder a field.
        std::fs::write(theirs.join(names::MANIFESTS[0]), "of the ship").unwrap();
        assert!(matches!(create("theirs", &parameters()), Err(FieldError::Foreign(_))));
        assert_eq!(std::fs::read_dir(&theirs).unwrap().count(), 2);
    }

    /// What file managers and editors leave everywhere.
    #[test]
    fn files_of_others_in_a_field_are_left_alone() {
        let storage = Arc::new(Memory::default());
        let mut field = create(&storage, &parameters()).unwrap();
        field.begin_folder(&names::generation(1)).unwrap();
        let theirs = [".DS_Store", "Thumbs.db", "scene~", ".scene.swp", "notes.tmp"];
        let theirs = theirs.map(str::to_owned).into_iter().chain(["unshot-0001/.DS_Store".into()]);
        let theirs: Vec<String> = theirs.collect();
        for name in &theirs {
            storage.create(name, 0).unwrap().write_all(b"theirs").unwrap();
        }
        for generation in 1..=4 {
            drop(field);
            field = create(&storage, &parameters()).unwrap();
            field.begin_folder(&names::generation(generation)).unwrap();
            field.manifest_mut().cycle = generation;
            field.commit().unwrap();
        }
        for name in &theirs {
            assert_eq!(files::read(&*storage, name).unwrap(), b"theirs", "{name}");
        }
    }
}
