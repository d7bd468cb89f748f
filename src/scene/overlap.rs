//! Whether polygons of one plane overlap, found with a grid. Near-linear for meshes of even size.

use super::triangulate::ears;
use glam::DVec2;

/// Triangle pairs and grid entries spent for each triangle, and at least, before giving up.
const SPENT_EACH: usize = 1000;
const SPENT_ANYWAY: usize = 10_000_000;

/// Whether any two of some counter-clockwise loops overlap by more than `slack`. When that cannot be
/// found with reasonable work the answer is yes, the safe one for a caller that wants to merge.
pub(super) fn overlap(loops: &[Vec<DVec2>], slack: f64) -> bool {
    let mut triangles: Vec<(u32, [DVec2; 3])> = Vec::new();
    for (i, points) in loops.iter().enumerate() {
        triangles.extend(ears(points).iter().map(|t| (i as u32, t.map(|k| points[k]))));
    }
    let all = || triangles.iter().flat_map(|(_, t)| t);
    let low = all().fold(DVec2::INFINITY, |a, b| a.min(*b));
    let high = all().fold(DVec2::NEG_INFINITY, |a, b| a.max(*b));
    let side = (triangles.len() as f64).sqrt().ceil().max(1.0);
    let scale = DVec2::splat(side) / (high - low).max(DVec2::splat(f64::MIN_POSITIVE));
    let cell = |p: DVec2| {
        let c = ((p - low) * scale).clamp(DVec2::ZERO, DVec2::splat(side - 1.0));
        (c.x as usize, c.y as usize)
    };
    let columns = side as usize;
    let mut budget = SPENT_ANYWAY + SPENT_EACH * triangles.len();
    let mut cells: Vec<Vec<u32>> = vec![Vec::new(); columns * columns];
    for (i, (_, [a, b, c])) in triangles.iter().enumerate() {
        let (from, to) = (cell(a.min(*b).min(*c)), cell(a.max(*b).max(*c)));
        for row in from.1..=to.1 {
            for column in from.0..=to.0 {
                let here = &mut cells[row * columns + column];
                let Some(left) = budget.checked_sub(1 + here.len()) else {
                    return true;
                };
                budget = left;
                let (owner, triangle) = &triangles[i];
                let hits = |j: &u32| {
                    let (other, second) = &triangles[*j as usize];
                    other != owner
                        && !apart(triangle, second, slack)
                        && !apart(second, triangle, slack)
                };
                if here.iter().any(hits) {
                    return true;
                }
                here.push(i as u32);
            }
        }
    }
    false
}

/// Whether an edge of the first counter-clockwise triangle has the second on its outer side.
fn apart(first: &[DVec2; 3], second: &[DVec2; 3], slack: f64) -> bool {
    (0..3).any(|i| {
        let (a, b) = (first[i], first[(i + 1) % 3]);
        let edge = b - a;
        let most = slack * edge.length();
        second.iter().all(|p| edge.perp_dot(*p - a) <= most)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(x: f64, y: f64, edge: f64) -> Vec<DVec2> {
        [(0.0, 0.0), (edge, 0.0), (edge, edge), (0.0, edge)]
            .map(|(i, j)| DVec2::new(x + i, y + j))
            .to_vec()
    }

    #[test]
    fn neighbours_do_not_overlap_and_shifted_ones_do() {
        let mut loops: Vec<_> =
            (0..400).map(|i| square(f64::from(i % 20), f64::from(i / 20), 1.0)).collect();
        assert!(!overlap(&loops, 1e-6));
        loops.push(square(7.25, 3.25, 0.5));
        assert!(overlap(&loops, 1e-6));
    }

    #[test]
    fn a_square_in_the_hollow_of_another_polygon_does_not_overlap() {
        let hollow = [(0.0, 0.0), (3.0, 0.0), (3.0, 1.0), (1.0, 1.0), (1.0, 3.0), (0.0, 3.0)];
        let hollow = hollow.map(DVec2::from).to_vec();
        assert!(!overlap(&[hollow.clone(), square(1.0, 1.0, 2.0)], 1e-6));
        assert!(overlap(&[hollow, square(0.9, 1.0, 2.0)], 1e-6));
    }
}
