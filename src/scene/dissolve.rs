//! One polygon in the place of many that tile it: what a surface costs goes by its outline, not by how
//! finely its file divides it.
//!
//! All corners of the outline stay, so that neighbours which share them leave no crack.

use super::outline::{Outline, flatten, outline};
use glam::DVec3;
use std::collections::HashMap;

/// The longest outline: each row of lines looks at all of it, and whether it is simple takes a look at all
/// pairs of its edges.
const MOST_CORNERS: usize = 256;

/// The one loop, about `normal`, that polygons of one plane fill together, given the edges that only one of
/// them has. `None` where it is not one simple loop, as around a hole.
pub(super) fn dissolved(points: &[DVec3], outer: &[(u32, u32)], normal: DVec3) -> Option<Vec<u32>> {
    if outer.len() > MOST_CORNERS {
        return None;
    }
    let next: HashMap<u32, u32> = outer.iter().copied().collect();
    let first = outer.first()?.0;
    let mut corners = vec![first];
    let mut at = *next.get(&first)?;
    while at != first {
        corners.push(at);
        if corners.len() > outer.len() {
            return None;
        }
        at = *next.get(&at)?;
    }
    // Fewer corners than edges: there is another loop, or this one meets itself in a corner.
    if corners.len() < outer.len() {
        return None;
    }
    let places: Vec<DVec3> = corners.iter().map(|c| points[*c as usize]).collect();
    (outline(&flatten(&places, normal)) == Outline::Simple).then_some(corners)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grid of 5 x 5 points, 1 apart.
    fn points() -> Vec<DVec3> {
        (0..25).map(|k| DVec3::new(f64::from(k % 5), f64::from(k / 5), 0.0)).collect()
    }

    /// Outer edges of some of the 4 x 4 squares between them, in no order.
    fn outer(squares: &[u32]) -> Vec<(u32, u32)> {
        let edges = |s: &u32| {
            let a = s / 4 * 5 + s % 4;
            [(a, a + 1), (a + 1, a + 6), (a + 6, a + 5), (a + 5, a)]
        };
        let all: Vec<(u32, u32)> = squares.iter().flat_map(edges).collect();
        let mut outer: Vec<_> =
            all.iter().copied().filter(|(a, b)| !all.contains(&(*b, *a))).collect();
        outer.sort_unstable_by_key(|(a, b)| (b * 7 + a) % 5);
        outer
    }

    #[test]
    fn squares_become_their_outline() {
        let found = dissolved(&points(), &outer(&[0, 1, 4, 5]), DVec3::Z).unwrap();
        let start = found.iter().position(|c| *c == 0).unwrap();
        let turned: Vec<u32> = (0..8).map(|k| found[(start + k) % 8]).collect();
        assert_eq!(turned, [0, 1, 2, 7, 12, 11, 10, 5]);
        let ell = dissolved(&points(), &outer(&[0, 1, 4]), DVec3::Z);
        assert_eq!(ell.map(|loop_| loop_.len()), Some(8));
    }

    #[test]
    fn holes_and_corners_that_meet_are_left_as_they_are() {
        for squares in [&[0, 1, 2, 4, 6, 8, 9, 10][..], &[0, 5], &[0, 2], &[]] {
            assert_eq!(dissolved(&points(), &outer(squares), DVec3::Z), None, "{squares:?}");
        }
    }
}
