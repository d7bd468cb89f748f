//! Transfer: what travels along the pairs of the exchange, by kind of receiver.
//!
//! Radiance is counted in fixed point while it is summed, so that the order of the sums, and with it
//! the number of threads and the order of directions, cannot change a bit.

pub mod diffuse;

pub mod specular;

use crate::radiance::Rgb;

/// Radiance in fixed point, three channels; the fourth counts lines.
pub type Fixed = [i64; 4];

/// How radiance is counted in fixed point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quantum {
    to_fixed: f64,
}

impl Quantum {
    /// Radiance up to `most` (W sr^-1 m^-2) becomes numbers up to 2^36: 2^26 lines a texel, each
    /// weighted by up to 3, stay below 2^63.
    pub fn new(most: f32) -> Quantum {
        Quantum { to_fixed: 36f64.exp2() / f64::from(most).max(f64::MIN_POSITIVE) }
    }

    /// Radiance along one line.
    pub fn fixed(self, radiance: Rgb) -> Fixed {
        let [r, g, b] = radiance.0.map(|c| (f64::from(c) * self.to_fixed) as i64);
        [r, g, b, 1]
    }

    /// The radiance that a fixed number stands for.
    pub fn radiance(self, fixed: Fixed) -> Rgb {
        let c = |k: usize| (fixed[k] as f64 / self.to_fixed) as f32;
        Rgb([c(0), c(1), c(2)])
    }

    /// One unit of the fixed numbers, W sr^-1 m^-2.
    pub fn unit(self) -> f64 {
        1.0 / self.to_fixed
    }
}

/// Adds `SHARES` times a line's radiance to a sum.
pub fn add<const SHARES: i64>(sum: &mut Fixed, line: &Fixed) {
    for (s, l) in sum.iter_mut().zip(line) {
        *s += l * SHARES;
    }
}
