//! Names of the files inside a field directory, built from numbers only.

#![deny(
    clippy::arithmetic_side_effects,
    clippy::cast_possible_truncation,
    clippy::indexing_slicing
)]

use std::path::{Path, PathBuf};

/// The two commit records, the newer one in turn.
pub const MANIFESTS: [&str; 2] = ["manifest-0", "manifest-1"];
/// The resolved scene.
pub const SCENE: &str = "scene";
/// Who bakes, for people to read.
pub const LOCK: &str = "lock";
/// Folder of the total radiance maps' tile files.
pub const TOTAL: &str = "total";

/// How the name of a file that is being written ends.
pub const TEMPORARY: &str = ".tmp";
const TILES: &str = ".tiles";

/// The commit record of a commit.
pub fn manifest(sequence: u64) -> &'static str {
    let [even, odd] = MANIFESTS;
    if sequence.is_multiple_of(2) { even } else { odd }
}

/// A file that is being written before it gets its name.
pub fn temporary(name: &str) -> String {
    format!("{name}{TEMPORARY}")
}

/// Texture maps of a generation.
pub fn textures(generation: u32) -> String {
    format!("textures-{generation:04}")
}

/// Sums of a cycle under way, as of a commit.
pub fn sums(sequence: u64) -> String {
    format!("sums-{sequence:08}")
}

/// Folder of a generation's tile files.
pub fn generation(generation: u32) -> String {
    format!("unshot-{generation:04}")
}

/// Tile file of a direction in a folder, within the field.
pub fn tile_file(folder: &str, direction: u32) -> String {
    format!("{folder}/{direction:06}{TILES}")
}

/// Tile file of a direction in a folder of the field at a path.
pub fn tiles(field: &Path, folder: &str, direction: u32) -> PathBuf {
    field.join(tile_file(folder, direction))
}

/// Whether a field's writer may have put a file of that name into a folder of tile files.
pub fn is_tile_file(name: &str) -> bool {
    name.strip_suffix(TILES).is_some_and(|n| n.len() >= 6 && n.bytes().all(|b| b.is_ascii_digit()))
}

/// Whether a field's writer may have put a file or folder of that name into the field.
pub fn is_ours(name: &str) -> bool {
    let name = name.strip_suffix(TEMPORARY).unwrap_or(name);
    MANIFESTS.contains(&name) || [SCENE, LOCK, TOTAL].contains(&name) || is_of_a_commit(name)
}

/// Whether a name is of a kind that belongs to some commits and not to others.
pub fn is_of_a_commit(name: &str) -> bool {
    ["textures-", "sums-", "unshot-"].iter().any(|kind| {
        name.strip_prefix(kind)
            .is_some_and(|n| n.len() >= 4 && n.bytes().all(|b| b.is_ascii_digit()))
    })
}
