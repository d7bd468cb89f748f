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
use crate::format::tiles::{Seen, TileMap};
use crate::ids::{Cell, Sense, SurfaceId};
use crate::psf::Psf;
use crate::radiance::Rgb;
use glam::{Vec3, Vec4};

/// What rounding may leave of a weight that is none. Mirrors along the axes turn lattice directions into others,
/// whose two neighbours need not be read.
const NEGLIGIBLE: f32 = 1e-4;

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
            let counts = n.weight > NEGLIGIBLE && shows(directions, n, normal);
            n.weight *= f32::from(u8::from(counts));
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
        self.blend(|k| {
            let mut cells = Lookup::new(maps[k]?, surface, self.near[k].sense);
            between_cells(&mut cells, &self.psfs[k], point)
        })
    }

    /// The same from what each of the three shows.
    #[inline]
    pub fn blend(&self, mut shown: impl FnMut(usize) -> Option<Rgb>) -> Option<Rgb> {
        let mut sum = Rgb::BLACK;
        let mut weight = 0.0;
        for (k, near) in self.near.iter().enumerate() {
            if near.weight <= 0.0 {
                continue;
            }
            if let Some(radiance) = shown(k) {
                sum += radiance * near.weight;
                weight += near.weight;
            }
        }
        (weight > 0.0).then(|| sum / weight)
    }
}

/// Whether a direction shows the side of a surface with unit normal `normal`, and not its other side or its edge.
pub fn shows(directions: &Directions, near: &Near, normal: Vec3) -> bool {
    directions.vector(near.direction).dot(normal) * near.sense.sign() > 1e-4
}

/// Cells of one surface in one PSF, seen in one sense.
pub trait Cells {
    /// Radiance in a column and row, W sr^-1 m^-2; `None` where the surface does not cover the cell or
    /// there is none.
    fn radiance(&mut self, i: i32, j: i32) -> Option<Rgb>;

    /// The same of this cell, the one to the right of it, the one below it, and that between these.
    #[inline]
    fn four(&mut self, i: i32, j: i32) -> Four {
        four(i, j, |i, j| self.radiance(i, j))
    }
}

/// Four cells: red, green, blue and 1 of each, or nothing but 0 where the surface does not cover it.
pub type Four = [Vec4; 4];

/// Four cells of a grid, by column and row.
#[inline]
pub fn four(i: i32, j: i32, mut radiance: impl FnMut(i32, i32) -> Option<Rgb>) -> Four {
    let all = [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)];
    all.map(|(i, j)| radiance(i, j).map_or(Vec4::ZERO, |rgb| Vec3::from(rgb.0).extend(1.0)))
}

/// A surface's cells, taken out of a tile map, so that the map need not be held.
pub struct Excerpt {
    origin: (i32, i32),
    width: i32,
    /// Row by row; what is not covered is negative.
    cells: Vec<Rgb>,
}

impl Excerpt {
    /// The cells of `surface` seen in a sense, from a PSF's map. `bounds` are the surface's: a corner,
    /// and how far it reaches along two axes.
    pub fn new(
        map: &TileMap,
        psf: &Psf,
        surface: SurfaceId,
        sense: Sense,
        (corner, reach): (Vec3, [Vec3; 2]),
    ) -> Excerpt {
        let [a, b] = reach;
        let corners = [corner, corner + a, corner + b, corner + a + b].map(|p| psf.project(p));
        let low = corners[1..].iter().fold(corners[0], |m, c| m.min(*c));
        let high = corners[1..].iter().fold(corners[0], |m, c| m.max(*c));
        // One cell more for rounding.
        let last = map.resolution() as i32 - 1;
        let clip = |v: f32| (v as i32).clamp(0, last);
        let (from, to) =
            ((clip(low.x - 1.0), clip(low.y - 1.0)), (clip(high.x + 1.0), clip(high.y + 1.0)));
        let (width, height) = (to.0 - from.0 + 1, to.1 - from.1 + 1);
        let mut cells = vec![Rgb::splat(-1.0); width as usize * height as usize];
        let m = map.tile_edge() as i32;
        for t in from.1 / m..=to.1 / m {
            for s in from.0 / m..=to.0 / m {
                let tile = Cell { i: (s * m) as u32, j: (t * m) as u32 };
                let Some(entry) = map.entry(tile, surface) else { continue };
                entry.for_each(sense, |inside, radiance| {
                    let (i, j) = (s * m + inside as i32 % m, t * m + inside as i32 / m);
                    if i >= from.0 && i <= to.0 && j >= from.1 && j <= to.1 {
                        cells[((j - from.1) * width + i - from.0) as usize] = radiance;
                    }
                });
            }
        }
        Excerpt { origin: from, width, cells }
    }
}

impl Cells for &Excerpt {
    fn radiance(&mut self, i: i32, j: i32) -> Option<Rgb> {
        let (i, j) = (i - self.origin.0, j - self.origin.1);
        if i < 0 || j < 0 || i >= self.width {
            return None;
        }
        self.cells.get((j * self.width + i) as usize).copied().filter(|r| r.0[0] >= 0.0)
    }
}

/// The direction from which light must arrive at a mirror to leave along `outgoing`; both point away
/// from the side with unit normal `normal`.
pub fn mirrored(outgoing: Vec3, normal: Vec3) -> Vec3 {
    (normal * (2.0 * outgoing.dot(normal)) - outgoing).normalize()
}

/// Bilinear between the four cells around the point that belong to the surface, or the mean of those
/// one ring farther out when none of the four does; `None` when those do not either.
#[inline]
pub fn between_cells(cells: &mut impl Cells, psf: &Psf, point: Vec3) -> Option<Rgb> {
    let found = between(cells, psf, point);
    (found.w > 0.0).then(|| Rgb((found / found.w).truncate().to_array()))
}

/// The same as a sum of red, green, blue and 1, each times its cell's weight; all 0 for none.
#[inline]
pub fn between(cells: &mut impl Cells, psf: &Psf, point: Vec3) -> Vec4 {
    let at = psf.project(point);
    let (x, y) = (at.x - 0.5, at.y - 0.5);
    // Rounded down, without the call that it is where a processor may lack the instruction.
    let down = |v: f32| v as i32 - i32::from((v as i32) as f32 > v);
    let (i, j) = (down(x), down(y));
    let (fx, fy) = (x - i as f32, y - j as f32);
    let weights = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
    let parts = cells.four(i, j).into_iter().zip(weights).map(|(cell, w)| cell * w.max(LEAST));
    let found: Vec4 = parts.sum();
    if found.w > 0.0 { found } else { in_ring(cells, i, j) }
}

/// A cell that alone is found counts even where its bilinear weight vanishes.
pub const LEAST: f32 = 1e-4;

/// The sum over the ring around four cells that are not covered, the first of which is given; all 0 for none.
#[inline(never)]
pub fn in_ring(cells: &mut impl Cells, i: i32, j: i32) -> Vec4 {
    let [below, above] = [j - 1, j + 1].map(|j| [i - 1, i + 1].map(|i| cells.four(i, j)));
    let rows = [below, above].into_iter().flat_map(|[left, right]| {
        [[left[0], left[1], right[0], right[1]], [left[2], left[3], right[2], right[3]]]
    });
    rows.flatten().sum()
}

/// Looks cells of one surface up and remembers the tile it found last.
pub struct Lookup<'a> {
    map: TileMap<'a>,
    surface: SurfaceId,
    sense: Sense,
    /// First cell of that tile, and what the surface shows in it.
    tile: Option<(Cell, Option<Seen<'a>>)>,
}

impl<'a> Lookup<'a> {
    /// For a surface as a map has it in one sense.
    pub fn new(map: TileMap<'a>, surface: SurfaceId, sense: Sense) -> Lookup<'a> {
        Lookup { map, surface, sense, tile: None }
    }

    /// The surface and the sense.
    pub fn of(&self) -> (SurfaceId, Sense) {
        (self.surface, self.sense)
    }

    /// What the surface shows in the tile that holds a cell, and the cell's place in it, row by row.
    #[inline]
    pub fn seen(&mut self, i: i32, j: i32) -> Option<(&mut Seen<'a>, u32)> {
        let last = self.map.resolution() as i32 - 1;
        if i < 0 || j < 0 || i > last || j > last {
            return None;
        }
        let (i, j, m) = (i as u32, j as u32, self.map.tile_edge());
        // Without a division: most cells are in the tile of the one before.
        let is_in = |first: &Cell| i.wrapping_sub(first.i) < m && j.wrapping_sub(first.j) < m;
        if !self.tile.as_ref().is_some_and(|(first, _)| is_in(first)) {
            let entry = self.map.entry(Cell { i, j }, self.surface);
            let first = Cell { i: i - i % m, j: j - j % m };
            self.tile = Some((first, entry.map(|entry| entry.seen(self.sense))));
        }
        let (first, seen) = self.tile.as_mut()?;
        seen.as_mut().map(|seen| (seen, (j - first.j) * m + (i - first.i)))
    }
}

impl Cells for Lookup<'_> {
    #[inline]
    fn radiance(&mut self, i: i32, j: i32) -> Option<Rgb> {
        let (seen, inside) = self.seen(i, j)?;
        seen.radiance(inside)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::tiles::{CoveredCell, Layout, TileMapWriter, exponent_for};

    const N: u32 = 32;

    /// A map in which surface 0 covers the cells for which `value` has radiance.
    fn map(value: impl Fn(u32, u32) -> Option<f32>) -> (Vec<u8>, Layout) {
        let exponent = exponent_for(4.0);
        let mut writer = TileMapWriter::new(N, 16, exponent);
        for tile in 0..4 {
            let mut cells = Vec::new();
            for cell in 0..256 {
                let (i, j) = (tile % 2 * 16 + cell % 16, tile / 2 * 16 + cell / 16);
                if let Some(v) = value(i, j) {
                    let radiance = [Rgb::splat(v); 2];
                    cells.push(CoveredCell { surface: SurfaceId(0), cell, radiance });
                }
            }
            writer.tile(&mut cells);
        }
        let bytes = writer.finish();
        let layout = Layout::check(&bytes, N, 16, 1, exponent).unwrap();
        (bytes, layout)
    }

    /// Looks points of a grid direction's PSF up in one map.
    fn look_up(value: impl Fn(u32, u32) -> Option<f32>, column: f32, row: f32) -> Option<f32> {
        let directions = Directions::with_lines(33).unwrap();
        let (bytes, layout) = map(value);
        let map = TileMap::new(&bytes, &layout);
        let away = directions.vector(crate::ids::DirectionId(7));
        let around = Around::new(&directions, N, away, away);
        let point = around.psfs[0].unproject(column, row, 0.1);
        let mut only = around;
        let first = (0..3).max_by(|a, b| around.near[*a].weight.total_cmp(&around.near[*b].weight));
        let first = first.unwrap();
        assert!(around.near[first].weight > 0.999 && around.near[first].sense == Sense::Along);
        only.near.iter_mut().enumerate().for_each(|(k, n)| n.weight = f32::from(k == first));
        let point = if first == 0 { point } else { only.psfs[first].unproject(column, row, 0.1) };
        only.radiance(&[Some(map); 3], SurfaceId(0), point).map(|v| v.0[0])
    }

    #[test]
    fn between_cells_radiance_is_bilinear_and_at_their_middles_exact() {
        let plane = |i: u32, j: u32| Some(0.03125 * i as f32 + 0.015625 * j as f32);
        for (x, y) in [(8.5, 9.5), (8.0, 9.0), (15.75, 16.25), (16.1, 15.9)] {
            let found = look_up(plane, x, y).unwrap();
            let expected = 0.03125 * (x - 0.5) + 0.015625 * (y - 0.5);
            assert!((found - expected).abs() < 1e-3, "({x}, {y}): {found}, not {expected}");
        }
    }

    #[test]
    fn at_a_border_the_cells_that_are_there_count_for_all() {
        // Covered up to column 10; beyond it the nearest cells, then those a ring farther, then none.
        let part = |i: u32, _| (i <= 10).then_some(2.0);
        for x in [10.0, 10.9, 11.4, 12.4] {
            assert_eq!(look_up(part, x, 8.0), Some(2.0), "{x}");
        }
        assert_eq!(look_up(part, 14.0, 8.0), None);
        assert_eq!(look_up(|_, _| None, 8.0, 8.0), None);
    }

    #[test]
    fn directions_behind_a_side_have_no_say() {
        let directions = Directions::with_lines(129).unwrap();
        for k in 0..64 {
            let turn = k as f32 * 0.1;
            let normal = Vec3::new(turn.sin(), 0.3, turn.cos()).normalize();
            // Nearly along the surface.
            let away = (normal.any_orthonormal_vector() + normal * 0.05).normalize();
            let around = Around::new(&directions, N, away, normal);
            let total: f32 = around.near.iter().map(|n| n.weight).sum();
            assert!(total == 0.0 || (total - 1.0).abs() < 1e-5);
            for n in around.near.iter().filter(|n| n.weight > 0.0) {
                assert!(directions.vector(n.direction).dot(normal) * n.sense.sign() > 0.0);
            }
        }
    }

    #[test]
    fn mirrored_twice_is_itself_and_both_angles_are_equal() {
        let normal = Vec3::new(0.2, 0.9, -0.1).normalize();
        let out = Vec3::new(0.5, 0.4, 0.3).normalize();
        let back = mirrored(out, normal);
        assert!((back.dot(normal) - out.dot(normal)).abs() < 1e-6);
        assert!(mirrored(back, normal).distance(out) < 1e-6);
        assert!((out + back).normalize().distance(normal) < 1e-6);
    }
}
