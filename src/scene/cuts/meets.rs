//! Along which segments other polygons meet a surface's plane.

use super::near::Near;
use crate::ids::SurfaceId;
use crate::scene::texels::Lattice;
use crate::scene::{Polygon, Surface};
use glam::{Vec2, Vec3};

/// Corners nearer to a plane than this lie in it, in the fitted scene's units.
const IN_PLANE: f32 = 2e-5;

/// Segments are longer by this at either end, in texels, so that two that meet leave no gap.
const LONGER: f32 = 1e-3;

/// Ends that differ by less than this are the same, in texels.
const SAME: f32 = 1e-4;

/// A segment in a lattice's coordinates: texels along `u` and `v`.
pub(super) type Segment = [Vec2; 2];

/// The segments along which polygons of other surfaces pass through a surface's plane or touch it,
/// each once, in an order that depends on nothing but the segments.
pub(super) fn segments(
    near: &Near,
    id: SurfaceId,
    surface: &Surface,
    lattice: &Lattice,
) -> Vec<Segment> {
    let mut found: Vec<Segment> = Vec::new();
    let mut keep = |a: Vec2, b: Vec2| {
        let (a, b) = (a * lattice.density, b * lattice.density);
        let further = (b - a).normalize_or_zero() * LONGER;
        let (a, b) = (a - further, b + further);
        found.push(if (a.x, a.y) <= (b.x, b.y) { [a, b] } else { [b, a] });
    };
    near.visit(id, surface, IN_PLANE, &mut |polygon| meet(surface, polygon, &mut keep));
    let key = |s: &Segment| [s[0].x, s[0].y, s[1].x, s[1].y];
    found.sort_by(|a, b| {
        let pairs = key(a).into_iter().zip(key(b));
        pairs.fold(std::cmp::Ordering::Equal, |o, (a, b)| o.then(a.total_cmp(&b)))
    });
    found.dedup_by(|a, b| a[0].distance(b[0]) < SAME && a[1].distance(b[1]) < SAME);
    found
}

/// Where a polygon meets a surface's plane, in the surface's coordinates.
fn meet(surface: &Surface, polygon: &Polygon, keep: &mut dyn FnMut(Vec2, Vec2)) {
    let height = |p: Vec3| {
        let h = (p - surface.origin).dot(surface.normal);
        if h.abs() < IN_PLANE { 0.0 } else { h }
    };
    let corners = &polygon.vertices;
    let mut meets: Vec<Vec2> = Vec::new();
    let mut a = corners[corners.len() - 1];
    for &b in corners {
        let (ha, hb) = (height(a), height(b));
        if ha == 0.0 && hb == 0.0 {
            // The edge lies in the plane.
            keep(surface.coordinates(a), surface.coordinates(b));
        } else if ha == 0.0 {
            meets.push(surface.coordinates(a));
        } else if ha * hb < 0.0 {
            meets.push(surface.coordinates(a + (b - a) * (ha / (ha - hb))));
        }
        a = b;
    }
    // The plane runs through the polygon between the outermost points where it meets the edge.
    let Some(first) = meets.first().copied() else { return };
    let farthest = |from: Vec2| {
        let far =
            |a: &Vec2, b: &Vec2| a.distance_squared(from).total_cmp(&b.distance_squared(from));
        meets.iter().copied().max_by(far).unwrap_or(from)
    };
    let end = farthest(first);
    let other = farthest(end);
    // A corner that only touches the plane cuts nothing.
    if end != other {
        keep(end, other);
    }
}

/// Calls `visit` with the column and row of each texel that a segment comes within `margin` of, in texels.
pub(super) fn along(
    [a, b]: Segment,
    lattice: &Lattice,
    margin: f32,
    visit: &mut dyn FnMut(u32, u32),
) {
    let cells = |low: f32, high: f32, count: u32| {
        let clamp = |v: f32| v.floor().clamp(-1.0, count as f32) as i64;
        clamp(low - margin).max(0)..(clamp(high + margin) + 1).min(i64::from(count))
    };
    for row in cells(a.y.min(b.y), a.y.max(b.y), lattice.height) {
        // The segment's part in this row.
        let (low, high) = (row as f32 - margin, (row + 1) as f32 + margin);
        let at = |y: f32| {
            let t = if a.y == b.y { 0.0 } else { ((y - a.y) / (b.y - a.y)).clamp(0.0, 1.0) };
            a.x + (b.x - a.x) * t
        };
        let (from, to) = if a.y == b.y { (a.x, b.x) } else { (at(low), at(high)) };
        for column in cells(from.min(to), from.max(to), lattice.width) {
            visit(column as u32, row as u32);
        }
    }
}
