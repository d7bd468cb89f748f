//! OBJ text, checked line by line and written out clean for the OBJ reader.
//!
//! The reader (`tobj`) gives no line numbers, takes NaN in silence and panics on some lines. So all
//! that can be wrong is found here, and what goes on holds only positions, absolute position indices
//! and materials by number. O(bytes).

use super::error::SceneError;
use super::report::Tally;
use crate::format::limits::{self, Limits};
use crate::format::text::shown;
use glam::DVec2;
use std::borrow::Cow;
use std::collections::{HashMap, HashSet};
use std::fmt::Write;
use std::path::Path;

/// The most corners a face may have: some checks of a face are quadratic in them.
const MOST_CORNERS: usize = 4096;

/// The largest coordinate in the scene's own units; its square is still far from overflow.
const FARTHEST: f64 = 1e30;

/// The largest texture coordinate: beyond it an image's pixels cannot be told apart.
const FARTHEST_IN_IMAGE: f64 = 1e6;

/// A checked OBJ.
#[derive(Debug, Default)]
pub(super) struct ObjScan {
    /// The same scene as OBJ text with materials by number, and a first line `mtllib m`.
    pub clean: String,
    /// The line of each face in `clean`, in order.
    pub face_lines: Vec<u32>,
    /// Texture coordinates as written; NaN where they are no numbers to reckon with.
    pub places: Vec<DVec2>,
    /// For each corner of each face in `clean` the number of its texture coordinates, from 1, or 0.
    pub corner_places: Vec<u32>,
    /// The `mtllib` lines: what follows the keyword, and the line.
    pub libraries: Vec<(String, u32)>,
    /// The materials used, by number: name and line of the first `usemtl`.
    pub uses: Vec<(String, u32)>,
    /// Faces of fewer than three corners, which do not stand in `clean`.
    pub too_few: Tally,
    /// Faces before any `usemtl`.
    pub no_material: Tally,
}

/// The lines of a text with `\` continuations joined, each with the number of its first line.
pub(super) fn logical_lines(text: &str) -> impl Iterator<Item = (u32, Cow<'_, str>)> {
    let mut lines = (1u32..).zip(text.trim_start_matches('\u{feff}').lines());
    std::iter::from_fn(move || {
        let (number, first) = lines.next()?;
        let mut line = Cow::Borrowed(first.trim());
        while let Some(stem) = line.strip_suffix('\\')
            && !line.starts_with('#')
        {
            let mut joined = stem.to_owned();
            // A backslash on the last line continues into nothing.
            let next = lines.next().map_or("", |(_, next)| next.trim());
            joined.push(' ');
            joined.push_str(next);
            line = Cow::Owned(joined);
        }
        Some((number, line))
    })
}

/// A line's keyword and what follows it.
pub(super) fn keyword(line: &str) -> (&str, &str) {
    let end = line.find(|c: char| c.is_ascii_whitespace()).unwrap_or(line.len());
    (&line[..end], line[end..].trim())
}

/// The words up to a comment.
pub(super) fn words(rest: &str) -> impl Iterator<Item = &str> {
    rest.split_ascii_whitespace().take_while(|w| !w.starts_with('#'))
}

/// A finite number, or what is wrong with the word.
pub(super) fn number(word: &str) -> Result<f64, String> {
    match word.parse::<f64>() {
        Ok(x) if x.is_finite() => Ok(x),
        Ok(_) => Err(format!("`{word}` is not finite; every number must be")),
        Err(_) => Err(format!("`{}` is not a number", shown(word))),
    }
}

/// Checks an OBJ text.
///
/// # Errors
/// [`SceneError::Invalid`] with the line, [`SceneError::TooLarge`] for too many polygons.
pub(super) fn scan_obj(path: &Path, text: &str, limits: &Limits) -> Result<ObjScan, SceneError> {
    let (limit, flag) = limits.polygons();
    let mut scan = ObjScan { clean: "mtllib m\n".to_owned(), ..ObjScan::default() };
    let mut numbers: HashMap<String, usize> = HashMap::new();
    let mut libraries: HashSet<String> = HashSet::new();
    // Positions, texture coordinates and normals so far.
    let mut have = [0usize; 3];
    let (mut corners, mut corner_places) = (Vec::new(), Vec::new());
    for (line, content) in logical_lines(text) {
        let invalid = |message| SceneError::Invalid { path: path.to_owned(), line, message };
        let (key, rest) = keyword(&content);
        match key {
            "v" => {
                vertex(rest, &mut scan.clean).map_err(invalid)?;
                have[0] += 1;
            }
            "vt" => {
                scan.places.push(place(rest));
                have[1] += 1;
            }
            "vn" => have[2] += 1,
            "f" | "fo" => {
                face(rest, have, (&mut corners, &mut corner_places)).map_err(invalid)?;
                if corners.len() < 3 {
                    scan.too_few.add(line);
                    continue;
                }
                if scan.face_lines.len() as u64 == limit {
                    let (path, what) = (path.to_owned(), "number of polygons");
                    return Err(SceneError::TooLarge { path, what, found: limit + 1, limit, flag });
                }
                if scan.uses.is_empty() {
                    scan.no_material.add(line);
                }
                scan.face_lines.push(line);
                scan.corner_places.extend(&corner_places);
                scan.clean.push('f');
                for corner in &corners {
                    // Writing to a string cannot fail.
                    let _ = write!(scan.clean, " {corner}");
                }
                scan.clean.push('\n');
            }
            "usemtl" if rest.len() > limits::NAME as usize => {
                let (name, most) = (shown(rest), limits::NAME);
                let message = format!("the name `{name}` has more than {most} bytes; shorten it");
                return Err(invalid(message));
            }
            "usemtl" => {
                let known = numbers.entry(rest.to_owned()).or_insert(scan.uses.len());
                if *known == scan.uses.len() {
                    scan.uses.push((rest.to_owned(), line));
                }
                let _ = writeln!(scan.clean, "usemtl {known}");
            }
            "mtllib" if rest.is_empty() => {
                let message = "`mtllib` names no file; write `mtllib NAME.mtl`".to_owned();
                return Err(invalid(message));
            }
            "mtllib" if !libraries.insert(rest.to_owned()) => {}
            "mtllib" => scan.libraries.push((rest.to_owned(), line)),
            // Groups, smoothing, curves, lines and points: nothing that is lit.
            _ => {}
        }
    }
    Ok(scan)
}

/// Checks a `v` line and writes it out: three coordinates, and a weight if there are four numbers.
fn vertex(rest: &str, clean: &mut String) -> Result<(), String> {
    let mut values = [0.0f64; 8];
    let mut count = 0;
    for word in words(rest) {
        if count == 7 {
            return Err("more than 7 numbers; write `v X Y Z`".to_owned());
        }
        values[count] = number(word)?;
        count += 1;
    }
    if !matches!(count, 3 | 4 | 6 | 7) {
        return Err(format!("a vertex of {count} numbers; write `v X Y Z`"));
    }
    let weight = if count == 4 { values[3] } else { 1.0 };
    if weight == 0.0 {
        return Err("weight 0 puts the vertex at infinity; leave the fourth number out".to_owned());
    }
    clean.push('v');
    for x in &values[..3] {
        let x = x / weight;
        if x.is_nan() || x.abs() > FARTHEST {
            return Err(format!("coordinate {x:e} is beyond {FARTHEST:e}; scale the scene down"));
        }
        // Exponents keep the text short whatever the number.
        let _ = write!(clean, " {x:e}");
    }
    clean.push('\n');
    Ok(())
}

/// The numbers of a `vt` line. Nothing depends on those that are none but where an image lies.
fn place(rest: &str) -> DVec2 {
    let mut values = words(rest).map(|w| number(w).unwrap_or(f64::NAN));
    let place = DVec2::new(values.next().unwrap_or(f64::NAN), values.next().unwrap_or(0.0));
    let inside = place.abs().max_element() <= FARTHEST_IN_IMAGE;
    if inside && !place.is_nan() { place } else { DVec2::NAN }
}

/// Checks an `f` line and puts its corners' indices, from 1, into `corners`, and those of their texture
/// coordinates, 0 for none, into `places`.
fn face(
    rest: &str,
    have: [usize; 3],
    (corners, places): (&mut Vec<usize>, &mut Vec<u32>),
) -> Result<(), String> {
    const WHAT: [&str; 3] = ["vertices", "texture coordinates", "normals"];
    corners.clear();
    places.clear();
    for word in words(rest) {
        let (mut position, mut place) = (None, 0);
        for (slot, part) in word.split('/').enumerate() {
            if slot > 2 {
                return Err(format!(
                    "`{}` has more than three indices; write `V/T/N`",
                    shown(word)
                ));
            }
            if part.is_empty() && slot > 0 {
                continue;
            }
            let index: i64 = part.parse().map_err(|_| {
                format!("`{}` is not a corner; write `V`, `V/T`, `V//N` or `V/T/N`", shown(word))
            })?;
            let count = have[slot] as i64;
            // Negative indices count back from the latest; 0 is none.
            let absolute =
                if index < 0 { index.checked_add(count).map_or(0, |i| i + 1) } else { index };
            if absolute < 1 || absolute > count {
                let what = WHAT[slot];
                return Err(format!(
                    "index {index} is out of range: {count} {what} are defined so far; indices \
                     start at 1"
                ));
            }
            match slot {
                0 => position = Some(absolute as usize),
                1 => place = absolute as u32,
                _ => {}
            }
        }
        corners.extend(position);
        places.extend(position.map(|_| place));
        if corners.len() > MOST_CORNERS {
            return Err(format!("a face of more than {MOST_CORNERS} corners; split it"));
        }
    }
    if corners.is_empty() {
        return Err("a face without corners; write `f V V V`".to_owned());
    }
    Ok(())
}
