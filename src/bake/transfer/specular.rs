//! Specular surface as sender (section 4.3): what a mirror sends on along a direction.
//!
//! Light is stored where it arrived: in the unshot map of the direction it came along. What a mirror P
//! sends along w' from a point x is found backwards: w' is mirrored at P, and the radiance that
//! arrived from there is gathered from the three nearest directions' unshot maps. P is planar, so
//! the three are the same for all of its cells in a PSF.

use crate::directions::Directions;
use crate::field::FieldError;
use crate::field::pages::Pages;
use crate::format::container::ChunkKind;
use crate::gather::{Around, Excerpt, between_cells, mirrored};
use crate::ids::{Side, SurfaceId};
use crate::radiance::Rgb;
use crate::scene::Scene;
use glam::Vec3;

/// Looks a mirror's outgoing radiance along one PSF up.
pub struct MirrorSender {
    around: Around,
    /// What arrived at the mirror along each of the three.
    arrived: [Option<Excerpt>; 3],
    factor: Rgb,
    emitted: Rgb,
}

impl MirrorSender {
    /// For the side of `surface` that faces along `outgoing`, a unit vector. `pages` hold the unshot
    /// maps of this cycle, or are `None` in the first, when nothing has arrived yet; `emits` says
    /// whether the surface's own emission is to be shot.
    ///
    /// # Errors
    /// When a page cannot be read.
    pub fn new(
        scene: &Scene,
        directions: &Directions,
        pages: Option<&Pages>,
        (surface, outgoing, emits): (SurfaceId, Vec3, bool),
        resolution: u32,
    ) -> Result<MirrorSender, FieldError> {
        let material = scene.material_of(surface);
        let polygon = scene.surface(surface);
        let plane = polygon.normal;
        let side = Side::facing(plane.dot(outgoing));
        let normal = plane * side.sign();
        let source = mirrored(outgoing, normal);
        let around = Around::new(directions, resolution, source, normal);
        let mut arrived = [None, None, None];
        if let Some(pages) = pages {
            let reach = [polygon.u * polygon.extent.x, polygon.v * polygon.extent.y];
            for (k, excerpt) in arrived.iter_mut().enumerate() {
                let near = around.near[k];
                if near.weight > 0.0 {
                    let page = pages.get(near.direction.0, ChunkKind::Unshot)?;
                    let bounds = (polygon.origin, reach);
                    let (map, psf) = (page.map(), &around.psfs[k]);
                    *excerpt = Some(Excerpt::new(&map, psf, surface, near.sense, bounds));
                }
            }
        }
        let emitted = if emits && side == Side::Front { material.emitted } else { Rgb::BLACK };
        let factor = material.reflectance.factor();
        Ok(MirrorSender { around, arrived, factor, emitted })
    }

    /// Radiance sent from a point of the mirror, W sr^-1 m^-2; `None` is a hole: something may have
    /// arrived there, but the surface covers no cell near the point in any of the three directions.
    pub fn radiance(&self, point: Vec3) -> Option<Rgb> {
        if self.arrived.iter().all(Option::is_none) {
            return Some(self.emitted);
        }
        let arrived = self.around.blend(|k| {
            between_cells(&mut self.arrived[k].as_ref()?, &self.around.psfs[k], point)
        })?;
        Some(arrived * self.factor + self.emitted)
    }
}
