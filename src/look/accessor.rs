//! One thread's way to an opened field: lookups, and the maps that were needed last.
//!
//! Neighbouring pixels need the same few maps; remembering them saves the shared cache's lock and keeps
//! threads from writing to one another's memory.

use super::lightfield::LightField;
use super::maps::Map;
use crate::format::FormatError;
use crate::gather::{Around, mirrored};
use crate::ids::{Side, SurfaceId};
use crate::radiance::Rgb;
use crate::scene::{Reflectance, texels};
use glam::Vec3;
use std::sync::Arc;

/// Circles of directions in which a mirror is looked for that none of the nearest three shows.
const CIRCLES: u32 = 4;

/// Maps that are remembered. A lookup needs three at once.
const REMEMBERED: usize = 8;

const _: () = assert!(REMEMBERED >= 3);

/// Looks radiance up in a field, for one thread.
pub struct Accessor<'a> {
    field: &'a LightField,
    last: [Option<Remembered>; REMEMBERED],
    lookups: u64,
}

struct Remembered {
    direction: u32,
    map: Arc<Map>,
    /// The lookup that needed it last.
    used: u64,
}

impl<'a> Accessor<'a> {
    /// One that remembers nothing yet.
    pub(super) fn new(field: &'a LightField) -> Accessor<'a> {
        Accessor { field, last: [const { None }; REMEMBERED], lookups: 0 }
    }

    /// As [`LightField::radiance`].
    ///
    /// # Errors
    /// When a direction's map is missing or damaged.
    pub fn radiance(
        &mut self,
        surface: SurfaceId,
        point: Vec3,
        away: Vec3,
    ) -> Result<Rgb, FormatError> {
        let plane = self.field.scene.surface(surface);
        let side = Side::facing(plane.normal.dot(away));
        let normal = plane.normal * side.sign();
        let material = self.field.scene.material_of(surface);
        let mirror = material.reflectance.is_mirror();
        let wanted = if mirror { mirrored(away, normal) } else { away };
        let found = match mirror || !self.field.diffuse_left_out {
            true => self.looked_up(surface, point, wanted, normal)?,
            false => None,
        };
        Ok(match material.reflectance {
            // Where no direction sees the surface (it is edge-on to all three, or smaller than a
            // cell) its texture map still knows it.
            Reflectance::Diffuse(_) => found.unwrap_or_else(|| {
                texels::sample(&self.field.texels, &self.field.total, surface, plane, side, point)
            }),
            Reflectance::Mirror(factor) => {
                let emitted = if side == Side::Front { material.emitted } else { Rgb::BLACK };
                let arrived = match found {
                    Some(arrived) => arrived,
                    None => self.looked_up_nearby(surface, point, wanted, normal)?,
                };
                arrived * factor + emitted
            }
        })
    }

    /// Where a direction's map is remembered, read if it was not.
    fn place(&mut self, direction: u32) -> Result<usize, FormatError> {
        let is_it =
            |slot: &Option<Remembered>| slot.as_ref().is_some_and(|map| map.direction == direction);
        let place = match self.last.iter().position(is_it) {
            Some(place) => place,
            None => {
                let map = self.field.map(direction)?;
                let age = |place: &usize| self.last[*place].as_ref().map_or(0, |map| map.used);
                let oldest = (0..REMEMBERED).min_by_key(age).unwrap_or(0);
                self.last[oldest] = Some(Remembered { direction, map, used: 0 });
                oldest
            }
        };
        if let Some(map) = &mut self.last[place] {
            map.used = self.lookups;
        }
        Ok(place)
    }

    /// Interpolated between the three directions around `wanted`; `None` when the surface covers no
    /// cell near the point in any of them.
    fn looked_up(
        &mut self,
        surface: SurfaceId,
        point: Vec3,
        wanted: Vec3,
        normal: Vec3,
    ) -> Result<Option<Rgb>, FormatError> {
        let resolution = self.field.manifest.parameters.resolution;
        let around = Around::new(&self.field.directions, resolution, wanted, normal);
        self.lookups += 1;
        let mut places = [None; 3];
        for (place, near) in places.iter_mut().zip(&around.near) {
            if near.weight > 0.0 {
                *place = Some(self.place(near.direction.0)?);
            }
        }
        let tiles = |place: usize| self.last[place].as_ref().map(|found| found.map.tiles());
        let maps = places.map(|place| place.and_then(tiles));
        Ok(around.radiance(&maps, surface, point))
    }

    /// For mirrors thinner than a cell: the first that is found in ever wider circles of directions.
    fn looked_up_nearby(
        &mut self,
        surface: SurfaceId,
        point: Vec3,
        wanted: Vec3,
        normal: Vec3,
    ) -> Result<Rgb, FormatError> {
        let spacing = 2.5 / (self.field.directions.len() as f32).sqrt();
        let (a, b) = wanted.any_orthonormal_pair();
        for circle in 1..=CIRCLES {
            for k in 0..8 {
                let (sin, cos) = (k as f32 * std::f32::consts::FRAC_PI_4).sin_cos();
                let aside = (a * cos + b * sin) * (spacing * circle as f32);
                let nearby = (wanted + aside).normalize();
                if let Some(found) = self.looked_up(surface, point, nearby, normal)? {
                    return Ok(found);
                }
            }
        }
        Ok(Rgb::BLACK)
    }
}
