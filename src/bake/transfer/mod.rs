//! Transfer: what travels along the pairs of the exchange, by kind of receiver.
//!
//! Radiance is counted in fixed point while it is summed, so that the order of the sums, and with it
//! the number of threads and the order of directions, cannot change a bit.

pub mod clip;

pub mod diffuse;

pub mod specular;

use crate::radiance::Rgb;

/// Radiance in fixed point, three channels; the fourth counts lines, in parts of [`LINE`].
pub type Fixed = [i64; 4];

/// What a texture value shoots along a line: radiance, W sr^-1 m^-2, and 1 for the line. Half as large as the
/// fixed numbers that it is summed in, since most of a transfer's time goes to fetching it.
pub type Shot = [f32; 4];

/// Nothing comes along a line from outside the scene; but it counts as a line.
pub const FROM_OUTSIDE: Shot = [0.0, 0.0, 0.0, 1.0];

/// What radiance shoots.
pub fn shot(Rgb([r, g, b]): Rgb) -> Shot {
    [r, g, b, 1.0]
}

/// Current texture maps, two values a texel, and one value more: what comes from outside the scene.
#[derive(Clone, Copy)]
pub struct Current<'a> {
    /// What the values shoot.
    pub shots: &'a [Shot],
    /// How it is counted.
    pub quantum: Quantum,
}

impl Current<'_> {
    /// What a value shoots along a line.
    #[inline(always)]
    pub fn line(&self, value: usize) -> Fixed {
        self.quantum.line(&self.shots[value])
    }

    /// The radiance of a value.
    pub fn radiance(&self, value: usize) -> Rgb {
        let [r, g, b, _] = self.shots[value];
        Rgb([r, g, b])
    }

    /// The value that stands for the space outside the scene.
    pub fn outside(&self) -> usize {
        self.shots.len() - 1
    }
}

/// What a whole line counts, so that a texel can have part of one.
pub const LINE: i64 = clip::overlap::WHOLE as i64;

/// How many lines a sum holds.
pub fn lines(sum: &Fixed) -> f64 {
    sum[3] as f64 / LINE as f64
}

/// How radiance is counted in fixed point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quantum {
    to_fixed: f64,
}

/// 2^52 + 2^51: added to a number of at most 2^51, leaves the nearest whole number in the low bits.
const TO_BITS: f64 = 6_755_399_441_055_744.0;

/// The most that a line is counted as.
const MOST: f64 = 2_251_799_813_685_248.0;

/// The nearest whole number, of one up to 2^51.
#[inline(always)]
fn whole(number: f64) -> i64 {
    (number + TO_BITS).to_bits() as i64 - TO_BITS.to_bits() as i64
}

impl Quantum {
    /// Radiance up to `most` (W sr^-1 m^-2) becomes numbers up to 2^36: 2^26 lines a texel, each
    /// weighted by up to 3, stay below 2^63.
    pub fn new(most: f32) -> Quantum {
        Quantum { to_fixed: 36f64.exp2() / f64::from(most.max(f32::MIN_POSITIVE)) }
    }

    /// Radiance along one line.
    pub fn fixed(self, radiance: Rgb) -> Fixed {
        self.line(&shot(radiance))
    }

    /// What is shot along one line.
    #[inline(always)]
    pub fn line(self, shot: &Shot) -> Fixed {
        let units = self.units();
        let mut line = [0; 4];
        for c in 0..4 {
            let exact = f64::from(shot[c]) * units[c];
            line[c] = whole(if exact < MOST { exact } else { MOST });
        }
        line
    }

    /// Fixed numbers for one of each number of a shot.
    #[inline(always)]
    fn units(self) -> [f64; 4] {
        [self.to_fixed, self.to_fixed, self.to_fixed, LINE as f64]
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

/// `SHARES` times a line's radiance; the line counts `COUNTS` times that.
#[inline]
pub fn times<const SHARES: i64, const COUNTS: i64>(line: &Fixed) -> Fixed {
    [line[0] * SHARES, line[1] * SHARES, line[2] * SHARES, line[3] * SHARES * COUNTS]
}

/// Adds a line to a sum.
#[inline]
pub fn add_to(sum: &mut Fixed, line: &Fixed) {
    let [a, b] = [*sum, *line];
    *sum = [a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3]];
}

/// Adds `SHARES` times a line's radiance to a sum; the line counts `COUNTS` times that.
#[inline]
pub fn add<const SHARES: i64, const COUNTS: i64>(sum: &mut Fixed, line: &Fixed) {
    add_to(sum, &times::<SHARES, COUNTS>(line));
}

/// How many pairs' texels are read before the first is added to: texels are far away in memory, and the processor
/// waits for as many of them at once as it has work that needs none.
const AHEAD: usize = 16;

/// Exchanges light along pairs of texture values that look at each other: what one shoots of `current` the
/// other receives in `sums`. Returns what was shot in all.
pub fn exchange<const SHARES: i64, const COUNTS: i64>(
    pairs: &[[u32; 2]],
    current: Current,
    sums: &mut [Fixed],
) -> Fixed {
    let mut shot = [0; 4];
    let mut sent = [[[0; 4]; 2]; AHEAD];
    for block in pairs.chunks(AHEAD) {
        for (sent, ends) in sent.iter_mut().zip(block) {
            let [near, far] = ends.map(|value| value as usize);
            *sent = [near, far].map(|value| times::<SHARES, COUNTS>(&current.line(value)));
        }
        for ([along, against], ends) in sent.iter().zip(block) {
            let [near, far] = ends.map(|value| value as usize);
            add_to(&mut sums[far], along);
            add_to(&mut sums[near], against);
            add_to(&mut shot, along);
            add_to(&mut shot, against);
        }
    }
    shot
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fixed_point_keeps_radiance_to_a_part_in_a_billion_of_the_brightest() {
        for most in [1e-6, 1.0, 220.0, 1e9] {
            let quantum = Quantum::new(most);
            for part in [0.0, 1e-6, 0.1, 0.333, 1.0] {
                let value = part * most;
                let back = quantum.radiance(quantum.fixed(Rgb([value, most, 0.0]))).0;
                assert!((back[0] - value).abs() <= 1e-7 * value + 2e-9 * most, "{back:?}");
                assert_eq!(back[2], 0.0);
            }
            // A texel that all lines of a final bake strike does not overflow.
            let line = quantum.fixed(Rgb::splat(most));
            assert!(line[0].checked_mul(3 << 24).is_some());
        }
    }

    #[test]
    fn shares_count_lines_as_well_as_radiance() {
        let mut sum = [0; 4];
        add::<3, 1>(&mut sum, &[1, 2, 3, 1]);
        add::<2, 1>(&mut sum, &[10, 20, 30, 1]);
        add::<2, 0>(&mut sum, &[100, 0, 0, 1]);
        assert_eq!(sum, [223, 46, 69, 5]);
    }
}
