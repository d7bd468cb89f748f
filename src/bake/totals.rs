//! The last sweep: total radiance maps L_T of every surface, written once.
//!
//! Transport is linear, so a diffuse surface's total map is a resampling of its Total Texture Map. A
//! mirror's total map holds what arrived at it, stored where it arrived; a lookup mirrors the
//! direction first. (The paper stores what a mirror sends; then a lookup between directions would
//! blur a second time what the gather has blurred once.)

use super::layers::Layers;
use super::step::Shared;
use crate::field::FieldError;
use crate::field::pages::Page;
use crate::format::manifest::Parameters;
use crate::format::tiles::{CoveredCell, TileMapWriter};
use crate::ids::{Cell, DirectionId, Sense, Side, SurfaceId};
use crate::psf::Psf;
use crate::radiance::Rgb;
use crate::scene::texels;

/// A worker's own memory, reused from direction to direction.
#[derive(Default)]
pub struct Scratch {
    layers: Layers,
    tile: Vec<CoveredCell>,
    /// Fragments so far.
    pub fragments: u64,
    /// Entries of the maps so far.
    pub entries: u64,
}

/// The bytes of a direction's total radiance map. `total` is P^T, two values a texel; `lit` says for
/// each surface and side whether any of it is not black; `arrived` is the direction's map of what
/// arrived at mirrors.
///
/// # Errors
/// None so far; steps of the other kind can fail.
pub fn total_map(
    shared: &Shared,
    id: DirectionId,
    (total, lit): (&[Rgb], &[[bool; 2]]),
    arrived: Option<&Page>,
    scratch: &mut Scratch,
) -> Result<Vec<u8>, FieldError> {
    let Parameters { resolution, tile: m, .. } = *shared.parameters;
    let psf = Psf::new(shared.directions.vector(id), resolution);
    scratch.layers.rasterise(shared.outlines, &psf);
    scratch.fragments += scratch.layers.len() as u64;
    let mut writer = TileMapWriter::new(resolution, m, shared.exponent);
    let n = resolution / m;
    for tile in 0..n * n {
        scratch.tile.clear();
        for inside in 0..m * m {
            let cell = Cell { i: tile % n * m + inside % m, j: tile / n * m + inside / m };
            for fragment in scratch.layers.cell(cell.i, cell.j) {
                let id = SurfaceId(shared.texels.surface_of[fragment.texel() as usize]);
                let mut radiance = [Rgb::BLACK; 2];
                if fragment.texel() >= shared.texels.diffuse {
                    if let Some(entry) = arrived.and_then(|p| p.map().entry(cell, id)) {
                        radiance = [Sense::Along, Sense::Against]
                            .map(|sense| entry.radiance(cell, sense).unwrap_or_default());
                    }
                } else {
                    let surface = shared.scene.surface(id);
                    let (x, y) = (cell.i as f32 + 0.5, cell.j as f32 + 0.5);
                    let point = psf.unproject(x, y, fragment.depth());
                    radiance = [Sense::Along, Sense::Against].map(|sense| {
                        let front = fragment.faces_along() == (sense == Sense::Along);
                        let side = if front { Side::Front } else { Side::Back };
                        if !lit[id.index()][side.index()] {
                            return Rgb::BLACK;
                        }
                        texels::sample(shared.texels, total, id, surface, side, point)
                    });
                }
                scratch.tile.push(CoveredCell { surface: id, cell: inside, radiance });
            }
        }
        writer.tile(&mut scratch.tile);
    }
    scratch.entries += writer.entry_count() as u64;
    Ok(writer.finish())
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
