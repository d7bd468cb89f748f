//! The pieces into which segments divide a texel, found on a grid of 8 x 8 points.

use super::meets::Segment;
use crate::scene::Surface;
use crate::scene::texels::Lattice;
use glam::Vec2;

/// Points along a texel's edge; a texel's points are the bits of a u64.
const POINTS: usize = 8;

/// Where in its eighth of a texel a point lies. Not in the middle: walls like to stand there.
const INSIDE: f32 = 0.47;

/// One piece of a texel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Piece {
    /// A point of it, about its middle, in texels from the texel's own corner.
    pub(super) site: Vec2,
    /// Its points.
    pub(super) points: u32,
}

fn place(point: usize) -> Vec2 {
    let at = |k: usize| (k as f32 + INSIDE) / POINTS as f32;
    Vec2::new(at(point % POINTS), at(point / POINTS))
}

/// Which points of some of a surface's texels lie inside its polygons. `index` names the texel in
/// `covered` by its column and row, if it is wanted.
pub(super) fn cover(
    surface: &Surface,
    lattice: &Lattice,
    index: &dyn Fn(u32, u32) -> Option<usize>,
    covered: &mut [u64],
) {
    let points = POINTS as f32;
    let range = |low: f32, high: f32, count: u32| {
        let first = |v: f32| (v * points - INSIDE).ceil().clamp(0.0, count as f32 * points) as u32;
        first(low)..first(high)
    };
    let mut crossings: Vec<f32> = Vec::new();
    for polygon in &surface.polygons {
        let corners: Vec<Vec2> =
            polygon.vertices.iter().map(|v| surface.coordinates(*v) * lattice.density).collect();
        let rows = corners.iter().map(|c| c.y);
        let (low, high) = (rows.clone().fold(f32::MAX, f32::min), rows.fold(f32::MIN, f32::max));
        for row in range(low, high, lattice.height) {
            let y = (row as f32 + INSIDE) / points;
            crossings.clear();
            let mut a = corners[corners.len() - 1];
            for &b in &corners {
                if (a.y <= y) != (b.y <= y) {
                    crossings.push(a.x + (y - a.y) * ((b.x - a.x) / (b.y - a.y)));
                }
                a = b;
            }
            crossings.sort_unstable_by(f32::total_cmp);
            for pair in crossings.chunks_exact(2) {
                for column in range(pair[0], pair[1], lattice.width) {
                    let texel = (column / POINTS as u32, row / POINTS as u32);
                    if let Some(k) = index(texel.0, texel.1) {
                        let inside = column as usize % POINTS + row as usize % POINTS * POINTS;
                        covered[k] |= 1 << inside;
                    }
                }
            }
        }
    }
}

/// Whether the point of the grid nearest to a place in a texel is covered.
pub(super) fn covers(covered: u64, inside: Vec2) -> bool {
    let at =
        (inside * POINTS as f32).clamp(Vec2::ZERO, Vec2::splat((POINTS - 1) as f32)).as_uvec2();
    covered >> (at.y as usize * POINTS + at.x as usize) & 1 == 1
}

/// The pieces of a texel's covered points, the one with the first point first. `corner` is the texel's
/// own corner.
pub(super) fn pieces(covered: u64, corner: Vec2, segments: &[Segment]) -> Vec<Piece> {
    let is_crossed = |a: usize, b: usize| {
        let (a, b) = (corner + place(a), corner + place(b));
        segments.iter().any(|s| crosses(s, a, b))
    };
    let mut left = covered;
    let mut found = Vec::new();
    while left != 0 {
        let first = left.trailing_zeros() as usize;
        left &= !(1 << first);
        let mut members = vec![first];
        let mut next = 0;
        while next < members.len() {
            let p = members[next];
            next += 1;
            let (column, row) = (p % POINTS, p / POINTS);
            let around = [
                (column > 0).then(|| p - 1),
                (column + 1 < POINTS).then_some(p + 1),
                (row > 0).then(|| p - POINTS),
                (row + 1 < POINTS).then_some(p + POINTS),
            ];
            for q in around.into_iter().flatten() {
                if left >> q & 1 == 1 && !is_crossed(p, q) {
                    left &= !(1 << q);
                    members.push(q);
                }
            }
        }
        let middle = members.iter().map(|p| place(*p)).sum::<Vec2>() / members.len() as f32;
        let off = |p: &usize| place(*p).distance_squared(middle);
        let nearest = members.iter().min_by(|a, b| off(a).total_cmp(&off(b)).then(a.cmp(b)));
        let site = nearest.map_or(middle, |p| place(*p));
        found.push(Piece { site, points: members.len() as u32 });
    }
    found
}

/// Whether the straight line between two points crosses a segment. One that only comes up to it does not.
pub(super) fn crosses([a, b]: &Segment, p: Vec2, q: Vec2) -> bool {
    let side = |from: Vec2, to: Vec2, point: Vec2| (to - from).perp_dot(point - from);
    side(*a, *b, p) * side(*a, *b, q) < 0.0 && side(p, q, *a) * side(p, q, *b) <= 0.0
}
