//! The two methods of section 6, ready to take pictures of an opened field.

use super::raytrace::{Raytrace, is_even, plain_pixels};
use super::{Look, Looker, Options, Shown, draw};
use crate::format::FormatError;
use crate::look::accessor::Accessor;
use crate::look::image::{Canvas, Picture};
use crate::look::lightfield::LightField;
use crate::look::packet::{Lanes, Packet};
use crate::look::tone::{Curve, Tone, auto_exposure};
use crate::paths::{MAX_DEPTH, Paths};
use crate::radiance::Rgb;
use crate::scene::camera::Camera;
use crate::visible::{Hit, Visible};
use glam::Vec3;
use std::sync::OnceLock;

/// How a pixel finds its radiance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// From the total radiance maps of the three nearest directions.
    Field,
    /// Diffuse surfaces from the Total Texture Map, mirrors by following rays.
    Trace,
}

/// Radiance that comes back against the unit direction `dir` from what it has hit, W sr^-1 m^-2.
///
/// # Errors
/// When a map of the field that is needed is missing or damaged.
pub fn look_along(
    field: &LightField,
    visible: &Visible,
    method: Method,
    dir: Vec3,
    hit: &Hit,
) -> Result<Rgb, FormatError> {
    match method {
        Method::Trace => Ok(tracing(field, visible).radiance(dir, hit)),
        Method::Field => field.radiance(hit.surface, hit.point, -dir),
    }
}

fn tracing<'a>(field: &'a LightField, visible: &'a Visible) -> Raytrace<'a> {
    let paths = Paths { scene: &field.scene, visible, max_depth: MAX_DEPTH };
    Raytrace { paths, texels: &field.texels, values: &field.total }
}

/// Takes a picture of an opened field; see [`super::render`].
///
/// # Errors
/// When a map of the field that the picture needs is missing or damaged.
pub fn take(
    field: &LightField,
    visible: &Visible,
    camera: &Camera,
    how: (Method, Options),
    progress: &(dyn Fn(f32) + Sync),
) -> Result<Picture, FormatError> {
    let mut picture = Picture::black(camera.width, camera.height);
    match drawn(field, visible, camera, how, progress, (&mut picture, None)) {
        None => Ok(picture),
        Some(error) => Err(error),
    }
}

/// The same, going on where maps are missing or damaged. Returns the pixels that needed one as well, row
/// by row; they are black, see [`mark`]. [`LightField::damaged`] says which directions it were.
pub fn take_tolerant(
    field: &LightField,
    visible: &Visible,
    camera: &Camera,
    how: (Method, Options),
    progress: &(dyn Fn(f32) + Sync),
) -> (Picture, Vec<usize>) {
    let mut picture = Picture::black(camera.width, camera.height);
    let failure = drawn(field, visible, camera, how, progress, (&mut picture, None));
    let missing = failure.map_or_else(Vec::new, |_| blackened(&mut picture));
    (picture, missing)
}

/// The same on a canvas, and what is shown of it; pixels that needed a map that is missing are magenta in both.
pub fn draw_tolerant(
    field: &LightField,
    visible: &Visible,
    camera: &Camera,
    how: (Method, Options),
    progress: &(dyn Fn(f32) + Sync),
    (canvas, ev, curve): (&mut Canvas, f32, Curve),
) {
    let tone = Tone::new(ev, curve);
    canvas.resize(camera.width, camera.height);
    let Canvas { picture, bitmap } = canvas;
    let shown = Some((tone, &mut bitmap.pixels[..]));
    if drawn(field, visible, camera, how, progress, (picture, shown)).is_some() {
        let missing = blackened(picture);
        mark(picture, &missing, Some(ev));
        for at in missing {
            tone.show(&picture.pixels[at..=at], &mut bitmap.pixels[at..=at]);
        }
    }
}

/// Makes pixels black that are no numbers, and returns them.
fn blackened(picture: &mut Picture) -> Vec<usize> {
    let mut missing = Vec::new();
    for (at, pixel) in picture.pixels.iter_mut().enumerate() {
        if !pixel.is_physical() {
            *pixel = Rgb::BLACK;
            missing.push(at);
        }
    }
    missing
}

/// Paints pixels magenta, as bright as white is at an exposure (in stops; `None`: the picture's own).
pub fn mark(picture: &mut Picture, pixels: &[usize], ev: Option<f32>) {
    let white = (-ev.unwrap_or_else(|| auto_exposure(picture))).exp2();
    pixels.iter().for_each(|at| picture.pixels[*at] = Rgb([white, 0.0, white]));
}

/// Draws a picture. Returns the first error; pixels that met one are not numbers, however many of their samples
/// were good.
fn drawn(
    field: &LightField,
    visible: &Visible,
    camera: &Camera,
    (method, options): (Method, Options),
    progress: &(dyn Fn(f32) + Sync),
    onto: (&mut Picture, Shown<'_>),
) -> Option<FormatError> {
    let scene = &field.scene;
    let failure = OnceLock::new();
    match method {
        Method::Trace => {
            let looker = |_| -> Looker { Box::new(tracing(field, visible)) };
            draw(scene, visible, camera, options, &looker, progress, onto);
        }
        Method::Field => {
            let looker = |part| -> Looker {
                Box::new(ByField { field, accessor: field.accessor_for(part), failure: &failure })
            };
            draw(scene, visible, camera, options, &looker, progress, onto);
        }
    }
    failure.into_inner()
}

/// Looks total radiance maps up.
struct ByField<'a> {
    field: &'a LightField,
    accessor: Accessor<'a>,
    /// The first error; what met one is not a number.
    failure: &'a OnceLock<FormatError>,
}

impl Look for ByField<'_> {
    fn radiance(&mut self, dir: Vec3, hit: &Hit) -> Rgb {
        self.accessor.radiance(hit.surface, hit.point, -dir).unwrap_or_else(|e| {
            self.failure.get_or_init(|| e);
            Rgb::splat(f32::NAN)
        })
    }

    fn packet(&mut self, packet: &Packet, out: &mut Lanes<Rgb>) {
        let found = self.accessor.radiances(packet, out);
        for (k, out) in out.iter_mut().enumerate().filter(|(k, _)| found >> k & 1 == 0) {
            *out = packet.hit(k).map_or(Rgb::BLACK, |hit| self.radiance(packet.dir(k), &hit));
        }
    }

    /// Mirrors as well: what they show is interpolated between cells, too.
    fn plain(&self, quarters: &[Packet; 4]) -> u32 {
        let LightField { scene, texels, manifest, .. } = self.field;
        let cell = 2.0 / manifest.parameters.resolution as f32;
        let turn = quarters[0].dir(0).distance(quarters[3].dir(0));
        plain_pixels(quarters, |hits| {
            let is_mirror = scene.material_of(hits[0].surface).reflectance.is_mirror();
            let has_cells = is_mirror || !self.field.diffuse_left_out;
            match has_cells {
                // A pixel's corners are twice as far apart as its quarters' middles.
                true => 2.0 * turn * hits[0].distance <= cell,
                false => is_even(scene, texels, hits),
            }
        })
    }
}
