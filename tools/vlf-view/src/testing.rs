//! Small light fields for tests.

use crate::source::Opening;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use tempfile::TempDir;
use vlf::bake::{Options, Progress};
use vlf::format::limits::Limits;
use vlf::look::packed::Access;
use vlf::{Codec, Outcome, Parameters, Scene};

/// How many cycles small fields have.
pub const CYCLES: u32 = 3;

/// Bakes a bundled box coarsely; `progress` may hold it up.
pub fn bake(field: &Path, progress: &(dyn Fn(&Progress) + Sync)) {
    let (scene, _) = Scene::bundled("cornell").unwrap();
    let parameters = Parameters {
        directions: 33,
        resolution: 16,
        tile: 8,
        cycles: Some(CYCLES),
        ..Parameters::default()
    };
    let options = Options {
        memory: 256 << 20,
        threads: 1,
        stop: &AtomicBool::new(false),
        progress,
        order: None,
        commit_every: 5.0,
        terms: vlf::field::Terms::default(),
        force: false,
    };
    assert_eq!(vlf::bake(&scene, &parameters, field, &options).unwrap(), Outcome::Finished);
}

/// A pack in a folder of its own.
pub fn pack() -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let (field, pack) = (folder.path().join("box.field"), folder.path().join("box.vlf"));
    bake(&field, &|_| ());
    vlf::pack(&field, &pack, Codec::Zstd, &|_| ()).unwrap();
    (folder, pack)
}

/// How tests open a field or pack.
pub fn opening(path: &Path) -> Opening {
    let limits = Limits::default();
    Opening { path: path.to_owned(), access: Access::Read, memory: 1 << 28, limits }
}
