//! Cameras of a glTF file as views.

use super::NamedCamera;
use super::meshes::Placed;
use super::said::Said;
use crate::scene::camera::Camera;
use crate::scene::report::NoteKind;
use ::gltf::camera::Projection;
use glam::DVec3;

/// What notes are about.
const CAMERA: [&str; 2] = ["camera", "cameras"];

/// Rows of a picture; how many columns its camera says.
const ROWS: u32 = 720;

/// Columns to a row where it does not.
const ASPECT: f64 = 16.0 / 9.0;

/// The view of a node, if it has one that pictures can be taken from.
pub(super) fn camera(placed: &Placed, said: &mut Said) -> Option<NamedCamera> {
    let camera = placed.node.camera()?;
    let name = placed.node.name().or(camera.name()).unwrap_or("").to_owned();
    let Projection::Perspective(lens) = camera.projection() else {
        said.add(NoteKind::Camera, CAMERA, &name, "parallel projections are left out");
        return None;
    };
    let [forward, up] =
        [DVec3::NEG_Z, DVec3::Y].map(|v| placed.to_scene.transform_vector3(v).normalize_or_zero());
    let eye = placed.to_scene.transform_point3(DVec3::ZERO);
    let aspect = lens.aspect_ratio().map_or(ASPECT, f64::from);
    let camera = Camera {
        eye,
        target: eye + forward,
        up,
        vfov_deg: f64::from(lens.yfov()).to_degrees(),
        width: (f64::from(ROWS) * aspect).round().clamp(1.0, 16384.0) as u32,
        height: ROWS,
    };
    if let Err(why) = camera.check() {
        said.add(NoteKind::Camera, CAMERA, &name, &format!("left out: {why}"));
        return None;
    }
    Some(NamedCamera { name, camera })
}
