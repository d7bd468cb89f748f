//! Windows: the cells of a PSF that some surfaces cover, when only these send light.
//!
//! In: runs of cells. Out: the cells, and for any run of a row the places of those of its cells that
//! the window holds. Small emitters cover few cells of a PSF; rasterising only these makes a PSF cheap,
//! so that direct light can have many more of them (section 5: perturb the first cycles most).

use crate::ids::Cell;
use glam::Vec3;

/// A set of cells of a square grid.
#[derive(Default)]
pub struct Window {
    /// Words of 64 cells in a row.
    words: usize,
    /// One bit a cell, row by row, low bit first.
    bits: Vec<u64>,
    /// For each word, how many cells the words before it hold.
    before: Vec<u32>,
    cells: Vec<Cell>,
    /// Columns and rows that the cells lie in, half open.
    columns: (u32, u32),
    rows: (u32, u32),
}

impl Window {
    /// Empties it, for a grid of `n` by `n` cells.
    pub fn clear(&mut self, n: u32) {
        self.words = (n as usize).div_ceil(64);
        self.bits.clear();
        self.bits.resize(self.words * n as usize, 0);
        (self.columns, self.rows) = ((n, 0), (n, 0));
    }

    /// Adds the cells `from..to` of a row.
    pub fn open(&mut self, row: u32, (from, to): (u32, u32)) {
        let first = row as usize * self.words;
        for word in from / 64..to.div_ceil(64) {
            self.bits[first + word as usize] |= run(word, from, to);
        }
        self.columns = (self.columns.0.min(from), self.columns.1.max(to));
        self.rows = (self.rows.0.min(row), self.rows.1.max(row + 1));
    }

    /// Numbers its cells: after this it is complete.
    pub fn close(&mut self) {
        self.before.clear();
        self.cells.clear();
        let words = self.words.max(1);
        for (at, bits) in self.bits.iter().enumerate() {
            self.before.push(self.cells.len() as u32);
            let (row, word) = ((at / words) as u32, (at % words) as u32);
            let mut left = *bits;
            while left != 0 {
                self.cells.push(Cell { i: 64 * word + left.trailing_zeros(), j: row });
                left &= left - 1;
            }
        }
    }

    /// Whether it holds a cell of its grid.
    #[inline]
    pub fn has(&self, cell: Cell) -> bool {
        let word = cell.j as usize * self.words + cell.i as usize / 64;
        self.bits[word] >> (cell.i % 64) & 1 == 1
    }

    /// Its cells, row by row.
    pub fn cells(&self) -> &[Cell] {
        &self.cells
    }

    /// The rows that its cells lie in, half open.
    pub fn rows(&self) -> (u32, u32) {
        self.rows
    }

    /// Whether a polygon with these corners (column, row, depth) may cover any of its cells.
    pub fn may_meet(&self, corners: &[Vec3]) -> bool {
        let low = corners.iter().fold(Vec3::MAX, |m, c| m.min(*c));
        let high = corners.iter().fold(Vec3::MIN, |m, c| m.max(*c));
        low.x < self.columns.1 as f32
            && high.x > self.columns.0 as f32
            && low.y < self.rows.1 as f32
            && high.y > self.rows.0 as f32
    }

    /// Calls `visit` with the place and the column of each of its cells among `from..to` of a row.
    #[inline]
    pub fn for_each(&self, row: u32, (from, to): (u32, u32), mut visit: impl FnMut(usize, u32)) {
        let first = row as usize * self.words;
        for word in from / 64..to.div_ceil(64) {
            let (bits, run) = (self.bits[first + word as usize], run(word, from, to));
            let mut left = bits & run;
            if left == 0 {
                continue;
            }
            let skipped = bits & (run & run.wrapping_neg()).wrapping_sub(1);
            let mut place = (self.before[first + word as usize] + skipped.count_ones()) as usize;
            while left != 0 {
                visit(place, 64 * word + left.trailing_zeros());
                place += 1;
                left &= left - 1;
            }
        }
    }
}

/// The bits of a word that stand for cells `from..to`, of which it holds one at least.
fn run(word: u32, from: u32, to: u32) -> u64 {
    let (low, high) = (from.max(64 * word) - 64 * word, to.min(64 * (word + 1)) - 64 * word);
    (u64::MAX >> (64 - (high - low))) << low
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    proptest! {
        /// Any runs: the window holds their cells, in order, and finds those of any other run.
        #[test]
        fn it_holds_the_cells_of_its_runs(
            n in 1u32..200,
            runs in prop::collection::vec((0.0f64..1.0, 0.0f64..1.0, 0.0f64..1.0), 0..12),
            asked in (0.0f64..1.0, 0.0f64..1.0, 0.0f64..1.0),
        ) {
            let cut = |(row, a, b): (f64, f64, f64)| {
                let at = |v: f64| (v * f64::from(n)) as u32;
                (at(row), at(a.min(b)), at(a.max(b)) + 1)
            };
            let mut window = Window::default();
            window.clear(n);
            let mut cells = BTreeSet::new();
            for (row, from, to) in runs.into_iter().map(cut) {
                window.open(row, (from, to));
                cells.extend((from..to).map(|i| (row, i)));
            }
            window.close();
            let found: Vec<_> = window.cells().iter().map(|c| (c.j, c.i)).collect();
            prop_assert_eq!(&found, &cells.into_iter().collect::<Vec<_>>());
            let (row, from, to) = cut(asked);
            let mut met = Vec::new();
            window.for_each(row, (from, to), |place, column| met.push((place, (row, column))));
            let expected = found.iter().copied().enumerate();
            let inside = |(_, (j, i)): &(usize, (u32, u32))| *j == row && (from..to).contains(i);
            prop_assert_eq!(met, expected.filter(inside).collect::<Vec<_>>());
        }
    }
}
