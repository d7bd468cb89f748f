//! A tile map rearranged so that a compressor finds its pattern: each table for itself, values as
//! differences from what their neighbours let expect, the bytes of numbers in planes. Nothing is lost.
//!
//! ```text
//! 0     u32 n, m, E, V        as in the map
//! 16    u16 step              all bits of values are multiples of it
//! 18    4 planes, n n         entries of each tile
//!       4 planes, E           surfaces, less the one before in the tile and 1
//!       u8 state[2 E]         all along, then all against
//!       u8 mask[8 w E]        byte k of every mask, k by k: its XOR with the byte a row before
//!       2 planes, V           red: bits / step, less the expected
//!       2 planes, V           green: the same, less red's difference
//!       2 planes, V           blue: the same
//! ```
//!
//! Planes are all lowest bytes, then all second ones, and so on. Differences wrap at 16 bits and are
//! folded, 0 -1 1 -2 2 ..., so that small ones have small bytes. What the other tables say is left out.

mod read;

mod write;

pub use read::from_planes;
pub use write::to_planes;

use super::{CONSTANT, DATA};

/// Bytes before the first plane.
const HEAD: u64 = 18;

/// Bytes of the planes of a map of so many tiles, mask words an entry, entries and values; `None`
/// beyond 2^64.
fn length(tiles: u64, words: u64, entries: u64, values: u64) -> Option<u64> {
    let per_entry = words.checked_mul(8)?.checked_add(6)?;
    HEAD.checked_add(tiles.checked_mul(4)?)?
        .checked_add(entries.checked_mul(per_entry)?)?
        .checked_add(values.checked_mul(6)?)
}

/// Bytes of a row of a mask; 1 where rows end within a byte.
fn row_bytes(m: usize) -> usize {
    if m.is_multiple_of(8) { m.div_ceil(8) } else { 1 }
}

/// What the cells of a slot that have gone by let expect of the next.
struct Neighbours {
    m: usize,
    row: usize,
    /// A row and the one above, each with a cell of nothing before its first.
    here: Vec<Option<[i16; 3]>>,
    above: Vec<Option<[i16; 3]>>,
    last: [i16; 3],
}

#[allow(
    clippy::arithmetic_side_effects,
    clippy::cast_possible_truncation,
    clippy::indexing_slicing,
    reason = "columns are remainders of m, which is not 0, and rows are m + 1 long; a median is as its numbers"
)]
impl Neighbours {
    /// For tiles of `m` cells along an edge, at least one.
    fn new(m: usize) -> Neighbours {
        let row = vec![None; m + 1];
        Neighbours { m, row: 0, here: row.clone(), above: row, last: [0; 3] }
    }

    /// Forgets the cells of another slot, but for its last value.
    fn begin_slot(&mut self) {
        self.row = 0;
        self.here.fill(None);
        self.above.fill(None);
    }

    /// From the cells to the left, above, and above to the left: the median of the first two and of the
    /// plane through all three (as JPEG-LS has it); where one is missing, the first or else the second;
    /// where both are, the value that came last.
    fn expected(&mut self, cell: usize) -> [i16; 3] {
        let (row, column) = (cell / self.m, cell % self.m);
        if row != self.row {
            std::mem::swap(&mut self.here, &mut self.above);
            self.here.fill(None);
            if row != self.row + 1 {
                self.above.fill(None);
            }
            self.row = row;
        }
        match (self.here[column], self.above[column + 1], self.above[column]) {
            (Some(left), Some(up), Some(corner)) => std::array::from_fn(|c| {
                let (low, high) = (left[c].min(up[c]), left[c].max(up[c]));
                let plane = i32::from(left[c]) + i32::from(up[c]) - i32::from(corner[c]);
                plane.clamp(low.into(), high.into()) as i16
            }),
            (Some(left), ..) => left,
            (None, Some(up), _) => up,
            (None, None, _) => self.last,
        }
    }

    /// Says what the cell of the last question has.
    fn set(&mut self, cell: usize, value: [i16; 3]) {
        self.here[cell % self.m + 1] = Some(value);
        self.last = value;
    }
}

/// Calls `visit` with the cell of every value of a slot, in order, as long as it succeeds. A constant
/// one's stands for all, so for the first.
fn try_cells<E>(
    state: u8,
    mask: &[u8],
    mut visit: impl FnMut(usize) -> Result<(), E>,
) -> Result<(), E> {
    match state {
        DATA => {
            for (word, bytes) in mask.as_chunks().0.iter().enumerate() {
                let mut left = u64::from_le_bytes(*bytes);
                while left != 0 {
                    let bit = left.trailing_zeros() as usize;
                    visit(word.saturating_mul(64).saturating_add(bit))?;
                    left &= left.wrapping_sub(1);
                }
            }
            Ok(())
        }
        CONSTANT => visit(0),
        _ => Ok(()),
    }
}

#[cfg(test)]
#[allow(
    clippy::arithmetic_side_effects,
    clippy::cast_possible_truncation,
    clippy::indexing_slicing,
    reason = "a panic fails the test"
)]
mod tests {
    use super::*;
    use crate::format::tiles::{CoveredCell, Layout, TileMap, TileMapWriter};
    use crate::ids::SurfaceId;
    use crate::radiance::Rgb;
    use proptest::prelude::*;

    /// A map of 2 x 2 tiles of m x m cells.
    fn map(m: u32, cells: &[(u32, u32, u32, [f32; 3])]) -> Vec<u8> {
        let mut writer = TileMapWriter::new(2 * m, m, 0);
        for tile in 0..4 {
            let mut cells: Vec<_> = { cells.iter() }
                .filter(|c| c.0 % 4 == tile)
                .map(|(_, surface, cell, value)| CoveredCell {
                    surface: SurfaceId(*surface),
                    cell: cell % (m * m),
                    radiance: [Rgb(*value), Rgb(if cell % 3 == 0 { [0.0; 3] } else { [1.0; 3] })],
                })
                .collect();
            writer.tile(&mut cells);
        }
        writer.finish()
    }

    proptest! {
        #[test]
        fn from_planes_is_the_inverse_of_to_planes(
            m in 1u32..18,
            cells in prop::collection::vec(
                (0u32..4, 0u32..70_000, 0u32..400, prop::array::uniform3(0f32..9e4)), 0..200),
            damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..4),
        ) {
            let map = map(m, &cells);
            let layout = Layout::check(&map, 2 * m, m, u32::MAX, 0).unwrap();
            let planes = to_planes(&TileMap::new(&map, &layout));
            prop_assert!(planes.len() <= map.len());
            prop_assert!(from_planes(&planes, map.len() as u64).unwrap() == map);
            prop_assert!(from_planes(&planes, map.len() as u64 + 8).is_err());
            prop_assert!(from_planes(&planes[1..], map.len() as u64).is_err());
            // Damaged ones are refused, or are planes of something else of that length.
            let mut damaged = planes;
            for (at, value) in damage {
                let at = at.index(damaged.len());
                damaged[at] = value;
            }
            if let Ok(found) = from_planes(&damaged, map.len() as u64) {
                prop_assert_eq!(found.len(), map.len());
                let _ = Layout::check(&found, 2 * m, m, u32::MAX, 0);
            }
        }
    }

    /// A damaged edge of an empty map's tiles: found by chance, when it took years to be read.
    #[test]
    fn an_empty_map_of_enormous_tiles_takes_no_time() {
        let empty = map(1, &[]);
        let layout = Layout::check(&empty, 2, 1, u32::MAX, 0).unwrap();
        let planes = to_planes(&TileMap::new(&empty, &layout));
        for (byte, is_planes) in [(7, false), (6, false), (5, true)] {
            let mut damaged = planes.clone();
            damaged[byte] = 0x80;
            let found = from_planes(&damaged, empty.len() as u64);
            assert_eq!(found.is_ok(), is_planes, "byte {byte}");
            assert!(
                found.is_ok_and(|f| Layout::check(&f, 2, 1, u32::MAX, 0).is_err()) == is_planes
            );
        }
    }

    #[test]
    fn smooth_values_have_small_differences() {
        let cells: Vec<_> = { 0..256 }
            .map(|cell| (0, 5, cell, [8.0 + (cell % 16) as f32 / 64.0, 4.0, 4.0]))
            .collect();
        let map = map(16, &cells);
        let layout = Layout::check(&map, 32, 16, 6, 0).unwrap();
        let planes = to_planes(&TileMap::new(&map, &layout));
        // Second bytes are of the slot's first value alone; the other sense's values are not smooth.
        let values = TileMap::new(&map, &layout).value_count();
        let red = &planes[planes.len() - 6 * values..][..2 * values];
        let along = &red[values..][..256];
        assert!(along.iter().filter(|b| **b != 0).count() <= 1, "{along:?}");
    }
}
