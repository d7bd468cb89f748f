//! What a thread looked up last: a cell of a tile map covers many pixels, and each of them needs four
//! cells of three maps.
//!
//! Each place of a memory holds what came to it last, so that asking again costs one comparison. What a
//! cell shows never changes while a field is open.

use crate::gather::{Four, four};
use crate::ids::{Sense, SurfaceId};
use crate::radiance::Rgb;

/// Which cell: one of a direction's grid, as a surface shows it in a sense.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Key {
    direction: u32,
    shown: u32,
    /// Column and row.
    cell: [i32; 2],
}

impl Key {
    /// A cell in a column and row of a direction's grid, which need not be there.
    pub fn new(direction: u32, (surface, sense): (SurfaceId, Sense), cell: [i32; 2]) -> Key {
        Key { direction, shown: 2 * surface.0 + sense.slot() as u32, cell }
    }

    /// The same grid's cell in another column and row.
    pub fn at(self, i: i32, j: i32) -> Key {
        Key { cell: [i, j], ..self }
    }

    /// A number for what is shown in the grid.
    fn grid(self) -> u32 {
        let mixed = self.direction.wrapping_mul(0x9e37_79b1) ^ self.shown.wrapping_mul(0x85eb_ca6b);
        mixed >> 16
    }
}

/// What cells show.
pub struct Recent {
    /// The four cells around the point that was looked up last in a grid: that of the next pixel, as a
    /// rule, lies between the same.
    fours: Box<[(Option<Key>, Four)]>,
    /// Cells. They stay in a core's own cache.
    cells: Box<[(Option<Key>, Option<Rgb>)]>,
}

/// How many of each are remembered: powers of two.
const FOURS: usize = 1 << 6;
const CELLS: usize = 1 << 13;

impl Default for Recent {
    fn default() -> Recent {
        Recent {
            fours: vec![Default::default(); FOURS].into_boxed_slice(),
            cells: vec![Default::default(); CELLS].into_boxed_slice(),
        }
    }
}

impl Recent {
    /// What a cell shows, and those to the right of it, below it, and both.
    #[inline]
    pub fn four(&mut self, first: Key, look: impl FnMut(i32, i32) -> Option<Rgb>) -> Four {
        let place = first.grid() as usize % FOURS;
        if self.fours[place].0 != Some(first) {
            self.fours[place] = (Some(first), self.cell_by_cell(first, look));
        }
        self.fours[place].1
    }

    #[inline(never)]
    fn cell_by_cell(&mut self, first: Key, mut look: impl FnMut(i32, i32) -> Option<Rgb>) -> Four {
        four(first.cell[0], first.cell[1], |i, j| {
            let key = first.at(i, j);
            let place = key.grid().wrapping_add((97 * j + i) as u32) as usize % CELLS;
            if self.cells[place].0 != Some(key) {
                self.cells[place] = (Some(key), look(i, j));
            }
            self.cells[place].1
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Whatever was asked for before, each cell has its own value.
        #[test]
        fn each_cell_has_its_own_value(
            asked in prop::collection::vec((0u32..40, 0u32..9, any::<bool>(), -1i32..200, -1i32..200), 1..4000),
        ) {
            let mut recent = Recent::default();
            for (direction, surface, along, i, j) in asked {
                let sense = if along { Sense::Along } else { Sense::Against };
                let own = |i: i32, j: i32| {
                    let own = Rgb([(1000 * direction + surface) as f32, sense.sign(), (256 * j + i) as f32]);
                    ((i + j) % 7 > 0).then_some(own)
                };
                let key = Key::new(direction, (SurfaceId(surface), sense), [i, j]);
                let all = four(i, j, own);
                prop_assert_eq!(recent.four(key, own), all);
                prop_assert_eq!(recent.four(key, |_, _| unreachable!()), all);
            }
        }
    }
}
