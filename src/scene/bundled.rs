//! The scenes that come with the program, so that trying it needs no file.

use super::Scene;
use super::camera::{Camera, CameraError};
use super::error::SceneError;
use super::report::Report;
use std::io;
use std::path::Path;

/// Names of the bundled scenes.
pub const NAMES: [&str; 3] = ["cornell", "cornell_mirror", "office"];

struct Files {
    obj: &'static str,
    mtl: &'static str,
    cameras: [&'static str; 2],
}

macro_rules! files {
    ($name:literal) => {
        Files {
            obj: include_str!(concat!("../../scenes/", $name, "/", $name, ".obj")),
            mtl: include_str!(concat!("../../scenes/", $name, "/", $name, ".mtl")),
            cameras: [
                include_str!(concat!("../../scenes/", $name, "/camera_a.json")),
                include_str!(concat!("../../scenes/", $name, "/camera_b.json")),
            ],
        }
    };
}

static FILES: [Files; 3] = [files!("cornell"), files!("cornell_mirror"), files!("office")];

fn files(name: &str) -> Option<&'static Files> {
    NAMES.iter().position(|n| *n == name).map(|i| &FILES[i])
}

impl Scene {
    /// One of the bundled scenes ([`NAMES`]).
    ///
    /// # Errors
    /// [`SceneError::UnknownBundled`] for any other name.
    pub fn bundled(name: &str) -> Result<(Scene, Report), SceneError> {
        let files = files(name).ok_or_else(|| unknown(name))?;
        let path = Path::new(name).with_extension("obj");
        Scene::from_text(&path, files.obj, &mut |file| {
            let own = file.strip_suffix(".mtl") == Some(name);
            own.then(|| files.mtl.into()).ok_or_else(|| io::ErrorKind::NotFound.into())
        })
    }
}

/// OBJ and MTL of a bundled scene.
///
/// # Errors
/// [`SceneError::UnknownBundled`] for a name that is not one.
pub fn text(name: &str) -> Result<(String, String), SceneError> {
    let files = files(name).ok_or_else(|| unknown(name))?;
    Ok((files.obj.to_owned(), files.mtl.to_owned()))
}

fn unknown(name: &str) -> SceneError {
    SceneError::UnknownBundled { name: name.to_owned(), known: NAMES.join(", ") }
}

/// The cameras of a bundled scene, the usual one first; none for any other name.
///
/// # Errors
/// [`CameraError`] if a bundled file were damaged; a test holds that none is.
pub fn cameras(name: &str) -> Result<Vec<Camera>, CameraError> {
    let texts = files(name).map_or(&[][..], |f| &f.cameras);
    texts.iter().map(|text| Camera::from_json(text)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_are_taken_as_written() {
        // Polygons, mirrors and emitters as counted when the scenes were made.
        let expected = [(17, 0, 1), (17, 5, 1), (800, 271, 4)];
        for (name, (polygons, mirrors, emitters)) in NAMES.iter().zip(expected) {
            let (scene, report) = Scene::bundled(name).unwrap();
            assert_eq!(report.notes, [], "{name}");
            let c = report.counts;
            assert_eq!(
                (c.polygons, c.mirrors, c.emitters),
                (polygons, mirrors, emitters),
                "{name}"
            );
            let cameras = cameras(name).unwrap();
            assert_eq!(cameras.len(), 2);
            assert!(cameras.iter().all(|c| c.view(&scene.fit).origin.is_finite()));
        }
        assert!(Scene::bundled("nowhere").unwrap_err().to_string().contains("cornell, "));
        assert_eq!(cameras("nowhere").unwrap(), []);
    }

    #[test]
    fn every_scene_folder_opens_without_a_note() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
        let mut seen = 0;
        for entry in std::fs::read_dir(folder).unwrap() {
            let folder = entry.unwrap().path();
            if !folder.is_dir() {
                continue;
            }
            let name = folder.file_name().unwrap().to_owned();
            let (_, report) = Scene::open(&folder.join(name).with_extension("obj")).unwrap();
            assert_eq!(report.notes, [], "{}", folder.display());
            Camera::open(&folder.join("camera_a.json")).unwrap();
            seen += 1;
        }
        assert_eq!(seen, 11);
    }
}
