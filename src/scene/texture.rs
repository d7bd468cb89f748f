//! Where an image lies on a surface: one affine map of the surface's plane to the image.
//!
//! Places of an image count in its edges, (0, 0) at the beginning of its top row and (1, 1) at the end of
//! its bottom row; beyond that it repeats, or its outermost pixels go on.

use crate::radiance::Rgb;
use glam::{DVec2, DVec3, Vec2};

/// How far texture coordinates may be off an affine map, in edges of the image: files have four
/// digits or so of them.
const AFFINE: f64 = 1e-3;

/// The largest number of a [`Placement`]: beyond it nothing is left of an image but its mean.
pub const FARTHEST: f32 = 1e9;

/// An image that a diffuse material has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Texture {
    /// Number of the image in its scene.
    pub image: u32,
    /// What the image is multiplied by, each in [0, 1].
    pub tint: Rgb,
    /// Whether the outermost pixels go on, along the image's rows and across them.
    pub clamp: [bool; 2],
}

/// Where a surface's image lies: a point `(a, b)` along `u` and `v` from the surface's origin, in the
/// fitted scene's units, shows `origin + along_u * a + along_v * b` of the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// At the surface's origin.
    pub origin: Vec2,
    /// What a unit along `u` adds.
    pub along_u: Vec2,
    /// What a unit along `v` adds.
    pub along_v: Vec2,
}

/// The same for points of space: `(s . p, t . p) + offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Affine {
    s: DVec3,
    t: DVec3,
    offset: DVec2,
}

impl Affine {
    /// The place that a point shows.
    pub fn at(&self, point: DVec3) -> DVec2 {
        DVec2::new(self.s.dot(point), self.t.dot(point)) + self.offset
    }

    /// Whether it shows the places that some points ought to.
    pub fn fits(&self, mut points: impl Iterator<Item = (DVec3, DVec2)>) -> bool {
        points.all(|(p, place)| (self.at(p) - place).abs().max_element() <= AFFINE)
    }

    /// The map of a plane that shows best what some of its points ought to (least squares).
    pub fn of(
        normal: DVec3,
        points: impl Iterator<Item = (DVec3, DVec2)> + Clone,
    ) -> Option<Affine> {
        let count = points.clone().count() as f64;
        let sum = |(p, q): (DVec3, DVec2), (r, s): (DVec3, DVec2)| (p + r, q + s);
        let (middle, place) = points.clone().reduce(sum).map(|(p, q)| (p / count, q / count))?;
        let (u, v) = normal.any_orthonormal_pair();
        // Normal equations of place = middle + a x + b y.
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        let (mut x_place, mut y_place) = (DVec2::ZERO, DVec2::ZERO);
        for (p, q) in points {
            let (x, y) = ((p - middle).dot(u), (p - middle).dot(v));
            (xx, xy, yy) = (xx + x * x, xy + x * y, yy + y * y);
            x_place += (q - place) * x;
            y_place += (q - place) * y;
        }
        let determinant = xx * yy - xy * xy;
        let a = (x_place * yy - y_place * xy) / determinant;
        let b = (y_place * xx - x_place * xy) / determinant;
        let (s, t) = (u * a.x + v * b.x, u * a.y + v * b.y);
        let affine = Affine { s, t, offset: place - DVec2::new(s.dot(middle), t.dot(middle)) };
        (s + t).is_finite().then_some(affine)
    }

    /// The same on a surface's axes. `None` when it goes beyond [`FARTHEST`].
    pub fn on(&self, origin: DVec3, u: DVec3, v: DVec3, clamp: [bool; 2]) -> Option<Placement> {
        let mut at = self.at(origin);
        // Whole images more or less make no difference where they repeat, and small numbers are exact.
        for axis in [0, 1] {
            at[axis] -= if clamp[axis] { 0.0 } else { at[axis].floor() };
        }
        let along = |d: DVec3| DVec2::new(self.s.dot(d), self.t.dot(d)).as_vec2();
        let placement = Placement { origin: at.as_vec2(), along_u: along(u), along_v: along(v) };
        placement.is_sound().then_some(placement)
    }
}

impl Placement {
    /// Whether its numbers can be reckoned with.
    pub fn is_sound(&self) -> bool {
        let all = [self.origin, self.along_u, self.along_v];
        all.iter().all(|v| v.is_finite() && v.abs().max_element() <= FARTHEST)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_shows_what_its_points_show() {
        let normal = DVec3::new(0.6, 0.0, 0.8);
        let (u, v) = (DVec3::Y, DVec3::new(-0.8, 0.0, 0.6));
        let points = [(0.0, 0.0), (0.5, 0.0), (0.5, 0.25), (0.0, 0.25)];
        let wanted = |(a, b): (f64, f64)| DVec2::new(1.25 + 2.0 * a, -3.5 + a - 4.0 * b);
        let here = DVec3::new(0.1, 0.2, 0.3);
        let all = points.map(|(a, b)| (here + u * a + v * b, wanted((a, b))));
        let affine = Affine::of(normal, all.into_iter()).unwrap();
        assert!(affine.fits(all.into_iter()));
        let bent = all[..3].iter().copied().chain([(all[3].0, all[3].1 + 0.1)]);
        assert!(!Affine::of(normal, bent.clone()).unwrap().fits(bent));
        let on = affine.on(here, u, v, [false, true]).unwrap();
        assert!(on.origin.distance(Vec2::new(0.25, -3.5)) < 1e-5, "{on:?}");
        assert!(on.along_u.distance(Vec2::new(2.0, 1.0)) < 1e-5, "{on:?}");
        assert!(on.along_v.distance(Vec2::new(0.0, -4.0)) < 1e-5, "{on:?}");
        let far = all.map(|(p, q)| (p, q * 1e12));
        let far = Affine::of(normal, far.into_iter()).unwrap();
        assert_eq!(far.on(here, u, v, [false; 2]), None);
    }
}
