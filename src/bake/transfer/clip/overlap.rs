//! Overlap of cells with texels, in closed form (section 4.2, "polygon clipping").
//!
//! In: cells as they fall on lattices of texels, parallelograms, many at once. Out: the part of each
//! that lies in each texel of a window around it, in whole numbers that sum up to [`WHOLE`].
//!
//! The area of a parallelogram to the lower left of a lattice point is a sum over its edges of the
//! integral of `min(x, X)` over the part of the edge below `Y` (Green). Differences of that area from
//! point to point are the texels' parts. Plain loops over arrays, for the compiler to vectorise: no
//! operation depends on how wide the processor's registers are, and so does no bit of the result.

/// What the weights of a cell sum up to.
pub const WHOLE: u32 = 1 << 16;

/// Texels along an axis that a cell may reach over. One seen at so flat an angle that it would reach
/// farther is shortened around its middle; such cells carry next to no light.
pub const REACH: f32 = 16.0;

/// Texels along an edge of a window.
const EDGE: usize = REACH as usize + 2;

/// Of a cell's area, what must lie inside the lattice for its parts to mean anything.
const FAINT: f32 = 1e-4;

/// Keeps quotients of nothing finite.
const TINY: f32 = 1e-30;

/// Added to a number below 2^23, leaves the nearest whole number in the low bits.
const TO_BITS: f32 = 8_388_608.0;

/// Cells on their lattices, as many as there are lanes. Coordinates are in texels, along columns and
/// rows; lattices begin at 0.
#[derive(Clone, Debug)]
pub struct Cells<const LANES: usize> {
    /// Where the cell's middle falls.
    pub middle: [[f32; LANES]; 2],
    /// One edge of the cell.
    pub across: [[f32; LANES]; 2],
    /// The other edge.
    pub up: [[f32; LANES]; 2],
    /// Texels along the lattice.
    pub size: [[f32; LANES]; 2],
}

impl<const LANES: usize> Default for Cells<LANES> {
    /// Unit cells in the middle of single texels.
    fn default() -> Cells<LANES> {
        Cells {
            middle: [[0.5; LANES]; 2],
            across: [[1.0; LANES], [0.0; LANES]],
            up: [[0.0; LANES], [1.0; LANES]],
            size: [[1.0; LANES]; 2],
        }
    }
}

impl<const LANES: usize> Cells<LANES> {
    /// Sets one cell: its middle, its edges and the size of its lattice.
    pub fn set(&mut self, lane: usize, [middle, across, up, size]: [[f32; 2]; 4]) {
        for axis in 0..2 {
            self.middle[axis][lane] = middle[axis];
            self.across[axis][lane] = across[axis];
            self.up[axis][lane] = up[axis];
            self.size[axis][lane] = size[axis];
        }
    }
}

/// Windows of texels with the parts of the cells that lie in them.
#[derive(Clone, Debug)]
pub struct Windows<const LANES: usize> {
    /// Column and row of a window's first texel; those outside the lattice have no weight.
    pub first: [[i32; LANES]; 2],
    /// Texels of a window along columns and rows, the same for all cells.
    pub size: [usize; 2],
    /// Where in the window the largest weight stands.
    pub largest: [u32; LANES],
    /// Weights, row by row.
    weights: Vec<[u32; LANES]>,
    areas: Vec<[f32; LANES]>,
}

/// Cells with windows around them.
struct Placed<const LANES: usize> {
    corners: Corners<LANES>,
    /// Area of the whole cell, in texels.
    whole: [f32; LANES],
    /// The middle's texel, from the window's first texel on.
    middle: [[i32; LANES]; 2],
    /// The texel after the last one that the cell reaches and the lattice has.
    end: [[f32; LANES]; 2],
}

/// The corners of parallelograms, counter-clockwise with columns to the right and rows upward.
struct Corners<const LANES: usize> {
    x: [[f32; LANES]; 4],
    y: [[f32; LANES]; 4],
    /// Columns per row along the edge from each corner to the next; 0 for edges along a row.
    slope: [[f32; LANES]; 4],
}

/// The parts of edges below a row's upper border: their height and columns at both ends.
struct Below<const LANES: usize> {
    height: [[f32; LANES]; 4],
    from: [[f32; LANES]; 4],
    to: [[f32; LANES]; 4],
}

impl<const LANES: usize> Default for Windows<LANES> {
    /// Room for any.
    fn default() -> Windows<LANES> {
        Windows {
            first: [[0; LANES]; 2],
            size: [0; 2],
            largest: [0; LANES],
            weights: vec![[0; LANES]; EDGE * EDGE],
            areas: vec![[0.0; LANES]; EDGE * EDGE],
        }
    }
}

impl<const LANES: usize> Windows<LANES> {
    /// The weights of the windows' texels, row by row.
    pub fn weights(&self) -> &[[u32; LANES]] {
        &self.weights[..self.size[0] * self.size[1]]
    }

    /// Finds the windows and weights of cells.
    #[inline(always)]
    pub fn clip(&mut self, cells: &Cells<LANES>) {
        let placed = self.place(cells);
        self.sweep(&placed.corners);
        self.weigh(&placed);
    }

    /// Lays a window around each cell.
    #[inline(always)]
    fn place(&mut self, cells: &Cells<LANES>) -> Placed<LANES> {
        let mut corners =
            Corners { x: [[0.0; LANES]; 4], y: [[0.0; LANES]; 4], slope: [[0.0; LANES]; 4] };
        let (mut whole, mut middle) = ([0.0; LANES], [[0; LANES]; 2]);
        let (mut count, mut end) = ([[0; LANES]; 2], [[0.0; LANES]; 2]);
        for k in 0..LANES {
            let ([mut ax, mut bx], [mut ay, mut by]) =
                ([cells.across[0][k], cells.up[0][k]], [cells.across[1][k], cells.up[1][k]]);
            if ax * by < ay * bx {
                (ax, ay, bx, by) = (bx, by, ax, ay);
            }
            let (rx, ry) = (0.5 * (ax.abs() + bx.abs()), 0.5 * (ay.abs() + by.abs()));
            let farther = if rx > ry { rx } else { ry };
            let short = if farther > 0.5 * REACH { 0.5 * REACH / farther } else { 1.0 };
            (ax, ay, bx, by) = (short * ax, short * ay, short * bx, short * by);
            whole[k] = ax * by - ay * bx;
            let mut local = [0.0; 2];
            for (axis, reach) in [(0, short * rx), (1, short * ry)] {
                // Rounding must not put the middle outside, here or below.
                let (at, size) = (cells.middle[axis][k], cells.size[axis][k]);
                let most = size - 2.0 * f32::EPSILON * (size + 2.0 * REACH);
                let at = if at < 0.0 { 0.0 } else { at };
                let at = if at > most { most } else { at };
                // The offset makes it positive; truncation is then the floor.
                let first = (at - reach + 2.0 * REACH) as i32 - 2 * REACH as i32;
                self.first[axis][k] = first;
                local[axis] = at - first as f32;
                middle[axis][k] = local[axis] as i32;
                count[axis][k] = (local[axis] + reach) as i32 + 1;
                let reached = (first + count[axis][k]) as f32;
                end[axis][k] = if reached < size { reached } else { size };
            }
            let (x, y) = (local[0] - 0.5 * (ax + bx), local[1] - 0.5 * (ay + by));
            let (xs, ys) = ([x, x + ax, x + ax + bx, x + bx], [y, y + ay, y + ay + by, y + by]);
            let (a, b) =
                (if ay == 0.0 { 0.0 } else { ax / ay }, if by == 0.0 { 0.0 } else { bx / by });
            for (edge, slope) in [a, b, a, b].into_iter().enumerate() {
                corners.x[edge][k] = xs[edge];
                corners.y[edge][k] = ys[edge];
                corners.slope[edge][k] = slope;
            }
        }
        let most = |count: &[i32; LANES]| count.iter().fold(1, |a, b| a.max(*b)) as usize;
        self.size = [0, 1].map(|axis| most(&count[axis]).min(EDGE));
        Placed { corners, whole, middle, end }
    }

    /// Sweeps over the windows' rows and finds the area of the cells in each texel.
    #[inline(always)]
    fn sweep(&mut self, corners: &Corners<LANES>) {
        let [columns, rows] = self.size;
        // Area left of each column's right border, in the rows so far.
        let mut before = [[0.0f32; LANES]; EDGE];
        for row in 0..rows {
            let below = corners.below((row + 1) as f32);
            let texels = &mut self.areas[row * columns..(row + 1) * columns];
            let mut left = [0.0f32; LANES];
            for (column, (texel, before)) in texels.iter_mut().zip(&mut before).enumerate() {
                let border = (column + 1) as f32;
                for k in 0..LANES {
                    let mut area = 0.0;
                    for edge in 0..4 {
                        let (p, q) = (below.from[edge][k] - border, below.to[edge][k] - border);
                        // The mean of min(x, border) - border over the edge: half the sum of what is
                        // left of the border, times the part of the edge that is.
                        let inside = if p < 0.0 { p } else { 0.0 } + if q < 0.0 { q } else { 0.0 };
                        let reach = p.abs() + q.abs() + TINY;
                        area += below.height[edge][k] * (inside * inside / reach);
                    }
                    // To the left, and so far below; less what was to the left before.
                    let so_far = -0.5 * area;
                    let strip = so_far - before[k];
                    before[k] = so_far;
                    texel[k] = strip - left[k];
                    left[k] = strip;
                }
            }
        }
    }

    /// Turns areas into weights.
    #[inline(always)]
    fn weigh(&mut self, placed: &Placed<LANES>) {
        let [columns, rows] = self.size;
        let mut inside = [0.0f32; LANES];
        for (at, area) in self.areas[..columns * rows].iter_mut().enumerate() {
            let (column, row) = ((at % columns) as i32, (at / columns) as i32);
            for k in 0..LANES {
                let (c, r) = ((self.first[0][k] + column) as f32, (self.first[1][k] + row) as f32);
                // Beyond what the cell reaches, rounding would leave something of other windows' sizes.
                let is_inside =
                    (c >= 0.0) & (c < placed.end[0][k]) & (r >= 0.0) & (r < placed.end[1][k]);
                area[k] = if is_inside & (area[k] > 0.0) { area[k] } else { 0.0 };
                inside[k] += area[k];
            }
        }
        let mut scale = [0.0f32; LANES];
        let (mut left, mut most) = ([WHOLE; LANES], [0u32; LANES]);
        for k in 0..LANES {
            let all = WHOLE as f32 / (inside[k] + TINY);
            scale[k] = if inside[k] > FAINT * placed.whole[k] { all } else { 0.0 };
            // Where the parts mean nothing, all goes to the texel under the middle.
            self.largest[k] = (placed.middle[1][k] * columns as i32 + placed.middle[0][k]) as u32;
        }
        let areas = &self.areas[..columns * rows];
        for (at, (weight, area)) in self.weights.iter_mut().zip(areas).enumerate() {
            for k in 0..LANES {
                let w = (area[k] * scale[k] + TO_BITS).to_bits().wrapping_sub(TO_BITS.to_bits());
                weight[k] = w;
                left[k] = left[k].wrapping_sub(w);
                let more = w > most[k];
                most[k] = if more { w } else { most[k] };
                self.largest[k] = if more { at as u32 } else { self.largest[k] };
            }
        }
        for (k, left) in left.into_iter().enumerate() {
            // What rounding left over or took too much of.
            let weight = &mut self.weights[self.largest[k] as usize][k];
            *weight = weight.wrapping_add(left);
        }
    }
}

impl<const LANES: usize> Corners<LANES> {
    /// The parts of the edges below a height.
    #[inline(always)]
    fn below(&self, height: f32) -> Below<LANES> {
        let mut below =
            Below { height: [[0.0; LANES]; 4], from: [[0.0; LANES]; 4], to: [[0.0; LANES]; 4] };
        for edge in 0..4 {
            let next = (edge + 1) % 4;
            for k in 0..LANES {
                let (x, y, slope) = (self.x[edge][k], self.y[edge][k], self.slope[edge][k]);
                let end = self.y[next][k];
                let low = if y < height { y } else { height };
                let high = if end < height { end } else { height };
                below.height[edge][k] = high - low;
                below.from[edge][k] = x + (low - y) * slope;
                below.to[edge][k] = x + (high - y) * slope;
            }
        }
        below
    }
}
