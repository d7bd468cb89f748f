//! Screenshots: a picture under the next free number, as PNG and as EXR. Nothing is replaced.

use crate::paint::Frame;
use std::fs::{self, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};
use vlf::look::image::{ImageError, write_exr, write_png};

/// The highest number.
const MOST: u32 = 9999;

/// Writes what a frame shows to `STEM-0001.png` and its radiance to `STEM-0001.exr` in a folder, or to
/// the next number that is free. Returns the name of the PNG.
///
/// # Errors
/// When they cannot be written.
pub fn save(folder: &Path, stem: &str, frame: &Frame) -> Result<PathBuf, ImageError> {
    let [png, exr] =
        free(folder, stem).map_err(|source| ImageError::Io { path: folder.join(stem), source })?;
    let written =
        write_png(&png, &frame.bitmap).and_then(|()| write_exr(&exr, &frame.taken.picture));
    if written.is_err() {
        // Empty files would be taken for pictures; there is nothing more to be done if they stay.
        _ = [&png, &exr].map(fs::remove_file);
    }
    written.map(|()| png)
}

/// Two names that nobody had, and now files are there that nobody else takes.
fn free(folder: &Path, stem: &str) -> io::Result<[PathBuf; 2]> {
    for number in 1..=MOST {
        let names = ["png", "exr"].map(|kind| folder.join(format!("{stem}-{number:04}.{kind}")));
        let mut taken = Vec::new();
        for name in &names {
            match OpenOptions::new().write(true).create_new(true).open(name) {
                Ok(_) => taken.push(name),
                Err(e) => {
                    taken.iter().try_for_each(fs::remove_file)?;
                    match e.kind() {
                        io::ErrorKind::AlreadyExists => break,
                        _ => return Err(e),
                    }
                }
            }
        }
        if taken.len() == names.len() {
            return Ok(names);
        }
    }
    Err(io::Error::other("all numbers are taken"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_that_are_taken_are_passed_over_and_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("a-0001.png"), "mine").unwrap();
        fs::write(folder.path().join("a-0002.exr"), "mine").unwrap();
        let names = free(folder.path(), "a").unwrap();
        assert_eq!(names[1], folder.path().join("a-0003.exr"));
        assert_eq!(free(folder.path(), "a").unwrap()[0], folder.path().join("a-0004.png"));
        assert!(!folder.path().join("a-0002.png").exists());
        assert_eq!(fs::read_to_string(folder.path().join("a-0001.png")).unwrap(), "mine");
        assert!(free(&folder.path().join("none"), "a").is_err());
    }
}
