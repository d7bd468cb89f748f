//! What a thread looked up last: a cell of a tile map covers many pixels, and each of them needs four
//! cells of three maps.
//!
//! Each place of a memory holds what came to it last, so that asking again costs one comparison. What a
//! cell shows never changes while a field is open.

use crate::ids::{Sense, SurfaceId};
use crate::radiance::Rgb;
use std::cell::Cell as Slot;

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

/// What cells show, `None` where the surface does not cover them.
pub struct Recent {
    /// The four cells around the point that was looked up last in a grid: that of the next pixel, as a
    /// rule, lies between the same.
    fours: Box<[Known<[Option<Rgb>; 4]>]>,
    /// Cells. They stay in a core's own cache.
    cells: Box<[Known<Option<Rgb>>]>,
}

type Known<T> = Slot<Option<(Key, T)>>;

/// How many of each are remembered: powers of two.
const FOURS: usize = 1 << 6;
const CELLS: usize = 1 << 13;

impl Default for Recent {
    fn default() -> Recent {
        Recent {
            fours: vec![Slot::new(None); FOURS].into_boxed_slice(),
            cells: vec![Slot::new(None); CELLS].into_boxed_slice(),
        }
    }
}

impl Recent {
    /// What a cell shows, and those to the right of it, below it, and both.
    #[inline]
    pub fn four(
        &self,
        first: Key,
        mut look: impl FnMut(i32, i32) -> Option<Rgb>,
    ) -> [Option<Rgb>; 4] {
        known(&self.fours[first.grid() as usize % FOURS], first, || {
            let [i, j] = first.cell;
            [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)].map(|(i, j)| {
                let key = first.at(i, j);
                let row = key.grid().wrapping_add((97 * j) as u32);
                let slot = &self.cells[row.wrapping_add(i as u32) as usize % CELLS];
                known(slot, key, || look(i, j))
            })
        })
    }
}

/// What a place remembers of a key, looked up and remembered if it has come to hold another's.
#[inline]
fn known<T: Copy>(slot: &Known<T>, key: Key, look: impl FnOnce() -> T) -> T {
    match slot.get() {
        Some((of, value)) if of == key => value,
        _ => {
            let value = look();
            slot.set(Some((key, value)));
            value
        }
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
            let recent = Recent::default();
            for (direction, surface, along, i, j) in asked {
                let sense = if along { Sense::Along } else { Sense::Against };
                let own = |i: i32, j: i32| {
                    let own = Rgb([(1000 * direction + surface) as f32, sense.sign(), (256 * j + i) as f32]);
                    ((i + j) % 7 > 0).then_some(own)
                };
                let key = Key::new(direction, (SurfaceId(surface), sense), [i, j]);
                let all = [own(i, j), own(i + 1, j), own(i, j + 1), own(i + 1, j + 1)];
                prop_assert_eq!(recent.four(key, own), all);
                prop_assert_eq!(recent.four(key, |_, _| unreachable!()), all);
            }
        }
    }
}
