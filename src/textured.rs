//! What a diffuse surface shows in the cells of a parallel subfield, as the Total Texture Map has it.
//!
//! Transport is linear, so a diffuse surface's total map is a resampling of its Total Texture Map; a
//! pack need not store what the other already says. A slot of a tile map that is *textured* has in each
//! covered cell the texture map's value where the cell's middle ray meets the surface's plane, rounded to
//! f16. That place is an affine function of column and row, so a value takes a few operations. None of
//! them is left to the machine: packer and reader find the same bits.

use crate::format::Fault;
use crate::format::tiles::{self, DATA, Slot, TEXTURED, TileMap, half_to_f32};
use crate::ids::{Cell, Sense, Side, SurfaceId};
use crate::psf::Psf;
use crate::radiance::Rgb;
use crate::scene::Scene;
use crate::scene::texels::{Lattice, Texels, sample_at};
use glam::{DVec2, DVec3, Vec2};
use half::f16;
use half::slice::{HalfBitsSliceExt, HalfFloatSliceExt};

/// The cosine between a line and a plane's normal below which the line runs along the plane.
const EDGE_ON: f64 = 1e-4;

/// A scene's Total Texture Map.
#[derive(Clone, Copy)]
pub struct Texture<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Where the texels lie.
    pub texels: &'a Texels,
    /// P^T, two values a texel, W sr^-1 m^-2.
    pub total: &'a [Rgb],
}

/// One surface's lattice under the cells of one parallel subfield.
pub struct Under<'a> {
    lattice: &'a Lattice,
    /// Place of the middle of cell (0, 0), in texels, and what a column and a row add.
    origin: DVec2,
    column: DVec2,
    row: DVec2,
    cosine: f64,
}

impl Under<'_> {
    fn side(&self, sense: Sense) -> Side {
        let facing = self.cosine * f64::from(sense.sign());
        if facing > 0.0 { Side::Front } else { Side::Back }
    }

    /// The place of a cell, in texels.
    #[inline]
    fn at(&self, Cell { i, j }: Cell) -> Vec2 {
        (self.origin + self.column * f64::from(i) + self.row * f64::from(j)).as_vec2()
    }
}

impl<'a> Texture<'a> {
    /// Appends the bits that a slot's covered cells have when it is textured, three f16 each, scaled by
    /// `2^-exponent`; `false`, and nothing, when it cannot be: a mirror, or seen edge-on.
    pub fn values(&self, psf: &Psf, slot: &Slot, exponent: i32, rgb: &mut Vec<u16>) -> bool {
        let Some(under) = self.under(psf, slot.surface) else { return false };
        let (side, scale) = (under.side(slot.sense), power(-exponent));
        let mut places = [Vec2::ZERO; BLOCK];
        let mut count = 0;
        slot.covered(|cell| {
            places[count] = under.at(cell);
            count += 1;
            if count == BLOCK {
                self.append(&places, under.lattice, side, scale, rgb);
                count = 0;
            }
        });
        self.append(&places[..count], under.lattice, side, scale, rgb);
        true
    }

    /// Appends the bits of values at places of a lattice, at most [`BLOCK`] of them.
    fn append(
        &self,
        places: &[Vec2],
        lattice: &Lattice,
        side: Side,
        scale: f32,
        rgb: &mut Vec<u16>,
    ) {
        // Each step for all: a texel that has to be waited for holds nothing else up.
        let mut blocks = [([0; 4], Vec2::ZERO); BLOCK];
        for (block, at) in blocks.iter_mut().zip(places) {
            *block = lattice.around(*at);
        }
        let mut values = [[0.0; 3]; BLOCK];
        for ((value, block), at) in values.iter_mut().zip(&blocks).zip(places) {
            let found = sample_at(self.texels, self.total, lattice, side, (*at, *block));
            *value = found.0.map(|c| storable(c * scale));
        }
        let end = rgb.len();
        rgb.resize(end + 3 * places.len(), 0);
        let halves: &mut [f16] = rgb[end..].reinterpret_cast_mut();
        halves.convert_from_f32_slice(values[..places.len()].as_flattened());
    }

    /// The radiance that one cell has in a slot that is textured; `under` is its surface's lattice.
    pub fn value(&self, under: &Under, sense: Sense, cell: Cell, exponent: i32) -> Rgb {
        let at = under.at(cell);
        let around = (at, under.lattice.around(at));
        let found = sample_at(self.texels, self.total, under.lattice, under.side(sense), around);
        let scale = power(-exponent);
        let mut bits = [f16::ZERO; 3];
        bits.convert_from_f32_slice(&found.0.map(|c| storable(c * scale)));
        Rgb(bits.map(|h| half_to_f32(h.to_bits()) * power(exponent)))
    }

    /// The lattice of a surface under the cells of a subfield; `None` for what is never textured: a
    /// mirror, or a surface seen edge-on.
    pub fn under(&self, psf: &Psf, id: SurfaceId) -> Option<Under<'a>> {
        let cosine = cosine(self.scene, psf, id)?;
        let surface = self.scene.surface(id);
        let [right, up, along] = [psf.right, psf.up, psf.direction].map(|v| v.as_dvec3());
        let (normal, origin) = (surface.normal.as_dvec3(), surface.origin.as_dvec3());
        // Where the ray through p of the subfield meets the plane; linear but for the plane's distance.
        let slide = |p: DVec3, distance: f64| p + along * ((distance - normal.dot(p)) / cosine);
        let edge = 2.0 / f64::from(psf.resolution);
        let middle = (right + up) * (0.5 * edge - 1.0);
        let lattice = &self.texels.lattices[id.index()];
        let (u, v, density) =
            (surface.u.as_dvec3(), surface.v.as_dvec3(), lattice.density.as_dvec2());
        let in_texels = |p: DVec3| DVec2::new(p.dot(u), p.dot(v)) * density;
        Some(Under {
            lattice,
            origin: in_texels(slide(middle, normal.dot(origin)) - origin),
            column: in_texels(slide(right * edge, 0.0)),
            row: in_texels(slide(up * edge, 0.0)),
            cosine,
        })
    }
}

/// 2^exponent, of an exponent that a field may have.
fn power(exponent: i32) -> f32 {
    f32::from_bits(((127 + exponent) as u32) << 23)
}

/// Values that are sampled at a time.
const BLOCK: usize = 64;

/// The nearest number that an f16 of a tile map can be. What is not a number, as on a surface without
/// extent, becomes 0.
#[inline]
#[allow(clippy::manual_clamp, reason = "that would keep what is not a number")]
fn storable(value: f32) -> f32 {
    value.max(0.0).min(65504.0)
}

/// Refuses a pack's map that leaves to the texture map what that does not know.
///
/// # Errors
/// When a mirror, or a surface on edge, is textured.
pub fn check(map: &TileMap, psf: &Psf, scene: &Scene) -> Result<(), Fault> {
    let is_known =
        |slot: Slot| slot.state != TEXTURED || cosine(scene, psf, slot.surface).is_some();
    match map.slots().all(is_known) {
        true => Ok(()),
        false => Err(Fault::invalid("tile map: a mirror, or a surface on edge, is textured")),
    }
}

/// The cosine between a line and the normal of a surface whose cells can be textured.
fn cosine(scene: &Scene, psf: &Psf, id: SurfaceId) -> Option<f64> {
    let normal = scene.surface(id).normal.as_dvec3();
    let cosine = normal.dot(psf.direction.as_dvec3());
    let is_mirror = scene.material_of(id).reflectance.is_mirror();
    (!is_mirror && cosine.abs() >= EDGE_ON).then_some(cosine)
}

/// The bytes of a pack's map with every value in place.
///
/// # Errors
/// As [`check`].
pub fn filled(
    map: &TileMap,
    psf: &Psf,
    exponent: i32,
    texture: &Texture,
) -> Result<Vec<u8>, Fault> {
    check(map, psf, texture.scene)?;
    Ok(tiles::rewritten(
        map,
        |_| true,
        |slot, rgb| match slot.state {
            TEXTURED => {
                texture.values(psf, slot, exponent, rgb);
                DATA
            }
            state => {
                slot.copy(rgb);
                state
            }
        },
    ))
}
