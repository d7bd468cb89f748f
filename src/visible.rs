//! What a ray meets first: a bounding volume hierarchy over the scene's triangles.
//!
//! In: the scene. Out: for a ray in the fitted scene's units the nearest surface, the point on its
//! plane and the side that faces the ray. Logarithmic in the number of triangles; triangles are met
//! in double precision, so that neighbours leave no crack between them.

use crate::ids::{Side, SurfaceId};
use crate::scene::contacts::{CONTACT, Contacts};
use crate::scene::{Scene, triangulate};
use fearless_simd::{Simd, f64x8};
use glam::{DVec3, Vec3, Vec3A};
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
use obvhs::cwbvh::{CwBvh, bvh2_to_cwbvh::bvh2_to_cwbvh};
use obvhs::ploc::PlocBuilder;
use obvhs::ray::{Ray, RayHit};
use obvhs::splits::split_aabbs_preset;
use obvhs::triangle::Triangle;
use obvhs::{Boundable, BvhBuildParams};

/// How far a triangle is widened at its edges, in the fitted scene's units: the rounding of two or
/// three f32 coordinates near 1, so that surfaces which meet without sharing corners stay tight.
const WIDENING: f64 = 2e-7;

/// How far the boxes of the hierarchy are widened: the rounding of a ray's own arithmetic in f32.
const BOX_WIDENING: f32 = 2e-6;

/// How much earlier a ray starts for the boxes: the wide hierarchy takes no box that ends nearer than
/// 1e-4 to a ray's origin, and so would lose the neighbouring wall of a ray that starts in a corner.
const HEAD_START: f32 = 2.5e-4;

/// Surfaces that a ray meets within this length of each other lie at one place for it.
pub const COINCIDENT: f64 = 1e-6;

/// An eye nearer to a surface than this, in the fitted scene's units, lies on it.
pub const TOUCHING: f32 = 1e-5;

/// Where a ray meets the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// The surface.
    pub surface: SurfaceId,
    /// The point, on the surface's plane, in the fitted scene's units.
    pub point: Vec3,
    /// Distance from the ray's origin, in lengths of the ray's direction.
    pub distance: f32,
    /// The side that faces the ray's origin.
    pub side: Side,
}

/// A triangle of a surface, ready to be met.
#[derive(Clone, Copy, Debug)]
pub struct Facet {
    /// Its first corner.
    pub corner: Vec3,
    /// From there to the others.
    pub edges: [Vec3; 2],
    /// The surface it belongs to.
    pub surface: u32,
    /// How far it is widened, in barycentric coordinates.
    pub slack: f32,
}

/// The scene's triangles with their hierarchy.
pub struct Visible {
    bvh: CwBvh,
    facets: Vec<Facet>,
    planes: Vec<Plane>,
    contacts: Contacts,
}

/// The plane of a surface: `normal . p = offset`.
#[derive(Clone, Copy, Debug)]
struct Plane {
    normal: DVec3,
    offset: f64,
}

impl Visible {
    /// Builds the hierarchy: about 5 microseconds a triangle.
    pub fn new(scene: &Scene) -> Visible {
        Visible::of(scene, |_| true)
    }

    /// The same as if the scene had no other surfaces than some of its own.
    pub fn of(scene: &Scene, some: impl Fn(SurfaceId) -> bool) -> Visible {
        let mut facets = Vec::new();
        let mut triangles = Vec::new();
        for id in scene.surface_ids().filter(|id| some(*id)) {
            let surface = scene.surface(id);
            for polygon in &surface.polygons {
                for corners in triangulate::triangles(polygon) {
                    let [a, b, c] = corners.map(|i| polygon.vertices[i]);
                    if let Some(facet) = Facet::new(a, b, c, id) {
                        facets.push(facet);
                        triangles.push(Triangle { v0: a.into(), v1: b.into(), v2: c.into() });
                    }
                }
            }
        }
        let planes = scene.surfaces.iter().map(|s| {
            let normal = s.normal.as_dvec3().normalize();
            Plane { normal, offset: normal.dot(s.origin.as_dvec3()) }
        });
        Visible {
            bvh: hierarchy(&triangles),
            facets,
            planes: planes.collect(),
            contacts: Contacts::new(scene),
        }
    }

    /// The first surface that the ray meets at `t_min` or farther, in lengths of `dir`; `t_min` is
    /// not negative.
    pub fn nearest(&self, origin: Vec3, dir: Vec3, t_min: f32) -> Option<Hit> {
        self.nearest_but(origin, dir, t_min, None)
    }

    /// The same, blind to one surface: for rays that leave a plane and cannot meet it again.
    pub fn nearest_but(
        &self,
        origin: Vec3,
        dir: Vec3,
        t_min: f32,
        but: Option<SurfaceId>,
    ) -> Option<Hit> {
        // The wide hierarchy loses every hit along a component of -0.0; adding +0.0 turns it to +0.0.
        let dir = dir + Vec3::ZERO;
        let but = but.map_or(u32::MAX, |s| s.0);
        let (o, d) = (origin.as_dvec3(), dir.as_dvec3());
        let start = Vec3A::from(origin - dir * HEAD_START);
        let ray = Ray::new(start, Vec3A::from(dir), 0.0, f32::INFINITY);
        let mut found = RayHit::none();
        let mut best = f64::INFINITY;
        let (mut surface, mut reach) = (u32::MAX, 0.0);
        self.bvh.ray_traverse(ray, &mut found, |_, at| {
            let facet = &self.facets[self.bvh.primitive_indices[at] as usize];
            if facet.surface == but {
                return f32::INFINITY;
            }
            let (t, slack) = self.distance(facet, o, d);
            if !t.is_finite() || t < f64::from(t_min) || t > best + COINCIDENT {
                return f32::INFINITY;
            }
            if t < best - COINCIDENT || self.is_before(facet.surface, surface, d) {
                (best, surface, reach) = (t, facet.surface, slack);
            }
            (best + reach + COINCIDENT) as f32 + HEAD_START
        });
        (surface != u32::MAX).then(|| self.hit(surface, o, d, best))
    }

    /// A hit on a surface at a distance along a ray.
    fn hit(&self, surface: u32, o: DVec3, d: DVec3, distance: f64) -> Hit {
        let plane = self.planes[surface as usize];
        let p = o + d * distance;
        let point = p - plane.normal * (plane.normal.dot(p) - plane.offset);
        Hit {
            surface: SurfaceId(surface),
            point: point.as_vec3(),
            distance: distance as f32,
            side: Side::facing(-plane.normal.dot(d) as f32),
        }
    }

    /// The hits of rays that are known to meet a surface first.
    #[inline]
    pub fn meeting(&self, surface: u32) -> Meeting {
        let (normal, offset) = self.touching_plane(surface);
        Meeting { plane: self.planes[surface as usize], touching: Plane { normal, offset } }
    }

    /// The scene's triangles.
    pub fn facets(&self) -> &[Facet] {
        &self.facets
    }

    /// The plane in which a surface lies with those that it touches: unit normal and distance from the
    /// origin along it.
    pub fn touching_plane(&self, surface: u32) -> (DVec3, f64) {
        let plane = self.contacts.plane_of(SurfaceId(surface)).index();
        (self.planes[plane].normal, self.planes[plane].offset)
    }

    /// Distance at which a ray meets a facet, or infinity, and how far beyond it along the ray surfaces
    /// may lie that touch it. Where surfaces touch, it is the distance of the plane they share.
    fn distance(&self, facet: &Facet, o: DVec3, d: DVec3) -> (f64, f64) {
        let t = facet.meet(o, d);
        let (normal, offset) = self.touching_plane(facet.surface);
        let cosine = normal.dot(d);
        let slack = f64::from(CONTACT) / cosine.abs();
        let touches = self.contacts.plane_of(SurfaceId(facet.surface)).0 != facet.surface;
        if !touches || !t.is_finite() {
            return (t, slack);
        }
        ((offset - normal.dot(o)) / cosine, slack)
    }

    /// Which of two surfaces at one place a ray sees, as the bake has it: of those in one plane the one
    /// whose place is before the other's, of those that meet in an edge one that shows its front.
    pub fn is_before(&self, surface: u32, other: u32, d: DVec3) -> bool {
        if other == u32::MAX {
            return true;
        }
        let along = |s: u32| self.planes[s as usize].normal.dot(d) > 0.0;
        let key = |s: u32| (along(s), self.contacts.place(SurfaceId(s), along(s)));
        let (one, two) = (key(surface), key(other));
        let plane = |s: u32| self.contacts.plane_of(SurfaceId(s));
        if plane(surface) == plane(other) { one.1 < two.1 } else { one < two }
    }

    /// Whether an eye sees nothing but back sides all around, as one inside a closed solid does. Where
    /// the solid touches another surface (a box on a floor) its back counts and not that one's front,
    /// as long as it is not so all around, as in a room whose walls are all drawn from both sides.
    pub fn inside_a_solid(&self, eye: Vec3) -> bool {
        const RAYS: usize = 48;
        let golden = std::f32::consts::PI * (3.0 - 5f32.sqrt());
        let mut contacts = 0;
        let enclosed = (0..RAYS).all(|i| {
            let z = 1.0 - (2.0 * i as f32 + 1.0) / RAYS as f32;
            let (sin, cos) = (golden * i as f32).sin_cos();
            let r = (1.0 - z * z).sqrt();
            let dir = Vec3::new(r * cos, r * sin, z);
            let Some(hit) = self.nearest(eye, dir, 0.0) else { return false };
            if hit.side == Side::Back {
                return true;
            }
            contacts += 1;
            let other = self.nearest_but(eye, dir, 0.0, Some(hit.surface));
            let touches = |o: &Hit| o.distance - hit.distance < 2.0 * TOUCHING;
            other.is_some_and(|o| o.side == Side::Back && touches(&o))
        });
        enclosed && contacts < RAYS
    }

    /// The surface that an eye lies on, to within [`TOUCHING`]. Looks at every triangle once.
    pub fn touching(&self, eye: Vec3) -> Option<SurfaceId> {
        let eye = eye.as_dvec3();
        let near = |f: &&Facet| {
            let plane = self.planes[f.surface as usize];
            (plane.normal.dot(eye) - plane.offset).abs() < f64::from(TOUCHING)
                && f.meet(eye + plane.normal, -plane.normal).is_finite()
        };
        self.facets.iter().find(near).map(|f| SurfaceId(f.surface))
    }
}

/// Where rays meet a surface.
#[derive(Clone, Copy, Debug)]
pub struct Meeting {
    plane: Plane,
    /// The plane in which the surface lies with those that it touches.
    touching: Plane,
}

/// Where eight rays meet a surface.
pub struct Met<S: Simd> {
    /// As [`Hit::point`], x, y and z.
    pub points: [f64x8<S>; 3],
    /// As [`Hit::distance`].
    pub distances: f64x8<S>,
    /// Above 0 where the front faces the rays' origin.
    pub facing: f64x8<S>,
}

impl Meeting {
    /// Where eight rays of one origin do; each as [`Visible::nearest`] has it, but for the rounding of triangles'
    /// corners.
    #[inline(always)]
    pub fn of_eight<S: Simd>(&self, o: DVec3, d: [f64x8<S>; 3]) -> Met<S> {
        let Plane { normal, offset } = self.plane;
        let ahead = self.touching.offset - self.touching.normal.dot(o);
        let distances = ahead / along(self.touching.normal, d);
        let p = [d[0] * distances + o.x, d[1] * distances + o.y, d[2] * distances + o.z];
        let off = along(normal, p) - offset;
        let points = [p[0] - off * normal.x, p[1] - off * normal.y, p[2] - off * normal.z];
        Met { points, distances, facing: -along(normal, d) }
    }
}

/// How far eight vectors reach along another.
#[inline(always)]
fn along<S: Simd>(n: DVec3, v: [f64x8<S>; 3]) -> f64x8<S> {
    v[0] * n.x + v[1] * n.y + v[2] * n.z
}

impl Facet {
    /// `None` for a triangle without area, which no ray can meet.
    fn new(a: Vec3, b: Vec3, c: Vec3, surface: SurfaceId) -> Option<Facet> {
        let (u, v) = ((b - a).as_dvec3(), (c - a).as_dvec3());
        let longest = u.length().max(v.length()).max((u - v).length());
        let height = u.cross(v).length() / longest;
        (height > 0.0).then(|| Facet {
            corner: a,
            edges: [b - a, c - a],
            surface: surface.0,
            slack: (WIDENING / height).min(0.5) as f32,
        })
    }

    /// Distance along the ray, either way, or infinity (Moeller and Trumbore 1997).
    fn meet(&self, origin: DVec3, dir: DVec3) -> f64 {
        let [e1, e2] = self.edges.map(Vec3::as_dvec3);
        let slack = -f64::from(self.slack);
        let p = dir.cross(e2);
        let inverse = 1.0 / e1.dot(p);
        let to = origin - self.corner.as_dvec3();
        let u = to.dot(p) * inverse;
        let q = to.cross(e1);
        let v = dir.dot(q) * inverse;
        // A ray in the plane divides by zero; its NaN or infinity fails one of these.
        if u >= slack && v >= slack && 1.0 - u - v >= slack {
            e2.dot(q) * inverse
        } else {
            f64::INFINITY
        }
    }
}

/// The library's slowest and best build, with boxes widened after the split.
fn hierarchy(triangles: &[Triangle]) -> CwBvh {
    if triangles.is_empty() {
        return CwBvh::default();
    }
    let params = BvhBuildParams::very_slow_build();
    let mut boxes: Vec<_> = triangles.iter().map(Boundable::aabb).collect();
    let mut indices: Vec<u32> = (0..triangles.len() as u32).collect();
    if params.pre_split {
        let areas = boxes.iter().map(|b| b.half_area());
        let largest = areas.clone().fold(0.0, f32::max);
        let mean = areas.sum::<f32>() / boxes.len() as f32;
        split_aabbs_preset(&mut boxes, &mut indices, triangles, mean, largest);
    }
    for b in &mut boxes {
        b.min -= BOX_WIDENING;
        b.max += BOX_WIDENING;
    }
    let mut binary = PlocBuilder::with_capacity(boxes.len()).build(
        params.ploc_search_distance,
        &boxes,
        indices,
        params.sort_precision,
        params.search_depth_threshold,
    );
    binary.uses_spatial_splits = params.pre_split;
    ReinsertionOptimizer::default().run(&mut binary, params.reinsertion_batch_ratio, None);
    bvh2_to_cwbvh(&binary, params.max_prims_per_leaf.clamp(1, 3), true, false)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::test_scenes::{Dice, quad, room, scene_of, soup};

    fn by_looking_at_all(visible: &Visible, o: Vec3, d: Vec3, t_min: f32) -> f64 {
        let hits = visible.facets.iter().map(|f| f.meet(o.as_dvec3(), d.as_dvec3()));
        hits.filter(|t| *t >= f64::from(t_min)).fold(f64::INFINITY, f64::min)
    }

    fn agree(scene: &Scene, rays: usize) {
        let visible = Visible::new(scene);
        let mut dice = Dice(7);
        let mut met = 0;
        for i in 0..rays {
            let o = dice.point() * 0.9;
            let mut d = dice.point().normalize();
            // Every fourth ray runs along an axis, another fourth in a plane of two, with zeros of both signs.
            let zero = if i & 4 == 0 { -0.0 } else { 0.0 };
            match i % 4 {
                0 => d = Vec3::new(zero, zero, if i & 8 == 0 { 1.0 } else { -1.0 }),
                1 => d = Vec3::new(zero, d.y, d.z).normalize(),
                _ => {}
            }
            let t_min = [0.0, 1e-6, 0.1][i % 3];
            let all = by_looking_at_all(&visible, o, d, t_min);
            let hit = visible.nearest(o, d, t_min);
            met += usize::from(hit.is_some());
            assert_eq!(hit.is_some(), all.is_finite(), "ray {i}: {o} {d}");
            if let Some(hit) = hit {
                assert!((f64::from(hit.distance) - all).abs() < 1e-6, "ray {i}: {hit:?}, {all}");
                let surface = scene.surface(hit.surface);
                assert_eq!(hit.side, Side::facing(-surface.normal.dot(d)));
                assert!((hit.point - surface.origin).dot(surface.normal).abs() < 2e-7);
            }
        }
        assert!(met * 3 > rays, "only {met} of {rays} rays meet anything");
    }

    #[test]
    fn finds_what_a_loop_over_all_triangles_finds() {
        agree(&room(), 4000);
        agree(&soup(3000), 4000);
    }

    #[test]
    fn a_closed_room_has_no_crack() {
        let visible = Visible::new(&room());
        // Straight at the corners, the edges and the diagonals that split the walls.
        for x in -8..=8 {
            for y in -8..=8 {
                for z in -8..=8 {
                    let d = Vec3::new(x as f32, y as f32, z as f32) / 8.0;
                    for o in [Vec3::ZERO, Vec3::new(0.1, -0.2, 0.05)] {
                        let d = d * 0.5 - o;
                        assert!(d == Vec3::ZERO || visible.nearest(o, d, 0.0).is_some(), "{o} {d}");
                    }
                }
            }
        }
    }

    #[test]
    fn a_wall_right_before_the_ray_is_seen() {
        let visible = Visible::new(&room());
        for gap in [1e-3, 1e-4, 1e-5, 1e-6, 0.0] {
            let hit = visible.nearest(Vec3::new(0.1, 0.5 - gap, 0.3), Vec3::Y, 0.0).unwrap();
            assert!((hit.distance - gap).abs() < 1e-7, "{gap}: {hit:?}");
        }
    }

    #[test]
    fn the_skipped_surface_is_not_seen() {
        let visible = Visible::new(&room());
        let hit = visible.nearest(Vec3::ZERO, Vec3::X, 0.0).unwrap();
        assert!((hit.distance - 0.5).abs() < 1e-6 && hit.side == Side::Front);
        assert_eq!(visible.nearest_but(Vec3::ZERO, Vec3::X, 0.0, Some(hit.surface)), None);
    }

    #[test]
    fn an_eye_in_a_solid_or_on_a_wall_is_noticed() {
        let visible = Visible::new(&room());
        assert!(!visible.inside_a_solid(Vec3::ZERO));
        assert_eq!(visible.touching(Vec3::ZERO), None);
        assert!(visible.touching(Vec3::new(0.5 - 5e-6, 0.1, 0.2)).is_some());
        assert_eq!(visible.touching(Vec3::new(0.5 - 2e-5, 0.1, 0.2)), None);

        // The same room turned inside out is a solid block.
        let mut solid = room();
        for s in &mut solid.surfaces {
            s.normal = -s.normal;
            std::mem::swap(&mut s.u, &mut s.v);
            std::mem::swap(&mut s.extent.x, &mut s.extent.y);
            s.polygons[0].vertices.reverse();
        }
        let visible = Visible::new(&solid);
        assert!(visible.inside_a_solid(Vec3::ZERO));
        assert!(!visible.inside_a_solid(Vec3::X * 0.9));

        // The block stands on a floor; the room's walls are drawn from both sides.
        let mut on_floor = solid.clone();
        let floor = quad(0, Vec3::new(-0.9, -0.5, -0.9), Vec3::Z * 1.8, Vec3::X * 1.8);
        on_floor.surfaces.push(floor);
        let visible = Visible::new(&on_floor);
        assert!(visible.inside_a_solid(Vec3::ZERO));
        assert!(!visible.inside_a_solid(Vec3::X * 0.7));
        let mut both = room();
        both.surfaces.extend(solid.surfaces);
        assert!(!Visible::new(&both).inside_a_solid(Vec3::ZERO));
    }

    #[test]
    fn of_equal_coincident_surfaces_the_last_is_seen_from_the_front_and_the_first_from_behind() {
        let one = quad(0, Vec3::new(-0.5, -0.5, 0.3), Vec3::X, Vec3::Y);
        let visible = Visible::new(&scene_of(vec![one; 5000], Vec::new()));
        for i in 0..50 {
            let o = Vec3::new(i as f32 * 0.019 - 0.47, 0.1, 0.0);
            let behind = visible.nearest(o, Vec3::Z, 0.0).unwrap();
            assert_eq!((behind.surface, behind.side), (SurfaceId(0), Side::Back));
            let before = visible.nearest(o + Vec3::Z * 0.6, -Vec3::Z, 0.0).unwrap();
            assert_eq!((before.surface, before.side), (SurfaceId(4999), Side::Front));
        }
    }

    #[test]
    fn a_scene_without_surfaces_shows_nothing() {
        let visible = Visible::new(&scene_of(Vec::new(), Vec::new()));
        assert_eq!(visible.nearest(Vec3::ZERO, Vec3::Z, 0.0), None);
        let one = quad(0, Vec3::new(-0.5, -0.5, 0.3), Vec3::X, Vec3::Y);
        let visible = Visible::new(&scene_of(vec![one], Vec::new()));
        assert!(visible.nearest(Vec3::ZERO, Vec3::Z, 0.0).is_some());
        assert_eq!(visible.nearest(Vec3::ZERO, -Vec3::Z, 0.0), None);
    }
}
