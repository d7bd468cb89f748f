//! Cells that a thread looked up last: a cell of a tile map covers many pixels, and each of them needs
//! four of three maps.
//!
//! Each place holds the cell that came to it last, so that a lookup costs one comparison. What a cell
//! shows never changes while a field is open.

use crate::ids::{Sense, SurfaceId};
use crate::radiance::Rgb;
use std::cell::Cell as Slot;

/// Which cell: one of a direction's grid, as a surface shows it in a sense.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Key {
    direction: u32,
    shown: u32,
    cell: u32,
}

/// No surface has this number, since each has two senses.
const NOTHING: Key = Key { direction: 0, shown: u32::MAX, cell: 0 };

/// Cells that are remembered: a power of two. With 24 bytes each they stay in a core's own cache.
const REMEMBERED: usize = 1 << 13;

/// The cells of one thread.
pub struct Recent(Box<[Slot<(Key, Option<Rgb>)>]>);

impl Key {
    /// The first cell of a grid, as a surface shows it.
    pub fn new(direction: u32, surface: SurfaceId, sense: Sense) -> Key {
        Key { direction, shown: 2 * surface.0 + sense.slot() as u32, cell: 0 }
    }

    /// Another cell of it, by its number row by row.
    pub fn at(self, cell: u32) -> Key {
        Key { cell, ..self }
    }

    /// Neighbours in a row lie side by side.
    fn place(self) -> usize {
        let grid = self.direction.wrapping_mul(0x9e37_79b1) ^ self.shown.wrapping_mul(0x85eb_ca6b);
        (grid >> 16).wrapping_add(self.cell.wrapping_mul(5)) as usize % REMEMBERED
    }
}

impl Default for Recent {
    fn default() -> Recent {
        Recent(vec![Slot::new((NOTHING, None)); REMEMBERED].into_boxed_slice())
    }
}

impl Recent {
    /// What a cell shows, `None` where the surface does not cover it; looked up if another took its place.
    #[inline]
    pub fn or_look(&self, key: Key, look: impl FnOnce() -> Option<Rgb>) -> Option<Rgb> {
        let slot = &self.0[key.place()];
        let (known, found) = slot.get();
        if known == key {
            return found;
        }
        let found = look();
        slot.set((key, found));
        found
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
            asked in prop::collection::vec((0u32..40, 0u32..9, any::<bool>(), 0u32..40_000), 1..4000),
        ) {
            let recent = Recent::default();
            for (direction, surface, along, cell) in asked {
                let sense = if along { Sense::Along } else { Sense::Against };
                let own = Rgb([(1000 * direction + surface) as f32, sense.sign(), cell as f32]);
                let own = (cell % 7 > 0).then_some(own);
                let key = Key::new(direction, SurfaceId(surface), sense).at(cell);
                prop_assert_eq!(recent.or_look(key, || own), own);
                prop_assert_eq!(recent.or_look(key, || unreachable!()), own);
            }
        }
    }
}
