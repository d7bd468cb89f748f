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

    /// A number for it, mixed.
    fn hash(self) -> u32 {
        let Key { direction, shown, cell: [i, j] } = self;
        let grid = direction.wrapping_mul(0x9e37_79b1) ^ shown.wrapping_mul(0x85eb_ca6b);
        (grid >> 15).wrapping_add((257 * j + i).cast_unsigned())
    }
}

/// What the four cells around a point show, by the first of them. The pixels of a row meet some hundreds, those
/// of the next row mostly the same; a picture meets some tens of thousands, and the next picture of a walk too.
#[derive(Default)]
pub struct Recent(Vec<(Option<Key>, Four)>);

/// How many are remembered: a power of two.
const FOURS: usize = 1 << 16;

impl Recent {
    /// What a cell shows, and those to the right of it, below it, and both.
    #[inline]
    pub fn four(&mut self, first: Key, look: impl FnMut(i32, i32) -> Option<Rgb>) -> Four {
        if self.0.is_empty() {
            self.0.resize(FOURS, Default::default());
        }
        let place = &mut self.0[first.hash() as usize % FOURS];
        if place.0 != Some(first) {
            *place = (Some(first), four(first.cell[0], first.cell[1], look));
        }
        place.1
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
