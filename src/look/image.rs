//! Pictures in memory and on disk.
//!
//! A [`Picture`] holds linear radiance and goes to OpenEXR (32-bit floats, exact); a [`Bitmap`] holds
//! what a screen shows and goes to PNG. A file appears whole or not at all: it is written beside its
//! place under another name and renamed.

use crate::format::text::inert;
use crate::radiance::Rgb;
use exr::prelude::{
    Encoding, FlatSamples, Image, Layer, LayerAttributes, MetaData, ReadChannels, ReadLayers,
    SpecificChannels, Vec2, WritableImage,
};
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// The most pixels a picture may have that is read from a file.
pub const MOST_PIXELS: u64 = 1 << 26;

/// The most bytes that all channels of a file may fill once unpacked.
const MOST_BYTES: u64 = 1 << 31;

/// Linear radiance, W sr^-1 m^-2, row by row from the top left.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Picture {
    /// Pixels along a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height` pixels.
    pub pixels: Vec<Rgb>,
}

/// Display values, sRGB with 8 bits a channel, row by row from the top left.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Bitmap {
    /// Pixels along a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height` pixels.
    pub pixels: Vec<[u8; 3]>,
}

/// A picture and what a screen shows of it. Drawn into again and again it takes no new memory.
#[derive(Debug, Default)]
pub struct Canvas {
    /// Radiance.
    pub picture: Picture,
    /// What is shown of it, of the same size.
    pub bitmap: Bitmap,
}

impl Canvas {
    /// Makes it as large as that; what it shows is not defined.
    pub fn resize(&mut self, width: u32, height: u32) {
        let Canvas { picture, bitmap } = self;
        (picture.width, picture.height, bitmap.width, bitmap.height) =
            (width, height, width, height);
        let count = width as usize * height as usize;
        picture.pixels.resize(count, Rgb::BLACK);
        bitmap.pixels.resize(count, [0; 3]);
    }
}

impl Picture {
    /// A picture without light.
    pub fn black(width: u32, height: u32) -> Picture {
        Picture { width, height, pixels: vec![Rgb::BLACK; width as usize * height as usize] }
    }
}

/// Why a picture could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What it said.
        source: io::Error,
    },
    /// The bytes are not a picture, or of a kind that is not read here.
    #[error("{}: not a readable OpenEXR picture: {}", path.display(), inert(why, 200))]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        why: String,
    },
    /// The picture is larger than what is read.
    #[error("{}: {width} x {height} pixels with all their channels are more than can be read", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Pixels along a row.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// The place to write to holds something that a picture must not replace.
    #[error("{}: exists and is not a regular file, so it is not replaced", path.display())]
    NotAFile {
        /// The place.
        path: PathBuf,
    },
    /// A picture without pixels has no file.
    #[error("{}: a picture of {width} x {height} pixels cannot be written", path.display())]
    Empty {
        /// The place.
        path: PathBuf,
        /// Pixels along a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// The picture could not be encoded.
    #[error("{}: cannot encode the picture: {why}", path.display())]
    Encode {
        /// The place.
        path: PathBuf,
        /// What the encoder said.
        why: String,
    },
}

/// Reads the first layer of an OpenEXR file: channels R, G and B (or `name.R` and so on), or Y alone
/// for a grey picture.
///
/// # Errors
/// Missing, damaged and deep files, files without these channels, and pictures of more than
/// [`MOST_PIXELS`].
pub fn read_exr(path: &Path) -> Result<Picture, ImageError> {
    let damaged = |why: String| ImageError::Damaged { path: path.to_owned(), why };
    let failed = |e: exr::error::Error| match e {
        exr::error::Error::Io(source) if source.kind() != io::ErrorKind::UnexpectedEof => {
            ImageError::Io { path: path.to_owned(), source }
        }
        other => damaged(other.to_string()),
    };
    // Look at the sizes before anything of that size is reserved.
    let file =
        File::open(path).map_err(|source| ImageError::Io { path: path.to_owned(), source })?;
    let meta = MetaData::read_from_buffered(io::BufReader::new(&file), false).map_err(failed)?;
    for header in &meta.headers {
        let Vec2(width, height) = header.layer_size;
        let pixels = (width as u64).saturating_mul(height as u64);
        let bytes = pixels.saturating_mul(header.channels.bytes_per_pixel as u64);
        if pixels > MOST_PIXELS || bytes > MOST_BYTES {
            return Err(ImageError::TooLarge { path: path.to_owned(), width, height });
        }
    }
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_file(path)
        .map_err(failed)?;
    let layer = image.layer_data;
    let Vec2(width, height) = layer.size;
    let count = width * height;
    let channel = |name: &str| {
        let is_it = |c: &&exr::prelude::AnyChannel<FlatSamples>| {
            let full = c.name.to_string();
            full == name || full.strip_suffix(name).is_some_and(|layer| layer.ends_with('.'))
        };
        layer.channel_data.list.iter().find(is_it).map(|c| &c.sample_data)
    };
    let planes = [
        channel("R").or_else(|| channel("Y")),
        channel("G").or_else(|| channel("Y")),
        channel("B").or_else(|| channel("Y")),
    ];
    let [Some(r), Some(g), Some(b)] = planes else {
        return Err(damaged("it has neither channels R, G, B nor a channel Y".into()));
    };
    if [r, g, b].iter().any(|plane| plane.len() != count) {
        return Err(damaged("its channels are subsampled".into()));
    }
    let planes = [r, g, b].map(|plane| plane.values_as_f32().collect::<Vec<f32>>());
    let pixels = (0..count).map(|i| Rgb([planes[0][i], planes[1][i], planes[2][i]])).collect();
    Ok(Picture { width: width as u32, height: height as u32, pixels })
}

/// Writes an OpenEXR file: channels R, G and B of 32-bit floats, compressed without loss.
///
/// # Errors
/// When the place exists and is not a regular file, cannot be written, or the picture is empty.
pub fn write_exr(path: &Path, picture: &Picture) -> Result<(), ImageError> {
    let size = Vec2(picture.width as usize, picture.height as usize);
    not_empty(path, picture.width, picture.height)?;
    let pixel = |at: Vec2<usize>| {
        let [r, g, b] = picture.pixels[at.1 * size.0 + at.0].0;
        (r, g, b)
    };
    let layer = Layer::new(
        size,
        LayerAttributes::default(),
        Encoding::SMALL_LOSSLESS,
        SpecificChannels::rgb(pixel),
    );
    let mut bytes = io::Cursor::new(Vec::new());
    Image::from_layer(layer)
        .write()
        .non_parallel()
        .to_buffered(&mut bytes)
        .map_err(|e| ImageError::Encode { path: path.to_owned(), why: e.to_string() })?;
    write_whole(path, bytes.get_ref())
}

/// Writes a PNG file, 8 bits a channel, marked as sRGB.
///
/// # Errors
/// When the place exists and is not a regular file, cannot be written, or the bitmap is empty.
pub fn write_png(path: &Path, bitmap: &Bitmap) -> Result<(), ImageError> {
    not_empty(path, bitmap.width, bitmap.height)?;
    let failed =
        |e: png::EncodingError| ImageError::Encode { path: path.to_owned(), why: e.to_string() };
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, bitmap.width, bitmap.height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    let mut writer = encoder.write_header().map_err(failed)?;
    writer.write_image_data(bitmap.pixels.as_flattened()).map_err(failed)?;
    writer.finish().map_err(failed)?;
    write_whole(path, &bytes)
}

fn not_empty(path: &Path, width: u32, height: u32) -> Result<(), ImageError> {
    if width == 0 || height == 0 {
        return Err(ImageError::Empty { path: path.to_owned(), width, height });
    }
    Ok(())
}

/// Puts a file in its place whole, by renaming. A link is followed, so that it stays a link.
fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), ImageError> {
    let failed = |source: io::Error| ImageError::Io { path: path.to_owned(), source };
    let mut place = path.to_owned();
    if fs::symlink_metadata(path).is_ok() {
        place = fs::canonicalize(path).map_err(failed)?;
        if !fs::metadata(&place).map_err(failed)?.is_file() {
            return Err(ImageError::NotAFile { path: path.to_owned() });
        }
    }
    let folder = match place.parent() {
        Some(p) if p != Path::new("") => p,
        _ => Path::new("."),
    };
    let mut builder = tempfile::Builder::new();
    builder.prefix(".vlf-");
    // Without this the file would be its owner's alone; the process's umask still applies.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let temporary = builder.tempfile_in(folder).map_err(failed)?;
    let mut out = BufWriter::new(temporary);
    out.write_all(bytes).map_err(failed)?;
    let temporary = out.into_inner().map_err(|e| failed(e.into_error()))?;
    temporary.as_file().sync_all().map_err(failed)?;
    temporary.persist(&place).map_err(|e| failed(e.error))?;
    Ok(())
}

#[cfg(test)]
mod tests;
