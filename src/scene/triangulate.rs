//! Polygons to triangles, by ear clipping with exact predicates.

use super::Polygon;
use super::outline::{flatten, turn, twice_area};
use glam::{DVec2, DVec3};

/// The triangles of a polygon, concave or not, as indices of its vertices, each counter-clockwise as
/// the polygon is. Corners in line with their neighbours make no triangle. Convex polygons come out as
/// the fan about vertex 0. At most `n - 2` triangles; O(n^2) for usual loops of n corners.
pub fn triangles(polygon: &Polygon) -> Vec<[usize; 3]> {
    let points: Vec<DVec3> = polygon.vertices.iter().map(|p| p.as_dvec3()).collect();
    let corners: Vec<u32> = (0..points.len() as u32).collect();
    // Its own normal, not its surface's: a loop that was found simple without one coordinate may cross
    // itself by rounding without another, and near-equal coordinates of a normal change places.
    ears(&flatten(&points, twice_area(&points, &corners).0))
}

/// The same for a counter-clockwise loop in two dimensions. A loop that crosses itself gets triangles
/// too, but their areas do not sum to its own.
pub(super) fn ears(points: &[DVec2]) -> Vec<[usize; 3]> {
    let n = points.len();
    let mut left: Vec<usize> = (0..n).collect();
    let mut out = Vec::with_capacity(n.saturating_sub(2));
    let mut at = 1;
    let mut missed = 0;
    while left.len() >= 3 {
        let m = left.len();
        at %= m;
        let [a, b, c] = [left[(at + m - 1) % m], left[at], left[(at + 1) % m]];
        let side = turn(points[a], points[b], points[c]);
        // After a whole round without an ear any left turn will do: it ends the search.
        if side == 0.0 || side > 0.0 && (missed >= m || is_ear(points, &left, [a, b, c])) {
            if side > 0.0 {
                out.push([a, b, c]);
            }
            left.remove(at);
            missed = 0;
        } else if missed >= 2 * m {
            break;
        } else {
            at += 1;
            missed += 1;
        }
    }
    out
}

/// Whether no other corner lies in the triangle. Corners at the very place of one of its own do not
/// count: keyholes have them.
fn is_ear(points: &[DVec2], left: &[usize], [a, b, c]: [usize; 3]) -> bool {
    let [pa, pb, pc] = [points[a], points[b], points[c]];
    let (low, high) = (pa.min(pb).min(pc), pa.max(pb).max(pc));
    !left.iter().any(|&i| {
        let p = points[i];
        p.cmpge(low).all()
            && p.cmple(high).all()
            && ![pa, pb, pc].contains(&p)
            && turn(pa, pb, p) >= 0.0
            && turn(pb, pc, p) >= 0.0
            && turn(pc, pa, p) >= 0.0
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use proptest::prelude::*;

    fn area(points: &[DVec2], triangles: &[[usize; 3]]) -> f64 {
        let twice =
            |t: &[usize; 3]| (points[t[1]] - points[t[0]]).perp_dot(points[t[2]] - points[t[0]]);
        triangles.iter().map(|t| 0.5 * twice(t)).sum()
    }

    #[test]
    fn convex_polygons_come_out_as_a_fan() {
        let square = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(DVec2::from);
        assert_eq!(ears(&square), [[0, 1, 2], [0, 2, 3]]);
    }

    #[test]
    fn keyhole_keeps_its_area() {
        // A square of edge 4 with a hole of edge 2 in its middle, reached over a bridge.
        let hole = [
            (0.0, 0.0),
            (4.0, 0.0),
            (4.0, 4.0),
            (0.0, 4.0),
            (0.0, 0.0),
            (1.0, 1.0),
            (1.0, 3.0),
            (3.0, 3.0),
            (3.0, 1.0),
            (1.0, 1.0),
        ]
        .map(DVec2::from);
        assert!((area(&hole, &ears(&hole)) - 12.0).abs() < 1e-12);
    }

    #[test]
    fn corners_in_line_make_no_triangle() {
        let p = [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (2.0, 2.0)].map(DVec2::from);
        let t = ears(&p);
        assert_eq!(area(&p, &t), 2.0);
    }

    #[test]
    fn triangles_go_round_as_the_polygon_does() {
        let vertices = [Vec3::ZERO, Vec3::Y, Vec3::new(1.0, 1.0, 0.0), Vec3::X].to_vec();
        let t = triangles(&Polygon { vertices });
        assert_eq!(t, [[0, 1, 2], [0, 2, 3]]);
    }

    proptest! {
        #[test]
        fn star_shaped_loops_keep_their_area(radii in prop::collection::vec(0.1f64..1.0, 3..40)) {
            let n = radii.len() as f64;
            let points: Vec<DVec2> = radii.iter().enumerate()
                .map(|(i, r)| DVec2::from_angle(i as f64 / n * std::f64::consts::TAU) * *r)
                .collect();
            let whole: f64 = (0..points.len())
                .map(|i| 0.5 * points[i].perp_dot(points[(i + 1) % points.len()]))
                .sum();
            let t = ears(&points);
            prop_assert!(t.len() <= points.len() - 2);
            // A star about the origin is simple when no step is wider than half a turn.
            prop_assert!((area(&points, &t) - whole).abs() < 1e-9);
        }
    }
}
