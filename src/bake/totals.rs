//! The last sweep: total radiance maps L_T of every surface, written once.
//!
//! Transport is linear, so a diffuse surface's total map is a resampling of its Total Texture Map. A
//! mirror's total map holds what arrives at it, stored where it arrives; a lookup mirrors the
//! direction first. What arrives is found along the true path `S* D` (backward ray-traced resampling,
//! section 5), or is what was stored while light was propagated. (The paper stores what a mirror sends; then a lookup between directions would
//! blur a second time what the gather has blurred once.)

use super::exchange;
use super::layers::{Fragment, Layers};
use super::marks::Marks;
use super::profile::{Stage, Watch};
use super::step::Shared;
use crate::field::pages::Page;
use crate::format::manifest::Parameters;
use crate::format::tiles::{CoveredCell, TileMapWriter};
use crate::ids::{Cell, DirectionId, Sense, Side, SurfaceId};
use crate::level::level;
use crate::paths::Paths;
use crate::psf::Psf;
use crate::radiance::Rgb;
use crate::scene::texels::{self, Places};
use crate::visible::Hit;
use fearless_simd::{Simd, dispatch, f32x16, prelude::*};

/// A worker's own memory, reused from direction to direction.
#[derive(Default)]
pub struct Scratch {
    layers: Layers,
    found: Vec<Found>,
    /// Their surfaces and places in that list.
    order: Vec<u64>,
    tile: Vec<CoveredCell>,
    /// Fragments so far.
    pub fragments: u64,
    /// Entries of the maps so far.
    pub entries: u64,
    /// Where the worker's time goes.
    pub watch: Watch,
}

/// Where the total maps of mirrors come from.
#[derive(Clone, Copy)]
pub enum Mirrors<'a> {
    /// There are none.
    None,
    /// From the direction's map of what arrived at mirrors.
    Stored(&'a Page),
    /// From the ends of paths.
    Traced(Paths<'a>),
}

/// The bytes of a direction's total radiance map. `total` is P^T, two values a texel; `lit` says for
/// each surface and side whether any of it is not black. Nothing comes to `sealed` sides of mirrors.
pub fn total_map(
    shared: &Shared,
    id: DirectionId,
    (total, lit): (&[Rgb], &[[bool; 2]]),
    (mirrors, marks): (Mirrors, &Marks),
    scratch: &mut Scratch,
) -> Vec<u8> {
    let Parameters { resolution, tile: m, .. } = *shared.parameters;
    let psf = Psf::new(shared.directions.vector(id), resolution);
    scratch.watch.start();
    scratch.layers.rasterise(shared.outlines, &psf);
    scratch.watch.lap(Stage::Rasterise);
    scratch.fragments += scratch.layers.len() as u64;
    scratch.watch.profile.fragments += scratch.layers.len() as u64;
    let mut writer = TileMapWriter::new(resolution, m, shared.exponent);
    let n = resolution / m;
    let map = Map { shared, psf: &psf, total, lit, mirrors, marks };
    for tile in 0..n * n {
        scratch.tile.clear();
        for inside in 0..m * m {
            let cell = Cell { i: tile % n * m + inside % m, j: tile / n * m + inside / m };
            map.find(cell, inside, scratch);
        }
        dispatch!(level(), simd => map.sample(simd, (tile % n * m, tile / n * m), scratch));
        writer.tile(&mut scratch.tile);
    }
    scratch.entries += writer.entry_count() as u64;
    let bytes = writer.finish();
    scratch.watch.profile.map_bytes += bytes.len() as u64;
    scratch.watch.lap(Stage::TotalMaps);
    bytes
}

/// A total map that is being made.
struct Map<'a> {
    shared: &'a Shared<'a>,
    psf: &'a Psf,
    total: &'a [Rgb],
    lit: &'a [[bool; 2]],
    mirrors: Mirrors<'a>,
    marks: &'a Marks,
}

/// A diffuse fragment of a tile, until all that lie on its surface are looked up together.
#[derive(Clone, Copy)]
struct Found {
    fragment: Fragment,
    /// The cell's place in the tile.
    inside: u32,
}

impl Map<'_> {
    /// Finds what lies on the ray of a cell, and what arrives at the mirrors there.
    fn find(&self, cell: Cell, inside: u32, scratch: &mut Scratch) {
        let Shared { outlines, texels, .. } = *self.shared;
        let Scratch { layers, found, order, tile, .. } = scratch;
        let fragments = layers.cell(cell.i, cell.j);
        exchange::order_contacts(fragments, &outlines.contacts, &texels.surface_of);
        for (k, fragment) in fragments.iter().enumerate() {
            let surface = texels.surface_of[fragment.texel() as usize];
            if fragment.texel() >= texels.diffuse {
                let radiance = [Sense::Along, Sense::Against]
                    .map(|sense| self.arrived(cell, (fragments, k), sense));
                tile.push(CoveredCell { surface: SurfaceId(surface), cell: inside, radiance });
            } else if !is_hidden(fragments, k, self.psf.cell_edge(), self.lit[surface as usize]) {
                order.push(u64::from(surface) << 32 | found.len() as u64);
                found.push(Found { fragment: *fragment, inside });
            }
        }
    }

    /// Looks up what the fragments found in a tile send, sixteen of a surface at a time. `corner` is the
    /// column and row of the tile's first cell.
    #[inline(always)]
    fn sample<S: Simd>(&self, simd: S, corner: (u32, u32), scratch: &mut Scratch) {
        let Shared { scene, texels, parameters, .. } = *self.shared;
        let Scratch { found, order, tile, .. } = scratch;
        order.sort_unstable();
        for run in order.chunk_by(|a, b| a >> 32 == b >> 32) {
            let id = SurfaceId((run[0] >> 32) as u32);
            for some in run.chunks(16) {
                let some = || some.iter().map(|key| &found[*key as u32 as usize]).enumerate();
                let mut points = [[0.0; 16]; 3];
                for (lane, one) in some() {
                    let (column, row) =
                        (one.inside % parameters.tile, one.inside / parameters.tile);
                    let (x, y) = ((corner.0 + column) as f32 + 0.5, (corner.1 + row) as f32 + 0.5);
                    let point = self.psf.unproject(x, y, one.fragment.depth());
                    for (axis, places) in points.iter_mut().enumerate() {
                        places[lane] = point[axis];
                    }
                }
                let [x, y, z] = points;
                let points = [
                    f32x16::simd_from(simd, x),
                    f32x16::simd_from(simd, y),
                    f32x16::simd_from(simd, z),
                ];
                let places = Places::new(simd, texels, (id, scene.surface(id)), points);
                for (lane, one) in some() {
                    let mut radiance = [Rgb::BLACK; 2];
                    for sense in [Sense::Along, Sense::Against] {
                        let side = side_of(one.fragment, sense);
                        if self.lit[id.index()][side.index()] {
                            radiance[sense.slot()] = places.sample(texels, self.total, side, lane);
                        }
                    }
                    tile.push(CoveredCell { surface: id, cell: one.inside, radiance });
                }
            }
        }
        found.clear();
        order.clear();
    }

    /// What arrives at a mirror, the k-th fragment of a cell, along or against the direction.
    fn arrived(&self, cell: Cell, (fragments, k): (&[Fragment], usize), sense: Sense) -> Rgb {
        let fragment = fragments[k];
        let surface_of = |f: Fragment| SurfaceId(self.shared.texels.surface_of[f.texel() as usize]);
        match self.mirrors {
            Mirrors::None => Rgb::BLACK,
            Mirrors::Stored(page) => {
                let entry = page.map().entry(cell, surface_of(fragment));
                entry.and_then(|e| e.radiance(cell, sense)).unwrap_or_default()
            }
            Mirrors::Traced(_) if self.marks.is_sealed(fragment.value(sense)) => Rgb::BLACK,
            Mirrors::Traced(paths) => {
                let Some((next, distance)) = exchange::seen_from(fragments, k, sense) else {
                    return Rgb::BLACK;
                };
                let (x, y) = (cell.i as f32 + 0.5, cell.j as f32 + 0.5);
                let point = self.psf.unproject(x, y, next.depth());
                let side = side_of(next, sense.flip());
                let seen = Hit { surface: surface_of(next), point, distance, side };
                let away = self.psf.direction * sense.sign();
                paths.radiance(away, &seen, true, |end| self.sent(end))
            }
        }
    }

    /// What a diffuse surface sends from a point.
    fn sent(&self, at: &Hit) -> Rgb {
        if !self.lit[at.surface.index()][at.side.index()] {
            return Rgb::BLACK;
        }
        let surface = self.shared.scene.surface(at.surface);
        texels::sample(self.shared.texels, self.total, at.surface, surface, at.side, at.point)
    }
}

/// The side of a fragment's surface that faces along the direction, or against it.
fn side_of(fragment: Fragment, facing: Sense) -> Side {
    match fragment.faces_along() == (facing == Sense::Along) {
        true => Side::Front,
        false => Side::Back,
    }
}

/// Whether another surface is nearer than `edge` to the k-th on a ray, before each `lit` side of it. No
/// eye is between them, and what is dark there, the wall behind a picture's frame, would darken lookups
/// beside it. Whose eye is there all the same finds the texture map's value.
fn is_hidden(fragments: &[Fragment], k: usize, edge: f32, lit: [bool; 2]) -> bool {
    let own = fragments[k];
    let is_near = |other: Option<&Fragment>| {
        other.is_some_and(|other| (other.depth() - own.depth()).abs() < edge)
    };
    let before = [Sense::Along, Sense::Against].map(|sense| match sense {
        Sense::Along => (own.value_along() % 2, is_near(fragments.get(k + 1))),
        Sense::Against => (own.value_against() % 2, is_near(fragments[..k].last())),
    });
    lit.contains(&true) && before.into_iter().all(|(side, is_near)| is_near || !lit[side])
}

/// For each surface and side, whether any texture value is not black.
pub fn lit_sides(texels: &texels::Texels, total: &[Rgb]) -> Vec<[bool; 2]> {
    let mut lit = vec![[false; 2]; texels.lattices.len()];
    for (texel, surface) in texels.surface_of.iter().enumerate() {
        for side in 0..2 {
            lit[*surface as usize][side] |= !total[2 * texel + side].is_black();
        }
    }
    lit
}
