//! Radiance of a surface at any point and direction, from tile maps of the fixed directions.
//!
//! In: the three directions around the wanted one with their weights (section 4.3), and for each its
//! tile map. In each of the three the point is projected into the PSF and the radiance is bilinear
//! between the four cells around it, of those that belong to the surface (section 6); the three are
//! then blended by their barycentric weights. Weights of cells and directions in which the surface is
//! not found are given to the others, so that nothing is lost at a surface's border. Baking gathers
//! what mirrors send on; looking gathers what the eye sees. Constant time but for the search of a
//! tile's list.

use crate::directions::{Directions, Near};
use crate::format::tiles::TileMap;
use crate::ids::{Cell, SurfaceId};
use crate::psf::Psf;
use crate::radiance::Rgb;
use glam::Vec3;

/// The three directions around a vector, as seen from one side of a surface.
#[derive(Clone, Copy, Debug)]
pub struct Around {
    /// The directions; weights sum to 1, or to 0 when none is on the side's own half.
    pub near: [Near; 3],
    /// Their PSFs.
    pub psfs: [Psf; 3],
}

impl Around {
    /// The three directions around `away`, a unit vector that points away from the side of a surface
    /// with unit normal `normal`. Directions that fall behind the side show its other side: they get
    /// no weight.
    pub fn new(directions: &Directions, resolution: u32, away: Vec3, normal: Vec3) -> Around {
        let mut near = directions.nearest_three(away);
        for n in &mut near {
            let behind = directions.vector(n.direction).dot(normal) * n.sense.sign() <= 1e-4;
            n.weight *= f32::from(u8::from(!behind));
        }
        let total: f32 = near.iter().map(|n| n.weight).sum();
        if total > 0.0 {
            near.iter_mut().for_each(|n| n.weight /= total);
        }
        Around { near, psfs: near.map(|n| Psf::new(directions.vector(n.direction), resolution)) }
    }

    /// The blended radiance at a point of the surface, W sr^-1 m^-2; `maps` are the tile maps of the
    /// three directions. `None` when the surface covers no cell near the point in any of them.
    pub fn radiance(
        &self,
        maps: &[Option<TileMap>; 3],
        surface: SurfaceId,
        point: Vec3,
    ) -> Option<Rgb> {
        let mut sum = Rgb::BLACK;
        let mut weight = 0.0;
        for ((near, psf), map) in self.near.iter().zip(&self.psfs).zip(maps) {
            let Some(map) = map.as_ref().filter(|_| near.weight > 0.0) else { continue };
            if let Some(radiance) = between_cells(map, psf, near, surface, point) {
                sum += radiance * near.weight;
                weight += near.weight;
            }
        }
        (weight > 0.0).then(|| sum / weight)
    }
}

/// The direction from which light must arrive at a mirror to leave along `outgoing`; both point away
/// from the side with unit normal `normal`.
pub fn mirrored(outgoing: Vec3, normal: Vec3) -> Vec3 {
    (normal * (2.0 * outgoing.dot(normal)) - outgoing).normalize()
}

/// Bilinear between the four cells around the point that belong to the surface, or the mean of those
/// one ring farther out when none of the four does.
fn between_cells(
    map: &TileMap,
    psf: &Psf,
    near: &Near,
    surface: SurfaceId,
    point: Vec3,
) -> Option<Rgb> {
    let at = psf.project(point);
    let (x, y) = (at.x - 0.5, at.y - 0.5);
    let (i, j) = (x.floor(), y.floor());
    let (fx, fy) = (x - i, y - j);
    let (i, j) = (i as i32, j as i32);
    let weights = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
    let inner = [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)];
    let mut lookup = Lookup { map, surface, tile: None };
    let mut sum = Rgb::BLACK;
    let mut weight = 0.0;
    for ((i, j), w) in inner.into_iter().zip(weights) {
        if let Some(radiance) = lookup.radiance(i, j, near) {
            // A cell that alone is found counts even where its bilinear weight vanishes.
            let w = w.max(1e-4);
            sum += radiance * w;
            weight += w;
        }
    }
    if weight > 0.0 {
        return Some(sum / weight);
    }
    for (di, dj) in RING {
        if let Some(radiance) = lookup.radiance(i + di, j + dj, near) {
            sum += radiance;
            weight += 1.0;
        }
    }
    (weight > 0.0).then(|| sum / weight)
}

/// The twelve cells around the inner four, as offsets from the lower left of those.
const RING: [(i32, i32); 12] = [
    (-1, -1),
    (0, -1),
    (1, -1),
    (2, -1),
    (-1, 0),
    (2, 0),
    (-1, 1),
    (2, 1),
    (-1, 2),
    (0, 2),
    (1, 2),
    (2, 2),
];

/// Looks cells of one surface up and remembers the tile entry it found last.
struct Lookup<'a> {
    map: &'a TileMap<'a>,
    surface: SurfaceId,
    tile: Option<((u32, u32), Option<crate::format::tiles::TileEntry<'a>>)>,
}

impl Lookup<'_> {
    fn radiance(&mut self, i: i32, j: i32, near: &Near) -> Option<Rgb> {
        let last = self.map.resolution() as i32 - 1;
        if i < 0 || j < 0 || i > last || j > last {
            return None;
        }
        let cell = Cell { i: i as u32, j: j as u32 };
        let tile = (cell.i / self.map.tile_edge(), cell.j / self.map.tile_edge());
        let entry = match self.tile {
            Some((t, entry)) if t == tile => entry,
            _ => {
                let entry = self.map.entry(cell, self.surface);
                self.tile = Some((tile, entry));
                entry
            }
        };
        entry?.radiance(cell, near.sense)
    }
}
