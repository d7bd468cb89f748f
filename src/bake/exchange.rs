//! Exchange: who sees whom along a ray (section 4.1).
//!
//! In: the fragments of one cell in order of depth. Between neighbours nothing stands, so the exchange
//! buffer is the order itself. A ray serves both ways: of each pair of neighbours, the nearer
//! surface's side that faces along the direction and the farther one's side that faces against it look
//! at each other, so that X(r, P) = Q exactly when X(r, Q) = P. Before the first and behind the last
//! fragment is the space outside the scene.

use super::layers::Fragment;
use crate::ids::{Sense, SurfaceId};
pub use crate::scene::contacts::CONTACT;
use crate::scene::contacts::Contacts;

/// Whether light passes between two neighbours on a ray. Lines that meet only in a contact say nothing
/// of the texel's radiance.
#[inline]
pub fn see_each_other(near: Fragment, far: Fragment) -> bool {
    far.depth() - near.depth() > CONTACT
}

/// What the k-th fragment of a line sees first along the direction, or against it, and how far away that is.
pub fn seen_from(fragments: &[Fragment], k: usize, sense: Sense) -> Option<(Fragment, f32)> {
    let next = *match sense {
        Sense::Along => fragments.get(k + 1),
        Sense::Against => fragments[..k].last(),
    }?;
    let gap = (next.depth() - fragments[k].depth()).abs();
    (gap > CONTACT).then_some((next, gap))
}

/// Puts touching fragments into an order that is the same from both ends of the ray and from every
/// direction. Fragments in the order of depth; only those that touch change places. `surface_of`
/// names the surface of each texel.
#[inline]
pub fn order_contacts(fragments: &mut [Fragment], contacts: &Contacts, surface_of: &[u32]) {
    if fragments.windows(2).any(|pair| !see_each_other(pair[0], pair[1])) {
        order_groups(fragments, contacts, surface_of);
    }
}

fn order_groups(fragments: &mut [Fragment], contacts: &Contacts, surface_of: &[u32]) {
    let mut from = 0;
    while from < fragments.len() {
        let to = group_end(fragments, from);
        if to - from > 1 {
            let surface = |f: &Fragment| SurfaceId(surface_of[f.texel() as usize]);
            order_group(&mut fragments[from..to], contacts, surface);
        }
        from = to;
    }
}

/// Where the group of touching fragments ends that begins at `from`.
fn group_end(fragments: &[Fragment], from: usize) -> usize {
    let gap = |pair: &[Fragment]| see_each_other(pair[0], pair[1]);
    let rest = &fragments[from..];
    from + rest.windows(2).position(gap).map_or(rest.len(), |k| k + 1)
}

/// Orders fragments that touch: those of one plane by their place in it. Surfaces that a ray meets
/// where they cross or share an edge are in no plane together; of these the fronts are seen.
fn order_group(
    group: &mut [Fragment],
    contacts: &Contacts,
    surface: impl Fn(&Fragment) -> SurfaceId,
) {
    let plane = |f: &Fragment| contacts.plane_of(surface(f));
    let first = plane(&group[0]);
    if group.iter().all(|f| plane(f) == first) {
        group.sort_by_key(|f| contacts.place(surface(f), f.faces_along()));
    } else {
        group.sort_by_key(|f| (f.faces_along(), contacts.place(surface(f), f.faces_along())));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::test_scenes::{quad, scene_of, walls};
    use glam::Vec3;

    /// A cube of surfaces 0 to 5 with its front outside and a large floor, 6, on which it stands on
    /// surface 4; a sheet of 7 and 8; a poster, 9, on the floor. `z` is up.
    fn contacts() -> (Contacts, Vec<u32>) {
        let mut surfaces = Vec::new();
        for mut s in walls() {
            s.normal = -s.normal;
            s.polygons[0].vertices.reverse();
            surfaces.push(s);
        }
        let (x, y, low) = (Vec3::X, Vec3::Y, Vec3::splat(-0.5));
        surfaces.push(quad(0, low, 3.0 * x, 3.0 * y));
        surfaces.push(quad(0, low + 0.2 * Vec3::Z, x * 0.5, y * 0.5));
        surfaces.push(quad(0, low + 0.2 * Vec3::Z, y * 0.5, x * 0.5));
        surfaces.push(quad(0, low, 0.1 * x, 0.1 * y));
        let scene = scene_of(surfaces, Vec::new());
        (Contacts::new(&scene), (0..scene.surfaces.len() as u32).collect())
    }

    /// Orders fragments given as (depth, surface, faces along) and gives their surfaces back.
    fn ordered(list: &[(f32, u32, bool)]) -> Vec<u32> {
        let (contacts, surface_of) = contacts();
        let mut fragments: Vec<_> = list.iter().map(|f| Fragment::new(f.0, f.1, f.2)).collect();
        fragments.sort();
        order_contacts(&mut fragments, &contacts, &surface_of);
        fragments.iter().map(|f| f.texel()).collect()
    }

    /// The same from the ray's other end, and that both agree.
    fn from_both_ends(list: &[(f32, u32, bool)]) -> Vec<u32> {
        let there = ordered(list);
        let turned: Vec<_> = list.iter().map(|(z, t, along)| (-z, *t, !along)).collect();
        let mut back = ordered(&turned);
        back.reverse();
        assert_eq!(there, back);
        there
    }

    #[test]
    fn a_box_on_a_floor_has_its_front_on_the_floors() {
        // From above: box top 5, box bottom 4 (back to us) on the floor, 6 (front to us).
        assert_eq!(from_both_ends(&[(0.0, 5, false), (0.5, 4, true), (0.5, 6, false)]), [5, 4, 6]);
        // A crate without a lid, whose floor is seen from within.
        assert_eq!(from_both_ends(&[(0.5, 6, false), (0.5, 4, true)]), [4, 6]);
        // A poster on the floor is under the box, too.
        let all = [(0.5, 6, false), (0.5, 4, true), (0.5, 9, false)];
        assert_eq!(from_both_ends(&all), [4, 9, 6]);
    }

    #[test]
    fn a_sheet_shows_its_fronts_whatever_stands_around_it() {
        for before in [true, false] {
            for behind in [true, false] {
                let sheet = [(-0.5, 0, before), (0.0, 8, true), (0.0, 7, false), (0.5, 1, behind)];
                assert_eq!(from_both_ends(&sheet), [0, 7, 8, 1]);
            }
        }
    }

    #[test]
    fn of_two_coincident_surfaces_the_smaller_is_in_front_from_either_end() {
        assert_eq!(ordered(&[(0.0, 6, false), (0.0, 9, false)]), [9, 6]);
        assert_eq!(ordered(&[(0.0, 6, true), (0.0, 9, true)]), [6, 9]);
    }

    #[test]
    fn surfaces_apart_keep_their_depth() {
        assert_eq!(ordered(&[(0.2, 1, true), (0.1, 2, false), (0.3, 3, false)]), [2, 1, 3]);
    }
}
