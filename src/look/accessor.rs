//! One thread's way to an opened field: lookups, and the maps that were needed last.
//!
//! Neighbouring pixels need the same few maps; remembering them saves the shared cache's lock and keeps
//! threads from writing to one another's memory.

use super::lightfield::LightField;
use super::maps::Map;
use super::recent::{Key, Recent};
use crate::directions::Near;
use crate::format::FormatError;
use crate::format::container::NO_DIRECTION;
use crate::gather::{Around, Cells, Four, Lookup, between_cells, mirrored};
use crate::ids::{Cell, Side, SurfaceId};
use crate::psf::Psf;
use crate::radiance::Rgb;
use crate::scene::{Reflectance, texels};
use crate::textured::{Texture, Under};
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
    texture: Texture<'a>,
    /// The directions whose maps are remembered; [`NO_DIRECTION`] where none is.
    directions: [u32; REMEMBERED],
    maps: [Option<Arc<Map>>; REMEMBERED],
    /// The lookup that needed each last.
    used: [u64; REMEMBERED],
    lookups: u64,
    recent: Recent,
}

impl<'a> Accessor<'a> {
    /// One that remembers nothing yet.
    pub(super) fn new(field: &'a LightField) -> Accessor<'a> {
        let LightField { scene, texels, total, .. } = field;
        Accessor {
            field,
            texture: Texture { scene, texels, total },
            directions: [NO_DIRECTION; REMEMBERED],
            maps: [const { None }; REMEMBERED],
            used: [0; REMEMBERED],
            lookups: 0,
            recent: Recent::default(),
        }
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
        let place = match self.directions.iter().position(|known| *known == direction) {
            Some(place) => place,
            None => {
                let map = self.field.held(direction)?;
                let oldest = (0..REMEMBERED).min_by_key(|place| self.used[*place]).unwrap_or(0);
                (self.directions[oldest], self.maps[oldest]) = (direction, Some(map));
                oldest
            }
        };
        self.used[place] = self.lookups;
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
        let (maps, recent) = (&self.maps, &mut self.recent);
        Ok(around.blend(|k| {
            let map = maps[places[k]?].as_ref()?;
            let Near { direction, sense, .. } = around.near[k];
            let lookup = Lookup::new(map.tiles(), surface, sense);
            let (psf, texture) = (&around.psfs[k], &self.texture);
            let key = Key::new(direction.0, (surface, sense), [0; 2]);
            let shown = Shown { lookup, map, psf, texture, under: None };
            between_cells(&mut Remembered { recent, key, shown }, psf, point)
        }))
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

/// Cells of a surface as a map has them, or as the texture map has them that it leaves them to.
struct Shown<'a> {
    lookup: Lookup<'a>,
    map: &'a Map,
    psf: &'a Psf,
    texture: &'a Texture<'a>,
    /// The surface's lattice under the cells, once it was needed.
    under: Option<Under<'a>>,
}

impl Cells for Shown<'_> {
    #[inline]
    fn radiance(&mut self, i: i32, j: i32) -> Option<Rgb> {
        let (seen, inside) = self.lookup.seen(i, j)?;
        let stored = seen.radiance(inside)?;
        match seen.is_textured() {
            false => Some(stored),
            true => self.textured(Cell { i: i as u32, j: j as u32 }),
        }
    }
}

/// The same, as far as it is not remembered.
struct Remembered<'a, 'b> {
    recent: &'b mut Recent,
    /// Any cell of the grid.
    key: Key,
    shown: Shown<'a>,
}

impl Cells for Remembered<'_, '_> {
    fn radiance(&mut self, i: i32, j: i32) -> Option<Rgb> {
        self.shown.radiance(i, j)
    }

    #[inline]
    fn four(&mut self, i: i32, j: i32) -> Four {
        self.recent.four(self.key.at(i, j), |i, j| self.shown.radiance(i, j))
    }
}

impl Shown<'_> {
    #[inline(never)]
    fn textured(&mut self, cell: Cell) -> Option<Rgb> {
        let (surface, sense) = self.lookup.of();
        if self.under.is_none() {
            self.under = self.texture.under(self.psf, surface);
        }
        Some(self.texture.value(self.under.as_ref()?, sense, cell, self.map.exponent()))
    }
}
