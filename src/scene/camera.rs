//! The pinhole camera, in the scene's own units, and its JSON file.

use glam::DVec3;
use serde::{Deserialize, Serialize};

/// A pinhole camera. The picture is `width` x `height` pixels; `vfov_deg` is the full vertical angle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Where the eye is, in the scene's own units.
    pub eye: DVec3,
    /// What it looks at.
    pub target: DVec3,
    /// Which way is up in the picture; need not be perpendicular to the view.
    pub up: DVec3,
    /// Vertical field of view in degrees, in (0, 180).
    pub vfov_deg: f64,
    /// Pixels along a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
}
