//! How far a picture is from a reference.
//!
//! In: two pictures of one size. Out: a handful of numbers and, for the eye, the two pictures side by
//! side with their signed difference. Sums are in f64.

use crate::look::image::{Bitmap, Picture};
use crate::look::tone;
use crate::radiance::Rgb;
use serde::Serialize;
use std::fmt;

/// Keeps divisions by a black reference finite.
const TINY: f64 = 1e-30;

/// Measures of a picture a against a reference b.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// `sqrt(mean((a - b)^2))` over pixels and channels, W sr^-1 m^-2.
    pub rmse: f64,
    /// `mean((a - b)^2 / (b^2 + e))` over pixels and channels.
    pub relmse: f64,
    /// The same without the worst 0.1 % of pixels, which a few edges cannot rule.
    pub relmse_trimmed: f64,
    /// The root of the largest pixel's `(a - b)^2 / (b^2 + e)`, the mean over its channels.
    pub worst: f64,
    /// The largest `|a - b| / sqrt(b^2 + e)` of all channels, `b` the pixel's brightest: what a pack states its
    /// error of cells by.
    pub worst_of_brightest: f64,
    /// relMSE of the means of 8 x 8 blocks: noise averages out, a systematic error stays. `None` for
    /// pictures smaller than one block.
    pub block8: Option<f64>,
    /// `e = 0.01 * mean(b)^2`, (W sr^-1 m^-2)^2.
    pub eps: f64,
    /// `mean(a) / mean(b)`.
    pub ratio: f64,
    /// The same for each channel.
    pub ratio_rgb: [f64; 3],
    /// Pixels of a that have a channel which is no finite number; it counts as 0 above.
    pub nonfinite_pixels: usize,
}

/// Why two pictures cannot be compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CompareError {
    /// They have different sizes.
    #[error("sizes differ: {} x {} pixels against {} x {} of the reference", test.0, test.1, reference.0, reference.1)]
    Sizes {
        /// Width and height of the picture.
        test: (u32, u32),
        /// Width and height of the reference.
        reference: (u32, u32),
    },
    /// They have no pixels.
    #[error("there are no pixels to compare")]
    Empty,
    /// The reference is not to be trusted.
    #[error("the reference has {pixels} pixels that are not finite numbers")]
    Reference {
        /// How many.
        pixels: usize,
    },
}

type Pixel = [f64; 3];

/// Compares a picture with a reference.
///
/// # Errors
/// When the sizes differ, there are no pixels, or the reference holds a NaN or an infinity.
pub fn compare(test: &Picture, reference: &Picture) -> Result<Comparison, CompareError> {
    check(test, reference)?;
    let (a, nonfinite_pixels) = finite(test);
    let (b, _) = finite(reference);
    let eps = eps_of(&b);
    let count = a.len();
    let mut squares = 0.0;
    let mut per_pixel = Vec::with_capacity(count);
    let mut worst_of_brightest = 0.0f64;
    for (p, q) in a.iter().zip(&b) {
        let brightest = q.iter().fold(0.0f64, |most, c| most.max(c.abs()));
        let off = (0..3).map(|c| (p[c] - q[c]).abs()).fold(0.0, f64::max);
        worst_of_brightest = worst_of_brightest.max(off / (brightest * brightest + eps).sqrt());
        squares += (0..3).map(|c| (p[c] - q[c]).powi(2)).sum::<f64>();
        per_pixel.push(relative_square(p, q, eps));
    }
    let relmse = per_pixel.iter().sum::<f64>() / count as f64;
    let kept = ((count as f64 * 0.999) as usize).max(1);
    per_pixel.sort_unstable_by(f64::total_cmp);
    let (width, height) = (test.width as usize, test.height as usize);
    let (mean_a, mean_b) = (channel_means(&a), channel_means(&b));
    Ok(Comparison {
        rmse: (squares / (3 * count) as f64).sqrt(),
        relmse,
        relmse_trimmed: per_pixel[..kept].iter().sum::<f64>() / kept as f64,
        worst: per_pixel.last().copied().unwrap_or_default().sqrt(),
        worst_of_brightest,
        block8: block8(&a, &b, width, height, eps),
        eps,
        ratio: mean_a.iter().sum::<f64>() / mean_b.iter().sum::<f64>(),
        ratio_rgb: [0, 1, 2].map(|c| mean_a[c] / mean_b[c].max(TINY)),
        nonfinite_pixels,
    })
}

impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [r, g, b] = self.ratio_rgb;
        write!(f, "RMSE {:.6} relMSE {:.6}", Short(self.rmse), Short(self.relmse))?;
        write!(f, " (without the worst 0.1 % {:.6})", Short(self.relmse_trimmed))?;
        write!(f, " worst pixel {:.6}", Short(self.worst))?;
        write!(f, " (of its brightest channel {:.6})", Short(self.worst_of_brightest))?;
        if let Some(block8) = self.block8 {
            write!(f, " block8 {:.6}", Short(block8))?;
        }
        write!(f, " mean ratio {:.5} (rgb {r:.5} {g:.5} {b:.5})", self.ratio)?;
        write!(f, " not finite {}", self.nonfinite_pixels)
    }
}

/// Small numbers with their exponent, the others without.
struct Short(f64);

impl fmt::Display for Short {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0 != 0.0 && self.0.abs() < 1e-3 {
            write!(f, "{:.4e}", self.0)
        } else {
            fmt::Display::fmt(&self.0, f)
        }
    }
}

/// Test, reference and signed relative error in a row, four white pixels between them. Red is too
/// bright, blue too dark, full colour an error of 50 %. Both pictures are developed at `ev` stops.
///
/// # Errors
/// As [`compare`].
pub fn difference_picture(
    test: &Picture,
    reference: &Picture,
    ev: f32,
) -> Result<Bitmap, CompareError> {
    const GAP: usize = 4;
    check(test, reference)?;
    let (a, _) = finite(test);
    let (b, _) = finite(reference);
    let eps = eps_of(&b);
    let mean = |p: &Pixel| p.iter().sum::<f64>() / 3.0;
    let signed = a.iter().zip(&b).map(|(p, q)| {
        let error = (mean(p) - mean(q)) / (mean(q).powi(2) + eps).sqrt();
        error_colour((error / 0.5).clamp(-1.0, 1.0))
    });
    let signed = Bitmap { width: test.width, height: test.height, pixels: signed.collect() };
    let panels = [tone::develop(test, ev), tone::develop(reference, ev), signed];
    let width = test.width as usize;
    let mut pixels = Vec::with_capacity((3 * width + 2 * GAP) * test.height as usize);
    for y in 0..test.height as usize {
        for (i, panel) in panels.iter().enumerate() {
            let gap = if i == 0 { 0 } else { GAP };
            pixels.extend(std::iter::repeat_n([255; 3], gap));
            pixels.extend_from_slice(&panel.pixels[y * width..(y + 1) * width]);
        }
    }
    Ok(Bitmap { width: (3 * width + 2 * GAP) as u32, height: test.height, pixels })
}

/// White at 0, red at 1, blue at -1.
fn error_colour(s: f64) -> [u8; 3] {
    let end = if s > 0.0 { [0.8, 0.0, 0.0] } else { [0.0, 0.0, 0.8] };
    end.map(|e| (((1.0 - s.abs()) + s.abs() * e) * 255.0 + 0.5) as u8)
}

fn check(test: &Picture, reference: &Picture) -> Result<(), CompareError> {
    let size = |p: &Picture| (p.width, p.height);
    if size(test) != size(reference) {
        return Err(CompareError::Sizes { test: size(test), reference: size(reference) });
    }
    if test.pixels.is_empty() {
        return Err(CompareError::Empty);
    }
    match finite(reference).1 {
        0 => Ok(()),
        pixels => Err(CompareError::Reference { pixels }),
    }
}

/// The pixels in f64, channels that are no finite number as 0, and how many pixels had one.
fn finite(picture: &Picture) -> (Vec<Pixel>, usize) {
    let is_odd = |p: &&Rgb| p.0.iter().any(|c| !c.is_finite());
    let odd = picture.pixels.iter().filter(is_odd).count();
    let value = |c: f32| if c.is_finite() { f64::from(c) } else { 0.0 };
    (picture.pixels.iter().map(|p| p.0.map(value)).collect(), odd)
}

fn channel_means(pixels: &[Pixel]) -> Pixel {
    [0, 1, 2].map(|c| pixels.iter().map(|p| p[c]).sum::<f64>() / pixels.len() as f64)
}

fn eps_of(reference: &[Pixel]) -> f64 {
    let mean = channel_means(reference).iter().sum::<f64>() / 3.0;
    0.01 * mean * mean + TINY
}

fn relative_square(a: &Pixel, b: &Pixel, eps: f64) -> f64 {
    (0..3).map(|c| (a[c] - b[c]).powi(2) / (b[c] * b[c] + eps)).sum::<f64>() / 3.0
}

/// Rows and columns beyond the last whole block are left out.
fn block8(a: &[Pixel], b: &[Pixel], width: usize, height: usize, eps: f64) -> Option<f64> {
    let (columns, rows) = (width / 8, height / 8);
    if columns * rows == 0 {
        return None;
    }
    let block = |pixels: &[Pixel], column: usize, row: usize| {
        let mut sum = [0.0; 3];
        for y in 8 * row..8 * row + 8 {
            for p in &pixels[y * width + 8 * column..y * width + 8 * column + 8] {
                (0..3).for_each(|c| sum[c] += p[c] / 64.0);
            }
        }
        sum
    };
    let mut total = 0.0;
    for row in 0..rows {
        for column in 0..columns {
            total += relative_square(&block(a, column, row), &block(b, column, row), eps);
        }
    }
    Some(total / (columns * rows) as f64)
}

#[cfg(test)]
mod tests;
