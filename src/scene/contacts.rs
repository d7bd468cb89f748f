//! Which surfaces lie in one plane, and which of them is in front: the same for the bake and the eye.
//!
//! In: the scene. Out: for each surface the plane by which its depth along a ray is found, and its place
//! among surfaces that touch there. Planes closer than [`CONTACT`] are taken for one, that of the largest
//! surface in it, so that neither the angle of a ray nor rounding decides who hides whom.

use super::{Polygon, Scene, Surface};
use crate::ids::SurfaceId;
use glam::Vec3;
use std::cmp::Reverse;
use std::collections::HashMap;

/// Surfaces closer than this touch: no light passes between them. In the fitted scene's units.
pub const CONTACT: f32 = 1e-5;

/// Edges of the cells in which planes are looked up: of unit normals, and of distances from the origin, which
/// tell parallel walls apart.
const CELLS: [f32; 4] = [2e-2, 2e-2, 2e-2, 4e-3];

/// How far the normals of touching surfaces, and with them their planes' distances, may be apart.
const TILT: f32 = 1e-3;

/// The planes of a scene and who is in front in each.
#[derive(Clone, Debug, Default)]
pub struct Contacts {
    /// For each surface the one whose plane it lies in: itself, or a larger one.
    planes: Vec<u32>,
    /// Position among all surfaces, the smallest first; of equally large ones the later first.
    ranks: Vec<u32>,
    /// Whether a surface's own polygons' neighbours go on behind it, as those of a box's face do.
    solid: Vec<bool>,
}

impl Contacts {
    /// Near-linear in the number of polygons.
    pub fn new(scene: &Scene) -> Contacts {
        let areas: Vec<f32> = scene.surfaces.iter().map(Surface::area).collect();
        let mut order: Vec<u32> = (0..areas.len() as u32).collect();
        order.sort_by_key(|s| (size(areas[*s as usize]), Reverse(*s)));
        let mut ranks = vec![0; areas.len()];
        order.iter().zip(0..).for_each(|(surface, rank)| ranks[*surface as usize] = rank);
        Contacts { planes: planes(scene, &order), ranks, solid: solid(scene) }
    }

    /// Bytes of memory that they take.
    pub fn bytes(&self) -> u64 {
        let Contacts { planes, ranks, solid } = self;
        (size_of_val(planes.as_slice()) + size_of_val(ranks.as_slice()) + solid.len()) as u64
    }

    /// The surface in whose plane another lies: itself, if no larger one touches it.
    pub fn plane_of(&self, surface: SurfaceId) -> SurfaceId {
        SurfaceId(self.planes[surface.index()])
    }

    /// The place of a surface among those that touch along a ray, the least first; `along` says whether
    /// its normal points along the ray. Of faces of solids (a box on a floor) the fronts are together, and
    /// other sheets lie with their backs together; of those that face the same way the smaller is in
    /// front, as a poster is on its wall. From the ray's other end the order is the reverse.
    pub fn place(&self, surface: SurfaceId, along: bool) -> (u8, u32) {
        let (rank, solid) = (self.ranks[surface.index()], self.solid[surface.index()]);
        match (along, solid) {
            (true, true) => (0, u32::MAX - rank),
            (false, false) => (1, rank),
            (true, false) => (2, u32::MAX - rank),
            (false, true) => (3, rank),
        }
    }
}

/// An area as a whole number that grows with it, the same for areas that differ by rounding.
fn size(area: f32) -> i64 {
    (1024.0 * area.ln()).round() as i64
}

/// For each surface the largest one in whose plane all its corners lie; `order` is by growing area.
fn planes(scene: &Scene, order: &[u32]) -> Vec<u32> {
    let mut cells: HashMap<[i32; 4], Vec<u32>> = HashMap::new();
    let mut planes: Vec<u32> = (0..order.len() as u32).collect();
    for &number in order.iter().rev() {
        let surface = &scene.surfaces[number as usize];
        let at = surface.normal.extend(surface.normal.dot(surface.origin)).to_array();
        let mut keys = [at, at.map(|v| -v)].into_iter().flat_map(cells_about);
        let lies_in = |other: &&u32| {
            let Surface { normal, origin, .. } = &scene.surfaces[**other as usize];
            let near = |v: &Vec3| (*v - *origin).dot(*normal).abs() <= CONTACT;
            normal.cross(surface.normal).length_squared() <= TILT * TILT
                && surface.polygons.iter().flat_map(|p| &p.vertices).all(near)
        };
        let found = keys.find_map(|key| cells.get(&key)?.iter().find(lies_in).copied());
        match found {
            Some(other) => planes[number as usize] = other,
            None => cells.entry(cell(at)).or_default().push(number),
        }
    }
    planes
}

fn cell(at: [f32; 4]) -> [i32; 4] {
    std::array::from_fn(|k| (at[k] / CELLS[k]).floor() as i32)
}

/// The cells within [`TILT`] of a place; a cell may come twice.
fn cells_about(at: [f32; 4]) -> impl Iterator<Item = [i32; 4]> {
    let low = cell(at.map(|v| v - 1.5 * TILT));
    let high = cell(at.map(|v| v + 1.5 * TILT));
    let choose =
        move |k: usize| [0, 1, 2, 3].map(|c| if k >> c & 1 == 0 { low[c] } else { high[c] });
    let differs = move |k: &usize| (0..4).all(|c| k >> c & 1 == 0 || low[c] != high[c]);
    (0..16).filter(differs).map(choose)
}

/// An edge of a surface's outline, with the direction in which the surface goes from it.
struct Edge {
    surface: u32,
    ends: [[u32; 3]; 2],
    inward: Vec3,
}

impl Edge {
    /// The same for edges that have the same ends.
    fn key(&self) -> [[u32; 3]; 2] {
        let [a, b] = self.ends;
        [a.min(b), a.max(b)]
    }

    fn runs_against(&self, other: &Edge) -> bool {
        self.ends[0] == other.ends[1] && self.ends[1] == other.ends[0]
    }
}

/// The edges of all outlines. Where two polygons of one surface meet is none.
fn edges(scene: &Scene) -> Vec<Edge> {
    let bits = |v: Vec3| (v + Vec3::ZERO).to_array().map(f32::to_bits);
    let mut all = Vec::new();
    let mut own: Vec<Edge> = Vec::new();
    for (s, surface) in scene.surfaces.iter().zip(0..) {
        for Polygon { vertices } in &s.polygons {
            for (a, b) in vertices.iter().zip(vertices.iter().cycle().skip(1)) {
                let inward = s.normal.cross(*b - *a).normalize_or_zero();
                own.push(Edge { surface, ends: [bits(*a), bits(*b)], inward });
            }
        }
        if s.polygons.len() > 1 {
            own.sort_unstable_by_key(Edge::key);
            let mut rest = std::mem::take(&mut own).into_iter().peekable();
            while let Some(edge) = rest.next() {
                if rest.next_if(|next| next.runs_against(&edge)).is_none() {
                    own.push(edge);
                }
            }
        }
        all.append(&mut own);
    }
    all
}

/// Whether of the polygons that share a surface's edges, and are wound as of one skin with it, more go on
/// behind it than before it, as with a box's faces. Says nothing of what stands around that skin. Not so
/// the outer skin of walls without thickness: the face at its back is of a skin that closes before it.
fn solid(scene: &Scene) -> Vec<bool> {
    let mut edges = edges(scene);
    edges.sort_unstable_by_key(Edge::key);
    let mut behind = vec![0i32; scene.surfaces.len()];
    let mut backs = Vec::new();
    for shared in edges.chunk_by(|a, b| a.key() == b.key()) {
        for edge in shared {
            let normal = scene.surfaces[edge.surface as usize].normal;
            for next in shared.iter().filter(|next| next.runs_against(edge)) {
                let height = next.inward.dot(normal);
                if height.abs() > TILT {
                    behind[edge.surface as usize] += if height < 0.0 { 1 } else { -1 };
                } else if next.inward.dot(edge.inward) > 0.0 {
                    backs.push((edge.surface, next.surface));
                }
            }
        }
    }
    let mut solid: Vec<bool> = behind.iter().map(|n| *n > 0).collect();
    for (surface, back) in backs {
        solid[surface as usize] &= behind[back as usize] >= 0;
    }
    solid
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::test_scenes::{quad, room, scene_of};

    /// The quads in the plane z = 0 are numbered from 0, the ones of a room follow.
    fn with_room(sheets: Vec<Surface>) -> Contacts {
        let mut scene = scene_of(sheets, Vec::new());
        scene.surfaces.extend(room().surfaces);
        Contacts::new(&scene)
    }

    fn sheet(height: f32, edge: f32, up: bool) -> Surface {
        let (a, b) = if up { (Vec3::X, Vec3::Y) } else { (Vec3::Y, Vec3::X) };
        quad(0, Vec3::new(-0.5 * edge, -0.5 * edge, height), a * edge, b * edge)
    }

    #[test]
    fn the_smaller_of_two_sheets_is_in_front_from_either_end_and_of_equal_ones_the_later() {
        for (first, later) in [(0.4, 0.2), (0.2, 0.2)] {
            let contacts = with_room(vec![sheet(0.0, first, true), sheet(9e-6, later, true)]);
            let place = |k, along| contacts.place(SurfaceId(k), along);
            assert!(place(1, false) < place(0, false) && place(0, true) < place(1, true));
            assert_eq!(contacts.plane_of(SurfaceId(1)), contacts.plane_of(SurfaceId(0)));
        }
    }

    #[test]
    fn only_what_touches_shares_a_plane() {
        let planes = |gap: f32, up| {
            let contacts = with_room(vec![sheet(0.1, 0.4, true), sheet(0.1 + gap, 0.2, up)]);
            contacts.plane_of(SurfaceId(1))
        };
        assert_eq!((planes(5e-6, true), planes(-5e-6, false)), (SurfaceId(0), SurfaceId(0)));
        assert_eq!((planes(2e-5, true), planes(-2e-5, false)), (SurfaceId(1), SurfaceId(1)));
    }

    #[test]
    fn a_box_is_solid_and_the_room_about_it_is_not() {
        let mut surfaces = room().surfaces;
        for mut s in room().surfaces {
            s.normal = -s.normal;
            s.polygons[0].vertices.iter_mut().for_each(|v| *v *= 0.5);
            s.polygons[0].vertices.reverse();
            surfaces.push(s);
        }
        let contacts = Contacts::new(&scene_of(surfaces, Vec::new()));
        assert_eq!(contacts.solid, [[false; 6], [true; 6]].concat());
        // The same walls drawn from both sides are no solid.
        let mut both = scene_of(room().surfaces, Vec::new());
        for mut s in room().surfaces {
            s.normal = -s.normal;
            s.polygons[0].vertices.reverse();
            both.surfaces.push(s);
        }
        assert_eq!(Contacts::new(&both).solid, [false; 12]);
        // Two sheets back to back share all edges, but none goes on behind the other.
        let sheet = with_room(vec![sheet(0.0, 0.4, true), sheet(0.0, 0.4, false)]);
        assert_eq!(sheet.solid[..2], [false; 2]);
    }
}
