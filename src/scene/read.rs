//! OBJ with MTL to a [`Scene`]: checked text through `tobj`, then polygons, fit, surfaces, materials.

use super::assemble::{Pieces, file_name, too_large};
use super::error::SceneError;
use super::flat::{Face, Flat, Tallies};
use super::image::{Images, Unread};
use super::material;
use super::report::{Note, NoteKind, Report};
use super::scan::{ObjScan, scan_obj};
use super::scan_mtl::{Definition, ImageLine, scan_mtl};
use super::{Material, Scene, gltf};
use crate::format::limits::{Limits, in_brackets};
use crate::format::text::{inert, shown};
use glam::{DVec2, DVec3};
use std::borrow::Cow;
use std::collections::HashMap;
use std::fs::File;
use std::io::{self, Read};
use std::panic::catch_unwind;
use std::path::Path;

/// The most material libraries a scene may name.
const MOST_LIBRARIES: usize = 1024;

/// The most characters of a library's name that messages show.
const LONGEST: usize = 200;

impl Scene {
    /// Reads a Wavefront OBJ, the MTL files it names, which are looked for beside it, and the images that
    /// these name, which are looked for beside them; or a glTF 2.0 file, `.gltf` or `.glb`, with its buffers and
    /// images.
    ///
    /// # Errors
    /// Anything that cannot be taken as it stands and has no harmless substitute, with file and line
    /// where there is one: see [`SceneError`]. What has a substitute is named in the [`Report`].
    pub fn open(path: &Path) -> Result<(Scene, Report), SceneError> {
        Scene::open_within(path, &Limits::default())
    }

    /// The same within other limits.
    ///
    /// # Errors
    /// As [`Scene::open`].
    pub fn open_within(path: &Path, limits: &Limits) -> Result<(Scene, Report), SceneError> {
        let (limit, flag) = limits.scene_bytes();
        let mut left = limit;
        let bytes = read_file(path, &mut left).map_err(|source| match source.kind() {
            io::ErrorKind::FileTooLarge => SceneError::TooLarge {
                path: path.to_owned(),
                what: "size in bytes",
                found: path.metadata().map_or(limit + 1, |m| m.len()),
                limit,
                flag,
            },
            _ => SceneError::Read { path: path.to_owned(), source },
        })?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let mut file = |name: &str| {
            read_file(&folder.join(name), &mut left).map_err(|e| match e.kind() {
                io::ErrorKind::FileTooLarge => {
                    let what = "with it, the scene's files exceed limit";
                    let flag = in_brackets(&flag);
                    io::Error::new(e.kind(), format!("{what} {limit} in bytes{flag}"))
                }
                _ => e,
            })
        };
        match gltf::is_one(path, &bytes) {
            true => gltf::read(path, &bytes, &mut file, limits),
            false => {
                let scan = scan_obj(path, &text_of(bytes), limits)?;
                read(path, scan, &mut file, limits)
            }
        }
    }

    /// Reads a scene from OBJ text; `file` gives the bytes of a material library by the name that
    /// the OBJ has for it, and of an image by the one that the library has. `path` stands in messages only.
    ///
    /// # Errors
    /// As [`Scene::open`].
    pub fn from_text(
        path: &Path,
        obj: &str,
        file: &mut dyn FnMut(&str) -> io::Result<Vec<u8>>,
    ) -> Result<(Scene, Report), SceneError> {
        let limits = Limits::default();
        read(path, scan_obj(path, obj, &limits)?, file, &limits)
    }

    /// Reads a scene from the bytes of a glTF 2.0 file, text or binary; `file` gives the bytes of a buffer
    /// or an image by its name. `path` stands in messages only.
    ///
    /// # Errors
    /// As [`Scene::open_within`].
    pub fn from_gltf(
        path: &Path,
        bytes: &[u8],
        file: &mut dyn FnMut(&str) -> io::Result<Vec<u8>>,
        limits: &Limits,
    ) -> Result<(Scene, Report), SceneError> {
        gltf::read(path, bytes, file, limits)
    }
}

/// Checked text to scene, within limits; see [`Scene::from_text`].
fn read(
    path: &Path,
    mut scan: ObjScan,
    file: &mut dyn FnMut(&str) -> io::Result<Vec<u8>>,
    limits: &Limits,
) -> Result<(Scene, Report), SceneError> {
    let (definitions, mtl) = libraries(path, &scan, file)?;
    let (positions, faces, read) = through_tobj(path, &scan, &definitions, &mtl)?;
    // A large scene's text is not held any longer than it is needed.
    (scan.clean, scan.face_lines, scan.corner_places) = Default::default();
    let empty = || SceneError::Empty { path: path.to_owned() };
    let tallies = Tallies { no_area: scan.too_few, ..Tallies::default() };
    let mut pieces = Pieces::new(positions, faces, tallies).ok_or_else(empty)?;
    let name = file_name(path);
    let mut images = Images::new(limits);
    let mut image =
        |line: &ImageLine| match images.take(&line.name, || file(&line.name).map(Cow::Owned)) {
            Err(Unread::TooLarge(found, limit, flag)) => Err(too_large(path, found, limit, flag)),
            Err(Unread::Damaged(why)) => Ok(Err(why)),
            Ok(found) => Ok(Ok(found)),
        };
    let (materials, mut notes) =
        materials(&name, &scan, (&definitions, &read), &mut image, &mut pieces.flats)?;
    notes.extend(pieces.notes(&name, &materials));
    if materials.iter().all(|m| m.emitted.is_black()) {
        let library = scan.libraries.first().map_or("its MTL file", |(name, _)| name);
        return Err(SceneError::NoEmitter { path: path.to_owned(), library: library.to_owned() });
    }
    let (scene, counts) = pieces.assemble(materials, images.images);
    Ok((scene, Report { counts, notes, cameras: Vec::new() }))
}

/// Reads a regular file whole, taking its size from what is left.
fn read_file(path: &Path, left: &mut u64) -> io::Result<Vec<u8>> {
    // Pipes and devices may never end.
    if !path.metadata()?.is_file() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "not a regular file"));
    }
    let mut bytes = Vec::new();
    File::open(path)?.take(*left + 1).read_to_end(&mut bytes)?;
    *left = left
        .checked_sub(bytes.len() as u64)
        .ok_or_else(|| io::Error::from(io::ErrorKind::FileTooLarge))?;
    Ok(bytes)
}

/// A file's text. What is not UTF-8 (comments in old encodings) is replaced.
fn text_of(bytes: Vec<u8>) -> String {
    let lossy = |e: std::string::FromUtf8Error| String::from_utf8_lossy(e.as_bytes()).into_owned();
    String::from_utf8(bytes).unwrap_or_else(lossy)
}

/// Reads and checks the material libraries: where each used material is defined, and clean MTL text.
fn libraries(
    path: &Path,
    scan: &ObjScan,
    file: &mut dyn FnMut(&str) -> io::Result<Vec<u8>>,
) -> Result<(Vec<Option<Definition>>, String), SceneError> {
    let numbers: HashMap<&str, usize> =
        scan.uses.iter().enumerate().map(|(i, (name, _))| (name.as_str(), i)).collect();
    let mut definitions = vec![None; scan.uses.len()];
    let mut clean = String::new();
    let folder = path.parent().unwrap_or(Path::new(""));
    if scan.libraries.len() > MOST_LIBRARIES {
        return Err(SceneError::TooLarge {
            path: path.to_owned(),
            what: "number of material libraries",
            found: scan.libraries.len() as u64,
            limit: MOST_LIBRARIES as u64,
            flag: None,
        });
    }
    for (rest, line) in &scan.libraries {
        let mut take = |name: &str| {
            // Paths written under Windows.
            let name = name.replace('\\', "/");
            file(&name).map(|bytes| (name, text_of(bytes)))
        };
        let missing = |source| SceneError::Library {
            path: path.to_owned(),
            line: *line,
            library: inert(rest, LONGEST),
            source,
        };
        // The rest of the line is one name with spaces, or else several names.
        let found = match take(rest) {
            Err(e) if e.kind() == io::ErrorKind::NotFound && rest.contains(' ') => rest
                .split_ascii_whitespace()
                .take(MOST_LIBRARIES)
                .map(take)
                .collect::<io::Result<Vec<_>>>()
                .map_err(|_| missing(e))?,
            other => vec![other.map_err(missing)?],
        };
        for (name, text) in found {
            let inner = name.rfind('/').map_or("", |slash| &name[..=slash]);
            scan_mtl(
                &folder.join(inert(&name, LONGEST)),
                inner,
                &text,
                &numbers,
                &mut definitions,
                &mut clean,
            )?;
        }
    }
    Ok((definitions, clean))
}

type Parsed = (Vec<DVec3>, Vec<Face>, HashMap<usize, tobj::Material>);

/// Puts the clean text through the OBJ reader. A face's material is its number in `scan.uses`, or
/// their count for faces without a defined one.
fn through_tobj(
    path: &Path,
    scan: &ObjScan,
    definitions: &[Option<Definition>],
    mtl: &str,
) -> Result<Parsed, SceneError> {
    let failed = |message: String| SceneError::Reader { path: path.to_owned(), message };
    let options =
        tobj::LoadOptions { ignore_points: true, ignore_lines: true, ..Default::default() };
    // The reader panics on some texts. None of ours should, but the text comes from outside.
    let read = catch_unwind(|| {
        tobj::load_obj_buf(&mut scan.clean.as_bytes(), &options, |_| {
            tobj::load_mtl_buf(&mut mtl.as_bytes())
        })
    });
    let (models, materials) =
        read.map_err(|_| failed("it panicked".to_owned()))?.map_err(|e| failed(e.to_string()))?;
    let materials = materials.map_err(|e| failed(e.to_string()))?;
    let numbers: Vec<usize> =
        materials.iter().map(|m| m.name.parse().unwrap_or(scan.uses.len())).collect();
    let mut positions: Vec<DVec3> = Vec::new();
    let mut faces: Vec<Face> = Vec::with_capacity(scan.face_lines.len());
    let mut lines = scan.face_lines.iter().copied();
    let mut places = &scan.corner_places[..];
    for tobj::Model { mesh, .. } in &models {
        let first = positions.len() as u32;
        positions.extend(mesh.positions.chunks_exact(3).map(DVec3::from_slice));
        let material = mesh.material_id.and_then(|m| numbers.get(m).copied());
        let material = material.unwrap_or(scan.uses.len()) as u32;
        let mut rest = &mesh.indices[..];
        let mut arities = mesh.face_arities.iter();
        while !rest.is_empty() {
            // No arities at all stand for triangles only.
            let arity = arities.next().map_or(3, |a| *a as usize);
            let (corners, after) = rest
                .split_at_checked(arity.max(1))
                .ok_or_else(|| failed("faces do not match their corners".to_owned()))?;
            rest = after;
            let line = lines.next().unwrap_or(0);
            let corners: Vec<u32> = corners.iter().map(|c| first + c).collect();
            let (own, after) = places.split_at_checked(corners.len()).unwrap_or((&[], &[]));
            places = after;
            let image = definitions.get(material as usize).and_then(|d| d.as_ref()?.image.as_ref());
            let places = image.map(|image| placed(scan, image, own));
            faces.push(Face { corners, places, material, line });
        }
    }
    Ok((positions, faces, numbers.into_iter().zip(materials).collect()))
}

/// The places of an image that a face's corners show; none where one of them has none.
fn placed(scan: &ObjScan, image: &ImageLine, corners: &[u32]) -> Vec<DVec2> {
    let of = |number: &u32| {
        let written = scan.places.get((*number as usize).checked_sub(1)?)?;
        let place = image.offset + image.scale * *written;
        // Texture coordinates begin at the bottom of the image, its rows at the top.
        place.is_finite().then_some(DVec2::new(place.x, 1.0 - place.y))
    };
    corners.iter().map(of).collect::<Option<_>>().unwrap_or_default()
}

/// Classifies the materials that polygons have, renumbers them, and notes what was not taken as written.
/// `image` gives an image's number and mean, or why there is none.
fn materials(
    file: &str,
    scan: &ObjScan,
    (definitions, read): (&[Option<Definition>], &HashMap<usize, tobj::Material>),
    image: &mut dyn FnMut(&ImageLine) -> Result<material::Found, SceneError>,
    flats: &mut [Flat],
) -> Result<(Vec<Material>, Vec<Note>), SceneError> {
    let mut used = vec![false; scan.uses.len() + 1];
    flats.iter().for_each(|f| used[f.material as usize] = true);
    let mut renumbered = vec![0u32; used.len()];
    let (mut out, mut notes) = (Vec::new(), Vec::new());
    for (number, (name, line)) in scan.uses.iter().enumerate() {
        if let (Some(definition), Some(material)) = (&definitions[number], read.get(&number)) {
            if used[number] {
                renumbered[number] = out.len() as u32;
                let image = definition.image.as_ref().map(&mut *image).transpose()?;
                let (material, said) = material::classify(name, material, definition, image);
                out.push(material);
                notes.extend(said);
            }
        } else {
            notes.push(Note {
                kind: NoteKind::UndefinedMaterial,
                subject: format!("material `{}`", shown(name)),
                file: file.to_owned(),
                line: *line,
                text: "no material library defines it, taken as diffuse 0.80 0.80 0.80".to_owned(),
            });
        }
    }
    if used[scan.uses.len()] {
        renumbered[scan.uses.len()] = out.len() as u32;
        out.push(material::unknown("(none)"));
    }
    notes.extend(scan.no_material.note(
        NoteKind::NoMaterial,
        file,
        "no `usemtl` before them, taken as diffuse 0.80 0.80 0.80",
    ));
    flats.iter_mut().for_each(|f| f.material = renumbered[f.material as usize]);
    Ok((out, notes))
}
