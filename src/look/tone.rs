//! From radiance to what a screen shows: exposure, tone curve, sRGB.
//!
//! In: a [`Picture`] and an exposure in stops. Out: a [`Bitmap`]. The exposure is absolute: radiance
//! is multiplied by `2^EV`, so one number makes pictures of one scene comparable. Where none is given
//! [`auto_exposure`] proposes one from the picture itself.

use crate::look::image::{Bitmap, Picture};
use crate::radiance::Rgb;
use rayon::prelude::*;
use std::sync::LazyLock;

/// Exposed luminance that the darker surfaces of a picture should have on the average.
const MIDDLE: f64 = 0.26;

/// Where the curve leaves the straight line, in exposed radiance; 1 is white.
const KNEE: f32 = 0.6;

/// How soon colours brighter than white are bleached.
const BLEACHING: f32 = 0.15;

/// How exposed radiance, of which 1 is white, becomes what is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Curve {
    /// Straight up to a knee, then a shoulder that keeps the colours: see [`develop`].
    #[default]
    Shoulder,
    /// Reinhard et al. 2002, equation 4, on the luminance: greyer, with more to see in what is bright.
    Reinhard,
    /// As it is; what is brighter than white is white.
    Plain,
}

/// Luminance that [`Curve::Reinhard`] shows as white.
const REINHARD_WHITE: f32 = 4.0;

impl Curve {
    /// What is shown of exposed radiance, 0 to 1 a channel where the screen can.
    pub fn shown(self, exposed: Rgb) -> Rgb {
        match self {
            Curve::Shoulder => curve(exposed),
            Curve::Reinhard => reinhard(exposed),
            Curve::Plain => exposed,
        }
    }
}

/// Tone-maps a picture with [`Curve::Shoulder`]. `ev` is the exposure in stops: radiance times `2^ev`.
pub fn develop(picture: &Picture, ev: f32) -> Bitmap {
    develop_with(picture, ev, Curve::Shoulder)
}

/// The same with another curve, on all threads of the rayon pool it is called in.
pub fn develop_with(picture: &Picture, ev: f32, curve: Curve) -> Bitmap {
    let Picture { width, height, pixels } = picture;
    let mut bitmap = Bitmap { width: *width, height: *height, pixels: vec![[0; 3]; pixels.len()] };
    Tone::new(ev, curve).develop(pixels, &mut bitmap.pixels);
    bitmap
}

/// Pixels that a thread develops at a time.
const TOGETHER: usize = 1 << 14;

/// How radiance becomes what is shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tone {
    /// What radiance is multiplied by.
    gain: f32,
    curve: Curve,
}

impl Tone {
    /// With an exposure in stops.
    pub fn new(ev: f32, curve: Curve) -> Tone {
        Tone { gain: ev.exp2(), curve }
    }

    /// What is shown of pixels, on all threads.
    pub fn develop(&self, pixels: &[Rgb], shown: &mut [[u8; 3]]) {
        let parts = pixels.par_chunks(TOGETHER).zip(shown.par_chunks_mut(TOGETHER));
        parts.for_each(|(pixels, shown)| self.show(pixels, shown));
    }

    /// What is shown of pixels.
    pub fn show(&self, pixels: &[Rgb], shown: &mut [[u8; 3]]) {
        let Tone { gain, curve } = *self;
        for (pixel, shown) in pixels.iter().zip(shown) {
            *shown = encode(curve.shown(*pixel * gain));
        }
    }
}

/// The exposure, in stops, that brings the logarithmic mean of a picture's luminance to
/// 26 %: somewhat above middle grey, since rooms are painted light. A lamp in the view hardly moves it; black pixels, where nothing is seen, are left
/// out, and 0 is the answer where there is no light at all.
pub fn auto_exposure(picture: &Picture) -> f32 {
    let lit = |p: &&Rgb| p.is_physical() && p.luminance() > 0.0;
    let luminance = |p: &Rgb| f64::from(p.luminance());
    let count = picture.pixels.iter().filter(lit).count();
    if count == 0 {
        return 0.0;
    }
    let mean = picture.pixels.iter().filter(lit).map(luminance).sum::<f64>() / count as f64;
    // Shadows far below the mean count as that far below, lest a nearly black corner rule the rest.
    let log = |p: &Rgb| luminance(p).clamp(mean * 0.02, mean * 50.0).log2();
    let middle = picture.pixels.iter().filter(lit).map(log).sum::<f64>() / count as f64;
    (MIDDLE.log2() - middle) as f32
}

/// Straight up to [`KNEE`], then a shoulder on the largest channel that reaches white at infinity and
/// bleaches what is far too bright (the shape of the Khronos "PBR neutral" tone mapper, without its
/// offset for dielectrics).
///
/// Compared on the reference pictures with Reinhard's extended curve, which greys everything, and
/// with the usual fit of the ACES curve, which closes shadows and burns coloured walls, this keeps
/// the colours that walls throw on each other, which is what global illumination is looked at for.
fn curve(exposed: Rgb) -> Rgb {
    let exposed = Rgb(exposed.0.map(|c| if c.is_nan() { 0.0 } else { c.clamp(0.0, 1e6) }));
    let peak = exposed.max();
    if peak <= KNEE {
        return exposed;
    }
    let room = 1.0 - KNEE;
    let shown = 1.0 - room * room / (peak - KNEE + room);
    let bleach = 1.0 - 1.0 / (BLEACHING * (peak - shown) + 1.0);
    exposed * (shown / peak * (1.0 - bleach)) + Rgb::splat(shown * bleach)
}

fn reinhard(exposed: Rgb) -> Rgb {
    let exposed = Rgb(exposed.0.map(|c| if c.is_nan() { 0.0 } else { c.clamp(0.0, 1e6) }));
    let white = REINHARD_WHITE * REINHARD_WHITE;
    let luminance = exposed.luminance();
    exposed * ((1.0 + luminance / white) / (1.0 + luminance))
}

/// The sRGB transfer curve (IEC 61966-2-1), to the nearest of 256 steps.
pub fn encode(linear: Rgb) -> [u8; 3] {
    let Steps { next, of_bin } = &*STEPS;
    linear.0.map(|x| {
        let x = x.clamp(0.0, 1.0);
        let step = of_bin[((x * BINS as f32) as usize).min(BINS - 1)];
        step + u8::from(x >= next[usize::from(step)])
    })
}

/// The curve's steps by their bounds, which are looked up in less time than the power takes.
struct Steps {
    /// The least number of the step after each; none is as large as the last one's.
    next: [f32; 256],
    /// The step of the least number of each of [`BINS`] parts of [0, 1].
    of_bin: [u8; BINS],
}

/// So many that none has more than one bound in it: where the curve is steepest, there are 0.8 steps a bin.
const BINS: usize = 4096;

static STEPS: LazyLock<Steps> = LazyLock::new(|| {
    // Bits of numbers that are not negative rise with them.
    let above = |step: u8| {
        let (mut below, mut above) = (0, 1.0f32.to_bits());
        while above - below > 1 {
            let middle = below + (above - below) / 2;
            match encoded(f32::from_bits(middle)) < step {
                true => below = middle,
                false => above = middle,
            }
        }
        f32::from_bits(above)
    };
    Steps {
        next: std::array::from_fn(|step| if step == 255 { 2.0 } else { above(step as u8 + 1) }),
        of_bin: std::array::from_fn(|bin| encoded(bin as f32 / BINS as f32)),
    }
});

/// The curve itself, of a number in [0, 1].
fn encoded(x: f32) -> u8 {
    let s = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
    (s * 255.0 + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(values: &[f32]) -> Picture {
        let pixels = values.iter().map(|v| Rgb::splat(*v)).collect();
        Picture { width: values.len() as u32, height: 1, pixels }
    }

    #[test]
    fn srgb_has_its_known_values() {
        assert_eq!(encode(Rgb([0.0, 1.0, 0.5])), [0, 255, 188]);
        assert_eq!(encode(Rgb([0.18, 2.0, -1.0])), [118, 255, 0]);
        assert_eq!(encode(Rgb::splat(0.002)), [7; 3]);
    }

    #[test]
    fn steps_are_the_curves() {
        for step in 1..=255u8 {
            let least = STEPS.next[usize::from(step) - 1];
            assert!(encoded(least) == step && encoded(least.next_down()) == step - 1, "{step}");
        }
        for k in 0..=100_000 {
            let x = k as f32 / 100_000.0;
            assert_eq!(encode(Rgb::splat(x)), [encoded(x); 3], "{x}");
        }
        assert_eq!(encode(Rgb([f32::NAN, f32::INFINITY, f32::NEG_INFINITY])), [0, 255, 0]);
    }

    #[test]
    fn the_curve_rises_from_black_to_white() {
        let mut last = -1.0;
        for i in 0..=1000 {
            let x = i as f32 / 1000.0 * 8.0;
            let y = curve(Rgb::splat(x)).0[1];
            assert!(y > last && y <= 1.0, "{x}: {y}");
            last = y;
        }
        assert!(last > 0.97 && curve(Rgb::splat(0.18)) == Rgb::splat(0.18));
        for odd in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0, f32::MAX] {
            let y = curve(Rgb([odd, 0.5, 0.5]));
            assert!(y.is_physical() && y.max() <= 1.0, "{odd}: {y:?}");
        }
    }

    #[test]
    fn every_curve_rises_and_shows_black_and_white_as_such() {
        for curve in [Curve::Shoulder, Curve::Reinhard, Curve::Plain] {
            let grey = |x: f32| encode(curve.shown(Rgb::splat(x)));
            let shown: Vec<u8> = (0..1000).map(|i| grey(i as f32 * 0.01)[1]).collect();
            assert!(shown.is_sorted() && shown[0] == 0, "{curve:?}");
            assert!(grey(1e9)[0] == 255 && grey(f32::NAN)[0] == 0, "{curve:?}");
        }
        assert_eq!(encode(Curve::Reinhard.shown(Rgb::splat(REINHARD_WHITE))), [255; 3]);
        assert_eq!(Curve::Plain.shown(Rgb([0.7, 0.8, 0.9])), Rgb([0.7, 0.8, 0.9]));
    }

    #[test]
    fn exposure_is_found_from_the_middle_and_follows_the_light() {
        assert!((auto_exposure(&grey(&[MIDDLE as f32; 8])) - 0.0).abs() < 1e-5);
        assert!(
            (auto_exposure(&grey(&[0.0, 4.0 * MIDDLE as f32, 4.0 * MIDDLE as f32, f32::NAN]))
                + 2.0)
                .abs()
                < 1e-5
        );
        assert_eq!(auto_exposure(&grey(&[0.0; 3])), 0.0);
        // One stop more light asks for one stop less, and shows the same bitmap.
        let (one, two) = (grey(&[0.1, 0.3, 2.0]), grey(&[0.2, 0.6, 4.0]));
        let (a, b) = (auto_exposure(&one), auto_exposure(&two));
        assert!((a - b - 1.0).abs() < 1e-5);
        assert_eq!(develop(&one, a).pixels, develop(&two, a - 1.0).pixels);
    }
}
