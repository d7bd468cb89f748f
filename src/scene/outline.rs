//! A polygon's outline in two dimensions: whether it is simple, with exact predicates.

use glam::{DVec2, DVec3};
use robust::{Coord, orient2d};

/// What an outline does to itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Outline {
    /// Nothing: a simple loop.
    Simple,
    /// Some edges touch, as those of a keyhole do.
    Touching,
    /// Some edges cross.
    Crossing,
}

/// Twice the vector area of a loop (Newell), and the largest distance from its first corner.
pub(super) fn twice_area(points: &[DVec3], corners: &[u32]) -> (DVec3, f64) {
    let at = |i: usize| points[corners[i] as usize] - points[corners[0] as usize];
    let mut sum = DVec3::ZERO;
    let mut reach: f64 = 0.0;
    for i in 1..corners.len() {
        reach = reach.max(at(i).length());
        if i + 1 < corners.len() {
            sum += at(i).cross(at(i + 1));
        }
    }
    (sum, reach)
}

/// The points without the coordinate in which the normal is largest, ordered so that loops
/// counter-clockwise about the normal stay so. No rounding takes place.
pub(super) fn flatten(points: &[DVec3], normal: DVec3) -> Vec<DVec2> {
    let k = normal.abs().max_position();
    let (mut i, mut j) = ((k + 1) % 3, (k + 2) % 3);
    if normal[k] < 0.0 {
        std::mem::swap(&mut i, &mut j);
    }
    points.iter().map(|p| DVec2::new(p[i], p[j])).collect()
}

/// Positive when a, b, c turn left, negative when right, zero when they are collinear; the sign is exact.
pub(super) fn turn(a: DVec2, b: DVec2, c: DVec2) -> f64 {
    let coord = |p: DVec2| Coord { x: p.x, y: p.y };
    orient2d(coord(a), coord(b), coord(c))
}

/// Classifies a counter-clockwise loop without repeated neighbours. O(n) for convex loops, else O(n^2).
pub(super) fn outline(loop_2d: &[DVec2]) -> Outline {
    let n = loop_2d.len();
    if n == 3 || is_convex(loop_2d) {
        return Outline::Simple;
    }
    let edge = |i: usize| (loop_2d[i], loop_2d[(i + 1) % n]);
    let mut found = Outline::Simple;
    for i in 0..n {
        let (a, b) = edge(i);
        // The next edge may only come back over this one.
        let c = edge((i + 1) % n).1;
        if turn(a, b, c) == 0.0 && (b - a).dot(c - b) < 0.0 {
            found = Outline::Touching;
        }
        for j in i + 2..n {
            if i == 0 && j == n - 1 {
                continue;
            }
            let (c, d) = edge(j);
            if a.max(b).cmplt(c.min(d)).any() || c.max(d).cmplt(a.min(b)).any() {
                continue;
            }
            let sides = [turn(a, b, c), turn(a, b, d), turn(c, d, a), turn(c, d, b)];
            if sides[0].signum() * sides[1].signum() < 0.0
                && sides[2].signum() * sides[3].signum() < 0.0
                && !sides.contains(&0.0)
            {
                return Outline::Crossing;
            }
            if on_segment(a, b, c, sides[0])
                || on_segment(a, b, d, sides[1])
                || on_segment(c, d, a, sides[2])
                || on_segment(c, d, b, sides[3])
            {
                found = Outline::Touching;
            }
        }
    }
    found
}

/// Whether p, on side `side` of the line through a and b, lies on the segment between them.
fn on_segment(a: DVec2, b: DVec2, p: DVec2, side: f64) -> bool {
    side == 0.0 && p.cmpge(a.min(b)).all() && p.cmple(a.max(b)).all()
}

/// Whether every corner turns left and the whole goes round once.
fn is_convex(loop_2d: &[DVec2]) -> bool {
    let n = loop_2d.len();
    let mut reversals = 0;
    for i in 0..n {
        let (a, b, c) = (loop_2d[i], loop_2d[(i + 1) % n], loop_2d[(i + 2) % n]);
        if turn(a, b, c) <= 0.0 {
            return false;
        }
        // A loop that goes round once turns from rising to falling once, and back once. Edges along
        // y count as rising when they go up.
        let rises = |p: DVec2, q: DVec2| q.x > p.x || q.x == p.x && q.y > p.y;
        reversals += usize::from(rises(a, b) != rises(b, c));
    }
    reversals == 2
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(points: &[(f64, f64)]) -> Outline {
        outline(&points.iter().map(|&p| p.into()).collect::<Vec<_>>())
    }

    #[test]
    fn outlines_are_told_apart() {
        let square = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
        assert_eq!(of(&square), Outline::Simple);
        let ell = [(0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.0, 1.0), (1.0, 2.0), (0.0, 2.0)];
        assert_eq!(of(&ell), Outline::Simple);
        let bow = [(0.0, 0.0), (2.0, 2.0), (2.0, 0.0), (0.0, 1.0)];
        assert_eq!(of(&bow), Outline::Crossing);
        let star: Vec<(f64, f64)> = (0..5)
            .map(|k| (f64::from(k) * 0.8 * std::f64::consts::PI).sin_cos())
            .map(|(s, c)| (c, s))
            .collect();
        assert_eq!(of(&star), Outline::Crossing, "every corner of a pentagram turns left");
        let spike = [(0.0, 0.0), (2.0, 0.0), (1.0, 0.0), (1.0, 1.0)];
        assert_eq!(of(&spike), Outline::Touching);
    }
}
