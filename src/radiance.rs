//! Linear RGB radiance, W sr^-1 m^-2, and what scales it.

use serde::{Deserialize, Serialize};
use std::ops::{Add, AddAssign, Div, Mul, Sub};

/// Three linear channels: radiance (W sr^-1 m^-2) where light is meant, a factor in [0, 1] where
/// reflectance is meant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[repr(transparent)]
pub struct Rgb(pub [f32; 3]);

impl Rgb {
    /// No light.
    pub const BLACK: Rgb = Rgb([0.0; 3]);

    /// The same value in each channel.
    pub const fn splat(value: f32) -> Rgb {
        Rgb([value; 3])
    }

    /// The largest channel.
    pub fn max(self) -> f32 {
        self.0[0].max(self.0[1]).max(self.0[2])
    }

    /// The mean of the channels, the scalar the energy ledger counts in.
    pub fn mean(self) -> f32 {
        (self.0[0] + self.0[1] + self.0[2]) / 3.0
    }

    /// Rec. 709 relative luminance.
    pub fn luminance(self) -> f32 {
        0.2126 * self.0[0] + 0.7152 * self.0[1] + 0.0722 * self.0[2]
    }

    /// Whether every channel is finite and not negative.
    pub fn is_physical(self) -> bool {
        self.0.iter().all(|c| c.is_finite() && *c >= 0.0)
    }

    /// Whether every channel is zero.
    pub fn is_black(self) -> bool {
        self.0 == [0.0; 3]
    }
}

impl Add for Rgb {
    type Output = Rgb;
    fn add(self, o: Rgb) -> Rgb {
        Rgb([self.0[0] + o.0[0], self.0[1] + o.0[1], self.0[2] + o.0[2]])
    }
}

impl AddAssign for Rgb {
    fn add_assign(&mut self, o: Rgb) {
        *self = *self + o;
    }
}

impl Sub for Rgb {
    type Output = Rgb;
    fn sub(self, o: Rgb) -> Rgb {
        Rgb([self.0[0] - o.0[0], self.0[1] - o.0[1], self.0[2] - o.0[2]])
    }
}

impl Mul for Rgb {
    type Output = Rgb;
    fn mul(self, o: Rgb) -> Rgb {
        Rgb([self.0[0] * o.0[0], self.0[1] * o.0[1], self.0[2] * o.0[2]])
    }
}

impl Mul<f32> for Rgb {
    type Output = Rgb;
    fn mul(self, k: f32) -> Rgb {
        Rgb(self.0.map(|c| c * k))
    }
}

impl Div<f32> for Rgb {
    type Output = Rgb;
    fn div(self, k: f32) -> Rgb {
        Rgb(self.0.map(|c| c / k))
    }
}

impl std::iter::Sum for Rgb {
    fn sum<I: Iterator<Item = Rgb>>(iter: I) -> Rgb {
        iter.fold(Rgb::BLACK, Add::add)
    }
}
