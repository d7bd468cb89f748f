//! Bytes of a glTF file: buffers, embedded or beside it, and the numbers that accessors find in them.

use super::File;
use crate::format::text::shown;
use ::gltf::accessor::{DataType, Dimensions};
use ::gltf::{Accessor, Document, buffer};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use percent_encoding::percent_decode_str;
use std::borrow::Cow;
use std::io;

/// The buffers of a file.
pub(super) struct Buffers(Vec<Vec<u8>>);

impl Buffers {
    /// Loads all of them; `blob` is the binary part of the file itself.
    pub fn load(
        document: &Document,
        mut blob: Option<Vec<u8>>,
        file: &mut File,
    ) -> Result<Buffers, String> {
        let mut buffers = Vec::new();
        for buffer in document.buffers() {
            let number = buffer.index();
            let bytes = match buffer.source() {
                buffer::Source::Bin => {
                    blob.take().ok_or_else(|| format!("buffer {number} has no bytes"))?
                }
                buffer::Source::Uri(uri) => named(uri, file).map_err(|e| {
                    let uri = shown(uri);
                    format!("buffer `{uri}` cannot be read: {e}; put the file beside it")
                })?,
            };
            if bytes.len() < buffer.length() {
                let (has, wants) = (bytes.len(), buffer.length());
                return Err(format!("buffer {number} has {has} bytes, not {wants}"));
            }
            buffers.push(bytes);
        }
        Ok(Buffers(buffers))
    }

    /// The bytes of a view.
    pub fn view(&self, view: &buffer::View) -> Result<&[u8], String> {
        let bytes = self.0.get(view.buffer().index());
        let end = view.offset().checked_add(view.length());
        let found = end.and_then(|end| bytes?.get(view.offset()..end));
        found.ok_or_else(|| format!("buffer view {} ends beyond its buffer", view.index()))
    }

    /// The items of an accessor as bytes, each of `size`.
    fn items(&self, accessor: &Accessor, size: usize) -> Result<Vec<&[u8]>, String> {
        let number = accessor.index();
        if accessor.sparse().is_some() {
            return Err(format!("accessor {number} is sparse; export the file without"));
        }
        let view = accessor.view().ok_or_else(|| format!("accessor {number} has no bytes"))?;
        let (bytes, stride) = (self.view(&view)?, view.stride().unwrap_or(size).max(1));
        let beyond = || format!("accessor {number} ends beyond its buffer view");
        let last = accessor.count().checked_sub(1).ok_or_else(beyond)?;
        let end = last
            .checked_mul(stride)
            .and_then(|at| at.checked_add(accessor.offset())?.checked_add(size));
        if end.is_none_or(|end| end > bytes.len()) {
            return Err(beyond());
        }
        let at = |k: usize| accessor.offset() + k * stride;
        Ok((0..accessor.count()).map(|k| &bytes[at(k)..at(k) + size]).collect())
    }

    /// Vectors of numbers. What is stored as whole numbers counts in parts of the largest.
    pub fn vectors<const N: usize>(&self, accessor: &Accessor) -> Result<Vec<[f32; N]>, String> {
        let other = || {
            let number = accessor.index();
            format!("accessor {number} holds numbers of another kind than is known here")
        };
        let dimensions = match N {
            2 => Dimensions::Vec2,
            3 => Dimensions::Vec3,
            _ => return Err(other()),
        };
        if accessor.dimensions() != dimensions {
            return Err(other());
        }
        let of: fn(&[u8]) -> f32 = match accessor.data_type() {
            DataType::F32 => |b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]),
            DataType::U8 if accessor.normalized() => |b| f32::from(b[0]) / 255.0,
            DataType::U16 if accessor.normalized() => {
                |b| f32::from(u16::from_le_bytes([b[0], b[1]])) / 65535.0
            }
            _ => return Err(other()),
        };
        let each = accessor.data_type().size();
        let items = self.items(accessor, N * each)?;
        let vector = |item: &[u8]| std::array::from_fn(|k| of(&item[k * each..]));
        Ok(items.into_iter().map(vector).collect())
    }

    /// Indices, each below `count`.
    pub fn indices(&self, accessor: &Accessor, count: usize) -> Result<Vec<u32>, String> {
        let number = accessor.index();
        let of: fn(&[u8]) -> u32 = match accessor.data_type() {
            DataType::U8 => |b| u32::from(b[0]),
            DataType::U16 => |b| u32::from(u16::from_le_bytes([b[0], b[1]])),
            DataType::U32 => |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]),
            _ => return Err(format!("accessor {number} holds no indices")),
        };
        if accessor.dimensions() != Dimensions::Scalar {
            return Err(format!("accessor {number} holds no indices"));
        }
        let items = self.items(accessor, accessor.data_type().size())?;
        let indices: Vec<u32> = items.into_iter().map(of).collect();
        match indices.iter().find(|i| **i as usize >= count) {
            Some(i) => Err(format!("accessor {number}: index {i} of {count} vertices")),
            None => Ok(indices),
        }
    }

    /// The bytes of an image's file.
    pub fn image(&self, image: &::gltf::Image, file: &mut File) -> io::Result<Cow<'_, [u8]>> {
        match image.source() {
            ::gltf::image::Source::View { view, .. } => {
                self.view(&view).map(Cow::Borrowed).map_err(io::Error::other)
            }
            ::gltf::image::Source::Uri { uri, .. } => named(uri, file).map(Cow::Owned),
        }
    }
}

/// What a URI names: the bytes in it, or a file.
fn named(uri: &str, file: &mut File) -> io::Result<Vec<u8>> {
    let Some(data) = uri.strip_prefix("data:") else {
        let name = percent_decode_str(uri).decode_utf8().map_err(io::Error::other)?;
        return file(&name);
    };
    let (kind, text) =
        data.split_once(',').ok_or_else(|| io::Error::other("a data URI without a comma"))?;
    match kind.ends_with(";base64") {
        true => STANDARD.decode(text).map_err(io::Error::other),
        false => Ok(percent_decode_str(text).collect()),
    }
}
