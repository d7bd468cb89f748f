//! Which pixels one surface fills: the others have edges in them.
//!
//! In: the scene and a view. Out: for each pixel the surface that is seen in all of it. That is known, not sampled:
//! where no polygon's outline passes through a pixel, each surface covers all of it or nothing, and as one over the
//! distance is linear in the picture, the part of the pixel in which one of them is nearest is convex. So what is seen
//! in the four corners of such a pixel is seen in all of it, however thin the legs of a chair. O(pixels + outlines).

use super::primary::{BAND, Band, Primary};
use crate::look::packet::{EDGE, NONE};
use crate::scene::camera::View;
use crate::scene::{Scene, Surface};
use crate::visible::Visible;
use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;
use std::collections::HashSet;

/// More than one thing may be seen in a pixel.
pub const MIXED: u32 = NONE - 1;

/// An outline so near to a pixel may pass through it, as far as rounding can tell. In pixels.
const MARGIN: f64 = 0.02;

/// For each pixel, row by row, the surface that fills it, [`NONE`] where there is nothing at all, or [`MIXED`].
pub fn filled(scene: &Scene, visible: &Visible, view: &View, size: (u32, u32)) -> Vec<u32> {
    let width = size.0 as usize;
    let corners = corners(visible, view, size);
    let mut filled = vec![MIXED; width * size.1 as usize];
    filled
        .par_chunks_mut(width)
        .zip(corners.par_windows(2 * (width + 1)).step_by(width + 1))
        .for_each(|(row, corners)| {
            let (upper, lower) = corners.split_at(width + 1);
            for (x, filled) in row.iter_mut().enumerate() {
                let all = [upper[x], upper[x + 1], lower[x], lower[x + 1]];
                if all.iter().all(|seen| *seen == all[0]) {
                    *filled = all[0];
                }
            }
        });
    let flat = Flat::new(view, size);
    for surface in &scene.surfaces {
        outline(surface, |a, b| flat.mark(a, b, &mut filled));
    }
    filled
}

/// What is seen in the corners of all pixels, one more along a row and down than there are pixels.
fn corners(visible: &Visible, view: &View, (width, height): (u32, u32)) -> Vec<u32> {
    let view = view.moved(-0.5, -0.5);
    let size = (width + 1, height + 1);
    let primary = Primary::new(visible, &view, size);
    let width = size.0 as usize;
    let mut corners = vec![NONE; width * size.1 as usize];
    let bands = corners.par_chunks_mut(width * BAND).enumerate();
    bands.for_each_init(Band::default, |into, (band, out)| {
        primary.draw(band, into, |[column, row], packet| {
            let rows = out[row * width..].chunks_mut(width);
            for (row, seen) in rows.zip(packet.surfaces.chunks(EDGE)) {
                let here = &mut row[column..width.min(column + EDGE)];
                here.copy_from_slice(&seen[..here.len()]);
            }
        });
    });
    corners
}

/// The edges of a surface's polygons, but for those that two of them share.
fn outline(surface: &Surface, mut edge: impl FnMut(Vec3, Vec3)) {
    let edges = surface.polygons.iter().flat_map(|polygon| {
        let corners = &polygon.vertices;
        corners.iter().zip(corners.iter().cycle().skip(1)).map(|(a, b)| (*a, *b))
    });
    if surface.polygons.len() == 1 {
        return edges.for_each(|(a, b)| edge(a, b));
    }
    let bits = |p: Vec3| p.to_array().map(f32::to_bits);
    let all: HashSet<_> = edges.clone().map(|(a, b)| (bits(a), bits(b))).collect();
    edges.filter(|(a, b)| !all.contains(&(bits(*b), bits(*a)))).for_each(|(a, b)| edge(a, b));
}

/// From places about the eye to places in the picture.
struct Flat {
    eye: DVec3,
    /// A place p is at `(x . p, y . p) / (ahead . p)`, in pixels from the top left corner.
    x: DVec3,
    y: DVec3,
    ahead: DVec3,
    size: DVec2,
}

impl Flat {
    fn new(view: &View, size: (u32, u32)) -> Flat {
        let View { origin, corner, across, down } = *view;
        // p is a multiple of corner + across x + down y.
        let ahead = across.cross(down) / corner.dot(across.cross(down));
        let (left, top) = (corner.cross(down), corner.cross(across));
        Flat {
            eye: origin.as_dvec3(),
            x: left / left.dot(across),
            y: top / top.dot(down),
            ahead,
            size: DVec2::new(f64::from(size.0), f64::from(size.1)),
        }
    }

    /// Marks the pixels that an edge passes through as mixed.
    fn mark(&self, a: Vec3, b: Vec3, filled: &mut [u32]) {
        let Some([a, b]) = self.clipped(a, b) else { return };
        let (upper, lower) = if a.y <= b.y { (a, b) } else { (b, a) };
        let width = self.size.x as usize;
        let last = self.size - 1.0;
        let rows = [upper.y - MARGIN, lower.y + MARGIN].map(|y| y.clamp(0.0, last.y) as usize);
        let slope = (lower.x - upper.x) / (lower.y - upper.y);
        for y in rows[0]..=rows[1] {
            // Where the edge is when it enters the row, and when it leaves it; a level one does neither.
            let at = |y: f64| upper.x + slope * (y.clamp(upper.y, lower.y) - upper.y);
            let (from, to) = match slope.is_finite() {
                true => (at(y as f64 - MARGIN), at(y as f64 + 1.0 + MARGIN)),
                false => (upper.x, lower.x),
            };
            let columns = [from.min(to) - MARGIN, from.max(to) + MARGIN];
            let [from, to] = columns.map(|x| x.clamp(0.0, last.x) as usize);
            filled[y * width + from..=y * width + to].fill(MIXED);
        }
    }

    /// The part of an edge that is in the picture, in pixels (Liang and Barsky 1984, before the division).
    fn clipped(&self, a: Vec3, b: Vec3) -> Option<[DVec2; 2]> {
        let ends = [a, b].map(|p| {
            let p = p.as_dvec3() - self.eye;
            DVec3::new(self.x.dot(p), self.y.dot(p), self.ahead.dot(p))
        });
        // Not negative in the picture; where all four are, the place is ahead.
        let within = ends.map(|p| {
            let far = (self.size + MARGIN) * p.z - p.truncate();
            let near = p.truncate() + MARGIN * p.z;
            [near.x, near.y, far.x, far.y]
        });
        let (mut from, mut to) = (0.0f64, 1.0f64);
        for (f, g) in within[0].into_iter().zip(within[1]) {
            match (f < 0.0, g < 0.0) {
                (true, true) => return None,
                (true, false) => from = from.max(f / (f - g)),
                (false, true) => to = to.min(f / (f - g)),
                (false, false) => {}
            }
        }
        let place = |t: f64| {
            let p = ends[0].lerp(ends[1], t);
            p.truncate() / p.z
        };
        let places = [place(from), place(to)];
        // Not of an edge that the eye lies on.
        (from <= to && places.iter().all(|p| p.is_finite())).then_some(places)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::camera::Camera;
    use crate::scene::test_scenes::{Dice, soup};

    fn bundled(name: &str) -> Scene {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes").join(name);
        Scene::open(&folder.join(name).with_extension("obj")).unwrap().0
    }

    #[test]
    fn whatever_is_looked_at_in_a_filled_pixel_is_what_fills_it() {
        let (width, height) = (40, 30);
        let all = ["office", "torture", "metal_sphere", "gallery"].map(bundled);
        for scene in all.into_iter().chain([soup(60)]) {
            let visible = Visible::new(&scene);
            let mut dice = Dice(11);
            for _ in 0..8 {
                let mut place = |part: f32| scene.fit.to_own(dice.point() * part);
                // Also from outside, and with walls before and behind the eye.
                let (eye, target) = (place(1.2), place(0.9));
                let (up, vfov_deg) = (DVec3::new(0.1, 1.0, 0.2), 80.0);
                let view = Camera { eye, target, up, vfov_deg, width, height }.view(&scene.fit);
                let filled = filled(&scene, &visible, &view, (width, height));
                for (place, surface) in (0..width * height).zip(&filled) {
                    for _ in 0..if *surface == MIXED { 0 } else { 40 } {
                        let [x, y] = [place % width, place / width]
                            .map(|from| f64::from(from) + 0.5 + 0.5 * f64::from(dice.roll()));
                        let (origin, dir) = view.ray(x, y);
                        let seen = visible.nearest(origin, dir, 0.0).map_or(NONE, |h| h.surface.0);
                        assert_eq!(seen, *surface, "at {x}, {y} of {view:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn only_pixels_at_edges_are_mixed() {
        let scene = bundled("office");
        let (width, height) = (640, 480);
        let camera = Camera::open(
            &std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/office/camera_a.json"),
        );
        let view = Camera { width, height, ..camera.unwrap() }.view(&scene.fit);
        let filled = filled(&scene, &Visible::new(&scene), &view, (width, height));
        let mixed = filled.iter().filter(|surface| **surface == MIXED).count();
        assert!(mixed > 0 && mixed < filled.len() / 8, "{mixed}");
    }
}
