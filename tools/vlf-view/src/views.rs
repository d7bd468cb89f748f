//! Saved views: a camera for each digit, kept in a small JSON file next to what is looked at
//! (`room.vlf` has `room.views.json`), or in the user's configuration where that folder cannot be
//! written. Each is a camera as `vlf render --camera` reads it.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use vlf::Camera;

/// Most bytes of a file of views.
const MOST_BYTES: u64 = 1 << 20;

/// The views that are saved.
#[derive(Debug, Default)]
pub struct Views {
    /// Where they may be, best first.
    places: Vec<PathBuf>,
    by_digit: BTreeMap<u8, Camera>,
    /// Why they are not to be replaced.
    unreadable: Option<String>,
}

impl Views {
    /// Reads what was saved for a field or pack.
    pub fn of(path: &Path) -> Views {
        let mut places = vec![path.with_extension("views.json")];
        places.extend(configuration().map(|folder| folder.join(name_in_configuration(path))));
        Views::at(places)
    }

    /// Reads the first file of several that is there.
    fn at(places: Vec<PathBuf>) -> Views {
        let mut views = Views { places, ..Views::default() };
        for place in &views.places {
            match read(place) {
                Ok(None) => continue,
                Ok(Some(by_digit)) => views.by_digit = by_digit,
                Err(why) => views.unreadable = Some(format!("{}: {why}", place.display())),
            }
            break;
        }
        views
    }

    /// What is wrong with the file, if anything is.
    pub fn trouble(&self) -> Option<&str> {
        self.unreadable.as_deref()
    }

    /// The view of a digit.
    pub fn get(&self, digit: u8) -> Option<&Camera> {
        self.by_digit.get(&digit)
    }

    /// Saves a view; returns where.
    ///
    /// # Errors
    /// When it can be written nowhere, or would replace a file that could not be read. The view is
    /// remembered all the same.
    pub fn save(&mut self, digit: u8, camera: Camera) -> io::Result<&Path> {
        self.by_digit.insert(digit, camera);
        if let Some(why) = &self.unreadable {
            return Err(io::Error::other(why.clone()));
        }
        let text = serde_json::to_string_pretty(&self.by_digit)?;
        let mut failure = io::Error::other("there is no place for saved views");
        for place in &self.places {
            match write(place, &text) {
                Ok(()) => return Ok(place),
                Err(e) => failure = e,
            }
        }
        Err(failure)
    }
}

fn read(place: &Path) -> Result<Option<BTreeMap<u8, Camera>>, String> {
    let file = match File::open(place) {
        Ok(file) => file,
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(e.to_string()),
    };
    let mut text = String::new();
    file.take(MOST_BYTES).read_to_string(&mut text).map_err(|e| e.to_string())?;
    let by_digit: BTreeMap<u8, Camera> =
        serde_json::from_str(&text).map_err(|e| format!("no saved views: {e}"))?;
    by_digit.values().try_for_each(Camera::check).map_err(|e| e.to_string())?;
    Ok(Some(by_digit))
}

fn write(place: &Path, text: &str) -> io::Result<()> {
    let folder = place.parent().filter(|p| *p != Path::new("")).unwrap_or(Path::new("."));
    fs::create_dir_all(folder)?;
    let mut file = tempfile::Builder::new().prefix(".vlf-").tempfile_in(folder)?;
    file.write_all(text.as_bytes())?;
    file.persist(place).map_err(|e| e.error)?;
    Ok(())
}

/// The user's folder for configuration.
fn configuration() -> Option<PathBuf> {
    let variable = |name| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
    variable("XDG_CONFIG_HOME")
        .or_else(|| variable("APPDATA"))
        .or_else(|| std::env::home_dir().map(|home| home.join(".config")))
        .map(|folder| folder.join("vlf-view"))
}

/// A name that says where the field or pack is, so that two of the same name have their own views.
fn name_in_configuration(path: &Path) -> String {
    let whole = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let plain = |c: char| if c.is_alphanumeric() || ".-_".contains(c) { c } else { '%' };
    let name: Vec<char> = whole.to_string_lossy().chars().map(plain).collect();
    // File systems end names at 255 bytes; the end of a path is what tells most.
    let end: String = name[name.len().saturating_sub(60)..].iter().collect();
    end + ".views.json"
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn camera(x: f64) -> Camera {
        let eye = DVec3::new(x, 0.5, 1.0);
        Camera { eye, target: DVec3::ZERO, up: DVec3::Y, vfov_deg: 60.0, width: 8, height: 6 }
    }

    #[test]
    fn views_come_back_and_a_view_is_a_camera_file() {
        let folder = tempfile::tempdir().unwrap();
        let pack = folder.path().join("room.vlf");
        let mut views = Views::of(&pack);
        assert!(views.get(3).is_none());
        let place = views.save(3, camera(2.0)).unwrap().to_owned();
        views.save(0, camera(3.0)).unwrap();
        assert_eq!(place, folder.path().join("room.views.json"));
        let again = Views::of(&pack);
        assert_eq!(again.get(3), Some(&camera(2.0)));
        assert_eq!(again.get(0), Some(&camera(3.0)));
        let file: serde_json::Value =
            serde_json::from_str(&fs::read_to_string(place).unwrap()).unwrap();
        assert_eq!(Camera::from_json(&file["3"].to_string()).unwrap(), camera(2.0));
    }

    #[test]
    fn where_the_first_place_cannot_be_written_the_second_is_taken() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a file");
        fs::write(&file, "").unwrap();
        let places = vec![file.join("a.views.json"), folder.path().join("c/a.views.json")];
        let mut views = Views::at(vec![places[1].clone()]);
        views.places = places.clone();
        assert_eq!(views.save(1, camera(1.0)).unwrap(), places[1]);
        assert_eq!(Views::at(vec![places[1].clone()]).get(1), Some(&camera(1.0)));
    }

    #[test]
    fn a_file_that_cannot_be_read_is_not_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let pack = folder.path().join("room.vlf");
        let place = folder.path().join("room.views.json");
        for odd in ["", "[]", "{\"1\":{}}", "{\"1\":7}", "{\"x\":null}"] {
            fs::write(&place, odd).unwrap();
            let mut views = Views::of(&pack);
            assert!(views.trouble().is_some(), "{odd}");
            assert!(views.save(1, camera(1.0)).is_err());
            assert_eq!(views.get(1), Some(&camera(1.0)));
            assert_eq!(fs::read_to_string(&place).unwrap(), odd);
        }
    }
}
