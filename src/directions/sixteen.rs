//! The triangles of sixteen vectors at once.

use super::{ARCTANGENT, Directions, Triangle};
use fearless_simd::{Simd, f32x16, mask32x16, prelude::*};
use std::f32::consts::FRAC_2_PI;

/// The triangles that sixteen vectors lie in, and the barycentric weights of their corners.
pub struct Triangles<S: Simd> {
    /// The triangles by number: vectors of one triangle have the same. Whole, and exact in an f32.
    pub numbers: f32x16<S>,
    /// As [`Directions::around`] gives them.
    pub weights: [f32x16<S>; 3],
}

impl Directions {
    /// As [`Directions::around`], to the last bit, of sixteen unit vectors.
    #[inline(always)]
    pub fn around_sixteen<S: Simd>(&self, simd: S, unit: [f32x16<S>; 3]) -> Triangles<S> {
        let (steps, most) = (self.steps as f32, (self.steps - 1) as f32);
        let [x, y] = to_square(simd, unit);
        let (x, y) = (x * steps, y * steps);
        let (lowest, highest) = (f32x16::splat(simd, -most - 1.0), f32x16::splat(simd, most));
        let (x0, y0) = (x.floor().max(lowest).min(highest), y.floor().max(lowest).min(highest));
        let (zero, one) = (f32x16::splat(simd, 0.0), f32x16::splat(simd, 1.0));
        let (fx, fy) = ((x - x0).max(zero).min(one), (y - y0).max(zero).min(one));
        let falling = !(x0.simd_ge(zero) ^ y0.simd_ge(zero));
        let is = [falling, (fx + fy).simd_le(one), fx.simd_ge(fy)];
        let two = f32x16::splat(simd, 2.0);
        let half = of_halves(is, [zero, one, two, one + two]);
        let weights = [
            of_halves(is, [one - fx - fy, fx + fy - one, one - fx, one - fy]),
            of_halves(is, [fx, one - fy, fx - fy, fy - fx]),
            of_halves(is, [fy, one - fx, fy, fx]),
        ];
        let slots = (y0 + steps) * (2.0 * steps + 1.0) + (x0 + steps);
        Triangles { numbers: slots * 4.0 + half, weights }
    }

    /// The triangle that has a number.
    pub fn numbered(&self, number: f32) -> Triangle {
        Triangle { slot: number as u32 / 4, half: number as u32 % 4 }
    }
}

/// For each vector that of four numbers which is its half's, as [`Triangle`] numbers them: whether its square
/// is cut along a falling diagonal, it lies below that, and below a rising one.
#[inline(always)]
fn of_halves<S: Simd>(
    [falling, below, right]: [mask32x16<S>; 3],
    [a, b, c, d]: [f32x16<S>; 4],
) -> f32x16<S> {
    falling.select(below.select(a, b), right.select(c, d))
}

/// As `sphere_to_square_f32`.
#[inline(always)]
fn to_square<S: Simd>(simd: S, [dx, dy, dz]: [f32x16<S>; 3]) -> [f32x16<S>; 2] {
    let zero = f32x16::splat(simd, 0.0);
    let (x, y, z) = (dx.abs(), dy.abs(), dz.abs());
    let r = ((x * x + y * y) / (z + 1.0)).sqrt();
    let (low, high) = (x.min(y), x.max(y));
    let t = low / high;
    let square = t * t;
    let mut sum = zero;
    for coefficient in ARCTANGENT {
        sum = sum * square + coefficient;
    }
    let eighth = high.simd_gt(zero).select(t * sum * FRAC_2_PI, zero);
    let one = f32x16::splat(simd, 1.0);
    let phi = y.simd_gt(x).select(one - eighth, eighth);
    let (u, v) = (r - phi * r, phi * r);
    let lower = dz.simd_lt(zero);
    let (u, v) = (lower.select(one - v, u), lower.select(one - u, v));
    [u.copysign(dx), v.copysign(dy)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use fearless_simd::dispatch;
    use glam::Vec3;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn sixteen_are_what_each_is_alone(
            k in 0u32..=6, any in prop::array::uniform16(prop::array::uniform3(-1.0f32..1.0)),
            axis in 0usize..6,
        ) {
            let directions = Directions::new(k);
            let mut unit = any.map(|v| Vec3::from(v).try_normalize().unwrap_or(Vec3::Y));
            // Along axes, edges of the octahedron, and the equator.
            unit[0] = [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z][axis];
            unit[1] = Vec3::new(unit[1].x, unit[1].y, 0.0).normalize_or(Vec3::X);
            unit[2] = Vec3::new(0.0, unit[2].y, unit[2].z).normalize_or(Vec3::Z);
            for level in crate::level::all() {
                let (numbers, weights): ([f32; 16], [[f32; 16]; 3]) = dispatch!(level, simd => {
                    let lanes = |c: usize| f32x16::from_fn(simd, |k| unit[k][c]);
                    let found = directions.around_sixteen(simd, [lanes(0), lanes(1), lanes(2)]);
                    (found.numbers.into(), found.weights.map(Into::into))
                });
                for (k, unit) in unit.iter().enumerate() {
                    let one = (directions.numbered(numbers[k]), weights.map(|w| w[k]));
                    prop_assert_eq!(one, directions.around(*unit), "{} with {:?}", unit, level);
                }
            }
        }
    }
}
