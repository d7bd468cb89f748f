//! Paths `S* D`: from a hit through any number of mirrors to the diffuse surface behind them.
//!
//! In: the scene, its [`Visible`], and a hit with the direction in which it was met. Out: what the
//! hit's surface sends back. Mirrors are ideal, so a path has one branch and costs one ray for each
//! mirror on its way. Baking follows them from the lines that meet mirrors (backward ray tracing,
//! section 5), looking from the eye (`E S* D`, section 6).

use crate::ids::Side;
use crate::radiance::Rgb;
use crate::scene::{Reflectance, Scene};
use crate::visible::{Hit, Visible};
use glam::Vec3;

/// The default bound on mirrors in one path.
pub const MAX_DEPTH: u32 = 64;

/// The most mirrors that a glance along a path goes through.
const GLANCES: u32 = 4;

/// A path that meets more backs of mirrors than this, one after the other, is inside a solid and given
/// up: such a path would go on for ever, and what it would find is dark.
const BACKS: u32 = 6;

/// A path that would carry less than this part of what it finds is given up.
const LEAST_THROUGHPUT: f32 = 1e-4;

/// Height above a mirror at which the reflected ray starts, in the fitted scene's units.
pub const LIFT: f32 = 1e-5;

/// What paths go through.
#[derive(Clone, Copy)]
pub struct Paths<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Its hierarchy.
    pub visible: &'a Visible,
    /// The most mirrors that a path may meet; see [`MAX_DEPTH`].
    pub max_depth: u32,
}

impl Paths<'_> {
    /// Whether a hit may send anything against the direction `dir` in which it was met: whether its path
    /// meets a surface and side that `lit` says yes of, or more mirrors than are worth following.
    pub fn may_send(&self, mut dir: Vec3, hit: &Hit, lit: impl Fn(&Hit) -> bool) -> bool {
        let mut hit = *hit;
        for _ in 0..GLANCES {
            if lit(&hit) {
                return true;
            }
            let surface = self.scene.surface(hit.surface);
            if !self.scene.material_of(hit.surface).reflectance.is_mirror() {
                return false;
            }
            let (origin, reflected) = reflect(dir, &hit, surface.normal);
            match self.visible.nearest_but(origin, reflected, 0.0, Some(hit.surface)) {
                Some(next) => (hit, dir) = (next, reflected),
                None => return false,
            }
        }
        true
    }

    /// Radiance from a hit against the unit direction `dir` in which it was met, W sr^-1 m^-2.
    /// `emit` says whether mirrors' own emission counts; `diffuse` gives what a diffuse surface sends.
    pub fn radiance(
        &self,
        dir: Vec3,
        hit: &Hit,
        emit: bool,
        diffuse: impl FnOnce(&Hit) -> Rgb,
    ) -> Rgb {
        let path = self.follow(dir, hit, emit);
        match path.end {
            Some(end) => path.emitted + path.carried * diffuse(&end),
            None => path.emitted,
        }
    }

    /// Follows the path that a hit shows against the unit direction `dir` in which it was met. `emit` says
    /// whether mirrors' own emission counts.
    pub fn follow(&self, mut dir: Vec3, hit: &Hit, emit: bool) -> Path {
        let mut hit = *hit;
        let mut path = Path { emitted: Rgb::BLACK, carried: Rgb::splat(1.0), end: None };
        let mut backs = 0;
        for _ in 0..=self.max_depth {
            let material = self.scene.material_of(hit.surface);
            let factor = match material.reflectance {
                Reflectance::Diffuse(_) => {
                    path.end = Some(hit);
                    break;
                }
                Reflectance::Mirror(factor) => factor,
            };
            if emit && hit.side == Side::Front {
                path.emitted += path.carried * material.emitted;
            }
            backs = if hit.side == Side::Back { backs + 1 } else { 0 };
            path.carried = path.carried * factor;
            if path.carried.max() < LEAST_THROUGHPUT || backs > BACKS {
                break;
            }
            let (origin, reflected) = reflect(dir, &hit, self.scene.surface(hit.surface).normal);
            match self.visible.nearest_but(origin, reflected, 0.0, Some(hit.surface)) {
                Some(next) => (hit, dir) = (next, reflected),
                None => break,
            }
        }
        path
    }
}

/// What a path `S* D` finds.
#[derive(Clone, Copy, Debug)]
pub struct Path {
    /// What its mirrors emit, as it arrives at the path's beginning.
    pub emitted: Rgb,
    /// What part of the light of its end its mirrors carry on.
    pub carried: Rgb,
    /// Where it meets a diffuse surface, if it does.
    pub end: Option<Hit>,
}

/// The ray that leaves a mirror, origin and unit direction.
pub fn reflect(dir: Vec3, hit: &Hit, normal: Vec3) -> (Vec3, Vec3) {
    let normal = normal * hit.side.sign();
    let cosine = -dir.dot(normal);
    let reflected = (dir + normal * (2.0 * cosine)).normalize();
    // In a corner the rounded point may lie behind the neighbouring wall, and a ray from there would
    // leave the scene. The arriving ray was still inside a little earlier, so start above that place.
    let back = (LIFT / cosine.max(0.25)).min(0.5 * hit.distance);
    let foot = hit.point - (dir + normal * cosine) * back;
    (foot + normal * LIFT, reflected)
}
