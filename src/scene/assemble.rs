//! Faces and materials to a scene, whatever kind of file they come from.

use super::error::SceneError;
use super::flat::{self, Face, Flat, Tallies};
use super::image::Image;
use super::merge::merge;
use super::report::{Counts, Note, NoteKind};
use super::{Fit, Material, Scene};
use crate::format::limits::Flag;
use glam::DVec3;
use std::path::Path;

/// A scene's polygons, fitted to the unit ball.
pub(super) struct Pieces {
    fit: Fit,
    points: Vec<DVec3>,
    tallies: Tallies,
    /// The polygons; their materials' numbers may still be changed.
    pub flats: Vec<Flat>,
}

impl Pieces {
    /// Fits and resolves faces; `None` when none has an area.
    pub fn new(positions: Vec<DVec3>, faces: Vec<Face>, mut tallies: Tallies) -> Option<Pieces> {
        let fit = flat::fit(&positions, &faces)?;
        let (points, welded) = flat::weld(&positions, &fit);
        drop(positions);
        let points: Vec<DVec3> = points.iter().map(|p| p.as_dvec3()).collect();
        let mut flats: Vec<Flat> = Vec::with_capacity(faces.len());
        for mut face in faces {
            face.corners.iter_mut().for_each(|c| *c = welded[*c as usize]);
            flat::resolve(&points, &face, &mut tallies, &mut flats);
        }
        (!flats.is_empty()).then_some(Pieces { fit, points, tallies, flats })
    }

    /// Notes on faces that were not taken as they stand.
    pub fn notes<'a>(
        &self,
        file: &'a str,
        materials: &[Material],
    ) -> impl Iterator<Item = Note> + use<'a> {
        use NoteKind::{NoArea, NoPlaces, NotPlanar, SelfIntersecting, SelfTouching};
        let Tallies { no_area, crossing, touching, not_planar, no_places } = self.tallies;
        // Where no image could be read, it is no matter where they were to lie.
        let textured = materials.iter().any(|m| m.texture.is_some());
        let all = [
            (no_area, NoArea, "no area, dropped"),
            (crossing, SelfIntersecting, "the outline crosses itself, dropped"),
            (touching, SelfTouching, "the outline touches itself, split into triangles"),
            (not_planar, NotPlanar, "not planar, split into triangles"),
            (
                no_places,
                NoPlaces,
                "textured, but without texture coordinates, taken as the image's mean colour",
            ),
        ];
        let said = move |kind| textured || kind != NoPlaces;
        all.into_iter()
            .filter(move |(_, kind, _)| said(*kind))
            .filter_map(move |(tally, kind, text)| tally.note(kind, file, text))
    }

    /// The scene of these polygons and materials.
    pub fn assemble(mut self, mut materials: Vec<Material>, images: Vec<Image>) -> (Scene, Counts) {
        let images = shown(&mut materials, images);
        for flat in &mut self.flats {
            if materials[flat.material as usize].texture.is_none() {
                flat.image = None;
            }
        }
        let mut seen = vec![false; self.points.len()];
        self.flats.iter().flat_map(|f| &f.corners).for_each(|c| seen[*c as usize] = true);
        let polygons = self.flats.len();
        let surfaces = merge(&self.points, self.flats, &materials);
        let scene = Scene { surfaces, materials, images, fit: self.fit };
        let with = |test: &dyn Fn(&Material) -> bool| {
            scene.surface_ids().filter(|id| test(scene.material_of(*id))).count()
        };
        let counts = Counts {
            vertices: seen.iter().filter(|s| **s).count(),
            polygons,
            surfaces: scene.surfaces.len(),
            emitters: with(&|m| !m.emitted.is_black()),
            mirrors: with(&|m| m.reflectance.is_mirror()),
        };
        (scene, counts)
    }
}

/// The images that any material shows, with their new numbers in the materials.
fn shown(materials: &mut [Material], images: Vec<Image>) -> Vec<Image> {
    let mut used = vec![false; images.len()];
    materials.iter().filter_map(|m| m.texture).for_each(|t| used[t.image as usize] = true);
    for texture in materials.iter_mut().filter_map(|m| m.texture.as_mut()) {
        texture.image = used[..texture.image as usize].iter().filter(|u| **u).count() as u32;
    }
    images.into_iter().zip(used).filter_map(|(image, used)| used.then_some(image)).collect()
}

/// A file's name as notes have it.
pub(super) fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// The refusal of more pixels than images may have.
pub(super) fn too_large(path: &Path, found: u64, limit: u64, flag: Flag) -> SceneError {
    let (path, what) = (path.to_owned(), "number of pixels of images");
    SceneError::TooLarge { path, what, found, limit, flag }
}
