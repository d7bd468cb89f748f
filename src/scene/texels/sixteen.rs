//! A texture map at sixteen points at once.

use super::{Lattice, Texels, sample_at};
use crate::ids::{Side, SurfaceId};
use crate::radiance::Rgb;
use crate::scene::Surface;
use fearless_simd::{Simd, f32x16, prelude::*, u32x16};
use glam::Vec2;

/// Where sixteen points of a surface's plane fall on its lattice.
pub struct Places {
    lattice: Lattice,
    /// In texels along `u` and `v`.
    at: [[f32; 16]; 2],
    /// The first of the four texels around each, and how far the point is from its middle to the last one's, as
    /// [`Lattice::around`] has it.
    columns: [u32; 16],
    rows: [u32; 16],
    parts: [[f32; 16]; 2],
}

impl Places {
    /// Of points of a surface's plane: x, y and z.
    #[inline(always)]
    pub fn new<S: Simd>(
        simd: S,
        texels: &Texels,
        (id, surface): (SurfaceId, &Surface),
        [x, y, z]: [f32x16<S>; 3],
    ) -> Places {
        let lattice = texels.lattices[id.index()];
        let Surface { origin, u, v, .. } = surface;
        let (x, y, z) = (x - origin.x, y - origin.y, z - origin.z);
        let zero = f32x16::splat(simd, 0.0);
        let last = |count: u32| f32x16::splat(simd, (count - 1) as f32);
        let at = [
            (x * u.x + y * u.y + z * u.z) * lattice.density.x,
            (x * v.x + y * v.y + z * v.z) * lattice.density.y,
        ];
        let p = [
            (at[0] - 0.5).max(zero).min(last(lattice.width)),
            (at[1] - 0.5).max(zero).min(last(lattice.height)),
        ];
        // Not negative: what is cut off is what rounding down takes.
        let (columns, rows): (u32x16<S>, u32x16<S>) = (p[0].to_int(), p[1].to_int());
        Places {
            lattice,
            at: [at[0].into(), at[1].into()],
            columns: columns.into(),
            rows: rows.into(),
            parts: [(p[0] - p[0].floor()).into(), (p[1] - p[1].floor()).into()],
        }
    }

    /// As [`super::sample`], to the last bit, at one of the points.
    #[inline]
    pub fn sample(&self, texels: &Texels, values: &[Rgb], side: Side, k: usize) -> Rgb {
        let Places { lattice, at, columns, rows, parts } = self;
        let block = lattice.block(columns[k], rows[k]);
        let at = Vec2::new(at[0][k], at[1][k]);
        sample_at(texels, values, lattice, side, (at, (block, Vec2::new(parts[0][k], parts[1][k]))))
    }
}
