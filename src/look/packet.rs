//! A packet of rays: a small square of pixels with what they meet, mostly one surface.
//!
//! What is the same for neighbours is found once for a packet, and what is not is computed for all at once
//! (Wald et al. 2001, "Interactive rendering with coherent ray tracing").

use crate::ids::{Side, SurfaceId};
use crate::scene::camera::View;
use crate::visible::{Hit, Visible};
use fearless_simd::{Simd, f32x16, f64x8, mask32x16, prelude::*, u32x16};
use glam::Vec3;

/// Pixels along the edge of a packet.
pub const EDGE: usize = 4;

/// Rays of a packet, row by row.
pub const LANES: usize = EDGE * EDGE;

/// A number for each ray.
pub type Lanes<T> = [T; LANES];

/// Where the middles of the first eight pixels are along a row.
const COLUMNS: [f64; 8] = [0.5, 1.5, 2.5, 3.5, 0.5, 1.5, 2.5, 3.5];

/// And down.
const ROWS: [f64; 8] = [0.5, 0.5, 0.5, 0.5, 1.5, 1.5, 1.5, 1.5];

/// No surface.
pub const NONE: u32 = u32::MAX;

/// Rays of one origin and their hits; made without any, to be used again and again.
#[derive(Debug, Default)]
pub struct Packet {
    /// Unit directions: x, y, z.
    pub dirs: [Lanes<f32>; 3],
    /// What is met, or [`NONE`], also of rays beyond the picture.
    pub surfaces: Lanes<u32>,
    /// Where: x, y, z.
    points: [Lanes<f32>; 3],
    distances: Lanes<f32>,
    /// Above 0 where the front is met.
    facing: Lanes<f32>,
}

impl Packet {
    /// Sends the rays of a view through the pixels from a column and row on to the surfaces that they are known
    /// to meet first.
    #[inline(always)]
    pub fn send<S: Simd>(
        &mut self,
        simd: S,
        view: &View,
        [column, row]: [usize; 2],
        (surfaces, visible): (Lanes<u32>, &Visible),
    ) {
        self.surfaces = surfaces;
        let x = f64x8::simd_from(simd, COLUMNS) + column as f64;
        let y = f64x8::simd_from(simd, ROWS) + row as f64;
        let (low, high) = (view.eight(simd, x, y), view.eight(simd, x, y + 0.5 * EDGE as f64));
        let dirs = [low[0].narrow(high[0]), low[1].narrow(high[1]), low[2].narrow(high[2])];
        self.dirs = [dirs[0].into(), dirs[1].into(), dirs[2].into()];
        let [x, y, z] = [dirs[0].widen(), dirs[1].widen(), dirs[2].widen()];
        let (low, high) = ([x.0, y.0, z.0], [x.1, y.1, z.1]);
        let origin = view.origin.as_dvec3();
        let surfaces = u32x16::simd_from(simd, self.surfaces);
        let mut left = surfaces.simd_ne(NONE).to_bitmask();
        while left != 0 {
            let surface = self.surfaces[left.trailing_zeros() as usize % LANES];
            let here = surfaces.simd_eq(surface);
            left &= !here.to_bitmask();
            let meeting = visible.meeting(surface);
            let (low, high) = (meeting.of_eight(origin, low), meeting.of_eight(origin, high));
            for c in 0..3 {
                put(simd, here, low.points[c].narrow(high.points[c]), &mut self.points[c]);
            }
            put(simd, here, low.distances.narrow(high.distances), &mut self.distances);
            put(simd, here, low.facing.narrow(high.facing), &mut self.facing);
        }
    }

    /// How many rays meet something.
    pub fn met(&self) -> usize {
        self.surfaces.iter().filter(|surface| **surface != NONE).count()
    }

    /// Where the hits are.
    #[inline(always)]
    pub fn points(&self) -> &[Lanes<f32>; 3] {
        &self.points
    }

    /// A ray's direction.
    #[inline(always)]
    pub fn dir(&self, k: usize) -> Vec3 {
        Vec3::from(self.dirs.map(|lanes| lanes[k]))
    }

    /// A ray's hit.
    #[inline]
    pub fn hit(&self, k: usize) -> Option<Hit> {
        (self.surfaces[k] != NONE).then(|| Hit {
            surface: SurfaceId(self.surfaces[k]),
            point: Vec3::from(self.points.map(|lanes| lanes[k])),
            distance: self.distances[k],
            side: self.side(k),
        })
    }

    /// The side that a ray meets.
    #[inline(always)]
    pub fn side(&self, k: usize) -> Side {
        Side::facing(self.facing[k])
    }
}

/// Replaces the numbers of some rays.
#[inline(always)]
fn put<S: Simd>(simd: S, some: mask32x16<S>, new: f32x16<S>, numbers: &mut Lanes<f32>) {
    *numbers = some.select(new, f32x16::simd_from(simd, *numbers)).into();
}
