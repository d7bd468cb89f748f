//! Pixels of a window: a picture brought to its size, and text over it.
//!
//! Pixels are `0x00RRGGBB`, row by row from the top left.

use crate::paint::Frame;
use embedded_graphics::mono_font::iso_8859_1::{FONT_7X13, FONT_10X20};
use embedded_graphics::mono_font::{MonoFont, MonoTextStyle};
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::{
    DrawTarget, Drawable, OriginDimensions, Pixel, Point, RgbColor, Size,
};
use embedded_graphics::text::{Baseline, Text};
use std::convert::Infallible;

/// Fills rows of `width` pixels with a frame, whatever size it was taken for. Between its pixels colours
/// go over into each other. On the calling thread alone: the others have the next frame to take, and
/// the window would wait for them.
pub fn enlarge(frame: &Frame, (width, height): (u32, u32), out: &mut [u32]) {
    let shot = &frame.taken.shot;
    let bitmap = &frame.bitmap;
    let (columns, rows) = (bitmap.width as usize, bitmap.height as usize);
    if (bitmap.width, bitmap.height) == (width, height) {
        for (out, [r, g, b]) in out.iter_mut().zip(&bitmap.pixels) {
            *out = u32::from(*r) << 16 | u32::from(*g) << 8 | u32::from(*b);
        }
        return;
    }
    // Where a pixel of the window is between those of the bitmap: the first of two, and 256ths of the way.
    let between = |at: usize, (size, shown, margin, count): (u32, u32, f32, usize)| {
        let shown = (at as f32 + 0.5) * shown as f32 / size as f32;
        let place = (shown + margin) / shot.pass.coarse as f32 - 0.5;
        let place = place.clamp(0.0, (count - 1) as f32);
        let first = (place as usize).min(count.saturating_sub(2));
        (first, ((place - first as f32) * 256.0) as u32)
    };
    let [left, top] = shot.margin();
    let across = (width, shot.camera.width, left, columns);
    let down = (height, shot.camera.height, top, rows);
    let places: Vec<_> = (0..width as usize).map(|x| between(x, across)).collect();
    for (y, out) in out.chunks_mut(width as usize).enumerate() {
        let (row, fy) = between(y, down);
        let line = |row: usize| {
            let row = row.min(rows - 1) * columns;
            &bitmap.pixels[row..row + columns]
        };
        let (upper, lower) = (line(row), line(row + 1));
        for (pixel, (x, fx)) in out.iter_mut().zip(&places) {
            let next = (x + 1).min(columns - 1);
            let channel = |c: usize| {
                let mix = |line: &[[u8; 3]]| {
                    u32::from(line[*x][c]) * (256 - fx) + u32::from(line[next][c]) * fx
                };
                (mix(upper) * (256 - fy) + mix(lower) * fy + 0x8000) >> 16
            };
            *pixel = channel(0) << 16 | channel(1) << 8 | channel(2);
        }
    }
}

/// Writes lines of text into the top left corner, on a darkened ground, larger on screens with small
/// pixels. What does not fit into the width goes on in the next line.
pub fn write(lines: &[String], (width, height): (u32, u32), scale: f64, out: &mut [u32]) {
    let (font, zoom): (&MonoFont<'_>, u32) = match scale {
        s if s < 1.5 => (&FONT_7X13, 1),
        s if s < 2.5 => (&FONT_10X20, 1),
        _ => (&FONT_10X20, 2),
    };
    let (wide, tall) = (font.character_size.width, font.character_size.height + 2);
    let size = Size::new(width / zoom, height / zoom);
    let fits = (size.width.saturating_sub(2 * wide) / wide).max(1) as usize;
    let lines: Vec<String> = lines.iter().flat_map(|line| wrapped(line, fits)).collect();
    let longest = lines.iter().map(|line| line.chars().count()).max().unwrap_or(0) as u32;
    if lines.is_empty() {
        return;
    }
    let box_width = ((longest + 2) * wide * zoom).min(width) as usize;
    let box_height = ((lines.len() as u32 * tall + tall / 2) * zoom).min(height) as usize;
    for row in out.chunks_mut(width as usize).take(box_height) {
        row[..box_width].iter_mut().for_each(|p| *p = (*p >> 2) & 0x3f_3f_3f);
    }
    let mut canvas = Canvas { pixels: out, width: width as usize, size, zoom: zoom as usize };
    let style = MonoTextStyle::new(font, Rgb888::WHITE);
    for (at, line) in lines.iter().enumerate() {
        let place = Point::new(wide as i32, (at as u32 * tall + tall / 4) as i32);
        // Drawing here cannot fail: the error type has no values.
        let Ok(_) = Text::with_baseline(line, place, style, Baseline::Top).draw(&mut canvas);
    }
}

/// A line in pieces of so many characters.
fn wrapped(line: &str, fits: usize) -> Vec<String> {
    let line: Vec<char> = line.chars().collect();
    line.chunks(fits).map(|piece| piece.iter().collect()).collect()
}

/// The pixels as the text library wants them.
struct Canvas<'a> {
    pixels: &'a mut [u32],
    width: usize,
    /// In text pixels, `zoom` pixels a side each.
    size: Size,
    zoom: usize,
}

impl OriginDimensions for Canvas<'_> {
    fn size(&self) -> Size {
        self.size
    }
}

impl DrawTarget for Canvas<'_> {
    type Color = Rgb888;
    type Error = Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Rgb888>>>(
        &mut self,
        pixels: I,
    ) -> Result<(), Infallible> {
        for Pixel(at, colour) in pixels {
            let (Ok(x), Ok(y)) = (u32::try_from(at.x), u32::try_from(at.y)) else { continue };
            if x >= self.size.width || y >= self.size.height {
                continue;
            }
            let value =
                u32::from(colour.r()) << 16 | u32::from(colour.g()) << 8 | u32::from(colour.b());
            for row in 0..self.zoom {
                let from = (y as usize * self.zoom + row) * self.width + x as usize * self.zoom;
                self.pixels[from..from + self.zoom].fill(value);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pace::Pass;
    use crate::paint::{Look, Method, Shot, Taken};
    use std::sync::Arc;
    use std::time::Duration;
    use vlf::look::image::{Bitmap, Picture};
    use vlf::{Camera, Rgb};

    /// A frame whose pixels get brighter by `step` from column to column.
    fn ramp(width: u32, height: u32, coarse: u32, step: u8) -> Frame {
        let camera: Camera = serde_json::from_str(&format!(
            r#"{{"eye":[0,0,5],"target":[0,0,0],"up":[0,1,0],"vfov_deg":60,"width":{width},"height":{height}}}"#
        ))
        .unwrap();
        let shot = Shot { camera, pass: Pass { coarse, samples: 1 }, method: Method::Trace };
        let (columns, rows) = (width.div_ceil(coarse), height.div_ceil(coarse));
        let pixels = (0..columns * rows).map(|i| [(i % columns) as u8 * step; 3]).collect();
        let picture = Picture { width: columns, height: rows, pixels: vec![Rgb::BLACK; 1] };
        let time = Duration::ZERO;
        Frame {
            taken: Arc::new(Taken { shot, picture, damaged: 0 }),
            bitmap: Arc::new(Bitmap { width: columns, height: rows, pixels }),
            look: Look { exposure: None, curve: vlf::look::tone::Curve::Plain },
            time,
        }
    }

    #[test]
    fn a_frame_fills_windows_of_every_size_and_rises_evenly() {
        for (width, height, coarse) in
            [(64, 48, 1), (64, 48, 4), (61, 5, 8), (1, 1, 16), (3, 90, 2)]
        {
            let frame = ramp(width, height, coarse, 3);
            for size in [(width, height), (1, 1), (200, 3), (7, 130)] {
                let mut out = vec![0xff00_0000; (size.0 * size.1) as usize];
                enlarge(&frame, size, &mut out);
                assert!(out.iter().all(|p| *p <= 0xff_ffff), "{width} {coarse} {size:?}");
                for row in out.chunks(size.0 as usize) {
                    assert!(row.is_sorted(), "{width} {coarse} {size:?}: {row:?}");
                }
            }
        }
        // Four window pixels for each of the frame's: the way from one to the next in four steps.
        let mut out = vec![0; 64 * 48];
        enlarge(&ramp(64, 48, 4, 16), (64, 48), &mut out);
        assert_eq!(out[6..10].iter().map(|p| p & 0xff).collect::<Vec<_>>(), [18, 22, 26, 30]);
    }

    #[test]
    fn text_is_in_its_corner_and_stays_in_windows_of_every_size() {
        let lines = vec!["Grüße ? \u{4e2d}".to_owned(), "x".repeat(500), String::new()];
        for size in [(400, 100), (1, 1), (8, 300), (300, 8), (30, 30)] {
            for scale in [1.0, 2.0, 4.0] {
                let mut out = vec![0x80_80_80; (size.0 * size.1) as usize];
                write(&lines, size, scale, &mut out);
                assert!(size.0.min(size.1) < 100 || out.contains(&0xff_ff_ff), "{size:?} {scale}");
            }
        }
        let mut out = vec![0x80_80_80; 400 * 100];
        write(&["short".to_owned()], (400, 100), 1.0, &mut out);
        assert_eq!(out[0], 0x20_20_20);
        assert_eq!(out[200], 0x80_80_80);
        assert_eq!(out[99 * 400], 0x80_80_80);
    }
}
