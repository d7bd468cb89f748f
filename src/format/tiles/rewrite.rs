//! A tile map again, with other values, or without some of its surfaces.

#![allow(
    clippy::arithmetic_side_effects,
    clippy::cast_possible_truncation,
    clippy::indexing_slicing,
    reason = "the layout was checked with the bytes"
)]

use super::{CONSTANT, DATA, FIRST_AT, Layout, TileMap};
use crate::format::bytes::{Writer, u16_at, u32_at, u64_at};
use crate::ids::{Cell, Sense, SurfaceId};

/// What one surface in one tile shows in one sense.
#[derive(Clone, Copy, Debug)]
pub struct Slot<'a> {
    /// The surface.
    pub surface: SurfaceId,
    /// Which way.
    pub sense: Sense,
    /// The tile's first cell.
    pub origin: Cell,
    /// How the values are stored.
    pub state: u8,
    /// Bits of its stored values, three little-endian f16 each: one for each covered cell, one for all,
    /// or none.
    pub rgb: &'a [u8],
    m: u32,
    mask: &'a [u8],
}

impl Slot<'_> {
    /// Calls `visit` with every covered cell, in order.
    #[inline]
    pub fn covered(&self, mut visit: impl FnMut(Cell)) {
        let Cell { i, mut j } = self.origin;
        // First cell of the row: what is next to it is found without a division.
        let mut row = 0;
        for word in 0..self.mask.len() / 8 {
            let mut bits = u64_at(self.mask, word);
            while bits != 0 {
                let inside = word as u32 * 64 + bits.trailing_zeros();
                while inside - row >= self.m {
                    (row, j) = (row + self.m, j + 1);
                }
                visit(Cell { i: i + inside - row, j });
                bits &= bits - 1;
            }
        }
    }

    /// How many cells are covered.
    pub fn covered_count(&self) -> u32 {
        (0..self.mask.len() / 8).map(|word| u64_at(self.mask, word).count_ones()).sum()
    }

    /// Whether another slot is of the same surface, cells and sense.
    pub fn is_same_place(&self, other: &Slot) -> bool {
        (self.surface, self.sense, self.origin, self.mask)
            == (other.surface, other.sense, other.origin, other.mask)
    }

    /// Bits of the value of each covered cell, in order, of slots that are not textured.
    #[inline]
    pub fn values(&self) -> impl Iterator<Item = [u16; 3]> {
        const BLACK: [u8; 6] = [0; 6];
        let (values, step) = match self.state {
            DATA => (self.rgb.as_chunks().0, 1),
            CONSTANT => (self.rgb.as_chunks().0, 0),
            _ => (std::slice::from_ref(&BLACK), 0),
        };
        let cells = self.covered_count() as usize;
        (0..cells).map(move |rank| [0, 1, 2].map(|c| u16_at(&values[step * rank], c)))
    }

    /// Whether another slot of the same cells has the same values, stored alike.
    pub fn is_stored_alike(&self, other: &Slot) -> bool {
        (self.state, self.rgb) == (other.state, other.rgb)
    }

    /// By how much the bits of its values differ at most from others, three for each covered cell; `None`
    /// when it does not store as many.
    pub fn differs_by(&self, bits: &[u16]) -> Option<u16> {
        let own = self.rgb.as_chunks().0;
        let differences = own.iter().zip(bits).map(|(a, b)| u16::from_le_bytes(*a).abs_diff(*b));
        (own.len() == bits.len()).then(|| differences.fold(0, u16::max))
    }

    /// Appends the bits of its values as they are.
    pub fn copy(&self, rgb: &mut Vec<u16>) {
        rgb.extend((0..self.rgb.len() / 2).map(|c| u16_at(self.rgb, c)));
    }
}

impl<'a> TileMap<'a> {
    /// All slots, in order, two an entry.
    pub fn slots(&self) -> impl Iterator<Item = Slot<'a>> {
        let map = *self;
        let tiles = 0..map.layout.n * map.layout.n;
        tiles.flat_map(move |tile| map.entries_of(tile).flat_map(move |e| map.slots_of(tile, e)))
    }

    fn entries_of(&self, tile: u32) -> std::ops::Range<usize> {
        let first = &self.bytes[FIRST_AT..];
        let tile = tile as usize;
        u32_at(first, tile) as usize..u32_at(first, tile + 1) as usize
    }

    fn slots_of(&self, tile: u32, entry: usize) -> [Slot<'a>; 2] {
        let Layout { n, m, rgb_at, entries, values, .. } = *self.layout;
        let origin = Cell { i: tile % n * m, j: tile / n * m };
        let (surface, mask) = (SurfaceId(self.surface(entry)), self.mask(entry));
        [Sense::Along, Sense::Against].map(|sense| {
            let number = 2 * entry + sense.slot();
            // Each slot's values end where the next one's begin.
            let next = number + 1;
            let end = if next < 2 * entries { self.value(next) as usize } else { values };
            let rgb = rgb_at + 6 * self.value(number) as usize..rgb_at + 6 * end;
            let state = self.state(number);
            Slot { surface, sense, origin, state, m, mask, rgb: &self.bytes[rgb] }
        })
    }
}

/// The bytes of a map with the same tiles and cells, of the surfaces that are to be kept. `slot` is
/// given each of their slots in order, appends what bits of values it shall have and returns its state.
pub fn rewritten(
    map: &TileMap,
    keep: impl Fn(SurfaceId) -> bool,
    mut slot: impl FnMut(&Slot, &mut Vec<u16>) -> u8,
) -> Vec<u8> {
    let Layout { n, m, values, .. } = *map.layout;
    let mut first = vec![0u32];
    let (mut surfaces, mut starts, mut states) = (Vec::new(), Vec::new(), Vec::new());
    let (mut masks, mut rgb) = (Vec::new(), Vec::with_capacity(3 * values));
    for tile in 0..n * n {
        for entry in map.entries_of(tile) {
            let slots = map.slots_of(tile, entry);
            if !keep(slots[0].surface) {
                continue;
            }
            surfaces.push(slots[0].surface.0);
            masks.extend_from_slice(slots[0].mask);
            for old in slots {
                starts.push((rgb.len() / 3) as u32);
                states.push(slot(&old, &mut rgb));
            }
        }
        first.push(surfaces.len() as u32);
    }
    let mut w = Writer(Vec::with_capacity(map.bytes.len()));
    [n, m, surfaces.len() as u32, (rgb.len() / 3) as u32].into_iter().for_each(|v| w.u32(v));
    for table in [&first, &surfaces, &starts] {
        table.iter().for_each(|v| w.u32(*v));
        w.pad(8);
    }
    w.0.extend_from_slice(&states);
    w.pad(8);
    w.0.extend_from_slice(&masks);
    rgb.iter().for_each(|v| w.u16(*v));
    w.pad(8);
    w.0
}
