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
//!       u8  state[2 E]     0 dark, 1 constant, 2 one value a covered cell,
//!                          3 textured (in packs)                                    pad to 8
//!       u64 mask[E * ceil(m*m / 64)]   covered cells, row by row, low bit first
//!       f16 rgb[3 V]       radiance / 2^exponent                                    pad to 8
//! ```
//!
//! A covered cell's value stands at `value + rank`, where rank counts the covered cells before it.
//! All numbers that repeat one another are compared when a map is opened, so that a lookup needs no
//! check beyond Rust's own.

#![deny(
    clippy::arithmetic_side_effects,
    clippy::cast_possible_truncation,
    clippy::indexing_slicing
)]

mod map;

mod planes;

mod rewrite;

mod write;

#[cfg(test)]
#[allow(clippy::indexing_slicing, reason = "a panic fails the test")]
mod tests;

pub use map::{Seen, TileEntry, TileMap, half_to_f32};
pub use planes::{from_planes, to_planes};
pub use rewrite::{Slot, rewritten};
pub use write::{CoveredCell, TileMapWriter, exponent_for};

use super::Fault;
use super::bytes::Reader;
use super::limits::MOST_CELLS;
use std::ops::Range;

/// Where the table of tiles begins.
const FIRST_AT: usize = 16;

/// State of a slot all of whose cells are black.
pub const DARK: u8 = 0;
/// State of a slot all of whose cells have one value.
pub const CONSTANT: u8 = 1;
/// State of a slot with a value for each covered cell.
pub const DATA: u8 = 2;
/// State of a slot, in packs only, whose cells have what the texture map says, see
/// [`crate::textured`]; it stores nothing.
pub const TEXTURED: u8 = 3;

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
    textured: bool,
}

/// The most bytes that a tile map of a sound first block can have: every surface covers every cell.
pub(super) fn most_bytes(resolution: u32, tile: u32, surfaces: u32) -> u64 {
    let [n, m, surfaces] =
        [resolution.checked_div(tile).unwrap_or(0), tile, surfaces].map(u64::from);
    let entries = n.saturating_mul(n).saturating_mul(surfaces);
    let values = m.saturating_mul(m).saturating_mul(2).saturating_mul(entries);
    Parts::new(n, m, entries, values).map_or(u64::MAX, |parts| parts.end)
}

/// The parts of a tile map in its bytes; between them and behind the last is padding.
struct Parts {
    first: Range<u64>,
    surface: Range<u64>,
    value: Range<u64>,
    state: Range<u64>,
    mask: Range<u64>,
    rgb: Range<u64>,
    end: u64,
}

impl Parts {
    /// Of n x n tiles of m x m cells; `None` beyond 2^64 bytes.
    fn new(n: u64, m: u64, entries: u64, values: u64) -> Option<Parts> {
        let part = |behind: u64, size: u64, count: u64| {
            let start = behind.checked_next_multiple_of(8)?;
            Some(start..size.checked_mul(count)?.checked_add(start)?)
        };
        let tiles = n.checked_mul(n)?;
        let mask_size = m.checked_mul(m)?.div_ceil(64).checked_mul(8)?;
        let first = part(FIRST_AT as u64, 4, tiles.checked_add(1)?)?;
        let surface = part(first.end, 4, entries)?;
        let value = part(surface.end, 8, entries)?;
        let state = part(value.end, 2, entries)?;
        let mask = part(state.end, mask_size, entries)?;
        let rgb = part(mask.end, 6, values)?;
        let end = rgb.end.checked_next_multiple_of(8)?;
        Some(Parts { first, surface, value, state, mask, rgb, end })
    }

    /// Whether the bytes between the parts and behind the last are zero.
    fn are_padded_with_zeros(&self, bytes: &[u8]) -> bool {
        let Parts { first, surface, value, state, mask, rgb, end } = self;
        [
            first.end..surface.start,
            surface.end..value.start,
            value.end..state.start,
            state.end..mask.start,
            mask.end..rgb.start,
            rgb.end..*end,
        ]
        .iter()
        .all(|gap| part(bytes, gap).is_some_and(|gap| gap.iter().all(|b| *b == 0)))
    }
}

/// A part of a tile map's bytes.
fn part<'a>(bytes: &'a [u8], range: &Range<u64>) -> Option<&'a [u8]> {
    bytes.get(range.start.try_into().ok()?..range.end.try_into().ok()?)
}

/// Little-endian numbers.
fn numbers(table: &[u8]) -> impl Iterator<Item = u32> {
    table.as_chunks().0.iter().map(|bytes| u32::from_le_bytes(*bytes))
}

/// Whether each number is smaller than the next.
fn rise(table: &[u8]) -> bool {
    numbers(table).is_sorted_by(|a, b| a < b)
}

impl Layout {
    /// `None` when a part begins beyond what the machine can count.
    #[allow(clippy::cast_possible_truncation, reason = "2^-100 to 2^100")]
    fn new((n, m): (u32, u32), parts: &Parts, counts: (u32, u32), exponent: i32) -> Option<Layout> {
        let at = |part: &Range<u64>| usize::try_from(part.start).ok();
        Some(Layout {
            n,
            m,
            words: usize::try_from(m.checked_mul(m)?.div_ceil(64)).ok()?,
            entries: usize::try_from(counts.0).ok()?,
            values: usize::try_from(counts.1).ok()?,
            surface_at: at(&parts.surface)?,
            value_at: at(&parts.value)?,
            state_at: at(&parts.state)?,
            mask_at: at(&parts.mask)?,
            rgb_at: at(&parts.rgb)?,
            scale: f64::from(exponent).exp2() as f32,
            textured: false,
        })
    }

    /// Checks the bytes of a tile map: that the tables fit the field's `resolution` and `tile`, are
    /// in order and agree, that every radiance is finite and not negative, and that all are there.
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
        let layout = Layout::check_packed(bytes, (resolution, tile), surfaces, exponent)?;
        match layout.textured {
            false => Ok(layout),
            true => Err(Fault::invalid("tile map: a state is none of dark, constant, data")),
        }
    }

    /// The same for a map of a pack, which may leave values to the texture map: then
    /// [`Layout::is_textured`].
    ///
    /// # Errors
    /// The first fault found.
    pub fn check_packed(
        bytes: &[u8],
        (resolution, tile): (u32, u32),
        surfaces: u32,
        exponent: i32,
    ) -> Result<Layout, Fault> {
        let bad = |what: &str| Fault::invalid(format!("tile map: {what}"));
        let mut r = Reader::new(bytes);
        let (n, m, entries, values) = (r.u32()?, r.u32()?, r.u32()?, r.u32()?);
        let of_field = (1..=MOST_CELLS).contains(&tile) && resolution <= MOST_CELLS;
        if !of_field || (resolution.checked_div(tile), tile) != (Some(n), m) {
            return Err(bad("its tiles are not the field's"));
        }
        let parts = Parts::new(n.into(), m.into(), entries.into(), values.into())
            .filter(|parts| parts.end == bytes.len() as u64);
        let wrong_length = || bad("its length is not the one its tables add up to");
        let parts = parts.ok_or_else(wrong_length)?;
        let layout = Layout::new((n, m), &parts, (entries, values), exponent);
        let mut layout = layout.ok_or_else(wrong_length)?;
        if !parts.are_padded_with_zeros(bytes) {
            return Err(bad("its padding is not zero"));
        }
        let tables = Tables::new(bytes, &parts, layout.words).ok_or_else(wrong_length)?;
        tables.check_tiles(entries).map_err(bad)?;
        tables.check_entries(surfaces, m, values).map_err(bad)?;
        tables.check_radiance().map_err(bad)?;
        layout.textured = tables.state.contains(&TEXTURED);
        Ok(layout)
    }

    /// Whether some of its values are the texture map's.
    pub fn is_textured(&self) -> bool {
        self.textured
    }
}

/// The least half-precision number, by its bits, that is not finite; negative ones are above it.
const INFINITE: u16 = 0x7c00;

/// The parts of a tile map that is being checked.
struct Tables<'a> {
    first: &'a [u8],
    surface: &'a [u8],
    value: &'a [u8],
    state: &'a [u8],
    mask: &'a [u8],
    rgb: &'a [u8],
    /// Bytes of a mask.
    mask_size: usize,
}

impl<'a> Tables<'a> {
    fn new(bytes: &'a [u8], parts: &Parts, words: usize) -> Option<Tables<'a>> {
        Some(Tables {
            first: part(bytes, &parts.first)?,
            surface: part(bytes, &parts.surface)?,
            value: part(bytes, &parts.value)?,
            state: part(bytes, &parts.state)?,
            mask: part(bytes, &parts.mask)?,
            rgb: part(bytes, &parts.rgb)?,
            mask_size: words.checked_mul(8)?,
        })
    }

    /// That the tiles share the entries out in order, and each one's surfaces rise.
    fn check_tiles(&self, entries: u32) -> Result<(), &'static str> {
        let ends = (numbers(self.first).next(), numbers(self.first).last());
        if ends != (Some(0), Some(entries)) {
            return Err("its tile table does not span its entries");
        }
        let mut rest = self.surface;
        for (from, to) in numbers(self.first).zip(numbers(self.first).skip(1)) {
            let bytes = to.checked_sub(from).and_then(|count| (count as usize).checked_mul(4));
            let list = bytes.and_then(|bytes| rest.split_at_checked(bytes));
            let (list, others) = list.ok_or("its tile table does not rise")?;
            if !rise(list) {
                return Err("a tile's surfaces do not rise");
            }
            rest = others;
        }
        Ok(())
    }

    /// That surfaces, masks, values and states agree.
    fn check_entries(&self, surfaces: u32, m: u32, values: u32) -> Result<(), &'static str> {
        // Bits of a mask behind its tile.
        let spare = m.wrapping_mul(m).wrapping_neg() % 64;
        let mut expected = 0u64;
        let masks = self.mask.chunks_exact(self.mask_size);
        let slots = self.value.chunks_exact(8).zip(self.state.chunks_exact(2));
        for ((surface, mask), (value, state)) in numbers(self.surface).zip(masks).zip(slots) {
            if surface >= surfaces {
                return Err("a surface is not of the scene");
            }
            let words = mask.as_chunks().0;
            let words = words.iter().map(|bytes| u64::from_le_bytes(*bytes));
            let last = words.clone().next_back().unwrap_or(0);
            let covered: u32 = words.map(u64::count_ones).sum();
            if covered == 0 || last.leading_zeros() < spare {
                return Err("a mask is empty or reaches beyond its tile");
            }
            for (value, state) in numbers(value).zip(state) {
                if u64::from(value) != expected {
                    return Err("its values are not in order");
                }
                expected = expected.saturating_add(match *state {
                    DARK | TEXTURED => 0,
                    CONSTANT => 1,
                    DATA => covered.into(),
                    _ => return Err("a state is none of dark, constant, data, textured"),
                });
            }
        }
        match expected == u64::from(values) {
            true => Ok(()),
            false => Err("its values are not all used"),
        }
    }

    /// Not negative, not infinite, not NaN: sign clear and exponent below its largest.
    fn check_radiance(&self) -> Result<(), &'static str> {
        let halves = self.rgb.as_chunks().0.iter().map(|half| u16::from_le_bytes(*half));
        // All of them, many at a time: to stop at the first would be to look at each.
        match halves.fold(0, u16::max) {
            0..INFINITE => Ok(()),
            _ => Err("a radiance is negative or not finite"),
        }
    }
}
