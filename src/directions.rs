//! The line directions Omega_l: the lattice of an octahedron, put on the sphere by an equal-area map.
//!
//! In: `k`, so that every edge of the octahedron has `m = 2^k` steps. Out: `l = 2 * 4^k + 1` lines
//! (antipodes are one line), their quadrature weights, and for any unit vector the three lattice
//! directions around it with barycentric weights, in constant time, without a search (section 3 of
//! the paper; the lattice follows Slater 2002 in spirit, the map is Clarberg 2008, "Fast equal-area
//! mapping of the (hemi)sphere using SIMD").
//!
//! The square `[-1, 1]^2` of the map holds the whole sphere: the inner diamond `|x| + |y| <= 1` the
//! hemisphere `z >= 0`, the four corner triangles the other one. The lattice is the square's grid of
//! step `1 / m`, so lattices of growing `k` are nested.

mod sixteen;

pub use sixteen::Triangles;

use crate::ids::{DirectionId, Sense};
use glam::{DVec2, DVec3, Vec2, Vec3};
use std::cmp::Reverse;
use std::f32::consts::FRAC_2_PI;
use std::f64::consts::{FRAC_PI_4, PI};

/// One of the three directions around a vector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Near {
    /// The line.
    pub direction: DirectionId,
    /// Which way along the line is the way the vector goes.
    pub sense: Sense,
    /// Barycentric weight in [0, 1]; the three sum to 1.
    pub weight: f32,
}

/// A triangle of the lattice: half a square of its grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Triangle {
    /// Slot of the square's first corner.
    slot: u32,
    /// Which half: 0 and 1 below and above a falling diagonal, 2 and 3 of a rising one.
    half: u32,
}

/// The set Omega_l of line directions.
#[derive(Clone, Debug)]
pub struct Directions {
    /// Steps along an octahedron edge, `2^k`.
    steps: i32,
    /// For each point of the square's grid, `(2 m + 1)^2` row by row: the line and its sense.
    lines: Vec<(u32, Sense)>,
    /// Unit direction of each line.
    vectors: Vec<Vec3>,
    /// Where each line's representative stands in the square's grid.
    places: Vec<(i32, i32)>,
    /// Shares of [`Directions::share`] each line stands for: 3, or 2 at a corner of the octahedron.
    shares: Vec<u8>,
}

/// The largest number of lines that a set may have: 2 * 4^9 + 1.
pub const MOST_LINES: u32 = 524_289;

impl Directions {
    /// The lattice with `2^k` steps along each edge of the octahedron: `2 * 4^k + 1` lines.
    ///
    /// # Panics
    /// When `k > 9`; see [`Directions::with_lines`] for counts that come from outside.
    pub fn new(k: u32) -> Directions {
        assert!(k <= 9, "k = {k} gives more than {MOST_LINES} lines");
        let steps = 1i32 << k;
        let side = 2 * steps + 1;
        let mut set = Directions {
            steps,
            lines: vec![(u32::MAX, Sense::Along); (side * side) as usize],
            vectors: Vec::new(),
            places: Vec::new(),
            shares: Vec::new(),
        };
        // The representative of a line is its first grid point in row order of the upper hemisphere;
        // on the equator two grid points or more may name one line.
        for y in -steps..=steps {
            for x in -steps..=steps {
                if x.abs() + y.abs() > steps || set.lines[set.slot(x, y)].0 != u32::MAX {
                    continue;
                }
                let id = set.vectors.len() as u32;
                let (ax, ay) = antipode(x, y, steps);
                for (gx, gy) in same_point(x, y, steps) {
                    let at = set.slot(gx, gy);
                    set.lines[at] = (id, Sense::Along);
                }
                for (gx, gy) in same_point(ax, ay, steps) {
                    let at = set.slot(gx, gy);
                    set.lines[at] = (id, Sense::Against);
                }
                let unit =
                    square_to_sphere(DVec2::new(f64::from(x), f64::from(y)) / f64::from(steps));
                set.vectors.push(unit.as_vec3());
                set.places.push((x, y));
                // The integral of the line's barycentric hat: a third of each triangle that meets
                // there. Six triangles meet at a lattice point, four at a corner of the octahedron.
                let corner = (x == 0 || x.abs() == steps) && (y == 0 || y.abs() == steps);
                set.shares.push(if corner { 2 } else { 3 });
            }
        }
        set
    }

    /// The lattice with exactly `lines` lines, if there is one: 3, 9, 33, 129, 513, 2049, 8193, ...
    pub fn with_lines(lines: u32) -> Option<Directions> {
        (0..=9).find(|k| 2 * 4u32.pow(*k) + 1 == lines).map(Directions::new)
    }

    /// The number of lines `l`.
    pub fn len(&self) -> usize {
        self.vectors.len()
    }

    /// Never: the coarsest lattice has three lines.
    pub fn is_empty(&self) -> bool {
        self.vectors.is_empty()
    }

    /// All ids in order.
    pub fn ids(&self) -> impl Iterator<Item = DirectionId> + use<> {
        (0..self.len() as u32).map(DirectionId)
    }

    /// All ids along a Hilbert curve over the lattice: lines that are near each other in it are near
    /// each other on the sphere, for as long as can be.
    pub fn curve(&self) -> Vec<DirectionId> {
        // The upper half of the lattice is a square that stands on a corner: turned by 45 degrees it
        // fills the curve's own. The last row and column, one too many, go with their neighbours.
        let along = |place: i32| (place + self.steps).min(2 * self.steps - 1) as u32;
        let order = (2 * self.steps as u32).ilog2() as u8;
        let mut ids: Vec<DirectionId> = self.ids().collect();
        ids.sort_by_cached_key(|id| {
            let (x, y) = self.places[id.index()];
            (fast_hilbert::xy2h(along(x + y), along(x - y), order), *id)
        });
        ids
    }

    /// Unit vector of a line.
    pub fn vector(&self, id: DirectionId) -> Vec3 {
        self.vectors[id.index()]
    }

    /// Solid angle a line stands for, in sr, one way; the weights of all lines sum to `2 pi`.
    pub fn weight(&self, id: DirectionId) -> f32 {
        (f64::from(self.shares[id.index()]) * self.share()) as f32
    }

    /// The weight of a line in whole shares, so that weighted sums can be exact.
    pub fn shares(&self, id: DirectionId) -> u8 {
        self.shares[id.index()]
    }

    /// Solid angle of one share, sr: two thirds of a lattice triangle.
    pub fn share(&self) -> f64 {
        2.0 / 3.0 * 4.0 * PI / (8.0 * f64::from(self.steps) * f64::from(self.steps))
    }

    /// Whether a line is also one of the lattice whose steps are `2^halvings` times as long, whose
    /// [`Directions::share`] is `4^halvings` times as large.
    pub fn is_in_coarser(&self, id: DirectionId, halvings: u32) -> bool {
        let (x, y) = self.places[id.index()];
        let step = 1 << halvings.min(self.most_halvings());
        x % step == 0 && y % step == 0
    }

    /// 0 or 1: lines that are neighbours along rows or columns of the lattice, or of the one that is
    /// coarser by so many halvings, have different ones, as the fields of a chessboard.
    pub fn colour(&self, id: DirectionId, halvings: u32) -> u32 {
        let (x, y) = self.places[id.index()];
        let halvings = halvings.min(self.most_halvings());
        ((x >> halvings) + (y >> halvings)).rem_euclid(2) as u32
    }

    /// How often the steps can be doubled.
    pub fn most_halvings(&self) -> u32 {
        self.steps.ilog2()
    }

    /// The unit vector at `offset` lattice steps from a line, each component in [-1/2, 1/2]: a
    /// sample of the line's own solid angle (section 5, perturbation). Over all lines the boxes of
    /// one step tile the sphere of lines once, with equal area.
    pub fn perturbed(&self, id: DirectionId, offset: DVec2) -> Vec3 {
        let (x, y) = self.places[id.index()];
        let p = (DVec2::new(f64::from(x), f64::from(y)) + offset) / f64::from(self.steps);
        square_to_sphere(fold(p)).as_vec3()
    }

    /// The three lattice directions around `unit` and their barycentric weights. Constant time;
    /// continuous over the whole sphere, across the equator too, where a neighbour may be the
    /// antipode of a line's representative ([`Sense::Against`]).
    pub fn nearest_three(&self, unit: Vec3) -> [Near; 3] {
        let (triangle, weights) = self.around(unit);
        let mut near = self.corners(triangle);
        near.iter_mut().zip(weights).for_each(|(near, weight)| near.weight = weight);
        near
    }

    /// The triangle of the lattice that `unit` lies in, and the barycentric weights of its corners.
    #[inline]
    pub fn around(&self, unit: Vec3) -> (Triangle, [f32; 3]) {
        let q = sphere_to_square_f32(unit) * self.steps as f32;
        let most = (self.steps - 1) as f32;
        let x0 = floor(q.x).clamp(-most - 1.0, most);
        let y0 = floor(q.y).clamp(-most - 1.0, most);
        let (fx, fy) = ((q.x - x0).clamp(0.0, 1.0), (q.y - y0).clamp(0.0, 1.0));
        // A square of the grid is cut along the diagonal that runs like the octahedron's edge of
        // its quadrant: falling where x y > 0, rising where x y < 0.
        let falling = (x0 >= 0.0) == (y0 >= 0.0);
        let (half, weights) = match (falling, fx + fy <= 1.0, fx >= fy) {
            (true, true, _) => (0, [1.0 - fx - fy, fx, fy]),
            (true, false, _) => (1, [fx + fy - 1.0, 1.0 - fy, 1.0 - fx]),
            (false, _, true) => (2, [1.0 - fx, fx - fy, fy]),
            (false, _, false) => (3, [1.0 - fy, fy - fx, fx]),
        };
        (Triangle { slot: self.slot(x0 as i32, y0 as i32) as u32, half }, weights)
    }

    /// The corners of a triangle, with no weight, in the order of those that [`Directions::around`] gives.
    pub fn corners(&self, Triangle { slot, half }: Triangle) -> [Near; 3] {
        let corners = match half {
            0 => [(0, 0), (1, 0), (0, 1)],
            1 => [(1, 1), (1, 0), (0, 1)],
            2 => [(0, 0), (1, 0), (1, 1)],
            _ => [(0, 0), (0, 1), (1, 1)],
        };
        corners.map(|(dx, dy)| {
            let (line, sense) = self.lines[slot as usize + dy * (2 * self.steps as usize + 1) + dx];
            Near { direction: DirectionId(line), sense, weight: 0.0 }
        })
    }

    fn slot(&self, x: i32, y: i32) -> usize {
        let side = 2 * self.steps + 1;
        ((y + self.steps) * side + x + self.steps) as usize
    }
}

/// The order in which a pack has the maps of `lines` lines: those of the coarsest lattice first, then
/// those that each finer one adds, each lattice's in Z-order of its grid, so that lines near each other
/// are mostly near each other in the file. Whole numbers only. `None` where there is no such lattice.
pub fn paging(lines: u32) -> Option<Vec<DirectionId>> {
    let steps = 1i32 << (0..=9).find(|k| 2 * 4u32.pow(*k) + 1 == lines)?;
    let mut keys = Vec::with_capacity(lines as usize);
    for y in -steps..=steps {
        let reach = steps - y.abs();
        for x in -reach..=reach {
            // Of the two ends of a line on the equator the first in row order names it.
            if x.abs() == reach && (y > 0 || (y == 0 && x > 0)) {
                continue;
            }
            let halvings = (x | y | steps).trailing_zeros();
            let along = |v: i32| u64::from((v + steps).cast_unsigned());
            let id = DirectionId(keys.len() as u32);
            keys.push((Reverse(halvings), z_order(along(x), along(y)), id));
        }
    }
    keys.sort_unstable();
    Some(keys.into_iter().map(|(.., id)| id).collect())
}

/// The bits of two numbers of up to 16 bits in turn, the first one's lower.
fn z_order(x: u64, y: u64) -> u64 {
    (0..16).map(|bit| (x >> bit & 1) << (2 * bit) | (y >> bit & 1) << (2 * bit + 1)).sum()
}

/// The grid point of the antipode. Antipodal points of the square trade their coordinates: the
/// triangle of an octant is carried onto the opposite octant's, which lies folded out of the diamond.
fn antipode(x: i32, y: i32, m: i32) -> (i32, i32) {
    let away = |v: i32| if v >= 0 { -1 } else { 1 };
    ((m - y.abs()) * away(x), (m - x.abs()) * away(y))
}

/// All grid points that name the same point of the sphere: one inside the square, two on its border
/// (mirrored about the border's middle), four at its corners.
fn same_point(x: i32, y: i32, m: i32) -> impl Iterator<Item = (i32, i32)> {
    let mut all = vec![(x, y)];
    if x.abs() == m {
        all.push((x, -y));
    }
    if y.abs() == m {
        all.push((-x, y));
    }
    if x.abs() == m && y.abs() == m {
        all.push((-x, -y));
    }
    all.into_iter()
}

/// Brings a point that left the square back in, over the border it left by.
fn fold(p: DVec2) -> DVec2 {
    let mut p = p;
    if p.x.abs() > 1.0 {
        p = DVec2::new((2.0 - p.x.abs()).copysign(p.x), -p.y);
    }
    if p.y.abs() > 1.0 {
        p = DVec2::new(-p.x, (2.0 - p.y.abs()).copysign(p.y));
    }
    p
}

/// Equal-area map from the square `[-1, 1]^2` to the unit sphere (Clarberg 2008).
pub fn square_to_sphere(p: DVec2) -> DVec3 {
    let (u, v) = (p.x.abs(), p.y.abs());
    // Signed distance from the diamond, positive inside: the hemisphere z >= 0.
    let inside = 1.0 - (u + v);
    let r = 1.0 - inside.abs();
    let phi = if r == 0.0 { FRAC_PI_4 } else { ((v - u) / r + 1.0) * FRAC_PI_4 };
    let z = (1.0 - r * r).copysign(inside);
    let (sin, cos) = phi.sin_cos();
    let flat = r * (2.0 - r * r).sqrt();
    DVec3::new((cos * flat).copysign(p.x), (sin * flat).copysign(p.y), z)
}

/// The inverse of [`square_to_sphere`].
pub fn sphere_to_square(d: DVec3) -> DVec2 {
    let (x, y, z) = (d.x.abs(), d.y.abs(), d.z.abs().min(1.0));
    let r = (1.0 - z).sqrt();
    let phi = if x == 0.0 && y == 0.0 { 0.0 } else { y.atan2(x) / (0.5 * PI) };
    let (mut u, mut v) = (r - phi * r, phi * r);
    if d.z < 0.0 {
        (u, v) = (1.0 - v, 1.0 - u);
    }
    DVec2::new(u.copysign(d.x), v.copysign(d.y))
}

/// The same as [`sphere_to_square`] with the accuracy of the vector's own numbers, several times as fast.
#[inline]
fn sphere_to_square_f32(d: Vec3) -> Vec2 {
    let (x, y, z) = (d.x.abs(), d.y.abs(), d.z.abs());
    // 1 - z, without what rounding leaves of it near the pole.
    let r = ((x * x + y * y) / (1.0 + z)).sqrt();
    let (low, high) = (x.min(y), x.max(y));
    let eighth = if high > 0.0 { arctangent(low / high) * FRAC_2_PI } else { 0.0 };
    let phi = if y > x { 1.0 - eighth } else { eighth };
    let (mut u, mut v) = (r - phi * r, phi * r);
    if d.z < 0.0 {
        (u, v) = (1.0 - v, 1.0 - u);
    }
    Vec2::new(u.copysign(d.x), v.copysign(d.y))
}

/// The arctangent of a number in [0, 1], within 2e-8 but for rounding (Hastings 1955; Abramowitz and Stegun
/// 1964, 4.4.49).
#[inline]
fn arctangent(t: f32) -> f32 {
    let square = t * t;
    t * ARCTANGENT.iter().fold(0.0, |sum, c| sum * square + c)
}

/// Coefficients of [`arctangent`], the highest power's first.
const ARCTANGENT: [f32; 9] = [
    0.002_866_225_7,
    -0.016_165_737,
    0.042_909_614,
    -0.075_289_64,
    0.106_562_64,
    -0.142_089,
    0.199_935_51,
    -0.333_331_45,
    1.0,
];

/// Rounded down, without the call that it is where a processor may lack the instruction.
#[inline]
fn floor(v: f32) -> f32 {
    let cut = (v as i32) as f32;
    cut - f32::from(u8::from(cut > v))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_curve_visits_every_line_once_in_small_steps() {
        for lines in [3, 9, 33, 2049] {
            let directions = Directions::with_lines(lines).unwrap();
            let curve = directions.curve();
            let mut ids: Vec<u32> = curve.iter().map(|id| id.0).collect();
            ids.sort_unstable();
            assert_eq!(ids, (0..lines).collect::<Vec<_>>());
            // A lattice step is about sqrt(2 pi / l) on the sphere.
            let angle = |a: DirectionId, b: DirectionId| {
                directions.vector(a).dot(directions.vector(b)).abs().min(1.0).acos()
            };
            let steps: f32 = curve.windows(2).map(|w| angle(w[0], w[1])).sum();
            let mean = steps / curve.len() as f32;
            assert!(mean < 2.0 * (2.0 * std::f32::consts::PI / lines as f32).sqrt(), "{mean}");
        }
    }

    #[test]
    fn counts_are_the_papers() {
        let counts: Vec<usize> = (1..=6).map(|k| Directions::new(k).len()).collect();
        assert_eq!(counts, [9, 33, 129, 513, 2049, 8193]);
        assert!(Directions::with_lines(2048).is_none());
    }

    #[test]
    fn weights_sum_to_the_hemisphere() {
        for k in 0..=6 {
            let set = Directions::new(k);
            let sum: f64 = set.ids().map(|d| f64::from(set.weight(d))).sum();
            assert!((sum - 2.0 * PI).abs() < 1e-4, "k {k}: {sum}");
        }
    }

    #[test]
    fn cosine_moment_of_any_normal_is_pi() {
        let set = Directions::new(5);
        for place in 0..400 {
            let p = DVec2::new(f64::from(place % 20), f64::from(place / 20)) / 9.5 - 1.0;
            let n = square_to_sphere(p).as_vec3();
            let moment: f64 =
                set.ids().map(|d| f64::from(set.weight(d) * set.vector(d).dot(n).abs())).sum();
            assert!((moment - PI).abs() < 1e-3 * PI, "normal {n}: {moment}");
        }
    }

    #[test]
    fn every_grid_point_has_a_line_and_antipodes_share_it() {
        for k in 0..=4 {
            let set = Directions::new(k);
            assert!(set.lines.iter().all(|(line, _)| (*line as usize) < set.len()));
            let m = set.steps;
            for y in -m..=m {
                for x in -m..=m {
                    let unit =
                        square_to_sphere(DVec2::new(f64::from(x), f64::from(y)) / f64::from(m));
                    let (line, sense) = set.lines[set.slot(x, y)];
                    let named = set.vectors[line as usize] * sense.sign();
                    assert!(
                        named.distance(unit.as_vec3()) < 1e-5,
                        "k {k} ({x}, {y}): {named} {unit}"
                    );
                }
            }
        }
    }

    #[test]
    fn perturbed_directions_stay_near_and_tile_the_lines() {
        // The mean of |d . n| over jittered lines is 1/2 for any n, as over the whole sphere.
        let set = Directions::new(4);
        let mut mean = 0.0f64;
        let mut count = 0.0;
        for d in set.ids() {
            for s in 0..16 {
                let offset = DVec2::new(f64::from(s % 4), f64::from(s / 4)) / 4.0 - 0.375;
                let unit = set.perturbed(d, offset);
                assert!(unit.dot(set.vector(d)) > 0.97);
                let w = f64::from(set.weight(d));
                mean += w * f64::from(unit.dot(Vec3::new(0.48, 0.6, 0.64)).abs());
                count += w;
            }
        }
        assert!((mean / count - 0.5).abs() < 2e-3, "{}", mean / count);
    }

    fn unit_vector() -> impl Strategy<Value = Vec3> {
        (-1.0f32..1.0, -1.0f32..1.0, -1.0f32..1.0)
            .prop_filter("not zero", |(x, y, z)| x * x + y * y + z * z > 1e-3)
            .prop_map(|(x, y, z)| Vec3::new(x, y, z).normalize())
    }

    proptest! {
        #[test]
        fn square_and_sphere_are_inverse(x in -1.0f64..1.0, y in -1.0f64..1.0) {
            let d = square_to_sphere(DVec2::new(x, y));
            prop_assert!((d.length() - 1.0).abs() < 1e-12);
            prop_assert!(square_to_sphere(sphere_to_square(d)).distance(d) < 1e-9);
        }

        #[test]
        fn the_fast_map_is_the_exact_one(unit in unit_vector()) {
            let (fast, exact) = (sphere_to_square_f32(unit), sphere_to_square(unit.as_dvec3().normalize()));
            // Of vectors that are of unit length but for rounding.
            prop_assert!(fast.as_dvec2().distance(exact) < 3e-7, "{fast} {exact}");
        }

        #[test]
        fn nearest_three_surround_the_vector(unit in unit_vector(), k in 1u32..6) {
            let set = Directions::new(k);
            let near = set.nearest_three(unit);
            let sum: f32 = near.iter().map(|n| n.weight).sum();
            prop_assert!((sum - 1.0).abs() < 1e-5);
            // The map stretches a lattice step to at most 3 / m.
            let spacing = 3.0 / (1 << k) as f32;
            let mut blend = Vec3::ZERO;
            for n in near {
                prop_assert!(n.weight >= 0.0);
                let v = set.vector(n.direction) * n.sense.sign();
                prop_assert!(v.distance(unit) < spacing, "{v} is far from {unit}");
                blend += v * n.weight;
            }
            // Barycentric weights reproduce the vector up to the map's curvature.
            prop_assert!(blend.normalize().distance(unit) < 0.35 * spacing);
        }

        #[test]
        fn nearest_three_are_continuous(unit in unit_vector(), step in unit_vector()) {
            let set = Directions::new(3);
            let near_by = (unit + step * 1e-4).normalize();
            let total = |v: Vec3| {
                set.nearest_three(v).iter().map(|n| {
                    let w = set.vector(n.direction) * n.sense.sign();
                    w * n.weight
                }).sum::<Vec3>()
            };
            prop_assert!(total(unit).distance(total(near_by)) < 2e-2);
        }
    }

    #[test]
    fn packs_have_coarse_lattices_first_and_neighbours_near_each_other() {
        for k in 0..=5 {
            let set = Directions::new(k);
            let order = paging(set.len() as u32).unwrap();
            let mut seen = order.clone();
            seen.sort_unstable();
            assert!(seen.into_iter().eq(set.ids()), "k = {k}");
            for coarser in 0..=k {
                let first = &order[..2 * 4usize.pow(k - coarser) + 1];
                assert!(first.iter().all(|id| set.is_in_coarser(*id, coarser)), "k = {k}");
            }
            // Of the finest lattice's own lines, most stand a few steps from the one before.
            let finest = &order[set.len() / 4 + 1..];
            let step = (4.0 * PI / (2.0 * set.len() as f64)).sqrt() as f32;
            let is_far = |pair: &&[DirectionId]| {
                let [a, b] = [pair[0], pair[1]].map(|id| set.vector(id));
                a.distance(b).min(a.distance(-b)) > 4.0 * step
            };
            let far = finest.windows(2).filter(is_far).count();
            assert!(far * 8 <= finest.len(), "k = {k}: {far} of {}", finest.len());
        }
        assert_eq!(paging(34), None);
    }
}
