//! Cuts: texels through which another surface's polygon passes, or on which its edge stands.
//!
//! In: the scene and its texels. Out: for each texel whether it is cut. What a cut texel sees on one
//! side of the cut has nothing to do with what it sees on the other: under a box that stands on a floor
//! it is dark, beside it light.

use crate::ids::SurfaceId;
use crate::scene::texels::{Lattice, Texels};
use crate::scene::{Polygon, Scene, Surface};
use glam::{Vec2, Vec3};
use std::collections::BTreeMap;

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
    let classes = by_size(scene.surface_ids().flat_map(|id| bounded(scene, id)));
    for id in scene.surface_ids() {
        let lattice = &texels.lattices[id.index()];
        if scene.material_of(id).reflectance.is_mirror() {
            continue;
        }
        let surface = scene.surface(id);
        let across = surface.u * surface.extent.x + surface.v * surface.extent.y;
        let middle = surface.origin + across * 0.5;
        let reach = 0.5 * surface.extent.length() + IN_PLANE;
        for (largest, polygons) in &classes {
            let (low, high) = (middle.x - reach - largest, middle.x + reach + largest);
            let from = polygons.partition_point(|p| p.centre.x < low);
            let near = polygons[from..].iter().take_while(|p| p.centre.x <= high);
            for other in near.filter(|p| p.surface != id) {
                let offset = other.centre - middle;
                let in_reach = offset.length() <= reach + other.radius;
                if in_reach && offset.dot(surface.normal).abs() <= other.radius + IN_PLANE {
                    cut_by(surface, lattice, other.polygon, &mut cut);
                }
            }
        }
    }
    cut
}

/// Polygons in classes of like size, each with its largest radius and sorted along x, so that a small
/// surface of a large mesh looks at few of them.
fn by_size<'a>(polygons: impl Iterator<Item = Bounded<'a>>) -> Vec<(f32, Vec<Bounded<'a>>)> {
    let mut classes: BTreeMap<i32, Vec<Bounded>> = BTreeMap::new();
    for polygon in polygons {
        let class = polygon.radius.max(1e-6).log2().ceil() as i32;
        classes.entry(class).or_default().push(polygon);
    }
    let sorted = |mut polygons: Vec<Bounded<'a>>| {
        polygons.sort_by(|a, b| a.centre.x.total_cmp(&b.centre.x));
        let largest = polygons.iter().map(|p| p.radius).fold(0.0, f32::max);
        (largest, polygons)
    };
    classes.into_values().map(sorted).collect()
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    /// A floor of 8 x 8 texels with a wall across it, and one that hangs above.
    #[test]
    fn a_wall_cuts_the_texels_it_stands_on_and_a_hanging_one_none() {
        let obj = "mtllib m\nusemtl lamp\n\
            v -4 0 4\nv 4 0 4\nv 4 0 -4\nv -4 0 -4\nf 1 2 3 4\n\
            v 0.5 0 2.7\nv 0.5 2 2.7\nv 0.5 2 -4\nv 0.5 0 -4\nf 5 6 7 8\n\
            v -2.5 1 4\nv -2.5 2 4\nv -2.5 2 -4\nv -2.5 1 -4\nf 9 10 11 12\n";
        let mtl = "newmtl lamp\nKd 0.5 0.5 0.5\nKe 1 1 1\n";
        let path = Path::new("cut.obj");
        let (scene, _) = Scene::from_text(path, obj, &mut |_| Ok(mtl.to_owned())).unwrap();
        let edge = (1.0 / scene.fit.radius) as f32;
        let texels = Texels::new(&scene, edge);
        let cut = cut_texels(&scene, &texels);
        let floor = texels.lattices[0];
        assert_eq!((floor.width, floor.height), (8, 8));
        let texel = |x: f64, z: f64| {
            let point = scene.fit.to_unit(glam::DVec3::new(x, 0.0, z));
            cut[texels.at(SurfaceId(0), &scene.surfaces[0], point) as usize]
        };
        for z in [-3.5, -2.5, -1.5, -0.5, 0.5, 1.5, 2.5] {
            for x in [-3.5, -2.5, -1.5, -0.5, 1.5, 2.5, 3.5] {
                assert!(!texel(x, z), "({x}, {z}) is cut");
            }
            assert!(texel(0.5, z), "(0.5, {z}) is not cut");
        }
        assert!(!texel(0.5, 3.5), "beyond the wall's end");
    }
}
