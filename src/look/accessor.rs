//! One thread's way to an opened field: lookups, and the maps that were needed last.
//!
//! Neighbouring pixels need the same few maps; remembering them saves the shared cache's lock and keeps
//! threads from writing to one another's memory.

mod sixteen;

use super::lightfield::LightField;
use super::maps::Map;
use super::recent::{Block, Grid, Recent, four_of, holding};
use crate::directions::{Near, Triangle};
use crate::format::FormatError;
use crate::format::container::NO_DIRECTION;
use crate::gather::{Cells, Four, Lookup, between, mirrored, shows};
use crate::ids::{Cell, Side, SurfaceId};
use crate::psf::Psf;
use crate::radiance::Rgb;
use crate::scene::{Reflectance, texels};
use crate::textured::{Texture, Under};
use glam::{Vec3, Vec4};
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
    /// Of which part of pictures it is, and what is remembered of that.
    part: usize,
    recent: Recent,
    last: Last,
}

/// Where the last lookup was: the next pixel's, as a rule, is in the same triangle of directions.
struct Last {
    /// The surface, the side and the triangle; `None` before the first.
    of: Option<(SurfaceId, Side, Triangle)>,
    /// The triangle's corners; those behind the side have no weight, the others 1.
    near: [Near; 3],
    psfs: [Psf; 3],
    /// Where their maps are remembered; `None` for those without weight.
    places: [Option<usize>; 3],
}

impl<'a> Accessor<'a> {
    /// One for a part of pictures.
    pub(super) fn new(field: &'a LightField, part: usize) -> Accessor<'a> {
        let LightField { scene, texels, total, .. } = field;
        Accessor {
            field,
            texture: Texture { scene, texels, total },
            directions: [NO_DIRECTION; REMEMBERED],
            maps: [const { None }; REMEMBERED],
            used: [0; REMEMBERED],
            lookups: 0,
            part,
            recent: field.remembered(part),
            last: Last {
                of: None,
                near: field.directions.corners(field.directions.around(Vec3::Z).0),
                psfs: [Psf::new(Vec3::Z, 1); 3],
                places: [None; 3],
            },
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
            true => self.looked_up(surface, point, wanted, (side, normal))?,
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
                    None => self.looked_up_nearby(surface, point, wanted, (side, normal))?,
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
        (side, normal): (Side, Vec3),
    ) -> Result<Option<Rgb>, FormatError> {
        let (triangle, weights) = self.field.directions.around(wanted);
        let of = (surface, side, triangle);
        if self.last.of != Some(of) {
            self.turn_to(of, normal)?;
        }
        let Accessor { last, maps, recent, texture, .. } = self;
        let mut sum = Vec4::ZERO;
        for (k, near) in last.near.iter().enumerate() {
            let part = weights[k];
            if part <= 0.0 || near.weight <= 0.0 {
                continue;
            }
            let Some(map) = last.places[k].and_then(|place| maps[place].as_deref()) else {
                continue;
            };
            let grid = Grid { direction: near.direction.0, surface, sense: near.sense };
            let shown = Shown { map, grid, psf: &last.psfs[k], texture };
            let mut cells = Remembered { recent, shown };
            let found = between(&mut cells, &last.psfs[k], point);
            if found.w > 0.0 {
                sum += found * (part / found.w);
            }
        }
        Ok((sum.w > 0.0).then(|| Rgb((sum / sum.w).truncate().to_array())))
    }

    /// Finds what lookups in another triangle need.
    #[inline(never)]
    fn turn_to(
        &mut self,
        of: (SurfaceId, Side, Triangle),
        normal: Vec3,
    ) -> Result<(), FormatError> {
        let LightField { directions, manifest, .. } = self.field;
        let mut near = directions.corners(of.2);
        near.iter_mut().for_each(|n| n.weight = f32::from(u8::from(shows(directions, n, normal))));
        // Until all of it is found there is nothing to be remembered.
        self.last.of = None;
        self.lookups += 1;
        let mut places = [None; 3];
        for (place, near) in places.iter_mut().zip(&near) {
            if near.weight > 0.0 {
                *place = Some(self.place(near.direction.0)?);
            }
        }
        let resolution = manifest.parameters.resolution;
        let psf = |n: Near| Psf::new(directions.vector(n.direction), resolution);
        self.last = Last { of: Some(of), near, psfs: near.map(psf), places };
        Ok(())
    }

    /// For mirrors thinner than a cell: the first that is found in ever wider circles of directions.
    fn looked_up_nearby(
        &mut self,
        surface: SurfaceId,
        point: Vec3,
        wanted: Vec3,
        facing: (Side, Vec3),
    ) -> Result<Rgb, FormatError> {
        let spacing = 2.5 / (self.field.directions.len() as f32).sqrt();
        let (a, b) = wanted.any_orthonormal_pair();
        for circle in 1..=CIRCLES {
            for k in 0..8 {
                let (sin, cos) = (k as f32 * std::f32::consts::FRAC_PI_4).sin_cos();
                let aside = (a * cos + b * sin) * (spacing * circle as f32);
                let nearby = (wanted + aside).normalize();
                if let Some(found) = self.looked_up(surface, point, nearby, facing)? {
                    return Ok(found);
                }
            }
        }
        Ok(Rgb::BLACK)
    }
}

impl Drop for Accessor<'_> {
    fn drop(&mut self) {
        self.field.remember(self.part, std::mem::take(&mut self.recent));
    }
}

/// Cells of a surface as a map has them, or as the texture map has them that it leaves them to.
struct Shown<'a> {
    map: &'a Map,
    grid: Grid,
    psf: &'a Psf,
    texture: &'a Texture<'a>,
}

impl<'a> Shown<'a> {
    fn lookup(&self) -> Lookup<'a> {
        Lookup::new(self.map.tiles(), self.grid.surface, self.grid.sense)
    }

    /// A cell; `under` is the surface's lattice under the cells, once it was needed.
    fn radiance(
        &self,
        lookup: &mut Lookup<'a>,
        under: &mut Option<Under<'a>>,
        i: i32,
        j: i32,
    ) -> Option<Rgb> {
        let (seen, inside) = lookup.seen(i, j)?;
        let stored = seen.radiance(inside)?;
        if !seen.is_textured() {
            return Some(stored);
        }
        if under.is_none() {
            *under = self.texture.under(self.psf, self.grid.surface);
        }
        let cell = Cell { i: i as u32, j: j as u32 };
        Some(self.texture.value(under.as_ref()?, self.grid.sense, cell, self.map.exponent()))
    }
}

/// The same, as far as it is not remembered.
struct Remembered<'a, 'b> {
    recent: &'b mut Recent,
    shown: Shown<'a>,
}

impl Remembered<'_, '_> {
    /// The block that holds a cell, and where.
    #[inline]
    fn holding(&mut self, i: i32, j: i32) -> (&Block, usize) {
        let (place, at) = holding(i, j);
        (self.block(place), at)
    }

    /// A block of cells.
    #[inline(always)]
    fn block(&mut self, place: [i32; 2]) -> &Block {
        let (mut lookup, mut under) = (None, None);
        self.recent.block(self.shown.grid, place, |i, j| {
            let lookup = lookup.get_or_insert_with(|| self.shown.lookup());
            self.shown.radiance(lookup, &mut under, i, j)
        })
    }
}

impl Cells for Remembered<'_, '_> {
    fn radiance(&mut self, i: i32, j: i32) -> Option<Rgb> {
        let (block, at) = self.holding(i, j);
        let cell = block[at];
        (cell.w > 0.0).then(|| Rgb(cell.truncate().to_array()))
    }

    #[inline]
    fn four(&mut self, i: i32, j: i32) -> Four {
        let (block, at) = self.holding(i, j);
        four_of(block, at)
    }
}
