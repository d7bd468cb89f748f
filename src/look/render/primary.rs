//! What the eye sees first in every pixel, by rasterising: several times faster than a ray for each.
//!
//! In: the scene's [`Visible`] and a view. Out: for the middle of each pixel the hit that
//! [`Visible::nearest`] finds. Triangles are not clipped: with the eye at the origin, a pixel's ray meets
//! a triangle where three planes through the eye and its edges say so, and these, like one over the
//! distance, are linear in the picture (Olano and Greer 1997).

use crate::level::level;
use crate::look::packet::{EDGE, LANES, NONE, Packet};
use crate::scene::camera::View;
use crate::visible::{COINCIDENT, Facet, Visible};
use fearless_simd::dispatch;
use glam::DVec3;
use rayon::prelude::*;

/// Rows that are drawn together: their depths stay in a core's own cache. Whole packets.
pub const BAND: usize = 2 * EDGE;

/// Triangles that a task sets up.
const SETUP: usize = 1024;

/// A number that is linear in the picture: at its origin, and its change per pixel to the right and down.
#[derive(Clone, Copy, Debug)]
struct Linear([f64; 3]);

impl Linear {
    /// `normal . d` for the rays' directions `d`, which are not of unit length.
    fn of(normal: DVec3, view: &View) -> Linear {
        Linear([view.corner, view.across, view.down].map(|v| normal.dot(v)))
    }

    fn plus(self, other: Linear, times: f64) -> Linear {
        Linear([0, 1, 2].map(|k| self.0[k] + other.0[k] * times))
    }

    fn times(self, factor: f64) -> Linear {
        Linear(self.0.map(|v| v * factor))
    }

    /// In a row, whose middle is `y`.
    fn at_row(&self, y: f64) -> (f64, f64) {
        (self.0[0] + self.0[2] * y, self.0[1])
    }
}

/// A triangle ready to be drawn.
#[derive(Clone, Copy, Debug)]
struct Triangle {
    /// Not negative inside.
    edges: [Linear; 3],
    /// One over the distance, in lengths of the ray's direction.
    nearness: Linear,
    surface: u32,
    /// First row, and the one after the last.
    rows: (u32, u32),
}

impl Triangle {
    /// `None`: not in the picture, or seen from its edge.
    fn new(visible: &Visible, facet: &Facet, view: &View, size: (u32, u32)) -> Option<Triangle> {
        let eye = view.origin.as_dvec3();
        let a = facet.corner.as_dvec3() - eye;
        let [b, c] = facet.edges.map(|e| a + e.as_dvec3());
        let rows = rows([a, b, c], view, size.1)?;
        let normals = [b.cross(c), c.cross(a), a.cross(b)];
        let sign = a.dot(normals[0]).signum();
        let edges = normals.map(|n| Linear::of(n, view).times(sign));
        let whole = edges[0].plus(edges[1], 1.0).plus(edges[2], 1.0);
        let (normal, offset) = visible.touching_plane(facet.surface);
        let height = offset - normal.dot(eye);
        (height != 0.0).then(|| Triangle {
            edges: edges.map(|e| e.plus(whole, f64::from(facet.slack))),
            nearness: Linear::of(normal / height, view),
            surface: facet.surface,
            rows,
        })
    }

    /// The columns of a row whose middles it covers: the first, and the one after the last.
    fn columns(&self, y: f64, width: u32) -> (usize, usize) {
        let (mut from, mut to) = (0.0f64, f64::from(width));
        for edge in &self.edges {
            let (at, step) = edge.at_row(y);
            let zero = -at / step;
            match step {
                _ if step > 0.0 => from = from.max(zero - 0.5),
                _ if step < 0.0 => to = to.min(zero + 0.5),
                _ if at < 0.0 => return (0, 0),
                _ => {}
            }
        }
        // Casts saturate, so that an empty span stays empty.
        (from.ceil() as usize, to.floor() as usize)
    }
}

/// The rows of a triangle whose corners stand at places from the eye; `None` when it is out of the picture.
fn rows(corners: [DVec3; 3], view: &View, height: u32) -> Option<(u32, u32)> {
    let forward = view.across.cross(view.down);
    let ahead = corners.map(|p| p.dot(forward));
    if ahead.iter().all(|z| *z <= 0.0) {
        return None;
    }
    if ahead.iter().any(|z| *z <= 0.0) {
        return Some((0, height));
    }
    // A place p is a multiple of corner + across x + down y; `top` sees nothing of the first two.
    let top = view.corner.cross(view.across);
    let scale = view.corner.dot(forward) / top.dot(view.down);
    let y = |p: DVec3, z: f64| top.dot(p) / z * scale;
    let at = [0, 1, 2].map(|k| y(corners[k], ahead[k]));
    let least = at.iter().copied().fold(f64::INFINITY, f64::min);
    let most = at.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let (from, to) = ((least - 1.0).max(0.0), (most + 1.0).min(f64::from(height)));
    (from < to).then(|| (from as u32, to.ceil() as u32))
}

/// The scene as a view sees it, ready to be drawn in bands of [`BAND`] rows.
pub struct Primary<'a> {
    visible: &'a Visible,
    view: &'a View,
    size: (u32, u32),
    triangles: Vec<Triangle>,
    /// By band its triangles.
    bands: Vec<Vec<u32>>,
}

/// What a thread draws a band into; may be used again.
#[derive(Default)]
pub struct Band {
    nearness: Vec<f64>,
    surfaces: Vec<u32>,
    packet: Packet,
}

impl<'a> Primary<'a> {
    /// Sets the scene's triangles up for a picture of `size` pixels.
    pub fn new(visible: &'a Visible, view: &'a View, size: (u32, u32)) -> Primary<'a> {
        let facets = visible.facets();
        let parts = facets.par_chunks(SETUP).map(|part| {
            part.iter().filter_map(|f| Triangle::new(visible, f, view, size)).collect()
        });
        let triangles: Vec<Triangle> = parts.collect::<Vec<Vec<_>>>().concat();
        let mut bands = vec![Vec::new(); size.1.div_ceil(BAND as u32) as usize];
        for (index, triangle) in (0..).zip(&triangles) {
            let last = (triangle.rows.1 - 1) as usize / BAND;
            let first = triangle.rows.0 as usize / BAND;
            bands[first..=last].iter_mut().for_each(|band| band.push(index));
        }
        Primary { visible, view, size, triangles, bands }
    }

    /// Draws a band and hands its pixels over in packets, with the column and, in the band, the row of the
    /// first.
    pub fn draw(&self, band: usize, into: &mut Band, mut take: impl FnMut([usize; 2], &Packet)) {
        let width = self.size.0 as usize;
        let first = band * BAND;
        let count = BAND.min(self.size.1 as usize - first);
        into.nearness.clear();
        into.nearness.resize(width * count, 0.0);
        into.surfaces.clear();
        into.surfaces.resize(width * count, NONE);
        for index in &self.bands[band] {
            self.fill(&self.triangles[*index as usize], first, into);
        }
        let Band { surfaces, packet, .. } = into;
        let level = level();
        for row in (0..count).step_by(EDGE) {
            for column in (0..width).step_by(EDGE) {
                let mut met = [NONE; LANES];
                let rows = surfaces[row * width..].chunks(width);
                for (met, row) in met.chunks_mut(EDGE).zip(rows) {
                    let here = &row[column..width.min(column + EDGE)];
                    met[..here.len()].copy_from_slice(here);
                }
                let first = [column, first + row];
                dispatch!(level, simd => packet.send(simd, self.view, first, (met, self.visible)));
                take([column, row], packet);
            }
        }
    }

    /// Draws what a triangle covers of a band that begins with row `first`.
    fn fill(&self, triangle: &Triangle, first: usize, into: &mut Band) {
        let width = self.size.0 as usize;
        let rows = into.surfaces.chunks_mut(width).zip(into.nearness.chunks_mut(width));
        for (row, (surfaces, nearness)) in rows.enumerate() {
            let y = (first + row) as f64 + 0.5;
            let (from, to) = triangle.columns(y, self.size.0);
            if from >= to {
                continue;
            }
            let (at, step) = triangle.nearness.at_row(y);
            let cells = surfaces[from..to].iter_mut().zip(&mut nearness[from..to]);
            for (x, (surface, best)) in (from..to).zip(cells) {
                let near = at + step * (x as f64 + 0.5);
                // Within this two surfaces may be at one place; rays' directions are longer than 1.
                let slack = COINCIDENT * *best * *best;
                if near > *best + slack
                    || near > *best - slack && self.is_before(triangle.surface, *surface, (x, y))
                {
                    (*best, *surface) = (near, triangle.surface);
                }
            }
        }
    }

    #[cold]
    fn is_before(&self, surface: u32, other: u32, (x, y): (usize, f64)) -> bool {
        let (_, dir) = self.view.ray(x as f64 + 0.5, y);
        surface != other && self.visible.is_before(surface, other, dir.as_dvec3())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;
    use crate::scene::camera::Camera;
    use crate::scene::test_scenes::Dice;
    use crate::visible::Hit;
    use glam::Vec3;

    fn scene(name: &str) -> Scene {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes").join(name);
        Scene::open(&folder.join(name).with_extension("obj")).unwrap().0
    }

    /// Every pixel's hit, drawn.
    fn drawn(visible: &Visible, view: &View, size: (u32, u32)) -> Vec<Option<Hit>> {
        let primary = Primary::new(visible, view, size);
        let (width, height) = (size.0 as usize, size.1 as usize);
        let (mut band, mut out) = (Band::default(), vec![None; width * height]);
        for k in 0..height.div_ceil(BAND) {
            primary.draw(k, &mut band, |[column, row], packet| {
                for lane in 0..LANES {
                    let (x, y) = (column + lane % EDGE, k * BAND + row + lane / EDGE);
                    match x < width && y < height {
                        true => out[y * width + x] = packet.hit(lane),
                        false => assert_eq!(packet.hit(lane), None),
                    }
                }
            });
        }
        out
    }

    /// Pixels in which the two differ by more than a ray does that is moved by a thousandth of a pixel.
    fn wrong(visible: &Visible, view: &View, size: (u32, u32)) -> usize {
        let is_wrong = |(place, hit): (usize, &Option<Hit>)| {
            let (x, y) = (place % size.0 as usize, place / size.0 as usize);
            let ways = [(0.0, 0.0), (1e-3, 0.0), (-1e-3, 0.0), (0.0, 1e-3), (0.0, -1e-3)];
            let same = |way: &(f64, f64)| {
                let (origin, dir) = view.ray(x as f64 + 0.5 + way.0, y as f64 + 0.5 + way.1);
                match (visible.nearest(origin, dir, 0.0), hit) {
                    (None, None) => true,
                    (Some(one), Some(two)) => {
                        let apart = one.point.distance(two.point);
                        (one.surface, one.side) == (two.surface, two.side) && apart < 1e-2
                    }
                    _ => false,
                }
            };
            !ways.iter().any(same)
        };
        drawn(visible, view, size).iter().enumerate().filter(|p| is_wrong(*p)).count()
    }

    #[test]
    fn pixels_are_what_rays_through_their_middles_meet() {
        let size = (96, 70);
        for name in ["office", "torture", "metal_sphere", "mirror_corridor"] {
            let scene = scene(name);
            let visible = Visible::new(&scene);
            let mut dice = Dice(7);
            for _ in 0..12 {
                let mut place = |part: f32| scene.fit.to_own(dice.point() * part);
                // Also from outside, and with walls before and behind the eye.
                let (eye, target) = (place(1.2), place(0.9));
                let (up, vfov_deg) = (DVec3::new(0.1, 1.0, 0.2), 100.0);
                let camera = Camera { eye, target, up, vfov_deg, width: size.0, height: size.1 };
                let wrong = wrong(&visible, &camera.view(&scene.fit), size);
                assert!(wrong <= 2, "{name}: {wrong} pixels, {camera:?}");
            }
        }
    }

    #[test]
    fn where_there_is_nothing_nothing_is_met() {
        let scene = scene("parallel_squares");
        let visible = Visible::new(&scene);
        let away = Camera {
            eye: scene.fit.to_own(Vec3::X * 3.0),
            target: scene.fit.to_own(Vec3::X * 5.0),
            up: DVec3::Y,
            vfov_deg: 60.0,
            width: 17,
            height: 9,
        };
        let all = drawn(&visible, &away.view(&scene.fit), (17, 9));
        assert!(all.len() == 17 * 9 && all.iter().all(Option::is_none));
    }
}
