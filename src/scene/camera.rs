//! The pinhole camera, in the scene's own units, and its JSON file.

use super::Fit;
use glam::{DVec3, Vec3};
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

/// A camera placed in the unit ball: pixels in, rays out.
#[derive(Clone, Copy, Debug)]
pub struct View {
    eye: Vec3,
    corner: DVec3,
    across: DVec3,
    down: DVec3,
}

impl Camera {
    /// The camera's frame in the fitted scene.
    pub fn view(&self, fit: &Fit) -> View {
        let forward = (self.target - self.eye).normalize();
        let right = forward.cross(self.up).normalize();
        let step = 2.0 * (0.5 * self.vfov_deg.to_radians()).tan() / f64::from(self.height);
        let (across, down) = (right * step, forward.cross(right) * step);
        let corner = forward
            - across * (0.5 * f64::from(self.width))
            - down * (0.5 * f64::from(self.height));
        View { eye: fit.to_unit(self.eye), corner, across, down }
    }
}

impl View {
    /// Origin and unit direction, in the unit ball, of the ray through a point of the picture, in
    /// pixels from its top left corner.
    pub fn ray(&self, px: f64, py: f64) -> (Vec3, Vec3) {
        let d = self.corner + self.across * px + self.down * py;
        (self.eye, d.normalize().as_vec3())
    }
}
