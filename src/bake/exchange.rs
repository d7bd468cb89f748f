//! Exchange: who sees whom along a ray (section 4.1).
//!
//! In: the fragments of one cell in order of depth. Between neighbours nothing stands, so the exchange
//! buffer is the order itself. A ray serves both ways: of each pair of neighbours, the nearer
//! surface's side that faces along the direction and the farther one's side that faces against it look
//! at each other, so that X(r, P) = Q exactly when X(r, Q) = P. Before the first and behind the last
//! fragment is the space outside the scene.

use super::layers::Fragment;

/// Surfaces closer than this along a ray touch: no light passes between them, and lines that meet
/// only in the contact say nothing of the texel's radiance. In the fitted scene's units.
pub const CONTACT: f32 = 1e-5;

/// Whether light passes between two neighbours on a ray.
pub fn see_each_other(near: Fragment, far: Fragment) -> bool {
    far.depth() - near.depth() > CONTACT
}

/// Puts touching fragments into an order that is the same from both ends of the ray and from every
/// direction. Fragments in the order of depth; only those that touch change places.
pub fn order_contacts(fragments: &mut [Fragment]) {
    // Groups of touching fragments, most of them of one: the one before, and the one at hand.
    let (mut before, mut from) = (0, 0);
    while from < fragments.len() {
        let to = group_end(fragments, from);
        if to - from > 1 {
            // The ray is inside a solid before them if what it met last showed it its front, and
            // inside one behind them if what comes next shows it its back.
            let entered = fragments[before..from].iter().any(|f| !f.faces_along());
            let next = group_end(fragments, to);
            let to_leave = fragments[to..next].iter().any(|f| f.faces_along());
            order_group(&mut fragments[from..to], entered || to_leave);
        }
        (before, from) = (from, to);
    }
}

/// Where the group of touching fragments ends that begins at `from`.
fn group_end(fragments: &[Fragment], from: usize) -> usize {
    let gap = |pair: &[Fragment]| see_each_other(pair[0], pair[1]);
    let rest = &fragments[from..];
    from + rest.windows(2).position(gap).map_or(rest.len(), |k| k + 1)
}

/// Orders fragments that touch. Two closed solids that touch (a box on a floor) have their fronts
/// together; a thin sheet of two polygons, with no solid at either end, has its backs together. Of
/// coincident surfaces that face the same way the one with the lower number is in front.
fn order_group(group: &mut [Fragment], solid: bool) {
    let key = |f: &Fragment| {
        let number = i64::from(f.texel());
        (f.faces_along() == solid, if f.faces_along() { -number } else { number })
    };
    group.sort_by(|a, b| {
        let ((a_first, a_number), (b_first, b_number)) = (key(a), key(b));
        b_first.cmp(&a_first).then(a_number.cmp(&b_number))
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Orders fragments given as (depth, texel, faces along) and gives their texels back.
    fn ordered(list: &[(f32, u32, bool)]) -> Vec<u32> {
        let mut fragments: Vec<_> = list.iter().map(|f| Fragment::new(f.0, f.1, f.2)).collect();
        fragments.sort();
        order_contacts(&mut fragments);
        fragments.iter().map(|f| f.texel()).collect()
    }

    #[test]
    fn a_box_on_a_floor_and_a_sheet_in_the_open() {
        // From above: box top 1 (front to us), box bottom 2 (back to us) on floor 3 (front to us).
        assert_eq!(ordered(&[(0.0, 1, false), (0.5, 2, true), (0.5, 3, false)]), [1, 2, 3]);
        assert_eq!(ordered(&[(0.0, 1, false), (0.5, 3, true), (0.5, 2, false)]), [1, 3, 2]);
        // From below: floor 3 shows its back, then the bottom 2 its front, then the top 1 its back.
        assert_eq!(ordered(&[(0.0, 3, true), (0.0, 2, false), (0.5, 1, true)]), [3, 2, 1]);
        assert_eq!(ordered(&[(0.0, 2, false), (0.0, 3, true), (0.5, 1, true)]), [3, 2, 1]);
        // Boxes 1 2, 3 4 and 5 6 in a row, from both ends.
        let row = [
            (0.0, 1, false),
            (0.1, 3, false),
            (0.1, 2, true),
            (0.2, 4, true),
            (0.2, 5, false),
            (0.3, 6, true),
        ];
        assert_eq!(ordered(&row), [1, 2, 3, 4, 5, 6]);
        assert_eq!(ordered(&row.map(|(z, t, along)| (-z, t, !along))), [6, 5, 4, 3, 2, 1]);
        // A sheet of 5 and 6 in a room: whichever shows its front comes first.
        let sheet = [(-0.5, 1, true), (0.0, 5, true), (0.0, 6, false), (0.5, 2, false)];
        assert_eq!(ordered(&sheet), [1, 6, 5, 2]);
    }

    #[test]
    fn of_two_coincident_surfaces_the_same_one_is_in_front_from_either_end() {
        assert_eq!(ordered(&[(0.0, 4, false), (0.0, 9, false)])[0], 4);
        assert_eq!(ordered(&[(0.0, 4, true), (0.0, 9, true)])[1], 4);
    }

    #[test]
    fn surfaces_apart_keep_their_depth() {
        assert_eq!(ordered(&[(0.2, 1, true), (0.1, 2, false), (0.3, 3, false)]), [2, 1, 3]);
    }
}
