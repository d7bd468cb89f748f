//! What a thread looked up last: a cell of a tile map covers many pixels, and each of them needs four
//! cells of three maps.
//!
//! Cells are remembered in blocks: where one is looked at, its neighbours soon are. Each place of a memory
//! holds what came to it last, so that asking again costs one comparison. What a cell shows never changes
//! while a field is open.

use crate::gather::Four;
use crate::ids::{Sense, SurfaceId};
use crate::radiance::Rgb;
use glam::{Vec3, Vec4};

/// Cells along the edge of a block whose neighbours to the right and below are in it too.
pub const EDGE: i32 = 4;

/// Cells along the edge of a block.
pub const ROW: usize = EDGE as usize + 1;

/// What the cells of a block show, row by row: red, green, blue and 1 of each, or 0 where the surface does not
/// cover it.
pub type Block = [Vec4; ROW * ROW];

/// Which block: one of a direction's grid, as a surface shows it in a sense.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Key {
    direction: u32,
    shown: u32,
    /// Its first column and row, in edges of blocks.
    place: [i32; 2],
}

impl Key {
    /// A number for it, mixed.
    fn hash(self) -> usize {
        let Key { direction, shown, place: [i, j] } = self;
        let grid = direction.wrapping_mul(0x9e37_79b1) ^ shown.wrapping_mul(0x85eb_ca6b);
        (grid >> 15).wrapping_add((67 * j + i).cast_unsigned()) as usize
    }
}

/// A direction's grid as a surface shows it in a sense.
#[derive(Clone, Copy, Debug)]
pub struct Grid {
    /// The direction.
    pub direction: u32,
    /// The surface.
    pub surface: SurfaceId,
    /// The sense.
    pub sense: Sense,
}

/// The blocks that were looked up last. A part of a picture meets several hundred, and the same part of the next
/// picture of a walk mostly the same.
#[derive(Default)]
pub struct Recent(Vec<(Option<Key>, Block)>);

/// How many are remembered, 420 bytes each: a power of two.
const BLOCKS: usize = 1 << 12;

impl Recent {
    /// What the block at a place shows; `look` finds what is not remembered.
    #[inline]
    pub fn block(
        &mut self,
        grid: Grid,
        place: [i32; 2],
        look: impl FnMut(i32, i32) -> Option<Rgb>,
    ) -> &Block {
        if self.0.is_empty() {
            self.0.resize(BLOCKS, Default::default());
        }
        let Grid { direction, surface, sense } = grid;
        let key = Key { direction, shown: 2 * surface.0 + sense.slot() as u32, place };
        let (known, block) = &mut self.0[key.hash() % BLOCKS];
        if *known != Some(key) {
            *known = None;
            fill(block, key.place.map(|first| first * EDGE), look);
            *known = Some(key);
        }
        block
    }
}

/// The place of the block that holds a cell and its neighbours to the right and below, and the cell's in it.
#[inline]
pub fn holding(i: i32, j: i32) -> ([i32; 2], usize) {
    let [column, row] = [i, j].map(|v| v.rem_euclid(EDGE) as usize);
    ([i.div_euclid(EDGE), j.div_euclid(EDGE)], row * ROW + column)
}

/// Four cells of a block, the first by its place in it.
#[inline(always)]
pub fn four_of(block: &Block, at: usize) -> Four {
    [block[at], block[at + 1], block[at + ROW], block[at + ROW + 1]]
}

/// Looks a block's cells up: the last row and column after the others, for they may be in other tiles.
#[inline]
fn fill(block: &mut Block, [i, j]: [i32; 2], mut look: impl FnMut(i32, i32) -> Option<Rgb>) {
    for rows in [0..EDGE, EDGE..EDGE + 1] {
        for columns in [0..EDGE, EDGE..EDGE + 1] {
            for row in rows.clone() {
                for column in columns.clone() {
                    let shown = look(i + column, j + row);
                    block[row as usize * ROW + column as usize] =
                        shown.map_or(Vec4::ZERO, |rgb| Vec3::from(rgb.0).extend(1.0));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gather::four;
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
                let grid = Grid { direction, surface: SurfaceId(surface), sense };
                let (place, at) = holding(i, j);
                let all = four(i, j, own);
                prop_assert_eq!(four_of(recent.block(grid, place, own), at), all);
                prop_assert_eq!(four_of(recent.block(grid, place, |_, _| unreachable!()), at), all);
            }
        }
    }
}
