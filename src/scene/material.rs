//! What an MTL material is taken for: ideal diffuse or ideal mirror, and notes on what is left out.

use super::report::{Note, NoteKind};
use super::scan_mtl::Definition;
use super::{Material, Reflectance, Texture};
use crate::format::text::shown;
use crate::radiance::Rgb;

/// Diffuse reflectance of faces that have no material, and of images that cannot be read.
const UNKNOWN: f32 = 0.8;

/// What faces without a defined material are made of: diffuse 0.8, no light.
pub(super) fn unknown(name: &str) -> Material {
    Material {
        name: name.to_owned(),
        emitted: Rgb::BLACK,
        reflectance: Reflectance::Diffuse(Rgb::splat(UNKNOWN)),
        texture: None,
    }
}

/// An image's number and mean, or why it cannot be read.
pub(super) type Found = Result<(u32, Rgb), String>;

/// Classifies a material; `image` is what was found of its `map_Kd`. Mirrors are those of `illum` 3 or 5 with `Ks` above zero, and those with
/// `Kd` zero, `Ks` above zero and `Ns` of 1000 or more; all others are diffuse.
pub(super) fn classify(
    name: &str,
    read: &tobj::Material,
    definition: &Definition,
    image: Option<Found>,
) -> (Material, Vec<Note>) {
    let rgb = |c: Option<[f64; 3]>| Rgb(c.unwrap_or_default().map(|x| x as f32));
    let (mut kd, ks, ke) = (rgb(read.diffuse), rgb(read.specular), rgb(read.emissive));
    let illum = read.illumination_model;
    let mirror = !ks.is_black()
        && (matches!(illum, Some(3 | 5))
            || kd.is_black() && read.shininess.is_some_and(|ns| ns >= 1000.0));
    let mut notes = Vec::new();
    let mut note_at = |line, kind, text| {
        let (subject, file) = (format!("material `{}`", shown(name)), definition.file.clone());
        notes.push(Note { kind, subject, file, line, text });
    };
    let line = definition.image.as_ref().map_or(definition.line, |image| image.line);
    let image = match image {
        Some(_) if mirror => {
            note_at(line, NoteKind::Texture, "`map_Kd` of a mirror, left out".to_owned());
            None
        }
        Some(Err(why)) => {
            kd = if kd.is_black() { Rgb::splat(UNKNOWN) } else { kd };
            let file = definition.image.as_ref().map_or("", |image| &image.name);
            let (file, taken) = (shown(file), three(kd));
            let text = format!("image `{file}` cannot be read: {why}; taken as diffuse {taken}");
            note_at(line, NoteKind::Image, text);
            None
        }
        Some(Ok(found)) => {
            if kd.is_black() {
                kd = Rgb::splat(1.0);
            }
            if read.diffuse == Some([0.0; 3]) {
                let text = "`Kd` is 0 and would make `map_Kd` black, taken as 1".to_owned();
                note_at(line, NoteKind::TextureOnly, text);
            }
            Some(found)
        }
        None => None,
    };
    for option in definition.image.iter().flat_map(|image| &image.left_out) {
        let text = format!("option `{option}` of `map_Kd` is not supported, left out");
        note_at(line, NoteKind::Texture, text);
    }
    let mut note = |kind, text| note_at(definition.line, kind, text);
    for key in &definition.textures {
        note(NoteKind::Texture, format!("`{key}` is not supported, left out"));
    }
    let factor = if mirror { ks } else { kd };
    let clamped = Rgb(factor.0.map(|c| c.min(1.0)));
    if clamped != factor {
        let text = format!("reflectance {} is above 1, taken as {}", three(factor), three(clamped));
        note(NoteKind::Clamped, text);
    }
    let as_what = format!("taken as {} {}", kind_name(mirror), three(clamped));
    if definition.transparency > 0.0 || matches!(illum, Some(4 | 6 | 7 | 9)) {
        note(NoteKind::Transparency, format!("transparency is not supported, {as_what}"));
    }
    if let Some(model @ (8 | 10..)) = illum {
        note(NoteKind::IlluminationModel, format!("`illum {model}` is not supported, {as_what}"));
    }
    if definition.metal > 0.0 && !mirror {
        let text = format!(
            "metalness is not supported, {as_what}; for an ideal mirror set `Ks` and `illum 3`"
        );
        note(NoteKind::Metal, text);
    }
    // Models 0 and 1 have no specular term, whatever `Ks` says.
    if !mirror && !ks.is_black() && !matches!(illum, Some(0 | 1)) {
        let text = format!(
            "glossy reflection `Ks` {} is not supported, {as_what}; for an ideal mirror set `illum 3`",
            three(ks)
        );
        note(NoteKind::Glossy, text);
    }
    if mirror && !kd.is_black() {
        let text = format!("the diffuse part `Kd` {} is left out, {as_what}", three(kd));
        note(NoteKind::MirrorDiffuse, text);
    }
    if !mirror && clamped.is_black() && read.diffuse.is_none() && ks.is_black() && ke.is_black() {
        note(NoteKind::Black, "neither `Kd` nor `Ks` nor `Ke`, taken as black".to_owned());
    }
    let (reflectance, texture) = match image {
        _ if mirror => (Reflectance::Mirror(clamped), None),
        None => (Reflectance::Diffuse(clamped), None),
        Some((image, mean)) => {
            let clamp = [definition.image.as_ref().is_some_and(|image| image.clamp); 2];
            let texture = Texture { image, tint: clamped, clamp };
            (Reflectance::Diffuse(clamped * mean), Some(texture))
        }
    };
    (Material { name: name.to_owned(), emitted: ke, reflectance, texture }, notes)
}

fn kind_name(mirror: bool) -> &'static str {
    if mirror { "mirror" } else { "diffuse" }
}

fn three(c: Rgb) -> String {
    format!("{:.2} {:.2} {:.2}", c.0[0], c.0[1], c.0[2])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(kd: f64, ks: f64, ns: f64, illum: u8) -> tobj::Material {
        tobj::Material {
            diffuse: Some([kd; 3]),
            specular: Some([ks; 3]),
            shininess: Some(ns),
            illumination_model: Some(illum),
            ..tobj::Material::default()
        }
    }

    #[test]
    fn mirrors_are_told_from_the_rest() {
        use NoteKind::*;
        let diffuse = |c| Reflectance::Diffuse(Rgb::splat(c));
        let mirror = |c| Reflectance::Mirror(Rgb::splat(c));
        // Kd, Ks, Ns, illum; what it is taken for; what is noted.
        type Row<'a> = (f64, f64, f64, u8, Reflectance, &'a [NoteKind]);
        let table: &[Row] = &[
            (0.5, 0.0, 0.0, 1, diffuse(0.5), &[]),
            (0.5, 0.0, 10.0, 2, diffuse(0.5), &[]),
            (0.0, 0.75, 0.0, 3, mirror(0.75), &[]),
            (0.0, 0.75, 0.0, 5, mirror(0.75), &[]),
            (0.25, 0.75, 0.0, 5, mirror(0.75), &[MirrorDiffuse]),
            (0.0, 0.75, 1000.0, 2, mirror(0.75), &[]),
            (0.0, 0.75, 999.0, 2, diffuse(0.0), &[Glossy]),
            (0.5, 0.75, 1e5, 2, diffuse(0.5), &[Glossy]),
            (0.5, 0.75, 1.0, 1, diffuse(0.5), &[]),
            (0.5, 0.0, 1.0, 3, diffuse(0.5), &[]),
            (0.0, 1.5, 1.0, 3, mirror(1.0), &[Clamped]),
            (2.0, 0.0, 1.0, 1, diffuse(1.0), &[Clamped]),
            (0.5, 0.0, 1.0, 7, diffuse(0.5), &[Transparency]),
            (0.5, 0.0, 1.0, 10, diffuse(0.5), &[IlluminationModel]),
        ];
        for &(kd, ks, ns, illum, expected, kinds) in table {
            let (m, notes) = classify("x", &read(kd, ks, ns, illum), &Definition::default(), None);
            assert_eq!(m.reflectance, expected, "Kd {kd} Ks {ks} Ns {ns} illum {illum}");
            let found: Vec<NoteKind> = notes.iter().map(|n| n.kind).collect();
            assert_eq!(found, kinds, "Kd {kd} Ks {ks} Ns {ns} illum {illum}");
        }
    }

    #[test]
    fn what_is_left_out_is_named() {
        let glass = Definition {
            file: "scene.mtl".to_owned(),
            line: 12,
            transparency: 0.5,
            ..Definition::default()
        };
        let (_, notes) = classify("glass", &read(0.8, 0.0, 0.0, 1), &glass, None);
        assert_eq!(
            notes[0].to_string(),
            "material `glass` (scene.mtl:12): transparency is not supported, taken as diffuse 0.80 \
             0.80 0.80"
        );
        let kinds = |m: &tobj::Material, d: &Definition| {
            classify("x", m, d, None).1.iter().map(|n| n.kind).collect::<Vec<_>>()
        };
        let none = tobj::Material::default();
        assert_eq!(kinds(&none, &Definition::default()), [NoteKind::Black]);
        let bumpy = Definition { textures: vec!["bump".to_owned()], ..Definition::default() };
        assert_eq!(kinds(&read(0.5, 0.0, 0.0, 1), &bumpy), [NoteKind::Texture]);
        let metal = Definition { metal: 1.0, ..Definition::default() };
        assert_eq!(kinds(&read(0.5, 0.0, 0.0, 1), &metal), [NoteKind::Metal]);
    }
}
