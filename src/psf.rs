//! One direction's parallel subfield (PSF): from a point to its cell and depth, and back.
//!
//! Written once, for baking and for looking, so that no half cell can creep in between the two.
//! In: a unit direction, the resolution N. The scene lies in the unit ball about the origin
//! (section 3 encloses it in a cuboid; a ball fits every direction alike). A PSF's cells are squares
//! of `2 / N` that tile `[-1, 1]^2` across the direction; ray (i, j) passes through its cell's middle.

use glam::{Vec2, Vec3};

/// The frame of a parallel subfield: two axes across the direction and the direction itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Psf {
    /// Axis of columns, unit.
    pub right: Vec3,
    /// Axis of rows, unit.
    pub up: Vec3,
    /// The direction omega, unit. Depth grows along it.
    pub direction: Vec3,
    /// Cells along an edge, N.
    pub resolution: u32,
    /// Where the grid's origin stands, in cells; within [-1/2, 1/2]. Zero but for perturbed PSFs.
    pub shift: Vec2,
}

impl Psf {
    /// The canonical PSF of a direction.
    ///
    /// The frame turns k = (0, 0, 1) into the direction along the shortest way (Duff et al. 2017,
    /// "Building an orthonormal basis, revisited"); the paper turns about y, then z, and asks only
    /// for consistency (section 3).
    pub fn new(direction: Vec3, resolution: u32) -> Psf {
        let (right, up) = direction.any_orthonormal_pair();
        Psf { right, up, direction, resolution, shift: Vec2::ZERO }
    }

    /// The same with the grid's origin moved by `shift` cells (section 5, perturbation).
    pub fn shifted(self, shift: Vec2) -> Psf {
        Psf { shift, ..self }
    }

    /// The same with each cell parted into `times` by `times`.
    pub fn parted(self, times: u32) -> Psf {
        let (resolution, shift) = (self.resolution * times, self.shift * times as f32);
        Psf { resolution, shift, ..self }
    }

    /// Edge of a cell in the fitted scene's units.
    pub fn cell_edge(&self) -> f32 {
        2.0 / self.resolution as f32
    }

    /// Where a point falls: column and row in cells (a cell's middle is at +1/2) and depth.
    pub fn project(&self, point: Vec3) -> Vec3 {
        let half = 0.5 * self.resolution as f32;
        Vec3::new(
            (point.dot(self.right) + 1.0) * half + self.shift.x,
            (point.dot(self.up) + 1.0) * half + self.shift.y,
            point.dot(self.direction),
        )
    }

    /// The point at column and row (in cells) and depth: the inverse of [`Psf::project`].
    pub fn unproject(&self, column: f32, row: f32, depth: f32) -> Vec3 {
        let edge = self.cell_edge();
        self.right * ((column - self.shift.x) * edge - 1.0)
            + self.up * ((row - self.shift.y) * edge - 1.0)
            + self.direction * depth
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn project_and_unproject_are_inverse(
            d in prop::array::uniform3(-1.0f32..1.0), p in prop::array::uniform3(-0.57f32..0.57),
            n in 1u32..512, sx in -0.5f32..0.5,
        ) {
            let d = Vec3::from(d);
            prop_assume!(d.length() > 0.05);
            let psf = Psf::new(d.normalize(), n).shifted(Vec2::new(sx, 0.0));
            let q = psf.project(Vec3::from(p));
            prop_assert!(q.x >= -0.5 && q.x <= n as f32 + 0.5);
            prop_assert!(psf.unproject(q.x, q.y, q.z).distance(Vec3::from(p)) < 1e-5);
        }
    }
}
