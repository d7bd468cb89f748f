//! Views that a scene's file has, put where `vlf-view` looks for saved ones.

use super::progress::tell;
use anyhow::Context;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{ErrorKind, Write};
use std::path::Path;
use vlf::Camera;
use vlf::scene::NamedCamera;

/// The keys that views lie on, in turn.
const DIGITS: [u8; 10] = [1, 2, 3, 4, 5, 6, 7, 8, 9, 0];

/// Saves the first ten views beside a field: `room.views.json` for `room.field` and `room.vlf`. A file that
/// is there stays as it is.
pub fn save(field: &Path, cameras: &[NamedCamera]) -> anyhow::Result<()> {
    if cameras.is_empty() {
        return Ok(());
    }
    let path = field.with_extension("views.json");
    let by_digit: BTreeMap<u8, &Camera> =
        DIGITS.into_iter().zip(cameras.iter().map(|named| &named.camera)).collect();
    let text = serde_json::to_string_pretty(&by_digit)?;
    let wrote = match File::create_new(&path) {
        Err(e) if e.kind() == ErrorKind::AlreadyExists => return Ok(()),
        file => file.and_then(|mut file| file.write_all(text.as_bytes())),
    };
    wrote.with_context(|| format!("{}: cannot be written", path.display()))?;
    let left = match cameras.len().saturating_sub(DIGITS.len()) {
        0 => String::new(),
        left => format!("; {left} more are left out"),
    };
    let count = by_digit.len();
    tell(&format!("{}: {count} views of the scene's file{left}", path.display()));
    Ok(())
}
