//! glTF 2.0, text or binary, to a [`Scene`]: what it shows in its default scene, at rest.
//!
//! Triangles of all nodes in the scene's own metres; base colour as diffuse reflectance or, of smooth
//! metals, as that of an ideal mirror; emission; lights as small lamps; cameras as views. Whatever else a
//! file says is noted and left out. Radiance is `emissiveFactor` times `emissiveStrength`, taken as
//! W sr^-1 m^-2, and candela as W sr^-1: the format's luminous units with one lumen for a watt.

use super::assemble::{Pieces, file_name};
use super::error::SceneError;
use super::flat::Tallies;
use super::image::{Images, Unread};
use super::report::Report;
use super::{NamedCamera, Scene};
use crate::format::limits::{Flag, Limits};
use buffers::Buffers;
use meshes::Meshes;
use said::Said;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

mod said;

mod buffers;

mod materials;

mod meshes;

mod lights;

mod cameras;

#[cfg(test)]
mod tests;

/// How a binary file begins.
const MAGIC: &[u8] = b"glTF";

/// Bytes of a binary file before its chunks.
const HEADER: usize = 12;

/// Gives the bytes of a file that is named.
type File<'a> = dyn FnMut(&str) -> io::Result<Vec<u8>> + 'a;

/// Why a file was refused.
enum Refusal {
    /// What is wrong.
    Message(String),
    /// Too much of something: what, how much, the limit, what raises it.
    TooLarge(&'static str, u64, u64, Flag),
}

impl From<String> for Refusal {
    fn from(message: String) -> Refusal {
        Refusal::Message(message)
    }
}

impl From<Unread> for Refusal {
    fn from(unread: Unread) -> Refusal {
        match unread {
            Unread::Damaged(why) => Refusal::Message(why),
            Unread::TooLarge(found, limit, flag) => {
                Refusal::TooLarge("number of pixels of images", found, limit, flag)
            }
        }
    }
}

/// Whether a scene's file is glTF, by its name or by how it begins.
pub(super) fn is_one(path: &Path, bytes: &[u8]) -> bool {
    let named = path.extension().is_some_and(|extension| {
        ["gltf", "glb"].iter().any(|known| extension.eq_ignore_ascii_case(known))
    });
    named || bytes.starts_with(MAGIC)
}

/// Reads a scene; see [`Scene::from_gltf`].
pub(super) fn read(
    path: &Path,
    bytes: &[u8],
    file: &mut File,
    limits: &Limits,
) -> Result<(Scene, Report), SceneError> {
    let refused = |refusal| {
        let path = path.to_owned();
        match refusal {
            Refusal::Message(message) => SceneError::Gltf { path, message },
            Refusal::TooLarge(what, found, limit, flag) => {
                SceneError::TooLarge { path, what, found, limit, flag }
            }
        }
    };
    // The reader trusts some numbers. What it does not check is checked here, but the file is anyone's.
    let read = AssertUnwindSafe(|| scene(path, bytes, file, limits));
    let read = catch_unwind(read).unwrap_or_else(|_| {
        Err(Refusal::Message("the glTF reader panicked; export the file anew".to_owned()))
    });
    read.map_err(refused)
}

fn scene(
    path: &Path,
    bytes: &[u8],
    file: &mut File,
    limits: &Limits,
) -> Result<(Scene, Report), Refusal> {
    let ::gltf::Gltf { document, blob } = parsed(bytes)?;
    let name = file_name(path);
    let buffers = Buffers::load(&document, blob, file)?;
    let mut said = Said::new(&name);
    let mut meshes = Meshes::new(&buffers, Images::new(limits), limits);
    let shown = document.default_scene().or_else(|| document.scenes().next());
    let shown = shown.ok_or_else(|| "it has no scene; export one".to_owned())?;
    let (mut lamps, mut cameras) = (Vec::new(), Vec::new());
    for placed in meshes::nodes(&document, &shown)? {
        meshes.add(&placed, file, &mut said)?;
        lamps.extend(lights::Light::of(&placed, &mut said));
        cameras.extend(cameras::camera(&placed, &mut said));
    }
    lights::add(&lamps, &mut meshes, &mut said)?;
    let Meshes { positions, faces, materials, images, .. } = meshes;
    let pieces = Pieces::new(positions, faces, Tallies::default())
        .ok_or_else(|| "no triangle with an area in its scene".to_owned())?;
    if materials.iter().all(|m| m.emitted.is_black()) {
        let message = "nothing emits light; give a material an emission, or add a point light";
        return Err(Refusal::Message(message.to_owned()));
    }
    let mut notes = said.notes();
    notes.extend(pieces.notes(&name, &materials));
    let (scene, counts) = pieces.assemble(materials, images.images);
    Ok((scene, Report { counts, notes, cameras }))
}

/// The document and its binary part.
fn parsed(bytes: &[u8]) -> Result<::gltf::Gltf, String> {
    if bytes.starts_with(MAGIC) {
        let length = bytes.get(8..HEADER).and_then(|b| b.try_into().ok()).map(u32::from_le_bytes);
        if length.is_none_or(|length| (length as usize) < HEADER) {
            return Err("its header is cut short; copy the file anew".to_owned());
        }
    }
    let unknown = |why: &dyn std::fmt::Display| {
        let why = crate::format::text::inert(&why.to_string(), 300);
        format!("not glTF 2.0 as it is known here: {why}")
    };
    let ::gltf::Gltf { document, blob } =
        ::gltf::Gltf::from_slice_without_validation(bytes).map_err(|e| unknown(&e))?;
    let root = document.into_json();
    let version = root.asset.min_version.as_ref().unwrap_or(&root.asset.version);
    if !version.starts_with("2.") {
        return Err(unknown(&format_args!("its version is {version}")));
    }
    // The reader looks for these corners before it has checked that they exist.
    let primitives = root.meshes.iter().flat_map(|mesh| &mesh.primitives);
    let accessors = primitives.flat_map(|primitive| primitive.attributes.values());
    if let Some(beyond) = accessors.map(|a| a.value()).find(|a| *a >= root.accessors.len()) {
        return Err(unknown(&format_args!("there is no accessor {beyond}")));
    }
    let document = ::gltf::Document::from_json(root).map_err(|e| unknown(&e))?;
    Ok(::gltf::Gltf { document, blob })
}
