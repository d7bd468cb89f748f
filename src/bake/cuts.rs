//! Cuts: texels through which another surface's polygon passes, or on which its edge stands.
//!
//! In: the scene and its texels. Out: for each texel whether it is cut. What a cut texel sees on one
//! side of the cut has nothing to do with what it sees on the other: under a box that stands on a floor
//! it is dark, beside it light.

use crate::ids::SurfaceId;
use crate::scene::texels::{Lattice, Texels};
use crate::scene::{Polygon, Scene, Surface};
use glam::{Vec2, Vec3};

/// Corners nearer to a plane than this lie in it, in the fitted scene's units.
const IN_PLANE: f32 = 2e-5;

/// A polygon with the ball around it.
struct Bounded<'a> {
    surface: SurfaceId,
    polygon: &'a Polygon,
    centre: Vec3,
    radius: f32,
}

/// Whether each texel is cut. Mirrors have no texels to be cut.
pub fn cut_texels(scene: &Scene, texels: &Texels) -> Vec<bool> {
    let mut cut = vec![false; texels.len()];
    let polygons: Vec<Bounded> = scene.surface_ids().flat_map(|id| bounded(scene, id)).collect();
    for id in scene.surface_ids() {
        let lattice = &texels.lattices[id.index()];
        if scene.material_of(id).reflectance.is_mirror() {
            continue;
        }
        let surface = scene.surface(id);
        let middle =
            surface.origin + (surface.u * surface.extent.x + surface.v * surface.extent.y) * 0.5;
        let reach = 0.5 * surface.extent.length();
        for other in polygons.iter().filter(|p| p.surface != id) {
            let offset = other.centre - middle;
            let beyond = offset.length() > reach + other.radius + IN_PLANE;
            if !beyond && offset.dot(surface.normal).abs() <= other.radius + IN_PLANE {
                cut_by(surface, lattice, other.polygon, &mut cut);
            }
        }
    }
    cut
}

fn bounded(scene: &Scene, id: SurfaceId) -> impl Iterator<Item = Bounded<'_>> {
    scene.surface(id).polygons.iter().map(move |polygon| {
        let count = polygon.vertices.len() as f32;
        let centre = polygon.vertices.iter().sum::<Vec3>() / count;
        let far = polygon.vertices.iter().map(|v| v.distance(centre));
        Bounded { surface: id, polygon, centre, radius: far.fold(0.0, f32::max) }
    })
}

/// Marks the texels along the line in which a polygon meets a surface's plane.
fn cut_by(surface: &Surface, lattice: &Lattice, polygon: &Polygon, cut: &mut [bool]) {
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
            mark(lattice, surface.coordinates(a), surface.coordinates(b), cut);
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
    mark(lattice, end, farthest(end), cut);
}

/// Marks the texels along a segment, given in the surface's coordinates.
fn mark(lattice: &Lattice, from: Vec2, to: Vec2, cut: &mut [bool]) {
    let (from, to) = (from * lattice.density, to * lattice.density);
    // Quarter steps leave no texel out that the segment crosses by more than a corner.
    let steps = ((to - from).abs().max_element() * 4.0).ceil().clamp(1.0, 1e6) as u32;
    let (width, height) = (lattice.width as i32, lattice.height as i32);
    // A segment along the border between two texels cuts both as far as sampling can tell.
    let near = 0.05;
    for k in 0..=steps {
        let p = from + (to - from) * (k as f32 / steps as f32);
        for (dx, dy) in [(-near, -near), (near, -near), (-near, near), (near, near)] {
            let (column, row) = ((p.x + dx).floor() as i32, (p.y + dy).floor() as i32);
            if (0..width).contains(&column) && (0..height).contains(&row) {
                cut[(lattice.first as i32 + row * width + column) as usize] = true;
            }
        }
    }
}
