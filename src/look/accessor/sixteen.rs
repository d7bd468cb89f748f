//! Lookups of a packet's rays, all at once: each as [`Accessor::radiance`] gives it, to the last bit.
//!
//! Rays that meet the same side of one surface, lie in one triangle of directions, and in each of its three
//! fall between the same four cells, differ in nothing but weights.

use super::{Accessor, Remembered, Shown};
use crate::gather::{LEAST, in_ring};
use crate::ids::{Side, SurfaceId};
use crate::level::level;
use crate::look::packet::{LANES, Lanes, NONE, Packet};
use crate::look::recent::{EDGE, Grid, ROW, four_of};
use crate::psf::Psf;
use crate::radiance::Rgb;
use crate::scene::Reflectance;
use fearless_simd::{Simd, dispatch, f32x16, i32x16, prelude::*, u32x16};
use glam::{Vec3, Vec4};

/// The components of a vector for each ray.
type Three<S> = [f32x16<S>; 3];

/// A bit for each ray, the first one's the lowest.
type Bits = u64;

/// The first ray of those whose bits are set.
#[inline(always)]
fn first(bits: Bits) -> usize {
    // Never 16: an index that cannot be out of range.
    bits.trailing_zeros() as usize % LANES
}

#[inline(always)]
fn loaded<S: Simd>(simd: S, [x, y, z]: &[Lanes<f32>; 3]) -> Three<S> {
    [f32x16::simd_from(simd, *x), f32x16::simd_from(simd, *y), f32x16::simd_from(simd, *z)]
}

#[inline(always)]
fn dot<S: Simd>(a: Three<S>, b: Vec3) -> f32x16<S> {
    a[0] * b.x + a[1] * b.y + a[2] * b.z
}

impl Accessor<'_> {
    /// Radiance that comes back along a packet's rays, W sr^-1 m^-2, of those whose bits are returned. The
    /// others meet nothing, or have to be looked up alone: what they need is missing, no cell is near, or
    /// there are no maps of what they meet.
    pub fn radiances(&mut self, packet: &Packet, out: &mut Lanes<Rgb>) -> Bits {
        dispatch!(level(), simd => self.radiances_with(simd, packet, out))
    }

    #[inline(always)]
    fn radiances_with<S: Simd>(&mut self, simd: S, packet: &Packet, out: &mut Lanes<Rgb>) -> Bits {
        let surfaces = u32x16::simd_from(simd, packet.surfaces);
        let mut left = surfaces.simd_ne(NONE).to_bitmask();
        let mut found = 0;
        while left != 0 {
            let surface = packet.surfaces[first(left)];
            let same = surfaces.simd_eq(surface).to_bitmask();
            found |= self.of_surface(simd, SurfaceId(surface), same, (packet, out));
            left &= !same;
        }
        found
    }

    /// The same of the rays that meet one surface.
    #[inline(always)]
    fn of_surface<S: Simd>(
        &mut self,
        simd: S,
        id: SurfaceId,
        rays: Bits,
        (packet, out): (&Packet, &mut Lanes<Rgb>),
    ) -> Bits {
        let (scene, diffuse_left_out) = (&self.field.scene, self.field.diffuse_left_out);
        let (plane, material) = (scene.surface(id), scene.material_of(id));
        let is_mirror = material.reflectance.is_mirror();
        if diffuse_left_out && !is_mirror {
            return 0;
        }
        let [x, y, z] = loaded(simd, &packet.dirs);
        let away = [-x, -y, -z];
        let cosines = dot(away, plane.normal);
        let side = Side::facing(cosines[first(rays)]);
        let front = cosines.simd_gt(0.0).to_bitmask();
        let rays = rays & if side == Side::Front { front } else { !front };
        let normal = plane.normal * side.sign();
        let wanted = if is_mirror { mirrored(simd, away, normal) } else { away };
        let (sums, mut found) = self.looked_up_sixteen(
            simd,
            (id, side, normal),
            wanted,
            loaded(simd, packet.points()),
            rays,
        );
        let (factor, emitted) = match material.reflectance {
            Reflectance::Diffuse(_) => (Vec4::ONE, Vec4::ZERO),
            Reflectance::Mirror(factor) => {
                let emitted = if side == Side::Front { material.emitted } else { Rgb::BLACK };
                (Vec3::from(factor.0).extend(0.0), Vec3::from(emitted.0).extend(0.0))
            }
        };
        let mut left = found;
        while left != 0 {
            let k = first(left);
            let rgb = sums[k] / sums[k].w;
            out[k] = Rgb((rgb * factor + emitted).truncate().to_array());
            if sums[k].w <= 0.0 {
                found &= !(1 << k);
            }
            left &= left - 1;
        }
        found
    }

    /// As [`Accessor::looked_up`], and for which rays something was found.
    #[inline(always)]
    fn looked_up_sixteen<S: Simd>(
        &mut self,
        simd: S,
        (id, side, normal): (SurfaceId, Side, Vec3),
        wanted: Three<S>,
        points: Three<S>,
        rays: Bits,
    ) -> (Lanes<Vec4>, Bits) {
        let around = self.field.directions.around_sixteen(simd, wanted);
        let mut sums = [Vec4::ZERO; LANES];
        let (mut left, mut found) = (rays, rays);
        while left != 0 {
            let number = around.numbers[first(left)];
            let same = around.numbers.simd_eq(number).to_bitmask() & left;
            left &= !same;
            let of = (id, side, self.field.directions.numbered(number));
            if self.last.of != Some(of) && self.turn_to(of, normal).is_err() {
                found &= !same;
                continue;
            }
            let Accessor { last, maps, recent, texture, .. } = self;
            for (k, near) in last.near.iter().enumerate() {
                let map = last.places[k].and_then(|place| maps[place].as_deref());
                let (true, Some(map)) = (near.weight > 0.0, map) else { continue };
                let psf = &last.psfs[k];
                let between = Between::new(simd, psf, points);
                let parts: Lanes<f32> = around.weights[k].into();
                let grid = Grid { direction: near.direction.0, surface: id, sense: near.sense };
                let mut cells = Remembered { recent, shown: Shown { map, grid, psf, texture } };
                between.add(&mut cells, &parts, same, &mut sums);
            }
        }
        (sums, found)
    }
}

/// The last place in a block from which there are cells to the right and below.
const LAST: usize = (EDGE as usize - 1) * (ROW + 1);

/// Between which four cells of a grid points fall.
struct Between {
    /// The blocks of the first of them: columns and rows.
    blocks: [Lanes<i32>; 2],
    /// Its place in the block.
    at: Lanes<u32>,
    /// Weights of the four.
    weights: [Lanes<f32>; 4],
}

impl Between {
    #[inline(always)]
    fn new<S: Simd>(simd: S, psf: &Psf, points: Three<S>) -> Between {
        let half = 0.5 * psf.resolution as f32;
        let x = (dot(points, psf.right) + 1.0) * half + psf.shift.x - 0.5;
        let y = (dot(points, psf.up) + 1.0) * half + psf.shift.y - 0.5;
        // Farther out there is nothing either.
        let out = (f32x16::splat(simd, -4.0), f32x16::splat(simd, 2.0 * half + 4.0));
        let (x, y) = (x.max(out.0).min(out.1), y.max(out.0).min(out.1));
        let (i, j) = (x.floor(), y.floor());
        let (fx, fy) = (x - i, y - j);
        let (gx, gy) = (-fx + 1.0, -fy + 1.0);
        let least = f32x16::splat(simd, LEAST);
        let weights = [gx * gy, fx * gy, gx * fy, fx * fy];
        let edge = EDGE as f32;
        let (column, row) = ((i / edge).floor(), (j / edge).floor());
        let at = (j - row * edge) * ROW as f32 + (i - column * edge);
        let column: i32x16<S> = column.to_int();
        let row: i32x16<S> = row.to_int();
        let at: u32x16<S> = at.to_int();
        Between {
            blocks: [column.into(), row.into()],
            at: at.into(),
            weights: [
                weights[0].max(least).into(),
                weights[1].max(least).into(),
                weights[2].max(least).into(),
                weights[3].max(least).into(),
            ],
        }
    }

    /// Adds what is between the cells to the sums of some rays, each with its part.
    #[inline(always)]
    fn add(&self, cells: &mut Remembered, parts: &Lanes<f32>, rays: Bits, sums: &mut Lanes<Vec4>) {
        let [columns, rows] = &self.blocks;
        let (mut left, mut none) = (rays, 0);
        while left != 0 {
            // Those in one block, neighbours as a rule.
            let place = [columns[first(left)], rows[first(left)]];
            let block = cells.block(place);
            while left != 0 {
                let k = first(left);
                if [columns[k], rows[k]] != place {
                    break;
                }
                left &= left - 1;
                if parts[k] <= 0.0 {
                    continue;
                }
                let [a, b, c, d] = four_of(block, (self.at[k] as usize).min(LAST));
                let w = &self.weights;
                let found = a * w[0][k] + b * w[1][k] + c * w[2][k] + d * w[3][k];
                if found.w > 0.0 {
                    sums[k] += found * (parts[k] / found.w);
                } else {
                    none |= 1 << k;
                }
            }
        }
        while none != 0 {
            let k = first(none);
            let cell = [columns[k], rows[k], self.at[k] as i32];
            let [column, row, at] = cell;
            let edge = ROW as i32;
            let found = in_ring(cells, column * EDGE + at % edge, row * EDGE + at / edge);
            // The same for all that are between the same cells.
            while none != 0 {
                let k = first(none);
                if [columns[k], rows[k], self.at[k] as i32] != cell {
                    break;
                }
                none &= none - 1;
                if found.w > 0.0 {
                    sums[k] += found * (parts[k] / found.w);
                }
            }
        }
    }
}

/// As `gather::mirrored`.
#[inline(always)]
fn mirrored<S: Simd>(simd: S, outgoing: Three<S>, normal: Vec3) -> Three<S> {
    let twice = dot(outgoing, normal) * 2.0;
    let [x, y, z] = outgoing;
    let (x, y, z) = (twice * normal.x - x, twice * normal.y - y, twice * normal.z - z);
    let scale = f32x16::splat(simd, 1.0) / (x * x + y * y + z * z).sqrt();
    [x * scale, y * scale, z * scale]
}
