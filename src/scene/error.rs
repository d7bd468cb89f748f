//! What can be wrong with a scene's files, each with its place and what to do about it.

use crate::format::limits::{Flag, in_brackets};
use std::io;
use std::path::PathBuf;

/// Why a scene was refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// A file could not be read.
    #[error("{}: cannot be read: {source}; give the path of a readable OBJ or glTF file", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A line that cannot be taken as it stands.
    #[error("{}:{line}: {message}", path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// Its line, from 1.
        line: u32,
        /// What is wrong and what to do.
        message: String,
    },
    /// A material library that the OBJ names could not be read.
    #[error(
        "{}:{line}: material library `{library}` cannot be read: {source}; put the file beside the \
         OBJ or correct its `mtllib` line",
        path.display()
    )]
    Library {
        /// The OBJ file.
        path: PathBuf,
        /// The `mtllib` line, from 1.
        line: u32,
        /// The library as the OBJ names it.
        library: String,
        /// What the system said.
        source: io::Error,
    },
    /// More than the stated limit of something.
    #[error("{}: {what} {found} exceeds limit {limit}{}; divide or simplify the scene", path.display(), in_brackets(.flag))]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// What there is too much of.
        what: &'static str,
        /// How much there is; where counting stopped, the first count beyond the limit.
        found: u64,
        /// How much there may be.
        limit: u64,
        /// What allows more.
        flag: Flag,
    },
    /// No face that has an area.
    #[error("{}: no face with an area; the scene needs at least one `f` line of three corners", path.display())]
    Empty {
        /// The OBJ file.
        path: PathBuf,
    },
    /// Nothing in the scene emits light.
    #[error("{}: nothing emits light; add `Ke 10 10 10` to the material of a lamp in {library}", path.display())]
    NoEmitter {
        /// The OBJ file.
        path: PathBuf,
        /// The material library to add it to.
        library: String,
    },
    /// The OBJ reader refused what our own checks let pass.
    #[error("{}: the OBJ reader stopped: {message}; export the file anew", path.display())]
    Reader {
        /// The OBJ file.
        path: PathBuf,
        /// What it said.
        message: String,
    },
    /// A glTF file that cannot be taken as it stands.
    #[error("{}: {message}", path.display())]
    Gltf {
        /// The file.
        path: PathBuf,
        /// What is wrong and what to do.
        message: String,
    },
    /// A bundled scene that does not exist.
    #[error("no bundled scene is called `{name}`; there are {known}")]
    UnknownBundled {
        /// What was asked for.
        name: String,
        /// What there is.
        known: String,
    },
}
