//! The two methods of section 6, ready to take pictures of an opened field.

use super::raytrace::{MAX_DEPTH, Raytrace};
use super::{Options, render};
use crate::format::FormatError;
use crate::look::image::Picture;
use crate::look::lightfield::LightField;
use crate::look::visible::{Hit, Visible};
use crate::radiance::Rgb;
use crate::scene::camera::Camera;
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

/// Takes a picture of an opened field; see [`render`].
///
/// # Errors
/// When a map of the field that the picture needs is missing or damaged.
pub fn take(
    field: &LightField,
    visible: &Visible,
    camera: &Camera,
    (method, options): (Method, Options),
    progress: &(dyn Fn(f32) + Sync),
) -> Result<Picture, FormatError> {
    let scene = &field.scene;
    let failure = OnceLock::new();
    let picture = match method {
        Method::Trace => {
            let trace = Raytrace {
                scene,
                visible,
                texels: &field.texels,
                values: &field.total,
                max_depth: MAX_DEPTH,
            };
            let radiance = |dir: Vec3, hit: &Hit| trace.radiance(dir, hit);
            render(scene, visible, camera, options, &radiance, progress)
        }
        Method::Field => {
            let radiance = |dir: Vec3, hit: &Hit| {
                field.radiance(hit.surface, hit.point, -dir).unwrap_or_else(|e| {
                    failure.get_or_init(|| e);
                    Rgb::BLACK
                })
            };
            render(scene, visible, camera, options, &radiance, progress)
        }
    };
    match failure.into_inner() {
        None => Ok(picture),
        Some(error) => Err(error),
    }
}
