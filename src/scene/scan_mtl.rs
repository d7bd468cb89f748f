//! MTL text, checked line by line and written out clean, for the materials that the OBJ uses.

use super::error::SceneError;
use super::scan::{keyword, logical_lines, number, words};
use crate::format::text::shown;
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
    /// Keywords of the textures it names.
    pub textures: Vec<String>,
    /// 1 - opacity, in [0, 1].
    pub transparency: f64,
    /// Metalness (`Pm`).
    pub metal: f64,
}

/// Checks an MTL text; appends the used materials to `clean` under their numbers and records where
/// they are defined. The last definition of a name counts.
///
/// # Errors
/// [`SceneError::Invalid`] with the line.
pub(super) fn scan_mtl(
    path: &Path,
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
        _ if key.starts_with("map_") && key != "map_Ka" => texture(key, definition),
        _ => String::new(),
    })
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
