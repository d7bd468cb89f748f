//! Diffuse surface as receiver (section 4.2): from sums over lines to the Next Texture Map.
//!
//! Self-normalised sampling: a texel's irradiance is pi times the mean radiance over the lines that
//! strike it, each weighted by its solid angle; lines meet a texel in proportion to its projected
//! area, so the cosine is in their number. Where every line brings the same radiance the result is
//! exact (a furnace stays a furnace), however few they are.

use super::{Fixed, Quantum};
use crate::radiance::Rgb;
use crate::scene::Scene;
use crate::scene::cuts::Cuts;
use crate::scene::reflectances::Reflectances;
use crate::scene::texels::{Lattice, Texels};

/// A texel struck by fewer than this part of the lines that a whole texel would meet leans on its
/// neighbours: it lies mostly outside its polygon or in contact with another.
const FAITHFUL: f32 = 0.25;

/// P^N from the sums of a cycle, two values a texel, W sr^-1 m^-2. `struck` says how many lines struck
/// a value, with or without light; a whole texel of unit area would have `lines` of them; `filter` is
/// the number of passes of the filter.
pub fn next_textures(
    (scene, reflectances): (&Scene, &Reflectances),
    texels: &Texels,
    (sums, quantum): (&[Fixed], Quantum),
    (struck, lines): (&dyn Fn(usize) -> f64, f64),
    (filter, one_sided): (u32, bool),
) -> Vec<Rgb> {
    let mut next = vec![Rgb::BLACK; 2 * texels.len()];
    for id in scene.surface_ids() {
        let lattice = &texels.lattices[id.index()];
        let sides = if one_sided { 1 } else { 2 };
        for side in 0..sides {
            let per_texel = 1.0 / f64::from(lattice.density.x * lattice.density.y);
            let expected = (lines * per_texel) as f32;
            let on = Lain { lattice, cuts: &texels.cuts };
            let filtered = Filtered::new(on, side, (sums, quantum), struck, filter);
            let plain = reflectances.of(id);
            let is_black = plain.is_some_and(|rho| rho.is_black());
            if is_black || !one_side(on, side, &filtered, expected, &mut next) {
                continue;
            }
            for (k, texel) in texel_range(lattice).enumerate() {
                let value = &mut next[2 * texel + side];
                *value = *value * plain.unwrap_or_else(|| reflectances.at(id, k));
            }
        }
    }
    next
}

/// A lattice and what cuts it: no light is carried over from texel to texel across a cut.
#[derive(Clone, Copy)]
struct Lain<'a> {
    lattice: &'a Lattice,
    cuts: &'a Cuts,
}

impl Lain<'_> {
    /// Whether no cut parts two texels.
    fn are_joined(&self, a: usize, b: usize) -> bool {
        self.cuts.are_joined(self.lattice, a as u32, b as u32)
    }
}

fn texel_range(lattice: &Lattice) -> std::ops::Range<usize> {
    let first = lattice.first as usize;
    first..first + lattice.len()
}

/// Sums of one side of a lattice, after the filter of section 5: radiance times lines, and lines.
///
/// Lines sample texels unevenly, and small bright emitters make much of it. The filter is the binomial
/// one (1 2 1) along rows and columns, a Gaussian of variance 1/2 texel a pass. Radiance and lines are
/// filtered alike and then divided, so that borders neither darken nor lose what is even.
struct Filtered {
    radiance: Vec<[f64; 3]>,
    lines: Vec<f64>,
}

impl Filtered {
    fn new(
        on: Lain,
        side: usize,
        (sums, quantum): (&[Fixed], Quantum),
        struck: &dyn Fn(usize) -> f64,
        passes: u32,
    ) -> Filtered {
        let lattice = on.lattice;
        let sum = |texel: usize| sums[2 * texel + side];
        let unit = quantum.unit();
        let channel = |texel, c: usize| sum(texel)[c] as f64 * unit;
        let radiance = |t| [channel(t, 0), channel(t, 1), channel(t, 2)];
        let mut filtered = Filtered {
            radiance: texel_range(lattice).map(radiance).collect(),
            lines: texel_range(lattice).map(|t| struck(2 * t + side)).collect(),
        };
        let (width, height) = (lattice.width as usize, lattice.height as usize);
        for _ in 0..passes {
            for row in 0..height {
                filtered.pass(on, row * width, 1, width);
            }
            for column in 0..width {
                filtered.pass(on, column, width, height);
            }
        }
        filtered
    }

    /// Filters `count` texels from `first` on, `step` apart. What would fall over the ends, or over a
    /// cut, stays there.
    fn pass(&mut self, on: Lain, first: usize, step: usize, count: usize) {
        let at = |k: usize| first + k * step;
        let texel = |k: usize| on.lattice.first + at(k) as u32;
        let (mut before, mut before_lines) = (self.radiance[first], self.lines[first]);
        for k in 0..count {
            let (own, own_lines) = (self.radiance[at(k)], self.lines[at(k)]);
            let goes_on = k + 1 < count && on.cuts.are_joined(on.lattice, texel(k), texel(k + 1));
            let next = at(if goes_on { k + 1 } else { k });
            let blend = |c: usize| 0.25 * (before[c] + self.radiance[next][c]) + 0.5 * own[c];
            self.radiance[at(k)] = [blend(0), blend(1), blend(2)];
            self.lines[at(k)] = 0.25 * (before_lines + self.lines[next]) + 0.5 * own_lines;
            (before, before_lines) = (own, own_lines);
            if !goes_on && k + 1 < count {
                (before, before_lines) = (self.radiance[at(k + 1)], self.lines[at(k + 1)]);
            }
        }
    }
}

/// Mean incident radiance of each texel of one side into `out`. False when no line struck it.
fn one_side(on: Lain, side: usize, sums: &Filtered, expected: f32, out: &mut [Rgb]) -> bool {
    let lattice = on.lattice;
    let range = texel_range(lattice);
    let lines = |texel: usize| sums.lines[texel - range.start];
    let mut missing = Vec::new();
    for texel in range.clone() {
        let n = lines(texel);
        if n > 0.0 {
            let mean = sums.radiance[texel - range.start].map(|c| (c / n) as f32);
            out[2 * texel + side] = Rgb(mean);
        } else {
            missing.push(texel);
        }
    }
    if missing.len() == range.len() {
        return false;
    }
    lean_on_neighbours(on, side, &lines, expected, out);
    fill(on, side, missing, out);
    true
}

/// Blends texels that few lines struck with the mean of their neighbours' lines.
fn lean_on_neighbours(
    on: Lain,
    side: usize,
    lines: &dyn Fn(usize) -> f64,
    expected: f32,
    out: &mut [Rgb],
) {
    let enough = FAITHFUL * expected;
    let mut blended = Vec::new();
    for texel in texel_range(on.lattice) {
        let own = lines(texel) as f32;
        if own == 0.0 || own >= enough {
            continue;
        }
        let mut sum = Rgb::BLACK;
        let mut weight = 0.0;
        for other in neighbours(on, texel).filter(|o| on.are_joined(texel, *o)) {
            let w = lines(other) as f32;
            sum += out[2 * other + side] * w;
            weight += w;
        }
        if weight > 0.0 {
            let trust = own / enough;
            let mean = sum / weight;
            blended.push((texel, out[2 * texel + side] * trust + mean * (1.0 - trust)));
        }
    }
    for (texel, value) in blended {
        out[2 * texel + side] = value;
    }
}

/// Gives texels that no line struck the mean of their neighbours, ring by ring from those that have a
/// value, so that lookups between texels find light up to every border. Cuts are crossed only to those
/// that they shut in: nothing sees them, as the floor under a box, but cells of light fields that the
/// box's foot runs through are looked up beside lit ones.
fn fill(on: Lain, side: usize, missing: Vec<usize>, out: &mut [Rgb]) {
    let first = on.lattice.first as usize;
    let mut known = vec![true; texel_range(on.lattice).len()];
    missing.iter().for_each(|t| known[t - first] = false);
    let mut across = false;
    let mut ring = missing.clone();
    loop {
        let mut filled = Vec::new();
        for &texel in ring.iter().filter(|t| !known[**t - first]) {
            let joined = |o: &usize| across || on.are_joined(texel, *o);
            let around = neighbours(on, texel).filter(|o| known[o - first]).filter(joined);
            let (sum, count) =
                around.fold((Rgb::BLACK, 0), |(sum, n), o| (sum + out[2 * o + side], n + 1));
            if count > 0 {
                filled.push((texel, sum / count as f32));
            }
        }
        if filled.is_empty() {
            if across {
                break;
            }
            // What is left is shut in.
            across = true;
            ring.clone_from(&missing);
            continue;
        }
        for &(texel, value) in &filled {
            out[2 * texel + side] = value;
            known[texel - first] = true;
        }
        // Only beside these is there anything new to take.
        ring.clear();
        for (texel, _) in filled {
            ring.extend(neighbours(on, texel).filter(|o| !known[o - first]));
        }
        ring.sort_unstable();
        ring.dedup();
    }
}

/// The up to eight texels around one.
fn neighbours(on: Lain, texel: usize) -> impl Iterator<Item = usize> {
    let Lattice { first, width, height, .. } = *on.lattice;
    let (first, width, height) = (first as usize, width as usize, height as usize);
    let (column, row) = ((texel - first) % width, (texel - first) / width);
    let rows = row.saturating_sub(1)..(row + 2).min(height);
    rows.flat_map(move |r| {
        (column.saturating_sub(1)..(column + 2).min(width)).map(move |c| first + r * width + c)
    })
    .filter(move |other| *other != texel)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::SurfaceId;

    /// The floor of the Cornell box with lines of radiance 2 on some of its texels.
    fn floor(lines: impl Fn(u32, u32) -> i64) -> (Rgb, Lattice, Vec<Rgb>) {
        let (scene, _) = Scene::bundled("cornell").unwrap();
        let texels = Texels::new(&scene, 0.1);
        let quantum = Quantum::new(2.0);
        let lattice = texels.lattices[0];
        let mut sums: Vec<Fixed> = vec![[0; 4]; 2 * texels.len() + 1];
        let line = quantum.fixed(Rgb::splat(2.0));
        for texel in texel_range(&lattice) {
            let at = texel as u32 - lattice.first;
            for _ in 0..lines(at % lattice.width, at / lattice.width) {
                crate::bake::transfer::add::<3, 1>(&mut sums[2 * texel], &line);
            }
        }
        let struck = |value: usize| crate::bake::transfer::lines(&sums[value]);
        let reflectances = Reflectances::new(&scene, &texels);
        let scene = (&scene, &reflectances);
        let next = next_textures(scene, &texels, (&sums, quantum), (&struck, 3000.0), (0, false));
        (reflectances.at(SurfaceId(0), 0), lattice, next)
    }

    /// Self-normalised: however many lines strike a texel, few or none, equal radiance stays equal.
    #[test]
    fn equal_radiance_stays_equal_whatever_the_number_of_lines() {
        let (rho, lattice, next) = floor(|column, row| match (column, row) {
            (2..5, 2..5) => 0,
            _ => i64::from((column * 7 + row * 13) % 11),
        });
        assert!(lattice.width > 5 && lattice.height > 5);
        for texel in texel_range(&lattice) {
            for c in 0..3 {
                assert!((next[2 * texel].0[c] - 2.0 * rho.0[c]).abs() < 1e-5, "{texel}");
            }
            assert_eq!(next[2 * texel + 1], Rgb::BLACK, "the side that nothing struck");
        }
    }

    #[test]
    fn a_surface_that_no_line_struck_is_black() {
        let (_, _, next) = floor(|_, _| 0);
        assert!(next.iter().all(|v| v.is_black()));
    }
}
