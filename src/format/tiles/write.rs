//! Making a tile map, of what the bake itself has found.

#![allow(
    clippy::arithmetic_side_effects,
    clippy::cast_possible_truncation,
    clippy::indexing_slicing,
    reason = "nothing here comes from a file"
)]

use super::{CONSTANT, DARK, DATA, Parts};
use crate::format::bytes::Writer;
use crate::ids::SurfaceId;
use crate::radiance::Rgb;
use half::f16;
use half::slice::HalfFloatSliceExt;

/// A cell that a surface covers, with the radiance of both senses: what a tile map is made from.
#[derive(Clone, Copy, Debug)]
pub struct CoveredCell {
    /// The surface.
    pub surface: SurfaceId,
    /// Row-by-row index of the cell inside its tile.
    pub cell: u32,
    /// Radiance for [`Along`](crate::ids::Sense::Along) and [`Against`](crate::ids::Sense::Against),
    /// W sr^-1 m^-2.
    pub radiance: [Rgb; 2],
}

/// Stored exponent 2^e for a field whose brightest radiance is about `most`: the brightest value is
/// stored near 2^8, so that f16 keeps its full precision over a range of 2^-22 to 2^8 of it.
pub fn exponent_for(most: f32) -> i32 {
    if most > 0.0 { (most.log2().ceil() as i32 - 8).clamp(-100, 100) } else { 0 }
}

fn words(m: u32) -> usize {
    (m as usize * m as usize).div_ceil(64)
}

/// Builds a tile map tile by tile.
pub struct TileMapWriter {
    n: u32,
    m: u32,
    exponent: i32,
    first: Vec<u32>,
    surface: Vec<u32>,
    value: Vec<u32>,
    state: Vec<u8>,
    mask: Vec<u64>,
    rgb: Vec<f16>,
    channels: Vec<f32>,
}

impl TileMapWriter {
    /// For `resolution` cells along an edge in tiles of `tile`; stored radiance is scaled by
    /// `2^-exponent`.
    pub fn new(resolution: u32, tile: u32, exponent: i32) -> TileMapWriter {
        TileMapWriter {
            n: resolution / tile,
            m: tile,
            exponent,
            first: vec![0],
            surface: Vec::new(),
            value: Vec::new(),
            state: Vec::new(),
            mask: Vec::new(),
            rgb: Vec::new(),
            channels: Vec::new(),
        }
    }

    /// Appends the next tile, row by row. Sorts `cells`; of two cells of one surface at one place
    /// the first counts.
    pub fn tile(&mut self, cells: &mut [CoveredCell]) {
        cells.sort_by_key(|c| (c.surface, c.cell));
        for run in cells.chunk_by(|a, b| a.surface == b.surface) {
            self.surface.push(run[0].surface.0);
            let mask_at = self.mask.len();
            self.mask.resize(mask_at + words(self.m), 0);
            for cell in run {
                self.mask[mask_at + cell.cell as usize / 64] |= 1 << (cell.cell % 64);
            }
            for slot in 0..2 {
                self.values(run, slot);
            }
        }
        self.first.push(self.surface.len() as u32);
    }

    fn values(&mut self, run: &[CoveredCell], slot: usize) {
        self.value.push((self.rgb.len() / 3) as u32);
        let first = run[0].radiance[slot];
        if run.iter().all(|c| c.radiance[slot] == first) {
            self.state.push(if first.is_black() { DARK } else { CONSTANT });
            if !first.is_black() {
                self.push(&run[..1], slot);
            }
        } else {
            self.state.push(DATA);
            self.push(run, slot);
        }
    }

    fn push(&mut self, run: &[CoveredCell], slot: usize) {
        let scale = (-f64::from(self.exponent)).exp2() as f32;
        self.channels.clear();
        let mut last = None;
        for cell in run.iter().filter(|c| last.replace(c.cell) != Some(c.cell)) {
            // Above the largest f16 would become infinite.
            self.channels.extend(cell.radiance[slot].0.map(|c| (c * scale).clamp(0.0, 65504.0)));
        }
        let at = self.rgb.len();
        self.rgb.resize(at + self.channels.len(), f16::ZERO);
        self.rgb[at..].convert_from_f32_slice(&self.channels);
    }

    /// Entries so far, one a surface and tile.
    pub fn entry_count(&self) -> usize {
        self.surface.len()
    }

    /// The bytes of the map.
    ///
    /// # Panics
    /// When not every tile was given.
    pub fn finish(self) -> Vec<u8> {
        assert_eq!(self.first.len(), (self.n * self.n) as usize + 1, "tiles are missing");
        let [entries, values] = [self.surface.len(), self.rgb.len() / 3].map(|v| v as u64);
        let parts = Parts::new(self.n.into(), self.m.into(), entries, values);
        let mut w = Writer(Vec::with_capacity(parts.map_or(0, |p| p.end as usize)));
        w.u32(self.n);
        w.u32(self.m);
        w.u32(self.surface.len() as u32);
        w.u32((self.rgb.len() / 3) as u32);
        self.first.iter().for_each(|v| w.u32(*v));
        w.pad(8);
        self.surface.iter().for_each(|v| w.u32(*v));
        w.pad(8);
        self.value.iter().for_each(|v| w.u32(*v));
        w.pad(8);
        w.0.extend_from_slice(&self.state);
        w.pad(8);
        self.mask.iter().for_each(|v| w.u64(*v));
        self.rgb.iter().for_each(|v| w.u16(v.to_bits()));
        w.pad(8);
        w.0
    }
}
