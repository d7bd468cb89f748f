//! Where the pictures come from: a baked light field, opened and ready to be looked at.

use crate::window::Painter;
use glam::{DVec3, Vec3};
use std::path::Path;
use vlf::Visible;
use vlf::format::limits::Limits;
use vlf::look::image::Picture;
use vlf::look::packed::Access;
use vlf::look::render::Options;
use vlf::look::render::method::{self, take};
use vlf::{Camera, LightField};

/// Which method of the paper's section 6 takes the pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Method {
    /// Everything from the light field.
    Field,
    /// Diffuse surfaces from the texture maps, mirrors by rays.
    Trace,
}

/// An opened light field.
pub struct Source {
    /// Takes pictures of it.
    pub painter: Painter,
    /// Where to start.
    pub start: Camera,
    /// A walking speed that suits the scene's size, in its own units a second.
    pub speed: f64,
}

/// Opens a light field, whose decoded maps may take so many bytes.
///
/// # Errors
/// When the file cannot be read.
pub fn open(
    path: &Path,
    method: Method,
    (access, memory): (Access, u64),
    limits: &Limits,
) -> anyhow::Result<Source> {
    let field = LightField::open_within(path, access, limits)?.with_memory(memory);
    let visible = Visible::new(&field.scene);
    let start = first_view(&field, &visible);
    let speed = 0.4 * field.scene.fit.radius;
    let method = match method {
        Method::Field => method::Method::Field,
        Method::Trace => method::Method::Trace,
    };
    let painter = Box::new(move |camera: &Camera| {
        let options = (method, Options { samples: 1, ..Options::default() });
        take(&field, &visible, camera, options, &|_| ()).unwrap_or_else(|error| {
            // A damaged map: the walk goes on, and whoever started it is told.
            eprintln!("vlf-view: {error}");
            Picture::black(camera.width, camera.height)
        })
    });
    Ok(Source { painter, start, speed })
}

/// A place inside the scene and a level view from it that shows most of it: of a grid of places and
/// sixteen headings, where the nearer half of the surfaces in view is farthest away.
fn first_view(field: &LightField, visible: &Visible) -> Camera {
    let mut best = (0.0, Vec3::ZERO, Vec3::NEG_Z);
    for place in 0..7 * 5 * 7 {
        let at = |n: i32, of: i32| (n as f32 + 0.5) / of as f32 * 2.0 - 1.0;
        let eye = Vec3::new(at(place % 7, 7), at(place / 7 % 5, 5), at(place / 35, 7)) * 0.7;
        if visible.touching(eye).is_some() || visible.inside_a_solid(eye) {
            continue;
        }
        for heading in 0..16 {
            let (sin, cos) = (heading as f32 / 8.0 * std::f32::consts::PI).sin_cos();
            let (ahead, right) = (Vec3::new(sin, 0.0, -cos), Vec3::new(cos, 0.0, sin));
            let mut seen: Vec<f32> = (0..25)
                .map(|k| {
                    let (x, y) = ((k % 5 - 2) as f32 * 0.3, (k / 5 - 2) as f32 * 0.22);
                    let dir = (ahead + right * x + Vec3::Y * y).normalize();
                    // Looking past the scene is worth less than looking at a wall.
                    visible.nearest(eye, dir, 0.0).map_or(0.0, |hit| hit.distance)
                })
                .collect();
            seen.sort_by(f32::total_cmp);
            let score: f32 = seen[..13].iter().sum();
            if score > best.0 {
                best = (score, eye, ahead);
            }
        }
    }
    let fit = &field.scene.fit;
    let eye = fit.to_own(best.1);
    Camera {
        eye,
        target: eye + best.2.as_dvec3() * fit.radius,
        up: DVec3::Y,
        vfov_deg: 60.0,
        width: 640,
        height: 480,
    }
}
