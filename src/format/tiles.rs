//! Tile maps: for one direction, which surfaces each tile holds, which cells they cover, and a
//! radiance for each covered cell and sense.
//!
//! ```text
//! 0     u32 n          tiles along an edge
//! 4     u32 m          cells along an edge of a tile
//! 8     u32 E          entries, one a tile and surface
//! 12    u32 V          values
//! 16    u32 first[n*n+1]   first entry of each tile, row by row; the last is E      pad to 8
//!       u32 surface[E]     rising within a tile                                     pad to 8
//!       u32 value[2 E]     first value of each sense, along before against          pad to 8
//!       u8  state[2 E]     0 dark, 1 constant, 2 one value a covered cell           pad to 8
//!       u64 mask[E * ceil(m*m / 64)]   covered cells, row by row, low bit first
//!       f16 rgb[3 V]       radiance / 2^exponent                                    pad to 8
//! ```
//!
//! A covered cell's value stands at `value + rank`, where rank counts the covered cells before it.
//! All numbers that repeat one another are compared when a map is opened, so that a lookup needs no
//! check beyond Rust's own.

use super::Fault;
use super::bytes::{Reader, Writer, u16_at, u32_at, u64_at};
use super::limits::MOST_CELLS;
use crate::ids::{Cell, Sense, SurfaceId};
use crate::radiance::Rgb;
use half::f16;
use half::slice::HalfFloatSliceExt;

/// 2^112: what the exponents of f16 and f32 differ by.
const REBIAS: f32 = f32::from_bits((127 + 112) << 23);

/// Where the table of tiles begins.
const FIRST_AT: usize = 16;

const DARK: u8 = 0;
const CONSTANT: u8 = 1;
const DATA: u8 = 2;

/// Where the parts of a tile map stand in its bytes; made by [`Layout::check`] only.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layout {
    n: u32,
    m: u32,
    words: usize,
    entries: usize,
    values: usize,
    surface_at: usize,
    value_at: usize,
    state_at: usize,
    mask_at: usize,
    rgb_at: usize,
    scale: f32,
}

/// A checked tile map over its bytes.
#[derive(Clone, Copy, Debug)]
pub struct TileMap<'a> {
    bytes: &'a [u8],
    layout: &'a Layout,
}

/// One surface in one tile.
#[derive(Clone, Copy, Debug)]
pub struct TileEntry<'a> {
    map: TileMap<'a>,
    entry: usize,
}

/// A cell that a surface covers, with the radiance of both senses: what a tile map is made from.
#[derive(Clone, Copy, Debug)]
pub struct CoveredCell {
    /// The surface.
    pub surface: SurfaceId,
    /// Row-by-row index of the cell inside its tile.
    pub cell: u32,
    /// Radiance for [`Sense::Along`] and [`Sense::Against`], W sr^-1 m^-2.
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

/// The most bytes that a tile map of a sound first block can have: every surface covers every cell.
pub(super) fn most_bytes(resolution: u32, tile: u32, surfaces: u32) -> u64 {
    let [n, m, surfaces] = [resolution / tile, tile, surfaces].map(u64::from);
    let entries = (n * n).saturating_mul(surfaces);
    let values = (2 * m * m).saturating_mul(entries);
    Parts::new(n, m, entries, values).map_or(u64::MAX, |parts| parts.end)
}

/// Where the parts of a tile map begin, and where the last one ends.
struct Parts {
    surface_at: u64,
    value_at: u64,
    state_at: u64,
    mask_at: u64,
    rgb_at: u64,
    end: u64,
}

impl Parts {
    /// Of n x n tiles of m x m cells; `None` beyond 2^64 bytes.
    fn new(n: u64, m: u64, entries: u64, values: u64) -> Option<Parts> {
        let behind = |at: u64, size: u64, count: u64| {
            size.checked_mul(count)?.checked_add(at)?.checked_next_multiple_of(8)
        };
        let words = (m * m).div_ceil(64);
        let surface_at = behind(FIRST_AT as u64, 4, n * n + 1)?;
        let value_at = behind(surface_at, 4, entries)?;
        let state_at = behind(value_at, 8, entries)?;
        let mask_at = behind(state_at, 2, entries)?;
        let rgb_at = behind(mask_at, 8 * words, entries)?;
        let end = behind(rgb_at, 6, values)?;
        Some(Parts { surface_at, value_at, state_at, mask_at, rgb_at, end })
    }
}

impl Layout {
    /// `None` when the parts do not take `length` bytes.
    fn new(
        (n, m): (u32, u32),
        (entries, values): (u32, u32),
        length: usize,
        exponent: i32,
    ) -> Option<Layout> {
        let parts = Parts::new(n.into(), m.into(), entries.into(), values.into())?;
        if parts.end != length as u64 {
            return None;
        }
        // All of them are at most the length now, so the casts keep their values.
        Some(Layout {
            n,
            m,
            words: words(m),
            entries: entries as usize,
            values: values as usize,
            surface_at: parts.surface_at as usize,
            value_at: parts.value_at as usize,
            state_at: parts.state_at as usize,
            mask_at: parts.mask_at as usize,
            rgb_at: parts.rgb_at as usize,
            scale: f64::from(exponent).exp2() as f32,
        })
    }

    /// Whether the bytes between the parts and behind the last are zero.
    fn pads_with_zeros(&self, bytes: &[u8]) -> bool {
        let tiles = self.n as usize * self.n as usize;
        let gaps = [
            FIRST_AT + 4 * (tiles + 1)..self.surface_at,
            self.surface_at + 4 * self.entries..self.value_at,
            self.value_at + 8 * self.entries..self.state_at,
            self.state_at + 2 * self.entries..self.mask_at,
            self.rgb_at + 6 * self.values..bytes.len(),
        ];
        gaps.into_iter().flat_map(|gap| &bytes[gap]).all(|b| *b == 0)
    }

    /// Checks the bytes of a tile map: that the tables fit the field's `resolution` and `tile`, are
    /// in order and agree, and that every radiance is finite and not negative.
    ///
    /// # Errors
    /// The first fault found.
    pub fn check(
        bytes: &[u8],
        resolution: u32,
        tile: u32,
        surfaces: u32,
        exponent: i32,
    ) -> Result<Layout, Fault> {
        let bad = |what: &str| Err(Fault::invalid(format!("tile map: {what}")));
        let mut r = Reader::new(bytes);
        let (n, m, entries, values) = (r.u32()?, r.u32()?, r.u32()?, r.u32()?);
        let of_field = (1..=MOST_CELLS).contains(&tile) && resolution <= MOST_CELLS;
        if !of_field || (n, m) != (resolution / tile, tile) {
            return bad("its tiles are not the field's");
        }
        let Some(layout) = Layout::new((n, m), (entries, values), bytes.len(), exponent) else {
            return bad("its length is not the one its tables add up to");
        };
        let map = TileMap { bytes, layout: &layout };
        let tiles = (n * n) as usize;
        if !layout.pads_with_zeros(bytes) {
            return bad("its padding is not zero");
        }
        let first = &bytes[FIRST_AT..];
        if u32_at(first, 0) != 0 || u32_at(first, tiles) != entries {
            return bad("its tile table does not span its entries");
        }
        for t in 0..tiles {
            let (from, to) = (u32_at(first, t), u32_at(first, t + 1));
            if from > to || to > entries {
                return bad("its tile table does not rise");
            }
            let list = (from..to).map(|e| map.surface(e as usize));
            if !list.clone().zip(list.skip(1)).all(|(a, b)| a < b) {
                return bad("a tile's surfaces do not rise");
            }
        }
        let spare = (layout.words * 64) as u32 - m * m;
        let mut expected = 0u64;
        for e in 0..layout.entries {
            if map.surface(e) >= surfaces {
                return bad("a surface is not of the scene");
            }
            let mask = map.mask(e);
            let last = u64_at(mask, layout.words - 1);
            let covered: u32 = (0..layout.words).map(|w| u64_at(mask, w).count_ones()).sum();
            if covered == 0 || (spare > 0 && last >> (64 - spare) != 0) {
                return bad("a mask is empty or reaches beyond its tile");
            }
            for slot in 0..2 {
                if u64::from(map.value(2 * e + slot)) != expected {
                    return bad("its values are not in order");
                }
                expected += match map.state(2 * e + slot) {
                    DARK => 0,
                    CONSTANT => 1,
                    DATA => u64::from(covered),
                    _ => return bad("a state is none of dark, constant, data"),
                };
            }
        }
        if expected != u64::from(values) {
            return bad("its values are not all used");
        }
        // Not negative, not infinite, not NaN: sign clear and exponent below its largest.
        let rgb = &bytes[layout.rgb_at..layout.rgb_at + 6 * layout.values];
        if rgb.chunks_exact(2).any(|h| h[1] & 0x80 != 0 || h[1] & 0x7c == 0x7c) {
            return bad("a radiance is negative or not finite");
        }
        Ok(layout)
    }
}

impl<'a> TileMap<'a> {
    /// The map over bytes that `layout` was checked with.
    pub fn new(bytes: &'a [u8], layout: &'a Layout) -> TileMap<'a> {
        TileMap { bytes, layout }
    }

    fn surface(&self, entry: usize) -> u32 {
        u32_at(&self.bytes[self.layout.surface_at..], entry)
    }

    fn value(&self, slot: usize) -> u32 {
        u32_at(&self.bytes[self.layout.value_at..], slot)
    }

    fn state(&self, slot: usize) -> u8 {
        self.bytes[self.layout.state_at + slot]
    }

    fn mask(&self, entry: usize) -> &'a [u8] {
        let at = self.layout.mask_at + 8 * self.layout.words * entry;
        &self.bytes[at..at + 8 * self.layout.words]
    }

    fn rgb(&self, value: usize) -> Rgb {
        let at = self.layout.rgb_at + 6 * value;
        let h = &self.bytes[at..at + 6];
        // Finite and not negative was checked, so the bits shift into place, subnormals as well. That
        // leaves the exponent 112 too small. Both products are exact; in one, 2^112 and the scale
        // could overflow.
        let channel =
            |c| f32::from_bits(u32::from(u16_at(h, c)) << 13) * REBIAS * self.layout.scale;
        Rgb([channel(0), channel(1), channel(2)])
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
    pub fn entry(&self, cell: Cell, surface: SurfaceId) -> Option<TileEntry<'a>> {
        let Layout { n, m, .. } = *self.layout;
        let tile = (cell.j / m * n + cell.i / m) as usize;
        let first = &self.bytes[FIRST_AT..];
        let (mut low, mut high) = (u32_at(first, tile) as usize, u32_at(first, tile + 1) as usize);
        while low < high {
            let middle = (low + high) / 2;
            match self.surface(middle).cmp(&surface.0) {
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
        let Layout { m, words, .. } = *self.map.layout;
        let index = (cell.j % m * m + cell.i % m) as usize;
        let mask = self.map.mask(self.entry);
        let word = u64_at(mask, index / 64);
        if word >> (index % 64) & 1 == 0 {
            return None;
        }
        let slot = 2 * self.entry + sense.slot();
        let value = self.map.value(slot) as usize;
        match self.map.state(slot) {
            DATA => {
                debug_assert!(words * 64 > index);
                let before: u32 = (0..index / 64).map(|w| u64_at(mask, w).count_ones()).sum();
                let below = word & ((1u64 << (index % 64)) - 1);
                Some(self.map.rgb(value + (before + below.count_ones()) as usize))
            }
            CONSTANT => Some(self.map.rgb(value)),
            _ => Some(Rgb::BLACK),
        }
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cell(surface: u32, cell: u32, along: f32, against: f32) -> CoveredCell {
        let radiance = [Rgb::splat(along), Rgb::splat(against)];
        CoveredCell { surface: SurfaceId(surface), cell, radiance }
    }

    fn two_tiles() -> Vec<u8> {
        let mut w = TileMapWriter::new(8, 4, 0);
        w.tile(&mut [cell(3, 1, 0.5, 0.0), cell(1, 0, 2.0, 1.0), cell(3, 15, 0.25, 0.0)]);
        w.tile(&mut []);
        w.tile(&mut []);
        w.tile(&mut [cell(3, 5, 0.125, 4.0)]);
        w.finish()
    }

    #[test]
    fn what_was_written_is_read_and_nothing_else() {
        let bytes = two_tiles();
        let layout = Layout::check(&bytes, 8, 4, 4, 0).unwrap();
        let map = TileMap::new(&bytes, &layout);
        let read = |i, j, s, sense| {
            map.entry(Cell { i, j }, SurfaceId(s)).and_then(|e| e.radiance(Cell { i, j }, sense))
        };
        assert_eq!(read(1, 0, 3, Sense::Along), Some(Rgb::splat(0.5)));
        assert_eq!(read(3, 3, 3, Sense::Along), Some(Rgb::splat(0.25)));
        assert_eq!(read(3, 3, 3, Sense::Against), Some(Rgb::BLACK));
        assert_eq!(read(0, 0, 1, Sense::Against), Some(Rgb::splat(1.0)));
        assert_eq!(read(5, 5, 3, Sense::Against), Some(Rgb::splat(4.0)));
        assert_eq!(read(0, 0, 3, Sense::Along), None);
        assert_eq!(read(5, 0, 3, Sense::Along), None);
        let mut count = 0;
        map.for_each(|_, _, _| count += 1);
        assert_eq!(count, 4);
    }

    #[test]
    fn any_flipped_byte_is_refused_or_stays_in_bounds() {
        let good = two_tiles();
        for at in 0..good.len() {
            for bit in 0..8 {
                let mut bytes = good.clone();
                bytes[at] ^= 1 << bit;
                if let Ok(layout) = Layout::check(&bytes, 8, 4, 4, 0) {
                    TileMap::new(&bytes, &layout).for_each(|_, _, both| {
                        assert!(both.iter().all(|r| r.is_physical()));
                    });
                }
            }
        }
    }

    proptest! {
        #[test]
        fn radiance_keeps_eleven_bits(v in 1e-4f32..1.0, power in -25i32..25) {
            let most = 1.7 * 10f32.powi(power);
            let exponent = exponent_for(most);
            let mut w = TileMapWriter::new(1, 1, exponent);
            w.tile(&mut [cell(0, 0, v * most, most)]);
            let bytes = w.finish();
            let layout = Layout::check(&bytes, 1, 1, 1, exponent).unwrap();
            let at = Cell { i: 0, j: 0 };
            let entry = TileMap::new(&bytes, &layout).entry(at, SurfaceId(0)).unwrap();
            let back = entry.radiance(at, Sense::Along).unwrap().0[0];
            prop_assert!((back / (v * most) - 1.0).abs() < 5e-4, "{back} {}", v * most);
        }

        #[test]
        fn random_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = Layout::check(&bytes, 8, 4, 4, 0);
        }
    }
}
