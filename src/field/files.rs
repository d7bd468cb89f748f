//! Files: read whole, published by rename, never edited.

use super::FieldError;
use crate::format::names;
use std::fs::{self, File};
use std::io::{Read, Write};
use std::path::Path;

/// Writes a file under a temporary name beside `path`, then renames it there. The bytes and the rename
/// have reached the disk when this returns.
///
/// # Errors
/// Of the system; `path` is then as it was.
pub fn publish(path: &Path, bytes: &[u8]) -> Result<(), FieldError> {
    let temporary = path.with_extension("tmp");
    let write = || {
        let mut file = File::create(&temporary)?;
        file.write_all(bytes)?;
        file.sync_all()
    };
    write().map_err(FieldError::io("write", &temporary))?;
    fs::rename(&temporary, path).map_err(FieldError::io("publish", path))?;
    let Some(folder) = path.parent() else { return Ok(()) };
    let sync = || File::open(folder)?.sync_all();
    sync().map_err(FieldError::io("sync", folder))
}

/// A whole file.
///
/// # Errors
/// When it is missing, no regular file, or the system refuses.
pub fn read(path: &Path) -> Result<Vec<u8>, FieldError> {
    let open = || {
        let file = File::open(path)?;
        if !file.metadata()?.is_file() {
            return Err(std::io::Error::other("not a regular file"));
        }
        Ok(file)
    };
    let mut file = open().map_err(FieldError::io("read", path))?;
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes).map_err(FieldError::io("read", path))?;
    Ok(bytes)
}

/// The beginning of a file.
pub struct Head {
    /// Its first bytes, at most 4 KiB.
    pub bytes: Vec<u8>,
    /// Its length.
    pub file_len: u64,
}

/// The first bytes of a file and its length.
///
/// # Errors
/// Of the system.
pub fn read_head(path: &Path) -> Result<Head, FieldError> {
    let file_len = fs::metadata(path).map_err(FieldError::io("read", path))?.len();
    Ok(Head { bytes: read_first(path, 4096)?, file_len })
}

/// The first `length` bytes of a file, fewer when it is shorter.
///
/// # Errors
/// Of the system.
pub fn read_first(path: &Path, length: usize) -> Result<Vec<u8>, FieldError> {
    let mut bytes = Vec::new();
    File::open(path)
        .and_then(|f| f.take(length as u64).read_to_end(&mut bytes))
        .map_err(FieldError::io("read", path))?;
    Ok(bytes)
}

/// Whether a directory holds nothing but what a field's writer puts there: an empty one, a field, or
/// one whose making was stopped before its first commit.
///
/// # Errors
/// Of the system.
pub fn only_ours(path: &Path) -> Result<bool, FieldError> {
    if path.join(names::MANIFEST).is_file() {
        return Ok(true);
    }
    let first_names = [names::LOCK, names::SCENE, "scene.tmp", "manifest.tmp"];
    for entry in fs::read_dir(path).map_err(FieldError::io("list", path))? {
        let entry = entry.map_err(FieldError::io("list", path))?;
        if !first_names.iter().any(|n| entry.file_name() == *n) {
            return Ok(false);
        }
    }
    Ok(true)
}
