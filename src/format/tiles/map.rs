//! Lookups in a checked tile map: the innermost loops of looking and of gathering.

#![allow(
    clippy::arithmetic_side_effects,
    clippy::cast_possible_truncation,
    clippy::indexing_slicing,
    reason = "the layout was checked with the bytes; Rust's own bounds are behind that"
)]

use super::{CONSTANT, DATA, FIRST_AT, Layout, TEXTURED};
use crate::format::bytes::{u16_at, u32_at, u64_at};
use crate::ids::{Cell, Sense, SurfaceId};
use crate::radiance::Rgb;

/// 2^112: what the exponents of f16 and f32 differ by.
const REBIAS: f32 = f32::from_bits((127 + 112) << 23);

/// The number that the bits of an f16 stand for that is finite and not negative: they shift into place,
/// subnormals as well. That leaves the exponent 112 too small.
#[inline]
pub fn half_to_f32(bits: u16) -> f32 {
    f32::from_bits(u32::from(bits) << 13) * REBIAS
}

/// A checked tile map over its bytes.
#[derive(Clone, Copy, Debug)]
pub struct TileMap<'a> {
    pub(super) bytes: &'a [u8],
    pub(super) layout: &'a Layout,
}

/// One surface in one tile.
#[derive(Clone, Copy, Debug)]
pub struct TileEntry<'a> {
    map: TileMap<'a>,
    entry: usize,
}

impl<'a> TileMap<'a> {
    /// The map over bytes that `layout` was checked with.
    pub fn new(bytes: &'a [u8], layout: &'a Layout) -> TileMap<'a> {
        TileMap { bytes, layout }
    }

    pub(super) fn surface(&self, entry: usize) -> u32 {
        u32_at(&self.bytes[self.layout.surface_at..], entry)
    }

    pub(super) fn value(&self, slot: usize) -> u32 {
        u32_at(&self.bytes[self.layout.value_at..], slot)
    }

    pub(super) fn state(&self, slot: usize) -> u8 {
        self.bytes[self.layout.state_at + slot]
    }

    pub(super) fn mask(&self, entry: usize) -> &'a [u8] {
        let at = self.layout.mask_at + 8 * self.layout.words * entry;
        &self.bytes[at..at + 8 * self.layout.words]
    }

    fn rgb(&self, value: usize) -> Rgb {
        rgb_of(&self.bytes[self.layout.rgb_at..], value, self.layout.scale)
    }

    /// Number of entries over all tiles.
    pub fn entry_count(&self) -> usize {
        self.layout.entries
    }

    /// Number of stored values.
    pub fn value_count(&self) -> usize {
        self.layout.values
    }

    /// Cells along an edge of the PSF.
    pub fn resolution(&self) -> u32 {
        self.layout.n * self.layout.m
    }

    /// Cells along an edge of a tile, m.
    pub fn tile_edge(&self) -> u32 {
        self.layout.m
    }

    /// A surface in the tile that holds a cell; binary search over the tile's surfaces (section 6).
    #[inline]
    pub fn entry(&self, cell: Cell, surface: SurfaceId) -> Option<TileEntry<'a>> {
        let Layout { n, m, .. } = *self.layout;
        let tile = (cell.j / m * n + cell.i / m) as usize;
        let first = &self.bytes[FIRST_AT..];
        let (mut low, mut high) = (u32_at(first, tile) as usize, u32_at(first, tile + 1) as usize);
        let surfaces = &self.bytes[self.layout.surface_at..];
        while low < high {
            let middle = (low + high) / 2;
            match u32_at(surfaces, middle).cmp(&surface.0) {
                std::cmp::Ordering::Less => low = middle + 1,
                std::cmp::Ordering::Greater => high = middle,
                std::cmp::Ordering::Equal => return Some(TileEntry { map: *self, entry: middle }),
            }
        }
        None
    }

    /// Calls `visit` with every covered cell's surface, place and the radiance of both senses.
    pub fn for_each(&self, mut visit: impl FnMut(SurfaceId, Cell, [Rgb; 2])) {
        let Layout { n, m, .. } = *self.layout;
        let first = &self.bytes[FIRST_AT..];
        for tile in 0..n * n {
            let (from, to) = (u32_at(first, tile as usize), u32_at(first, tile as usize + 1));
            for entry in from as usize..to as usize {
                let at = TileEntry { map: *self, entry };
                at.covered(|inside| {
                    let cell = Cell { i: tile % n * m + inside % m, j: tile / n * m + inside / m };
                    let value = |s| at.radiance(cell, s).unwrap_or(Rgb::BLACK);
                    let both = [value(Sense::Along), value(Sense::Against)];
                    visit(SurfaceId(self.surface(entry)), cell, both);
                });
            }
        }
    }
}

impl TileEntry<'_> {
    /// Calls `visit` with the row-by-row index of every covered cell inside the tile, in order.
    fn covered(&self, mut visit: impl FnMut(u32)) {
        let mask = self.map.mask(self.entry);
        for word in 0..self.map.layout.words {
            let mut bits = u64_at(mask, word);
            while bits != 0 {
                visit(word as u32 * 64 + bits.trailing_zeros());
                bits &= bits - 1;
            }
        }
    }

    /// Calls `visit` with the row-by-row index of every covered cell inside the tile, in order, and its
    /// radiance.
    pub fn for_each(&self, sense: Sense, mut visit: impl FnMut(u32, Rgb)) {
        let slot = 2 * self.entry + sense.slot();
        let value = self.map.value(slot) as usize;
        match self.map.state(slot) {
            DATA => {
                let mut rank = value;
                self.covered(|inside| {
                    visit(inside, self.map.rgb(rank));
                    rank += 1;
                });
            }
            CONSTANT => self.covered(|inside| visit(inside, self.map.rgb(value))),
            _ => self.covered(|inside| visit(inside, Rgb::BLACK)),
        }
    }

    /// Radiance at a cell of this tile, or `None` where the surface does not cover it.
    pub fn radiance(&self, cell: Cell, sense: Sense) -> Option<Rgb> {
        let m = self.map.layout.m;
        self.seen(sense).radiance(cell.j % m * m + cell.i % m)
    }
}

impl<'a> TileEntry<'a> {
    /// What it shows in one sense, its tables looked up.
    #[inline]
    pub fn seen(&self, sense: Sense) -> Seen<'a> {
        let slot = 2 * self.entry + sense.slot();
        let Layout { rgb_at, scale, .. } = *self.map.layout;
        let state = self.map.state(slot);
        let values = &self.map.bytes[rgb_at + 6 * self.map.value(slot) as usize..];
        Seen { mask: self.map.mask(self.entry), state, values, scale, counted: (0, 0) }
    }
}

/// What one surface in one tile shows in one sense.
#[derive(Clone, Copy, Debug)]
pub struct Seen<'a> {
    mask: &'a [u8],
    state: u8,
    /// From its first value on.
    values: &'a [u8],
    scale: f32,
    /// A word of the mask and how many cells are covered before it: neighbours need the same.
    counted: (usize, u32),
}

impl Seen<'_> {
    /// Whether its covered cells have what the texture map says; here they are black.
    #[inline]
    pub fn is_textured(&self) -> bool {
        self.state == TEXTURED
    }

    /// How many cells are covered before a word of the mask.
    #[inline]
    fn before(&mut self, word: usize) -> u32 {
        if self.counted.0 != word {
            let (from, count) = if self.counted.0 < word { self.counted } else { (0, 0) };
            let more: u32 = (from..word).map(|w| u64_at(self.mask, w).count_ones()).sum();
            self.counted = (word, count + more);
        }
        self.counted.1
    }

    /// Radiance at the cell of a row-by-row index inside the tile, or `None` where the surface does not
    /// cover it.
    #[inline]
    pub fn radiance(&mut self, inside: u32) -> Option<Rgb> {
        let index = inside as usize;
        let word = u64_at(self.mask, index / 64);
        if word >> (index % 64) & 1 == 0 {
            return None;
        }
        match self.state {
            DATA => {
                let below = word & ((1u64 << (index % 64)) - 1);
                let rank = self.before(index / 64) + below.count_ones();
                Some(rgb_of(self.values, rank as usize, self.scale))
            }
            CONSTANT => Some(rgb_of(self.values, 0, self.scale)),
            _ => Some(Rgb::BLACK),
        }
    }
}

/// The value of a number in a table of values.
#[inline]
fn rgb_of(values: &[u8], number: usize, scale: f32) -> Rgb {
    let h = &values[6 * number..6 * number + 6];
    // Both products are exact; in one, 2^112 and the scale could overflow.
    let channel = |c| half_to_f32(u16_at(h, c)) * scale;
    Rgb([channel(0), channel(1), channel(2)])
}
