//! Images that stand for a surface's colour: decoded, and what a pixel of one reflects.

use crate::format::limits::{Flag, Limits};
use crate::radiance::Rgb;
use image::{ImageReader, Limits as Decoding};
use std::borrow::Cow;
use std::collections::HashMap;
use std::io::{self, Cursor};
use std::sync::LazyLock;

/// What 1 is in [`linear`].
pub const ONE: u32 = 1 << 24;

/// Bytes that a decoder may take for a pixel: 16 bits of four channels, and as much of its own.
const A_PIXEL: u64 = 16;

/// Bytes that a decoder may take for the smallest image.
const A_DECODER: u64 = 1 << 20;

/// An image of 8 bits a channel, red, green, blue, in sRGB.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    /// Pixels in a row; not 0.
    pub width: u32,
    /// Rows; not 0.
    pub height: u32,
    /// `width * height` pixels, row by row from the top.
    pub pixels: Vec<[u8; 3]>,
}

/// The images of a scene that is being read, each once.
pub(super) struct Images<'a> {
    limits: &'a Limits,
    left: u64,
    known: HashMap<String, Result<u32, String>>,
    /// Those that could be read.
    pub images: Vec<Image>,
}

impl<'a> Images<'a> {
    /// None yet.
    pub fn new(limits: &'a Limits) -> Images<'a> {
        Images { limits, left: limits.pixels().0, known: HashMap::new(), images: Vec::new() }
    }

    /// The number of the image of a name, and its mean; `bytes` gives its file.
    pub fn take<'b>(
        &mut self,
        name: &str,
        bytes: impl FnOnce() -> io::Result<Cow<'b, [u8]>>,
    ) -> Result<(u32, Rgb), Unread> {
        let found = match self.known.get(name) {
            Some(known) => known.clone(),
            None => {
                let read = match bytes() {
                    Ok(bytes) => Image::decode(&bytes, self.limits, &mut self.left),
                    Err(e) => Err(Unread::Damaged(e.to_string())),
                };
                let found = match read {
                    Ok(image) => {
                        self.images.push(image);
                        Ok(self.images.len() as u32 - 1)
                    }
                    Err(Unread::Damaged(why)) => Err(why),
                    Err(too_large) => return Err(too_large),
                };
                self.known.insert(name.to_owned(), found.clone());
                found
            }
        };
        let number = found.map_err(Unread::Damaged)?;
        Ok((number, self.images[number as usize].mean()))
    }
}

/// Why an image cannot be taken.
#[derive(Debug)]
pub(super) enum Unread {
    /// It is none, or of a kind that is not known: what the decoder says.
    Damaged(String),
    /// It has more pixels than are left: how many, the limit, and what raises it.
    TooLarge(u64, u64, Flag),
}

impl Image {
    /// Decodes a PNG or JPEG file; what it is its bytes say, not its name. Opacity is left out. Its
    /// pixels are taken from `left`.
    pub(super) fn decode(bytes: &[u8], limits: &Limits, left: &mut u64) -> Result<Image, Unread> {
        let damaged = |e: image::ImageError| Unread::Damaged(e.to_string());
        let reader = || {
            let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format();
            reader.map_err(|e| Unread::Damaged(e.to_string()))
        };
        let (width, height) = reader()?.into_dimensions().map_err(damaged)?;
        let pixels = u64::from(width) * u64::from(height);
        if pixels > *left {
            let (limit, flag) = limits.pixels();
            return Err(Unread::TooLarge(limit - *left + pixels, limit, flag));
        }
        let mut reader = reader()?;
        let mut decoding = Decoding::no_limits();
        (decoding.max_image_width, decoding.max_image_height) = (Some(width), Some(height));
        decoding.max_alloc = Some(A_DECODER + A_PIXEL * pixels);
        reader.limits(decoding);
        let decoded = reader.decode().map_err(damaged)?.into_rgb8();
        if pixels == 0 {
            return Err(Unread::Damaged("it has no pixel".to_owned()));
        }
        *left -= pixels;
        let pixels = decoded.into_raw().as_chunks().0.to_vec();
        Ok(Image { width, height, pixels })
    }

    /// The pixel at a place in edges of the image, which repeats.
    pub fn at(&self, place: glam::DVec2) -> [u8; 3] {
        let of = |x: f64, edge: u32| (((x - x.floor()) * f64::from(edge)) as u32).min(edge - 1);
        let (column, row) = (of(place.x, self.width), of(place.y, self.height));
        self.pixels[row as usize * self.width as usize + column as usize]
    }

    /// The mean of all pixels, linear, in [0, 1].
    pub fn mean(&self) -> Rgb {
        let sum = |c: usize| self.pixels.iter().map(|p| u64::from(linear(p[c]))).sum::<u64>();
        let count = f64::from(ONE) * self.pixels.len() as f64;
        Rgb([0, 1, 2].map(|c| (sum(c) as f64 / count) as f32))
    }

    /// Bytes of memory that it takes.
    pub fn bytes(&self) -> u64 {
        3 * self.pixels.len() as u64
    }
}

/// A channel of sRGB (IEC 61966-2-1) in linear light, in parts of [`ONE`]. Whole numbers, so that
/// sums do not depend on their order.
pub fn linear(channel: u8) -> u32 {
    static TABLE: LazyLock<[u32; 256]> = LazyLock::new(|| {
        std::array::from_fn(|i| {
            let c = i as f64 / 255.0;
            let linear = if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) };
            // Rounding hides how a machine's power function rounds.
            (linear * f64::from(ONE)).round() as u32
        })
    });
    TABLE[usize::from(channel)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A PNG of one colour.
    fn grey(width: u32, height: u32) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, width, height);
        encoder.set_color(png::ColorType::Grayscale);
        let mut writer = encoder.write_header().unwrap();
        writer.write_image_data(&vec![188; (width * height) as usize]).unwrap();
        writer.finish().unwrap();
        bytes
    }

    #[test]
    fn srgb_is_decoded_and_averaged_in_linear_light() {
        // By the standard: 188 is 0.5029, 1 is 1/255/12.92.
        assert_eq!((linear(0), linear(255)), (0, ONE));
        assert!((f64::from(linear(188)) / f64::from(ONE) - 0.50289).abs() < 1e-5);
        assert!((f64::from(linear(1)) / f64::from(ONE) - 3.0353e-4).abs() < 1e-7);
        let two = Image { width: 2, height: 1, pixels: vec![[0, 255, 188], [255, 255, 188]] };
        assert!((two.mean().0[0] - 0.5).abs() < 1e-6, "not the mean of the numbers, 0.21");
        assert!((two.mean().0[2] - 0.50289).abs() < 1e-5);
    }

    #[test]
    fn pixels_are_counted_before_they_are_decoded() {
        let limits = Limits { pixels: 100, ..Limits::default() };
        let mut left = 100;
        let image = Image::decode(&grey(9, 8), &limits, &mut left).unwrap();
        assert_eq!((image.width, image.height, image.pixels[71], left), (9, 8, [188; 3], 28));
        let again = Image::decode(&grey(9, 8), &limits, &mut left);
        assert!(matches!(again, Err(Unread::TooLarge(144, 100, Some("--limit-pixels")))));
        for bad in [&b""[..], b"GIF89a", &grey(9, 8)[..40]] {
            let mut left = 100;
            assert!(matches!(Image::decode(bad, &limits, &mut left), Err(Unread::Damaged(_))));
        }
    }
}
