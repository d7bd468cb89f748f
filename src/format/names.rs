//! Names of the files inside a field directory, built from numbers only.

use std::path::{Path, PathBuf};

/// The commit record.
pub const MANIFEST: &str = "manifest";
/// The resolved scene.
pub const SCENE: &str = "scene";
/// The lock that one writer holds.
pub const LOCK: &str = "lock";
/// Tile files of the total radiance maps.
pub const TOTAL: &str = "total";

/// Texture maps of a generation.
pub fn textures(generation: u32) -> String {
    format!("textures-{generation:04}")
}

/// Sums of a cycle under way, alternating between two names so that the committed one stays.
pub fn sums(sequence: u64) -> String {
    format!("sums-{}", sequence % 2)
}

/// Folder of a generation's tile files.
pub fn generation(generation: u32) -> String {
    format!("unshot-{generation:04}")
}

/// Name of a folder while its tile files are being written.
pub fn unpublished(folder: &str) -> String {
    format!("{folder}.part")
}

/// Tile file of a direction in a folder of the field.
pub fn tiles(field: &Path, folder: &str, direction: u32) -> PathBuf {
    field.join(folder).join(format!("{direction:06}.tiles"))
}
