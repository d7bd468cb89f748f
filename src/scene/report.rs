//! What was made of a scene's files: counts, and a note for everything not taken as it was written.

use super::camera::Camera;
use serde::Serialize;
use std::fmt;

/// Counts of a resolved scene and what the reader of its files ought to know.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Report {
    /// How much there is.
    pub counts: Counts,
    /// What was not taken as it was written; materials first, in the order of their definition.
    pub notes: Vec<Note>,
    /// The views that its file has.
    pub cameras: Vec<NamedCamera>,
}

/// A view that a scene's file has.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NamedCamera {
    /// Its name; may be empty.
    pub name: String,
    /// The camera.
    #[serde(flatten)]
    pub camera: Camera,
}

/// How much of everything a resolved scene has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    /// Distinct corner positions.
    pub vertices: usize,
    /// Polygons.
    pub polygons: usize,
    /// Surfaces.
    pub surfaces: usize,
    /// Surfaces that emit.
    pub emitters: usize,
    /// Surfaces that are mirrors.
    pub mirrors: usize,
}

/// What kind of thing was not taken as written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum NoteKind {
    /// Transparency: taken as opaque.
    Transparency,
    /// A glossy lobe: left out.
    Glossy,
    /// An illumination model other than diffuse and ideal mirror.
    IlluminationModel,
    /// Metalness: taken as diffuse.
    Metal,
    /// Colours of vertices: left out.
    VertexColours,
    /// Skins and morph targets: taken as they are at rest.
    Pose,
    /// Points and lines: left out.
    NoFaces,
    /// A light without extent: taken as a small lamp, or left out.
    Light,
    /// A camera that takes no pictures here: left out.
    Camera,
    /// The diffuse part of a mirror: left out.
    MirrorDiffuse,
    /// A texture, or an option of one: left out.
    Texture,
    /// A texture whose factor is 0: taken as 1.
    TextureOnly,
    /// An image that cannot be read: one colour stands for it.
    Image,
    /// Textured faces without texture coordinates: the image's mean.
    NoPlaces,
    /// Reflectance above 1: clamped.
    Clamped,
    /// A material that neither reflects nor emits.
    Black,
    /// Faces before any `usemtl`: diffuse 0.8.
    NoMaterial,
    /// Faces of a material that no library defines: diffuse 0.8.
    UndefinedMaterial,
    /// Faces without area: dropped.
    NoArea,
    /// Faces whose outline crosses itself: dropped.
    SelfIntersecting,
    /// Faces that touch themselves, as keyholes do: split into triangles.
    SelfTouching,
    /// Faces that are not planar: split into triangles.
    NotPlanar,
}

/// One thing that was not taken as it was written.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Note {
    /// What kind of thing.
    pub kind: NoteKind,
    /// What it is about: a material by name, or how many faces.
    pub subject: String,
    /// The file it stands in.
    pub file: String,
    /// The line it stands in, from 1; for several faces the first one's. 0 in files without lines.
    pub line: u32,
    /// What was made of it.
    pub text: String,
}

impl fmt::Display for Note {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Note { subject, file, line, text, .. } = self;
        match line {
            0 => write!(f, "{subject} ({file}): {text}"),
            line => write!(f, "{subject} ({file}:{line}): {text}"),
        }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let c = self.counts;
        writeln!(
            f,
            "{} vertices, {} polygons, {} surfaces, {} emitters, {} mirrors",
            c.vertices, c.polygons, c.surfaces, c.emitters, c.mirrors
        )?;
        self.notes.iter().try_for_each(|note| writeln!(f, "{note}"))
    }
}

/// Faces of one kind, counted, so that a million of them make one note.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tally {
    count: u64,
    first: u32,
}

impl Tally {
    /// One more, at a line.
    pub fn add(&mut self, line: u32) {
        if self.count == 0 || line < self.first {
            self.first = line;
        }
        self.count += 1;
    }

    /// The note on all of them, if there are any.
    pub fn note(self, kind: NoteKind, file: &str, text: &str) -> Option<Note> {
        let subject = match self.count {
            0 => return None,
            1 => "1 face".to_owned(),
            n if self.first == 0 => format!("{n} faces"),
            n => format!("{n} faces, the first"),
        };
        Some(Note { kind, subject, file: file.to_owned(), line: self.first, text: text.to_owned() })
    }
}
