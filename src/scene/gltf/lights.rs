//! Lights without extent (KHR_lights_punctual) as small lamps of the same power.
//!
//! Light is carried along lines between surfaces, so a lamp must have some. A point light becomes an
//! octahedron that shines all around, a spot light a square that shines to its front; both are black,
//! and smaller where something is near. A directional light has no place in the scene and is left out.

use super::meshes::{Meshes, Placed};
use super::said::Said;
use super::{Refusal, materials};
use crate::radiance::Rgb;
use crate::scene::flat::Face;
use crate::scene::report::NoteKind;
use crate::scene::{Material, Reflectance};
use ::gltf::khr_lights_punctual::Kind;
use glam::DVec3;
use std::f64::consts::PI;

/// What notes are about.
const LIGHT: [&str; 2] = ["light", "lights"];

/// A lamp's radius as part of half the scene's diagonal.
const RADIUS: f64 = 0.02;

/// The same where something is nearer than that.
const LEAST: f64 = 0.002;

/// How much of the way to what is nearest a lamp may reach.
const REACH: f64 = 0.5;

/// The most lights: each looks for what is nearest.
const MOST: usize = 1024;

/// A light where it stands.
pub(super) struct Light {
    name: String,
    at: DVec3,
    /// Where a spot light shines to; a point light shines all around.
    to: Option<DVec3>,
    /// Power of each channel, W.
    power: [f64; 3],
}

impl Light {
    /// The light of a node, if it has one with a place.
    pub fn of(placed: &Placed, said: &mut Said) -> Option<Light> {
        let light = placed.node.light()?;
        let name = light.name().unwrap_or(&placed.name).to_owned();
        let intensity = f64::from(light.intensity().max(0.0));
        let along = placed.to_scene.transform_vector3(DVec3::NEG_Z).normalize_or(DVec3::NEG_Z);
        let (to, solid_angle, text) = match light.kind() {
            Kind::Directional => {
                let text = "directional lights have no place in a scene, left out; use a lamp, or \
                            panes that emit";
                said.add(NoteKind::Light, LIGHT, &name, text);
                return None;
            }
            Kind::Point => (None, 4.0 * PI, "taken as small octahedral lamps of the same power"),
            Kind::Spot { inner_cone_angle, outer_cone_angle } => {
                let outer = f64::from(outer_cone_angle).clamp(0.0, PI);
                let inner = f64::from(inner_cone_angle).clamp(0.0, outer);
                // Full inside the inner cone; beyond it the square of what is left of the cosine.
                let fading = (inner.cos() - outer.cos()) / 3.0;
                let cone = 2.0 * PI * (1.0 - inner.cos() + fading);
                let text = "taken as small square lamps of the same power, which shine to all of \
                            their front";
                (Some(along), cone, text)
            }
        };
        let power = light.color().map(|c| f64::from(c.max(0.0)) * intensity * solid_angle);
        if power.iter().all(|p| *p == 0.0) {
            return None;
        }
        said.add(NoteKind::Light, LIGHT, &name, text);
        Some(Light { name, at: placed.to_scene.transform_point3(DVec3::ZERO), to, power })
    }
}

/// Adds lamps in place of lights.
pub(super) fn add(lights: &[Light], meshes: &mut Meshes, said: &mut Said) -> Result<(), Refusal> {
    let corners = || meshes.positions.iter().copied();
    let low = corners().reduce(DVec3::min).unwrap_or_default();
    let high = corners().reduce(DVec3::max).unwrap_or_default();
    let half = 0.5 * low.distance(high);
    let surroundings = meshes.faces.len();
    for (k, light) in lights.iter().enumerate() {
        if k == MOST || !light.at.is_finite() {
            said.add(NoteKind::Light, LIGHT, &light.name, "left out: too many, or too far away");
            continue;
        }
        let free = meshes.faces[..surroundings]
            .iter()
            .map(|face| {
                let corner = |k: usize| meshes.positions[face.corners[k] as usize];
                distance(light.at, [corner(0), corner(1), corner(2)])
            })
            .fold(f64::MAX, f64::min);
        let radius = (RADIUS * half).min(REACH * free).max(LEAST * half);
        let (points, triangles) = shape(light, radius);
        let area = triangles.iter().map(|t| {
            let [a, b, c] = t.map(|k| points[k]);
            0.5 * (b - a).cross(c - a).length()
        });
        let per_power = 1.0 / (PI * area.sum::<f64>());
        let emitted = Rgb(light.power.map(|p| (p * per_power) as f32));
        let name = materials::short(&light.name);
        let reflectance = Reflectance::Diffuse(Rgb::BLACK);
        let (first, material) = (meshes.positions.len() as u32, meshes.materials.len() as u32);
        let emitted = materials::bounded(emitted);
        meshes.materials.push(Material { name, emitted, reflectance, texture: None });
        meshes.positions.extend(points);
        meshes.faces.extend(triangles.into_iter().map(|t| {
            let corners = t.map(|k| first + k as u32).to_vec();
            Face { corners, places: None, material, line: 0 }
        }));
    }
    Ok(())
}

/// Corners and outward triangles of a lamp.
fn shape(light: &Light, radius: f64) -> (Vec<DVec3>, Vec<[usize; 3]>) {
    match light.to {
        None => {
            let axes = [DVec3::X, DVec3::Y, DVec3::Z];
            let points = axes.iter().flat_map(|a| [light.at + a * radius, light.at - a * radius]);
            let octant = |k: usize| {
                let [x, y, z] = [k & 1, 2 + (k >> 1 & 1), 4 + (k >> 2 & 1)];
                // An odd number of reflections turns the way round.
                if k.count_ones().is_multiple_of(2) { [x, y, z] } else { [x, z, y] }
            };
            (points.collect(), (0..8).map(octant).collect())
        }
        Some(to) => {
            let (u, v) = to.any_orthonormal_pair();
            let corner = |(a, b): (f64, f64)| light.at + (u * a + v * b) * radius;
            let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(corner);
            (corners.to_vec(), vec![[0, 1, 2], [0, 2, 3]])
        }
    }
}

/// The distance of a point from a triangle (Ericson 2005, 5.1.5).
fn distance(p: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
    let edge = |a: DVec3, b: DVec3| {
        let along = b - a;
        let t = ((p - a).dot(along) / along.length_squared()).clamp(0.0, 1.0);
        p.distance(if t.is_nan() { a } else { a + along * t })
    };
    let normal = (b - a).cross(c - a).normalize_or_zero();
    let inside = |a: DVec3, b: DVec3| (b - a).cross(p - a).dot(normal) >= 0.0;
    if normal != DVec3::ZERO && inside(a, b) && inside(b, c) && inside(c, a) {
        return (p - a).dot(normal).abs();
    }
    edge(a, b).min(edge(b, c)).min(edge(c, a))
}
