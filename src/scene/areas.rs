//! How much of each texel lies inside its surface's polygons, by clipping (Sutherland and Hodgman 1974).

use super::{Polygon, Scene, Surface};
use crate::scene::texels::{Lattice, Texels};
use glam::DVec2;

/// Area of each texel inside its surface, in the fitted scene's units squared; mirrors' one texel has
/// the area of the whole surface.
pub fn areas(scene: &Scene, texels: &Texels) -> Vec<f32> {
    let mut areas = vec![0.0; texels.len()];
    for (surface, lattice) in scene.surfaces.iter().zip(&texels.lattices) {
        for polygon in &surface.polygons {
            add_polygon(surface, lattice, polygon, &mut areas);
        }
    }
    areas
}

fn add_polygon(surface: &Surface, lattice: &Lattice, polygon: &Polygon, areas: &mut [f32]) {
    // In texels along u and v; one texel measures one there.
    let density = lattice.density.as_dvec2();
    let corners: Vec<DVec2> =
        polygon.vertices.iter().map(|v| surface.coordinates(*v).as_dvec2() * density).collect();
    if lattice.width == 1 && lattice.height == 1 {
        areas[lattice.first as usize] += (area(&corners) / (density.x * density.y)) as f32;
        return;
    }
    let (mut band, mut cell, mut spare) = (Vec::new(), Vec::new(), Vec::new());
    for row in range(corners.iter().map(|c| c.y), lattice.height) {
        clip_between(&corners, |p| p.y, f64::from(row), &mut spare, &mut band);
        for column in range(band.iter().map(|c| c.x), lattice.width) {
            clip_between(&band, |p| p.x, f64::from(column), &mut spare, &mut cell);
            let texel = lattice.first + row * lattice.width + column;
            areas[texel as usize] += (area(&cell) / (density.x * density.y)) as f32;
        }
    }
}

/// The texels that an interval of coordinates meets.
fn range(values: impl Iterator<Item = f64>, count: u32) -> std::ops::Range<u32> {
    let (low, high) = values.fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
    let last = f64::from(count);
    (low.floor().clamp(0.0, last) as u32)..(high.ceil().clamp(0.0, last) as u32)
}

/// The part of a loop where a coordinate lies in `[from, from + 1]`.
fn clip_between(
    corners: &[DVec2],
    coordinate: impl Fn(DVec2) -> f64,
    from: f64,
    spare: &mut Vec<DVec2>,
    out: &mut Vec<DVec2>,
) {
    clip(corners, |p| coordinate(p) - from, spare);
    clip(spare, |p| from + 1.0 - coordinate(p), out);
}

/// The part of a loop where `inside` is not negative.
fn clip(corners: &[DVec2], inside: impl Fn(DVec2) -> f64, out: &mut Vec<DVec2>) {
    out.clear();
    let Some(mut a) = corners.last().copied() else { return };
    for &b in corners {
        let (da, db) = (inside(a), inside(b));
        if (da < 0.0) != (db < 0.0) {
            out.push(a + (b - a) * (da / (da - db)));
        }
        if db >= 0.0 {
            out.push(b);
        }
        a = b;
    }
}

fn area(corners: &[DVec2]) -> f64 {
    let Some(mut a) = corners.last().copied() else { return 0.0 };
    let mut twice = 0.0;
    for &b in corners {
        twice += a.perp_dot(b);
        a = b;
    }
    0.5 * twice
}
