use super::*;
use crate::bake::transfer::{FROM_OUTSIDE, Quantum, Shot, shot};
use crate::radiance::Rgb;
use glam::DVec2;
use proptest::prelude::*;

/// The part of a convex polygon on one side of a line: where `inside` is not negative.
fn cut(polygon: &[DVec2], inside: impl Fn(DVec2) -> f64) -> Vec<DVec2> {
    let mut kept = Vec::new();
    for (k, &b) in polygon.iter().enumerate() {
        let a = polygon[(k + polygon.len() - 1) % polygon.len()];
        let (da, db) = (inside(a), inside(b));
        if da * db < 0.0 {
            kept.push(a + (b - a) * (da / (da - db)));
        }
        if db >= 0.0 {
            kept.push(b);
        }
    }
    kept
}

/// Area of the overlap of a polygon with a box, by clipping (Sutherland and Hodgman 1974).
fn overlap(polygon: &[DVec2], low: DVec2, high: DVec2) -> f64 {
    let p = cut(polygon, |p| p.x - low.x);
    let p = cut(&p, |p| high.x - p.x);
    let p = cut(&p, |p| p.y - low.y);
    let p = cut(&p, |p| high.y - p.y);
    let doubled = |k: usize| p[k].perp_dot(p[(k + 1) % p.len()]);
    0.5 * (0..p.len()).map(doubled).sum::<f64>().abs()
}

fn parallelogram([middle, across, up, _]: [[f32; 2]; 4]) -> Vec<DVec2> {
    let [m, a, b] = [middle, across, up].map(|v| DVec2::new(v[0].into(), v[1].into()));
    let corner = m - (a + b) / 2.0;
    vec![corner, corner + a, corner + a + b, corner + b]
}

/// A cell that reaches over at most [`overlap::REACH`] texels, its middle on the lattice.
fn a_cell() -> impl Strategy<Value = [[f32; 2]; 4]> {
    let edge = || prop::array::uniform2(-2.5f32..2.5);
    let special = prop_oneof![Just(0.0f32), Just(1.0), Just(-1.0), Just(0.5), Just(2.0)];
    let snapped = prop::array::uniform2(special);
    (
        prop::array::uniform2(prop_oneof![4 => 0.0f32..1.0, 1 => 0.9990f32..1.0]),
        prop_oneof![4 => edge(), 1 => snapped],
        edge(),
        1..40u32,
        1..40u32,
    )
        .prop_filter("too thin for f32", |(_, a, b, ..)| (a[0] * b[1] - a[1] * b[0]).abs() > 0.02)
        .prop_map(|(at, a, b, w, h)| {
            let size = [w as f32, h as f32];
            [[at[0] * size[0], at[1] * size[1]], a, b, size]
        })
}

proptest! {
    /// Each texel's weight is its part of what lies inside the lattice.
    #[test]
    fn weights_are_the_areas_that_a_polygon_clipper_finds(cell in a_cell()) {
        let (mut cells, mut windows) = (Cells::<1>::default(), Windows::<1>::default());
        cells.set(0, cell);
        windows.clip(&cells);
        let corners = parallelogram(cell);
        let size = DVec2::new(cell[3][0].into(), cell[3][1].into());
        let inside = overlap(&corners, DVec2::ZERO, size);
        let whole = (corners[1] - corners[0]).perp_dot(corners[3] - corners[0]).abs();
        prop_assume!(inside > 0.01 * whole);
        let [columns, _] = windows.size;
        let mut total = 0;
        let mut found = 0.0;
        for (at, weight) in windows.weights().iter().enumerate() {
            let column = windows.first[0][0] + (at % columns) as i32;
            let row = windows.first[1][0] + (at / columns) as i32;
            let low = DVec2::new(column.into(), row.into());
            let is_texel = low.cmpge(DVec2::ZERO).all() && low.cmplt(size).all();
            let area = if is_texel { overlap(&corners, low, low + 1.0) } else { 0.0 };
            total += weight[0];
            found += area;
            let (weight, exact) = (f64::from(weight[0]) / f64::from(WHOLE), area / inside);
            // Of the largest weight, the rounding of all; else half a part, and f32's own.
            let most = 1e-4 + 1e-5 / inside;
            prop_assert!((weight - exact).abs() < most,
                "texel {column}, {row}: {weight}, exactly {exact}, area {inside}");
            prop_assert!(is_texel || weight == 0.0, "outside the lattice");
        }
        prop_assert_eq!(total, WHOLE);
        prop_assert!((found / inside - 1.0).abs() < 1e-5, "texels outside the window: {found} of {inside}");
        let largest = windows.weights()[windows.largest[0] as usize][0];
        let most = windows.weights().iter().map(|w| w[0]).max().unwrap_or(0);
        prop_assert!(most - largest <= windows.weights().len() as u32, "up to rounding");
    }

    /// However flat a cell is seen, wherever its middle: its weights sum up to the whole, and those of
    /// texels outside the lattice are nothing.
    #[test]
    fn weights_of_any_cell_sum_up_to_the_whole(
        middle in prop::array::uniform2(-3.0f32..43.0), scale in prop::array::uniform2(-7.0f32..7.0),
        a in prop::array::uniform2(-1.0f32..1.0), b in prop::array::uniform2(-1.0f32..1.0),
        size in prop::array::uniform2(1..40u32),
    ) {
        let (mut cells, mut windows) = (Cells::<1>::default(), Windows::<1>::default());
        let times = |v: [f32; 2], s: f32| v.map(|c| c * 10f32.powf(s));
        cells.set(0, [middle, times(a, scale[0]), times(b, scale[1]), size.map(|s| s as f32)]);
        windows.clip(&cells);
        let [columns, _] = windows.size;
        for (at, weight) in windows.weights().iter().enumerate() {
            let (column, row) = ((at % columns) as i32, (at / columns) as i32);
            let (c, r) = (windows.first[0][0] + column, windows.first[1][0] + row);
            let inside = (0..size[0] as i32).contains(&c) && (0..size[1] as i32).contains(&r);
            prop_assert!(inside || weight[0] == 0, "{c}, {r} of {size:?}: {}", weight[0]);
        }
        let total = windows.weights().iter().map(|w| u64::from(w[0])).sum::<u64>();
        prop_assert_eq!(total, u64::from(WHOLE));
    }

    /// What leaves is what arrives, to the last unit, and nothing of it is negative.
    #[test]
    fn shares_sum_up_to_the_line(
        line in prop::array::uniform3(0..1i64 << 36), weights in prop::collection::vec(1..1000u32, 1..20),
        dim in 0..36u32,
    ) {
        let sum: u32 = weights.iter().sum();
        let mut taps: Vec<Tap> = (0..).zip(&weights).map(|(value, w)| Tap { value, weight: w * WHOLE / sum }).collect();
        taps[0].weight += WHOLE - taps.iter().map(|t| t.weight).sum::<u32>();
        let line = [line[0] >> dim, line[1] >> dim, line[2], i64::from(WHOLE)];
        let mut sums = vec![[0; 4]; weights.len()];
        share_out::<3, 1>(&line, &taps, &mut sums);
        for c in 0..4 {
            prop_assert_eq!(sums.iter().map(|s| s[c]).sum::<i64>(), 3 * line[c]);
        }
        prop_assert!(sums.iter().flatten().all(|s| *s >= 0));
        for tap in &taps {
            prop_assert_eq!(sums[tap.value as usize][3], 3 * i64::from(tap.weight));
        }
        // Where all texels shoot the same, so does the cell.
        let shots = vec![shot(Rgb([0, 1, 2].map(|c| line[c] as f32))); weights.len()];
        let current = Current { shots: &shots, quantum: Quantum::new(36f32.exp2()) };
        prop_assert_eq!(mean(&taps, current), current.line(0));
    }
}

/// Two lattices that face each other and many pairs of cells.
struct Facing {
    projections: [Projection; 2],
    surface_of: Vec<u32>,
    marks: Marks,
    shots: Vec<Shot>,
    cells: Vec<SmallCell>,
    pairs: Vec<[u32; 2]>,
}

const EDGE: u32 = 40;

impl Facing {
    fn new() -> Facing {
        let texels = EDGE * EDGE;
        let lattice = |first, per_column, per_row| Projection {
            at_origin: [1.3, -0.4],
            per_column,
            per_row,
            first,
            size: [EDGE; 2],
        };
        let values = 4 * texels as usize;
        let light = |v: usize| ((v as u64 * 2_654_435_761) % (1 << 24)) as f32;
        let light = |v: usize| shot(Rgb([light(v), light(v + 1), light(v + 2)]));
        let shots = (0..values).map(light).chain([FROM_OUTSIDE]).collect();
        let projections =
            [lattice(0, [0.9, 0.3], [-0.4, 1.1]), lattice(texels, [-0.2, 0.8], [1.4, 0.5])];
        let (mut cells, mut pairs) = (Vec::new(), Vec::new());
        for (k, j) in (0..30).flat_map(|j| (0..31).map(move |i| (i, j))).enumerate() {
            let cell = Cell { i: j.0, j: j.1 };
            let value = |at: usize| {
                let p = &projections[at];
                let [[x, y], ..] = p.place(cell);
                let inside = |c: f32| (c.max(0.0) as u32).min(EDGE - 1);
                2 * (p.first + inside(y) * EDGE + inside(x)) + at as u32
            };
            let far = if k % 7 == 0 { values as u32 } else { value(1) };
            cells.push(cell.into());
            pairs.push([value(0), far]);
        }
        let surface_of = (0..2 * texels).map(|t| t / texels).collect();
        Facing { projections, surface_of, marks: Marks::none(values / 2), shots, cells, pairs }
    }

    fn current(&self) -> Current<'_> {
        Current { shots: &self.shots, quantum: Quantum::new(2f32.powi(24)) }
    }

    fn exchange(&self, level: Level) -> (Fixed, Vec<Fixed>) {
        let ground = Ground {
            projections: &self.projections,
            surface_of: &self.surface_of,
            marks: &self.marks,
        };
        let mut sums = vec![[0; 4]; self.shots.len()];
        let mut clip = Clip::new(level);
        let (pairs, current) = ((self.cells.as_slice(), self.pairs.as_slice()), self.current());
        let shot = clip.exchange::<2, 1>(pairs, &ground, current, &mut sums);
        (shot, sums)
    }
}

#[test]
fn all_levels_of_instructions_find_the_same_bits() {
    let facing = Facing::new();
    let plain = facing.exchange(Level::baseline());
    for level in crate::level::all() {
        assert!(facing.exchange(level) == plain, "{level:?}");
    }
}

/// One cell alone finds what it finds among others.
#[test]
fn a_cell_alone_has_the_taps_it_has_among_others() {
    let facing = Facing::new();
    let ground = Ground {
        projections: &facing.projections,
        surface_of: &facing.surface_of,
        marks: &facing.marks,
    };
    let mut clip = Clip::default();
    let mut sums = vec![[0; 4]; facing.shots.len()];
    for (cell, pair) in facing.cells.iter().zip(&facing.pairs) {
        let [near, far] = pair.map(|value| clip.taps((*cell).into(), value, &ground).to_vec());
        share_out::<2, 1>(&mean(&near, facing.current()), &far, &mut sums);
        share_out::<2, 1>(&mean(&far, facing.current()), &near, &mut sums);
    }
    assert!(sums == facing.exchange(Level::new()).1);
}

#[test]
fn what_is_shot_arrives() {
    let facing = Facing::new();
    let (shot, sums) = facing.exchange(Level::new());
    for c in 0..4 {
        assert_eq!(shot[c], sums.iter().map(|s| s[c]).sum::<i64>());
    }
    assert_eq!(shot[3], 4 * i64::from(WHOLE) * facing.pairs.len() as i64);
}
