//! The last sweep: total radiance maps L_T of every surface, written once.
//!
//! Transport is linear, so a diffuse surface's total map is a resampling of its Total Texture Map. A
//! mirror's total map holds what arrives at it, stored where it arrives; a lookup mirrors the
//! direction first. What arrives is found along the true path `S* D` (backward ray-traced resampling,
//! section 5), or is what was stored while light was propagated. (The paper stores what a mirror sends; then a lookup between directions would
//! blur a second time what the gather has blurred once.)

use super::exchange;
use super::layers::{Fragment, Layers};
use super::profile::{Stage, Watch};
use super::marks::Marks;
use super::step::Shared;
use crate::field::pages::Page;
use crate::format::manifest::Parameters;
use crate::format::tiles::{CoveredCell, TileMapWriter};
use crate::ids::{Cell, DirectionId, Sense, Side, SurfaceId};
use crate::paths::Paths;
use crate::psf::Psf;
use crate::radiance::Rgb;
use crate::scene::texels;
use crate::visible::Hit;

/// A worker's own memory, reused from direction to direction.
#[derive(Default)]
pub struct Scratch {
    layers: Layers,
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
    let (contacts, surface_of) = (&shared.outlines.contacts, &shared.texels.surface_of);
    for tile in 0..n * n {
        scratch.tile.clear();
        for inside in 0..m * m {
            let cell = Cell { i: tile % n * m + inside % m, j: tile / n * m + inside / m };
            let (x, y) = (cell.i as f32 + 0.5, cell.j as f32 + 0.5);
            let fragments = scratch.layers.cell(cell.i, cell.j);
            exchange::order_contacts(fragments, contacts, surface_of);
            let hit = |fragment: Fragment, facing: Sense| {
                let surface = SurfaceId(shared.texels.surface_of[fragment.texel() as usize]);
                let front = fragment.faces_along() == (facing == Sense::Along);
                let side = if front { Side::Front } else { Side::Back };
                Hit { surface, point: psf.unproject(x, y, fragment.depth()), distance: 0.0, side }
            };
            let diffuse = |at: &Hit| {
                if !lit[at.surface.index()][at.side.index()] {
                    return Rgb::BLACK;
                }
                let surface = shared.scene.surface(at.surface);
                texels::sample(shared.texels, total, at.surface, surface, at.side, at.point)
            };
            for (k, fragment) in fragments.iter().enumerate() {
                let id = SurfaceId(shared.texels.surface_of[fragment.texel() as usize]);
                let is_mirror = fragment.texel() >= shared.texels.diffuse;
                if !is_mirror && is_hidden(fragments, k, psf.cell_edge(), lit[id.index()]) {
                    continue;
                }
                let radiance = [Sense::Along, Sense::Against].map(|sense| match mirrors {
                    _ if !is_mirror => diffuse(&hit(*fragment, sense)),
                    Mirrors::None => Rgb::BLACK,
                    Mirrors::Stored(page) => {
                        let entry = page.map().entry(cell, id);
                        entry.and_then(|e| e.radiance(cell, sense)).unwrap_or_default()
                    }
                    Mirrors::Traced(_) if marks.is_sealed(fragment.value(sense)) => Rgb::BLACK,
                    Mirrors::Traced(paths) => {
                        let seen = exchange::seen_from(fragments, k, sense);
                        seen.map_or(Rgb::BLACK, |(next, distance)| {
                            let at = Hit { distance, ..hit(next, sense.flip()) };
                            paths.radiance(psf.direction * sense.sign(), &at, true, diffuse)
                        })
                    }
                });
                scratch.tile.push(CoveredCell { surface: id, cell: inside, radiance });
            }
        }
        writer.tile(&mut scratch.tile);
    }
    scratch.entries += writer.entry_count() as u64;
    let bytes = writer.finish();
    scratch.watch.profile.map_bytes += bytes.len() as u64;
    scratch.watch.lap(Stage::TotalMaps);
    bytes
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
