//! A film as an uncompressed YUV4MPEG2 stream, which video encoders read.

use anyhow::Context;
use std::fs::File;
use std::io::{BufWriter, Write, stdout};
use std::path::Path;
use vlf::look::image::Bitmap;
use y4m::{Colorspace, Encoder, EncoderBuilder, Frame, Ratio, VendorExtensionString};

/// Thousandths of a frame a second: the stream states the rate as a fraction.
const RATE: f64 = 1000.0;

/// A film being written, three bytes a pixel and frame.
pub struct Film(Encoder<Box<dyn Write + Send>>);

impl Film {
    /// Begins a film of `size` pixels and so many frames a second; `-` is standard output.
    pub fn create(path: &Path, size: (u32, u32), fps: f64) -> anyhow::Result<Film> {
        let failed = || format!("{}: cannot be written", path.display());
        let out: Box<dyn Write + Send> = match path == Path::new("-") {
            true => Box::new(BufWriter::new(stdout())),
            false => Box::new(BufWriter::new(File::create(path).with_context(failed)?)),
        };
        let rate = Ratio::new((fps * RATE).round() as usize, RATE as usize);
        let range = VendorExtensionString::new(b"COLORRANGE=LIMITED".to_vec())?;
        let encoder = EncoderBuilder::new(size.0 as usize, size.1 as usize, rate)
            .with_colorspace(Colorspace::C444)
            .append_vendor_extension(range)
            .write_header(out)
            .with_context(failed)?;
        Ok(Film(encoder))
    }

    /// Adds a frame.
    pub fn push(&mut self, frame: &Bitmap) -> anyhow::Result<()> {
        let yuv: Vec<[u8; 3]> = frame.pixels.iter().map(|p| to_yuv(*p)).collect();
        let plane = |k: usize| -> Vec<u8> { yuv.iter().map(|p| p[k]).collect() };
        let planes = [plane(0), plane(1), plane(2)];
        let [y, u, v] = &planes;
        self.0.write_frame(&Frame::new([y, u, v], None)).context("the film cannot be written")?;
        Ok(())
    }
}

/// Y'CbCr of ITU-R BT.709, limited range.
fn to_yuv(rgb: [u8; 3]) -> [u8; 3] {
    let [r, g, b] = rgb.map(|c| f32::from(c) / 255.0);
    let y = 0.2126 * r + 0.7152 * g + 0.0722 * b;
    let [cb, cr] = [(b - y) / 1.8556, (r - y) / 1.5748];
    [16.0 + 219.0 * y, 128.0 + 224.0 * cb, 128.0 + 224.0 * cr].map(|v| v.round() as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_are_those_of_the_standard() {
        assert_eq!(to_yuv([0, 0, 0]), [16, 128, 128]);
        assert_eq!(to_yuv([255, 255, 255]), [235, 128, 128]);
        assert_eq!(to_yuv([255, 0, 0]), [63, 102, 240]);
        assert_eq!(to_yuv([0, 0, 255]), [32, 240, 118]);
    }
}
