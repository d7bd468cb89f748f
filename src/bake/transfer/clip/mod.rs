//! Exact clipping (section 4.2): a cell trades light with all texels that it overlaps.
//!
//! In: pairs of sides that see each other along the line of a cell, and where the cells fall on the
//! surfaces' lattices. A cell is a parallelogram on a lattice. What it sends is the mean radiance of its
//! texels, each weighted by the part of the cell that lies in it; what it receives is shared out by the
//! same weights, and so is the count of lines. Who sees whom is still decided along the middle ray.
//!
//! Shares are whole numbers that sum up to what came: no unit of energy is lost or made. Numbers up to
//! 2^51 are exact in f64, which processors multiply in vectors where they do not multiply i64.

pub mod overlap;

use self::overlap::{Cells, WHOLE, Windows};
use super::{Current, Fixed, whole};
use crate::bake::marks::Marks;
use crate::ids::{Cell, SmallCell};
use crate::level::level;
use fearless_simd::{Level, dispatch};

/// Cells that are clipped at once.
const LANES: usize = 16;

/// Classes of windows by their number of texels; the last has all larger ones.
const CLASSES: usize = 64;

/// How the cells of a PSF fall on a surface's lattice of texels, an affine map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Projection {
    /// Column and row, in texels, of the point that the origin of the PSF's grid falls on.
    pub at_origin: [f32; 2],
    /// Texels along columns and rows for each column of cells.
    pub per_column: [f32; 2],
    /// Texels along columns and rows for each row of cells.
    pub per_row: [f32; 2],
    /// Number of the lattice's first texel.
    pub first: u32,
    /// Texels along columns and rows.
    pub size: [u32; 2],
}

/// The surfaces that cells fall on.
#[derive(Clone, Copy)]
pub struct Ground<'a> {
    /// How cells fall on each surface.
    pub projections: &'a [Projection],
    /// For each texel its surface.
    pub surface_of: &'a [u32],
    /// Which texture values no light can come to, and which texels others cut.
    pub marks: &'a Marks,
}

impl Ground<'_> {
    /// How cells fall on the surface of a texture value; `None` for what stands for the space outside.
    #[inline(always)]
    fn projection(&self, value: u32) -> Option<&Projection> {
        self.surface_of.get(value as usize / 2).map(|s| &self.projections[*s as usize])
    }

    /// Whether light of a cell around a texture value may come and go through another one: not if that
    /// is sealed, nor if it is cut, for then it lies behind the cut as likely as not.
    #[inline(always)]
    fn joins(&self, value: u32) -> bool {
        self.marks.is_whole(value as usize)
    }
}

/// A texture value and its part of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tap {
    /// The texture value.
    pub value: u32,
    /// Its part of [`WHOLE`].
    pub weight: u32,
}

/// Clips cells; a worker's own memory.
pub struct Clip {
    level: Level,
    cells: Cells<LANES>,
    windows: Windows<LANES>,
    alone: (Cells<1>, Windows<1>),
    taps: Taps,
    /// Ends of pairs in the order in which they are clipped.
    order: Vec<u32>,
    /// Where the taps of each end stand.
    ends: Vec<(u32, u32)>,
}

impl Default for Clip {
    fn default() -> Clip {
        Clip::new(level())
    }
}

impl Clip {
    /// Bytes of a worker's own memory: windows, and the taps and ends of a block of cells.
    pub const BYTES: u64 = 1 << 20;

    /// Bytes for each surface.
    pub const A_SURFACE: u64 = size_of::<Projection>() as u64;

    /// With the instructions of a level. The level does not change a bit of what is found.
    pub fn new(level: Level) -> Clip {
        Clip {
            level,
            cells: Cells::default(),
            windows: Windows::default(),
            alone: (Cells::default(), Windows::default()),
            taps: Taps::default(),
            order: Vec::new(),
            ends: Vec::new(),
        }
    }

    /// Exchanges light along pairs of texture values, those under the middles of `cells`, one cell a
    /// pair: `sums` receive what `current` shoots, `SHARES` times, and `COUNTS` times as many lines.
    /// Returns what was shot, counted as often.
    pub fn exchange<const SHARES: i64, const COUNTS: i64>(
        &mut self,
        (cells, pairs): (&[SmallCell], &[[u32; 2]]),
        ground: &Ground,
        current: Current,
        sums: &mut [Fixed],
    ) -> Fixed {
        let (level, pairs) = (self.level, (cells, pairs));
        dispatch!(level, _ => self.exchange_all::<SHARES, COUNTS>(pairs, ground, current, sums))
    }

    /// Texels under the ends of the pairs that were exchanged last.
    pub fn tap_count(&self) -> usize {
        self.taps.count
    }

    #[inline(always)]
    fn exchange_all<const SHARES: i64, const COUNTS: i64>(
        &mut self,
        (cells, pairs): (&[SmallCell], &[[u32; 2]]),
        ground: &Ground,
        current: Current,
        sums: &mut [Fixed],
    ) -> Fixed {
        self.sort(pairs, ground);
        self.taps_of((cells, pairs), ground);
        let mut shot = [0; 4];
        for ends in self.ends.chunks_exact(2) {
            let [near, far] =
                [0, 1].map(|k| &self.taps.found()[ends[k].0 as usize..ends[k].1 as usize]);
            let (along, against) = (mean(near, current), mean(far, current));
            share_out::<SHARES, COUNTS>(&along, far, sums);
            share_out::<SHARES, COUNTS>(&against, near, sums);
            for c in 0..4 {
                shot[c] += SHARES * (along[c] + against[c]);
            }
        }
        shot
    }

    /// Puts the ends of pairs in order of their windows' sizes, by counting: the largest of those that
    /// are clipped at once decides how long it takes.
    #[inline(always)]
    fn sort(&mut self, pairs: &[[u32; 2]], ground: &Ground) {
        let class = |value: u32| ground.projection(value).map_or(0, Projection::class);
        let mut place = [0; CLASSES + 1];
        for value in pairs.iter().flatten() {
            place[class(*value) + 1] += 1;
        }
        for k in 0..CLASSES {
            place[k + 1] += place[k];
        }
        self.order.resize(2 * pairs.len(), 0);
        for (end, value) in pairs.iter().flatten().enumerate() {
            let place = &mut place[class(*value)];
            self.order[*place] = end as u32;
            *place += 1;
        }
    }

    /// Finds the taps of the ends of pairs.
    #[inline(always)]
    fn taps_of(&mut self, (cells, pairs): (&[SmallCell], &[[u32; 2]]), ground: &Ground) {
        self.taps.count = 0;
        self.ends.resize(2 * pairs.len(), (0, 0));
        for ends in self.order.chunks(LANES) {
            let value = |end: u32| pairs[end as usize / 2][end as usize % 2];
            for (lane, end) in ends.iter().enumerate() {
                if let Some(projection) = ground.projection(value(*end)) {
                    self.cells.set(lane, projection.place(cells[*end as usize / 2].into()));
                }
            }
            self.windows.clip(&self.cells);
            for (lane, end) in ends.iter().enumerate() {
                let from = self.taps.count as u32;
                gather(&self.windows, lane, value(*end), ground, &mut self.taps);
                self.ends[*end as usize] = (from, self.taps.count as u32);
            }
        }
    }

    /// The taps that were found last.
    pub fn last_taps(&self) -> &[Tap] {
        self.taps.found()
    }

    /// The taps of one cell around a texture value.
    pub fn taps(&mut self, cell: Cell, value: u32, ground: &Ground) -> &[Tap] {
        self.taps.count = 0;
        let (cells, windows) = &mut self.alone;
        if let Some(projection) = ground.projection(value) {
            cells.set(0, projection.place(cell));
            windows.clip(cells);
        }
        gather(windows, 0, value, ground, &mut self.taps);
        self.taps.found()
    }
}

impl Projection {
    /// The class of its cells' windows.
    #[inline(always)]
    fn class(&self) -> usize {
        let across = |axis: usize| {
            let reach = self.per_column[axis].abs() + self.per_row[axis].abs();
            if reach < overlap::REACH { reach as usize + 2 } else { CLASSES }
        };
        (across(0) * across(1)).min(CLASSES - 1)
    }

    /// A cell's middle, its edges and the size of the lattice, as [`Cells::set`] takes them.
    #[inline(always)]
    fn place(&self, cell: Cell) -> [[f32; 2]; 4] {
        let (x, y) = (cell.i as f32 + 0.5, cell.j as f32 + 0.5);
        let middle =
            |axis: usize| self.at_origin[axis] + y * self.per_row[axis] + x * self.per_column[axis];
        let size = self.size.map(|count| count as f32);
        [[middle(0), middle(1)], self.per_column, self.per_row, size]
    }
}

/// Appends the taps of one lane's window. The texel of the middle ray stands in for those through which
/// nothing may come or go.
#[inline(always)]
fn gather<const N: usize>(
    windows: &Windows<N>,
    lane: usize,
    value: u32,
    ground: &Ground,
    taps: &mut Taps,
) {
    let Some(projection) = ground.projection(value) else {
        taps.room(1)[0] = Tap { value, weight: WHOLE };
        taps.count += 1;
        return;
    };
    let [columns, rows] = windows.size;
    let [left, below] = [windows.first[0][lane], windows.first[1][lane]];
    let room = taps.room(columns * rows);
    let mut count = 0;
    // Texels outside the lattice have no weight, whatever value is written for them.
    let width = projection.size[0] as i32;
    let first = projection.first as i32 + below * width + left;
    let mut at = 2 * first + (value & 1) as i32;
    for row in windows.weights().chunks_exact(columns) {
        for (column, weights) in row.iter().enumerate() {
            let weight = weights[lane];
            // Written always, and kept if it has weight: which ones have is hard to foretell.
            room[count] = Tap { value: at as u32 + 2 * column as u32, weight };
            count += usize::from(weight > 0);
        }
        at += 2 * width;
    }
    for tap in &mut room[..count] {
        tap.value = if ground.joins(tap.value) { tap.value } else { value };
    }
    taps.count += count;
}

/// Taps of many cells, in memory that only grows.
#[derive(Default)]
struct Taps {
    all: Vec<Tap>,
    count: usize,
}

impl Taps {
    /// Those that were found.
    #[inline(always)]
    fn found(&self) -> &[Tap] {
        &self.all[..self.count]
    }

    /// Room for more behind those found.
    #[inline(always)]
    fn room(&mut self, more: usize) -> &mut [Tap] {
        if self.all.len() < self.count + more {
            self.all.resize(2 * (self.count + more), Tap { value: 0, weight: 0 });
        }
        &mut self.all[self.count..self.count + more]
    }
}

/// One part of [`WHOLE`].
const PART: f64 = 1.0 / WHOLE as f64;

/// The mean of what taps shoot.
#[inline(always)]
pub fn mean(taps: &[Tap], current: Current) -> Fixed {
    let mut sum = [0.0; 4];
    for tap in taps {
        let (shot, weight) = (&current.shots[tap.value as usize], f64::from(tap.weight));
        for c in 0..4 {
            sum[c] += f64::from(shot[c]) * weight;
        }
    }
    let units = current.quantum.units();
    let mut line = [0; 4];
    for c in 0..4 {
        line[c] = whole(sum[c] * units[c] * PART);
    }
    line
}

/// Shares a line's radiance out, `SHARES` times, and its count `COUNTS` times that. What rounding leaves
/// over goes to the first tap.
#[inline(always)]
pub fn share_out<const SHARES: i64, const COUNTS: i64>(
    line: &Fixed,
    taps: &[Tap],
    sums: &mut [Fixed],
) {
    let Some((first, others)) = taps.split_first() else { return };
    let mut rest = line.map(|l| l * SHARES);
    rest[3] *= COUNTS;
    let all = rest.map(|l| l as f64 * PART);
    for tap in others {
        let (sum, weight) = (&mut sums[tap.value as usize], f64::from(tap.weight));
        for c in 0..4 {
            // All but rounded down: the rest must not become negative.
            let share = whole(all[c] * weight - 0.4999);
            rest[c] -= share;
            sum[c] += share;
        }
    }
    let sum = &mut sums[first.value as usize];
    for c in 0..4 {
        sum[c] += rest[c];
    }
}

#[cfg(test)]
mod tests;
