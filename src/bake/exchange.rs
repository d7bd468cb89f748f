//! Exchange: who sees whom along a ray (section 4.1).
//!
//! In: the fragments of one cell in order of depth. Out: the pairs between which nothing stands. A
//! ray serves both ways: of each pair, the nearer surface's side that faces along the direction and
//! the farther one's side that faces against it look at each other, so that X(r, P) = Q exactly when
//! X(r, Q) = P.

use super::layers::Fragment;

/// Surfaces closer than this along a ray touch: no light passes between them, and lines that meet
/// only in the contact say nothing of the texel's radiance. In the fitted scene's units.
const CONTACT: f32 = 1e-5;

/// Calls `visit` with each pair of neighbours on a ray, `None` standing for the space outside the
/// scene before the first and after the last fragment. `fragments` may be reordered where they touch.
pub fn pairs(
    fragments: &mut [Fragment],
    mut visit: impl FnMut(Option<(usize, Fragment)>, Option<(usize, Fragment)>),
) {
    order_contacts(fragments);
    let Some(first) = fragments.first() else { return };
    visit(None, Some((0, *first)));
    for k in 1..fragments.len() {
        let (near, far) = (fragments[k - 1], fragments[k]);
        if far.depth() - near.depth() > CONTACT {
            visit(Some((k - 1, near)), Some((k, far)));
        }
    }
    let last = fragments.len() - 1;
    visit(Some((last, fragments[last])), None);
}

/// Puts touching fragments that face opposite ways into the order that solids imply. Two closed solids
/// that touch (a box on a floor) have their fronts together; a thin sheet made of two polygons has
/// its backs together. Behind a surface that shows its front to the ray's origin we are inside a
/// solid, so the next to come is its far side.
fn order_contacts(fragments: &mut [Fragment]) {
    for k in 1..fragments.len() {
        let (a, b) = (fragments[k - 1], fragments[k]);
        if a.faces_along() != b.faces_along() && b.depth() - a.depth() <= CONTACT {
            let inside = k >= 2 && !fragments[k - 2].faces_along();
            if a.faces_along() != inside {
                fragments.swap(k - 1, k);
            }
        }
    }
}
