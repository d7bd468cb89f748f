//! MTL text, checked line by line and written out clean, for the materials that the OBJ uses.

use super::error::SceneError;
use super::scan::{keyword, logical_lines, number, words};
use crate::format::text::shown;
use glam::DVec2;
use std::collections::HashMap;
use std::fmt::Write;
use std::path::Path;

/// The largest colour value: sums of such radiances still fit f32.
const BRIGHTEST: f64 = 1e12;

/// Where a material is defined, and what the OBJ reader does not keep of it.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Definition {
    /// The library's name.
    pub file: String,
    /// The line of its `newmtl`.
    pub line: u32,
    /// The image of its diffuse colour, `map_Kd`.
    pub image: Option<ImageLine>,
    /// Keywords of the other textures it names.
    pub textures: Vec<String>,
    /// 1 - opacity, in [0, 1].
    pub transparency: f64,
    /// Metalness (`Pm`).
    pub metal: f64,
}

/// A `map_Kd` line: places of the image are `offset + scale * vt`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ImageLine {
    /// The image's file, from the OBJ's folder; may be empty.
    pub name: String,
    /// Its line in the library.
    pub line: u32,
    /// Factors of the texture coordinates (`-s`).
    pub scale: DVec2,
    /// What is added to them (`-o`).
    pub offset: DVec2,
    /// Whether the image does not repeat (`-clamp on`).
    pub clamp: bool,
    /// Options that are left out.
    pub left_out: Vec<String>,
}

/// Checks an MTL text; appends the used materials to `clean` under their numbers and records where
/// they are defined. The last definition of a name counts. Images are looked for in `folder`, which is
/// empty or ends in a slash.
///
/// # Errors
/// [`SceneError::Invalid`] with the line.
pub(super) fn scan_mtl(
    path: &Path,
    folder: &str,
    text: &str,
    numbers: &HashMap<&str, usize>,
    definitions: &mut [Option<Definition>],
    clean: &mut String,
) -> Result<(), SceneError> {
    let file = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
    let mut started = false;
    let mut current: Option<usize> = None;
    for (line, content) in logical_lines(text) {
        let invalid = |message| SceneError::Invalid { path: path.to_owned(), line, message };
        let (key, rest) = keyword(&content);
        if key == "newmtl" {
            if rest.is_empty() {
                return Err(invalid("`newmtl` without a name; write `newmtl NAME`".to_owned()));
            }
            started = true;
            current = numbers.get(rest).copied();
            if let Some(number) = current {
                // Writing to a string cannot fail.
                let _ = writeln!(clean, "newmtl {number}");
                definitions[number] =
                    Some(Definition { file: file.clone(), line, ..Definition::default() });
            }
            continue;
        }
        // Materials that are not used are checked all the same.
        let mut unused = Definition::default();
        let definition = current.and_then(|n| definitions[n].as_mut()).unwrap_or(&mut unused);
        if key == "map_Kd" {
            definition.image = Some(image_line(folder, rest, line));
        }
        let out = property(key, rest, definition).map_err(invalid)?;
        if !started && !out.is_empty() {
            return Err(invalid(format!("`{key}` before any `newmtl NAME` line")));
        }
        if current.is_some() {
            clean.push_str(&out);
        }
    }
    Ok(())
}

/// One property: the clean line for the reader, or a change of the definition, or neither.
fn property(key: &str, rest: &str, definition: &mut Definition) -> Result<String, String> {
    Ok(match key {
        "Kd" | "Ks" | "Ke" => {
            let [r, g, b] = colour(key, rest)?;
            format!("{key} {r:e} {g:e} {b:e}\n")
        }
        "Ns" => format!("Ns {:e}\n", single(key, rest, f64::MAX)?),
        "d" => {
            let rest = rest.strip_prefix("-halo").unwrap_or(rest);
            definition.transparency = 1.0 - single(key, rest, f64::MAX)?.min(1.0);
            String::new()
        }
        "Tr" => {
            definition.transparency = single(key, rest, f64::MAX)?.min(1.0);
            String::new()
        }
        "Pm" => {
            definition.metal = single(key, rest, f64::MAX)?;
            String::new()
        }
        "illum" => {
            let model = single(key, rest, 255.0)?;
            if model.fract() != 0.0 {
                return Err(format!("`illum {model}`: write a whole number from 0 to 10"));
            }
            format!("illum {model}\n")
        }
        "bump" | "norm" | "disp" | "decal" | "refl" => texture(key, definition),
        // Ambient terms do not exist here, so neither do their textures.
        _ if key.starts_with("map_") && !matches!(key, "map_Ka" | "map_Kd") => {
            texture(key, definition)
        }
        _ => String::new(),
    })
}

/// What a `map_Kd` line says: options, each with its values, and the rest is the file's name.
fn image_line(folder: &str, rest: &str, line: u32) -> ImageLine {
    let (scale, offset) = (DVec2::ONE, DVec2::ZERO);
    let mut image =
        ImageLine { name: String::new(), line, scale, offset, clamp: false, left_out: Vec::new() };
    let mut rest = rest;
    while rest.starts_with('-') {
        let (option, mut values) = keyword(rest);
        let mut take = |most: usize| {
            let mut taken = Vec::new();
            // Of several numbers the last may be left out.
            while taken.len() < most
                && let (word, after) = keyword(values)
                && let Ok(x) = number(word)
            {
                taken.push(x);
                values = after;
            }
            DVec2::new(
                taken.first().copied().unwrap_or(f64::NAN),
                taken.get(1).copied().unwrap_or(f64::NAN),
            )
        };
        let or = |given: DVec2, usual: DVec2| DVec2::select(given.is_nan_mask(), usual, given);
        match option {
            "-s" => image.scale = or(take(3), image.scale),
            "-o" => image.offset = or(take(3), image.offset),
            "-clamp" | "-blendu" | "-blendv" | "-cc" | "-imfchan" | "-type" => {
                let (value, after) = keyword(values);
                image.clamp |= option == "-clamp" && value == "on";
                values = after;
            }
            _ => {
                take(3);
            }
        }
        let known = matches!(option, "-s" | "-o" | "-clamp" | "-blendu" | "-blendv" | "-type");
        if !known && image.left_out.len() < 8 {
            image.left_out.push(shown(option));
        }
        rest = values;
    }
    let name = rest.replace('\\', "/");
    let absolute = name.starts_with('/') || name.get(1..2) == Some(":");
    image.name = if absolute || name.is_empty() { name } else { format!("{folder}{name}") };
    image
}

fn texture(key: &str, definition: &mut Definition) -> String {
    if !definition.textures.iter().any(|k| k == key) && definition.textures.len() < 16 {
        definition.textures.push(shown(key));
    }
    String::new()
}

/// Three numbers, or one for all three.
fn colour(key: &str, rest: &str) -> Result<[f64; 3], String> {
    let values = words(rest).take(4).map(|w| value(key, w, BRIGHTEST));
    match values.collect::<Result<Vec<f64>, String>>()?[..] {
        [grey] => Ok([grey; 3]),
        [r, g, b] => Ok([r, g, b]),
        ref other => {
            let n = other.len();
            Err(format!("`{key}` with {n} numbers; write `{key} R G B`"))
        }
    }
}

fn single(key: &str, rest: &str, most: f64) -> Result<f64, String> {
    let word = words(rest).next();
    value(key, word.ok_or_else(|| format!("`{key}` without a number; write `{key} X`"))?, most)
}

fn value(key: &str, word: &str, most: f64) -> Result<f64, String> {
    let x = number(word).map_err(|e| format!("`{key}`: {e}"))?;
    if x < 0.0 {
        return Err(format!("`{key}`: {word} is negative; light and reflectance are not"));
    }
    if x > most {
        return Err(format!("`{key}`: {word} is more than {most:e}"));
    }
    // Minus zero would be written as such.
    Ok(x + 0.0)
}
