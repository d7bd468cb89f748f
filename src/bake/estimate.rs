//! How wrong the texture maps are, judged from the lines themselves.
//!
//! In: the Total Texture Map of all lines, and that of one half of them. Out: the squared error that
//! pictures of them will have, relative as `vlf compare` has it.
//!
//! Two things are wrong with a texture map. Its lines are finitely many: what one half of them says
//! differs from what both say by as much as both are wrong, were the halves independent; those of a
//! lattice make up for each other, and what both say is better than that (`LATTICE`). And between
//! texels radiance is bilinear, of averages over texels: an edge of light is washed out. How much
//! follows from the map's second differences (`WASHED_OUT`), less what of them the halves do not agree
//! on. Cycles add up in the maps, so that what their errors have in common is in the estimate.

use crate::directions::Directions;
use crate::format::limits;
use crate::format::manifest::{ErrorEstimate, SurfaceError};
use crate::ids::SurfaceId;
use crate::radiance::Rgb;
use crate::scene::Scene;
use crate::scene::texels::{Lattice, Texels};
use rayon::prelude::*;

/// What part of the mean square of the halves' disagreement is error. All of it if they were independent;
/// a third if each were a lattice and the error fell as the number of lines; measured is a half.
const LATTICE: f64 = 0.5;

/// Mean squared error of bilinear lookups in averages over texels, in parts of the mean squared
/// second difference. By theory 1/64 where radiance is smooth, 1/35 at kinks, 1/23 at ramps a texel
/// wide, 1/8 at steps; edges of shadows are ramps of about a texel.
const WASHED_OUT: f64 = 1.0 / 24.0;

/// What keeps relative errors finite, in parts of the squared mean radiance.
const EPSILON: f64 = 0.01;

/// What part of the error aimed at the noise may have at least.
const LEAST: f64 = 0.25;

/// Texels whose noise is told well by what the halves of their lines say. A surface of fewer is taken to be
/// in part as noisy as the scene is.
const TELLING: f64 = 64.0;

/// The half of all lines that a PSF belongs to, 0 or 1, from the [`Directions::colour`] of its line:
/// lines that are neighbours in their lattice, and PSFs of a line that follow each other, are in
/// different ones.
pub fn half_of(colour: u32, number: u32) -> usize {
    ((colour + number) % 2) as usize
}

/// How many of a line's `grids` are in half 0, on the average over the lines of a cycle.
pub fn grids_of_half(directions: &Directions, thinned: u32, grids: u32) -> f64 {
    let (mut own, mut all) = (0, 0);
    for id in directions.ids().filter(|id| directions.is_in_coarser(*id, thinned)) {
        let shares = u64::from(directions.shares(id));
        let skipped = half_of(directions.colour(id, thinned), 0) as u64;
        own += shares * ((u64::from(grids) + 1 - skipped) / 2);
        all += shares;
    }
    own as f64 / all as f64
}

/// The noise that pictures of relMSE `target` may have after a cycle (from 0). Lines do not help what the
/// texels' size spoils, `washed_out`; so noise may take what that leaves of the target, and a quarter of it
/// in any case. The first cycle may take half of this, the second half of the rest, and so on.
fn granted(washed_out: f64, target: f64, cycle: u32) -> f64 {
    (target - washed_out).max(LEAST * target) * (1.0 - 0.5f64.powi(cycle as i32 + 1))
}

/// The surfaces that lack lines for pictures of relMSE `target` after some of a cycle's (from 0); none when
/// all together have enough.
///
/// Lines cost alike wherever they end, and noise falls as their number to the power of -3/2. So the same
/// error of all together takes the fewest when, at the end, the noise of each surface is in proportion to
/// its lines: calm surfaces end sooner and with less noise than the others.
pub fn lacking(surfaces: &[Errors], target: f64, cycle: u32) -> Vec<SurfaceId> {
    let sum = |of: fn(&Errors) -> f64| surfaces.iter().map(of).sum::<f64>();
    let area = sum(|s| s.area);
    let (noise, washed_out) = (sum(|s| s.noise) / area, sum(|s| s.washed_out) / area);
    let granted = granted(washed_out, target, cycle);
    if area <= 0.0 || noise <= granted {
        return Vec::new();
    }
    // What part of all lines those so far are, from what they are to bring about yet.
    let so_far = (granted / noise).powf(2.0 / 3.0);
    let lacks = |s: &&Errors| {
        let told = f64::from(s.texels) / TELLING;
        (told * s.noise / s.area + noise) / (told + 1.0) > granted * so_far
    };
    surfaces.iter().filter(lacks).map(|s| s.surface).collect()
}

/// Total texture maps, two values a texel, W sr^-1 m^-2.
#[derive(Clone, Copy)]
pub struct Totals<'a> {
    /// Of all lines.
    pub all: &'a [Rgb],
    /// Of half of them.
    pub half: &'a [Rgb],
}

/// What is wrong with a surface: sums over the texels of its lit sides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Errors {
    /// Which.
    pub surface: SurfaceId,
    /// Texels of all sides.
    pub texels: u32,
    /// Area of all sides.
    pub area: f64,
    /// Area times relative squared error that comes from the number of lines.
    pub noise: f64,
    /// The same that comes from the size of texels.
    pub washed_out: f64,
}

/// The error of texture maps, of all surfaces that have any light.
pub fn estimate(surfaces: &[Errors]) -> ErrorEstimate {
    let sum = |of: fn(&Errors) -> f64| surfaces.iter().map(of).sum::<f64>();
    let (area, noise) = (sum(|s| s.area), sum(|s| s.noise));
    let error = noise + sum(|s| s.washed_out);
    if area <= 0.0 {
        return ErrorEstimate::default();
    }
    let part = |of: f64, all: f64| if all > 0.0 { of / all } else { 0.0 };
    let stated = |s: &Errors| {
        let own = s.noise + s.washed_out;
        SurfaceError { surface: s.surface.0, relmse: part(own, s.area), part: part(own, error) }
    };
    let mut worst: Vec<SurfaceError> = surfaces.iter().map(stated).collect();
    worst.sort_by(|a, b| b.part.total_cmp(&a.part).then(a.surface.cmp(&b.surface)));
    worst.truncate(limits::WORST);
    ErrorEstimate { relmse: error / area, noise: noise / area, worst }
}

/// The error of texture maps, surface by surface, weighted by `areas`, one for each value. Sides without any
/// light count for nothing: as a rule, nobody sees them.
pub fn by_surface(scene: &Scene, texels: &Texels, areas: &[f64], maps: Totals) -> Vec<Errors> {
    let sides = || {
        let diffuse = |id: &SurfaceId| !scene.material_of(*id).reflectance.is_mirror();
        let sides = scene.surface_ids().filter(diffuse).flat_map(|id| [(id, 0), (id, 1)]);
        let sides = sides
            .map(|(id, side)| (id, Sheet { texels, lattice: &texels.lattices[id.index()], side }));
        sides.filter(|(_, sheet)| sheet.values().any(|v| !maps.all[v].is_black()))
    };
    let (mut light, mut area) = (0.0, 0.0);
    for value in sides().flat_map(|(_, sheet)| sheet.values()) {
        light += areas[value] * f64::from(maps.all[value].mean());
        area += areas[value];
    }
    if light <= 0.0 {
        return Vec::new();
    }
    let epsilon = EPSILON * (light / area).powi(2);
    let mut surfaces: Vec<Errors> = Vec::new();
    let sides: Vec<(SurfaceId, Sheet)> = sides().collect();
    let errors = sides.par_iter().map(|(_, sheet)| sheet.errors(areas, maps, epsilon));
    for ((surface, sheet), errors) in sides.iter().zip(errors.collect::<Vec<_>>()) {
        let ([area, noise, washed_out], surface) = (errors, *surface);
        let texels = sheet.values().count() as u32;
        match surfaces.last_mut().filter(|s| s.surface == surface) {
            Some(s) => {
                (s.texels, s.area) = (s.texels + texels, s.area + area);
                (s.noise, s.washed_out) = (s.noise + noise, s.washed_out + washed_out);
            }
            None => surfaces.push(Errors { surface, texels, area, noise, washed_out }),
        }
    }
    surfaces
}

/// How often each side of a surface is filtered (section 5): each pass takes noise away, the less the more lines
/// there are, and blurs edges of light.
pub struct Choice {
    /// For each side, two a surface, if there is light on it.
    sides: Vec<Option<Side>>,
}

/// A side of a surface before more of the filter.
struct Side {
    /// The error of the maps chosen so far, by noise and by more of the filter than the least.
    error: f64,
    /// Squared second differences of light, without those of noise.
    bent: f64,
    /// What keeps relative errors finite.
    epsilon: f64,
}

impl Choice {
    /// From a cycle's maps that are filtered least.
    pub fn new(texels: &Texels, areas: &[f64], maps: Totals) -> Choice {
        let side = |sheet: Sheet| {
            let lit = |v: &usize| areas[*v] > 0.0;
            let area: f64 = sheet.values().filter(lit).map(|v| areas[v]).sum();
            let light = |v: usize| areas[v] * f64::from(maps.all[v].mean());
            let light: f64 = sheet.values().filter(lit).map(light).sum();
            (light > 0.0).then(|| {
                let epsilon = EPSILON * (light / area).powi(2);
                let (noise, bent) = sheet.filtered(areas, maps, epsilon);
                Side { error: noise, bent, epsilon }
            })
        };
        let sides = texels.lattices.iter();
        let sides = sides.flat_map(|lattice| [0, 1].map(|side| Sheet { texels, lattice, side }));
        Choice { sides: sides.map(side).collect() }
    }

    /// Takes from maps of `passes` of the filter, where the first had `least`, the sides that are less wrong in
    /// them, into those chosen so far.
    pub fn take(
        &mut self,
        texels: &Texels,
        (areas, maps): (&[f64], Totals),
        [least, passes]: [u32; 2],
        [all, half]: [&mut [Rgb]; 2],
    ) {
        // Each pass is off by a quarter of the second differences, all of them the same way.
        let off = |passes| (0.25 * f64::from(passes)).powi(2);
        let bends = off(passes) - off(least);
        for (index, side) in self.sides.iter_mut().enumerate() {
            let Some(known) = side else { continue };
            let sheet = Sheet { texels, lattice: &texels.lattices[index / 2], side: index % 2 };
            let (noise, _) = sheet.filtered(areas, maps, known.epsilon);
            let error = noise + bends * known.bent;
            if error < known.error {
                known.error = error;
                for value in sheet.values() {
                    (all[value], half[value]) = (maps.all[value], maps.half[value]);
                }
            }
        }
    }
}

/// One side of a lattice.
#[derive(Clone, Copy)]
struct Sheet<'a> {
    texels: &'a Texels,
    lattice: &'a Lattice,
    side: usize,
}

impl Sheet<'_> {
    /// Its values in texture maps.
    fn values(self) -> impl Iterator<Item = usize> {
        let first = self.lattice.first as usize;
        let count = self.lattice.width as usize * self.lattice.height as usize;
        (first..first + count).map(move |texel| 2 * texel + self.side)
    }

    /// Sums over its texels: area, and area times squared errors by noise and by texels' size.
    fn errors(self, areas: &[f64], maps: Totals, epsilon: f64) -> [f64; 3] {
        let [mut area, mut noise, mut washed_out] = [0.0; 3];
        for value in self.values().filter(|v| areas[*v] > 0.0) {
            let around = self.around(value);
            area += areas[value];
            for channel in 0..3 {
                let total = |v: usize| f64::from(maps.all[v].0[channel]);
                let differs = |v: usize| f64::from(maps.half[v].0[channel]) - total(v);
                let weight = areas[value] / (total(value).powi(2) + epsilon) / 3.0;
                let bent = second_difference(&around, total).powi(2);
                let noisy = second_difference(&around, differs).powi(2);
                noise += weight * LATTICE * differs(value) * smoothed(&around, differs);
                washed_out += weight * WASHED_OUT * (bent - noisy);
            }
        }
        [area, noise.max(0.0), washed_out.max(0.0)]
    }

    /// Sums over its texels of relative squared errors by noise, and of squared second differences of light.
    fn filtered(self, areas: &[f64], maps: Totals, epsilon: f64) -> (f64, f64) {
        let (mut noise, mut bent) = (0.0, 0.0);
        for value in self.values().filter(|v| areas[*v] > 0.0) {
            let around = self.around(value);
            for channel in 0..3 {
                let light = |v: usize| f64::from(maps.all[v].0[channel]);
                let differs = |v: usize| f64::from(maps.half[v].0[channel]) - light(v);
                let weight = areas[value] / (light(value).powi(2) + epsilon);
                let rough = second_difference(&around, differs).powi(2);
                noise += weight * LATTICE * differs(value) * smoothed(&around, differs);
                bent += weight * (second_difference(&around, light).powi(2) - rough);
            }
        }
        (noise.max(0.0), bent.max(0.0))
    }

    /// The 3 x 3 values around one, row by row. Beyond borders and cuts stands the one itself, as if
    /// radiance were even there.
    fn around(self, value: usize) -> [usize; 9] {
        let Lattice { first, width, height, .. } = *self.lattice;
        let own = (value / 2) as u32;
        let (column, row) = ((own - first) % width, (own - first) / width);
        let mut around = [value; 9];
        for (k, at) in around.iter_mut().enumerate() {
            // One more than the place, so that none is negative.
            let (c, r) = (column + (k % 3) as u32, row + (k / 3) as u32);
            let is_inside = (1..=width).contains(&c) && (1..=height).contains(&r);
            let other = || first + (r - 1) * width + c - 1;
            if is_inside && self.texels.cuts.are_joined(self.lattice, own, other()) {
                *at = 2 * other() as usize + self.side;
            }
        }
        around
    }
}

/// Sum of the second differences along rows and columns. At a border and beside a cut it is not known,
/// and taken to be none along that axis.
fn second_difference(around: &[usize; 9], of: impl Fn(usize) -> f64) -> f64 {
    let middle = around[4];
    let along = |a: usize, b: usize| match a == middle || b == middle {
        true => 0.0,
        false => of(a) + of(b) - 2.0 * of(middle),
    };
    along(around[3], around[5]) + along(around[1], around[7])
}

/// What a value must be multiplied with to give its part of the mean square of the bilinear interpolant:
/// (1 4 1) / 6 along rows and columns. Of independent values little more than 4/9 is left.
fn smoothed(around: &[usize; 9], of: impl Fn(usize) -> f64) -> f64 {
    const WEIGHTS: [f64; 9] = [1.0, 4.0, 1.0, 4.0, 16.0, 4.0, 1.0, 4.0, 1.0];
    around.iter().zip(WEIGHTS).map(|(v, weight)| weight * of(*v)).sum::<f64>() / 36.0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The floor of the Cornell box lit by `light`, the halves apart by `apart`: by column and row.
    fn floor(light: impl Fn(u32, u32) -> f32, apart: impl Fn(u32, u32) -> f32) -> ErrorEstimate {
        let (scene, _) = Scene::bundled("cornell").unwrap();
        let texels = Texels::new(&scene, 0.05);
        let Lattice { first, width, height, .. } = texels.lattices[0];
        let mut maps = [vec![Rgb::BLACK; 2 * texels.len()], vec![Rgb::BLACK; 2 * texels.len()]];
        for texel in 0..width * height {
            let (column, row) = (texel % width, texel / width);
            let (value, light) = (2 * (first + texel) as usize, light(column, row));
            maps[0][value] = Rgb::splat(light);
            maps[1][value] = Rgb::splat(light + apart(column, row));
        }
        let areas = vec![1.0; 2 * texels.len()];
        let totals = Totals { all: &maps[0], half: &maps[1] };
        estimate(&by_surface(&scene, &texels, &areas, totals))
    }

    #[test]
    fn even_light_on_which_the_halves_agree_is_right() {
        assert_eq!(floor(|_, _| 1.0, |_, _| 0.0).relmse, 0.0);
        // Nor is anything wrong between texels where light changes evenly, apart from rounding.
        assert!(floor(|column, row| 1.0 + 0.1 * (column + row) as f32, |_, _| 0.0).relmse < 1e-9);
    }

    #[test]
    fn halves_that_are_apart_everywhere_are_wrong_by_that_and_between_texels_by_less() {
        let (expected, epsilon) = (LATTICE * 0.04, EPSILON);
        let even = floor(|_, _| 1.0, |_, _| 0.2);
        assert!((even.noise * (1.0 + epsilon) / expected - 1.0).abs() < 1e-3, "{even:?}");
        assert_eq!((even.worst.len(), even.worst[0].surface), (1, 0));
        // Signs that alternate along rows and columns cancel in lookups, a ninth is left; more at borders.
        let rough =
            floor(|_, _| 1.0, |column, row| if (column + row) % 2 == 0 { 0.2 } else { -0.2 });
        assert!(rough.noise > 0.0 && rough.noise < 0.3 * even.noise, "{rough:?}");
        assert_eq!(rough.relmse, rough.noise, "what the halves do not agree on is no edge");
    }

    #[test]
    fn edges_of_light_are_washed_out() {
        let edge = floor(|column, _| if column < 9 { 1.0 } else { 2.0 }, |_, _| 0.0);
        assert!(edge.noise == 0.0 && edge.relmse > 0.0, "{edge:?}");
    }

    /// Whether a floor is taken as more of the filter leaves it: light by column, and how far the halves are apart,
    /// in turn up and down, before and after.
    fn takes_more(light: [fn(u32) -> f32; 2], apart: [f32; 2]) -> bool {
        let (scene, _) = Scene::bundled("cornell").unwrap();
        let texels = Texels::new(&scene, 0.05);
        let Lattice { first, width, height, .. } = texels.lattices[0];
        let map = |light: fn(u32) -> f32, apart: f32| {
            let mut map = vec![Rgb::BLACK; 2 * texels.len()];
            for texel in 0..width * height {
                let (column, row) = (texel % width, texel / width);
                // Patches of 2 x 2, which are larger than what lookups smooth.
                let sign = if (column / 2 + row / 2) % 2 == 0 { apart } else { -apart };
                map[2 * (first + texel) as usize] = Rgb::splat(light(column) + sign);
            }
            map
        };
        let areas = vec![1.0; 2 * texels.len()];
        let maps = |k: usize| [map(light[k], 0.0), map(light[k], apart[k])];
        let ([mut all, mut half], [more, more_half]) = (maps(0), maps(1));
        let mut choice = Choice::new(&texels, &areas, Totals { all: &all, half: &half });
        let candidate = (areas.as_slice(), Totals { all: &more, half: &more_half });
        choice.take(&texels, candidate, [1, 2], [&mut all, &mut half]);
        let taken = (all == more, half == more_half);
        assert!(taken.0 == taken.1 || light[0](3) == light[1](3), "one map without the other");
        taken.1
    }

    #[test]
    fn noise_is_filtered_away_and_edges_that_lines_resolve_are_not() {
        let even = |_| 1.0;
        let edge = |column| if column < 9 { 1.0 } else { 2.0 };
        let blurred = |column| match column {
            0..8 => 1.0,
            8 => 1.25,
            9 => 1.75,
            _ => 2.0,
        };
        assert!(takes_more([even, even], [0.1, 0.05]));
        assert!(
            !takes_more([edge, blurred], [0.01, 0.005]),
            "the edge is sharper than noise is strong"
        );
        assert!(takes_more([edge, blurred], [0.4, 0.2]), "the edge is lost in noise");
        assert!(!takes_more([even, even], [0.1, 0.11]), "nothing is won");
    }

    #[test]
    fn both_halves_have_their_share_of_any_lattice() {
        let directions = Directions::with_lines(513).unwrap();
        for thinned in 0..3 {
            assert_eq!(grids_of_half(&directions, thinned, 8), 4.0);
            let odd = grids_of_half(&directions, thinned, 1);
            assert!((odd - 0.5).abs() < 0.1, "{thinned}: {odd}");
        }
    }

    #[test]
    fn noise_may_be_what_it_leaves_small_beside_the_target() {
        assert_eq!(
            [granted(0.0, 1.0, 0), granted(0.0, 1.0, 1)],
            [0.5, 0.75],
            "later cycles may add"
        );
        assert_eq!(
            [granted(0.5, 1.0, 0), granted(0.9, 1.0, 0), granted(5.0, 1.0, 0)],
            [0.25, 0.125, 0.125]
        );
    }

    #[test]
    fn surfaces_lack_lines_by_themselves_until_all_together_have_enough() {
        let surface = |id, noise| {
            let surface = SurfaceId(id);
            Errors { surface, texels: 10_000, area: 2.0, noise: 2.0 * noise, washed_out: 0.0 }
        };
        let ids = |surfaces: &[Errors]| lacking(surfaces, 1.0, 0);
        let [calm, noisy] = [surface(3, 0.1), surface(5, 2.0)];
        assert_eq!(ids(&[calm, noisy]), [SurfaceId(5)]);
        assert_eq!(ids(&[calm, surface(5, 0.8)]), [], "0.45 on the average");
        assert_eq!(
            ids(&[surface(3, 0.3), noisy]).len(),
            2,
            "some noise is spared for the noisier one"
        );
        let enough = |noise, washed_out, cycle| {
            let one = Errors { washed_out: 2.0 * washed_out, ..surface(3, noise) };
            lacking(&[one], 1.0, cycle).is_empty()
        };
        assert!(enough(0.49, 0.0, 0) && !enough(0.51, 0.0, 0));
        assert!(enough(0.7, 0.0, 1), "later cycles may add to it");
        assert!(!enough(0.3, 0.5, 0) && enough(0.12, 5.0, 0));
        // The halves of a few texels may agree by chance.
        let small = Errors { texels: 4, ..calm };
        assert_eq!(ids(&[small, noisy]), [SurfaceId(3), SurfaceId(5)]);
        assert_eq!(ids(&[]), []);
    }
}
