//! What a glTF material is taken for: ideal diffuse or ideal mirror.

use super::said::{MATERIAL, Said};
use crate::format::limits;
use crate::radiance::Rgb;
use crate::scene::report::NoteKind;
use crate::scene::{Material, Reflectance, Texture};
use ::gltf::material::AlphaMode;
use ::gltf::texture::{Info, WrappingMode};
use glam::DVec2;

/// Metals smoother than this are ideal mirrors.
const SMOOTH: f32 = 0.05;

/// The largest radiance: sums of such still fit f32.
const BRIGHTEST: f32 = 1e12;

/// Where texture coordinates go in an image: `offset + x u + y v`.
#[derive(Clone, Copy)]
pub(super) struct Transform {
    offset: DVec2,
    x: DVec2,
    y: DVec2,
    /// Which of the texture coordinates.
    pub set: u32,
}

impl Transform {
    /// That of a material's image (KHR_texture_transform: scaled, turned counter-clockwise, moved).
    pub fn of(info: &Info) -> Transform {
        let Some(given) = info.texture_transform() else {
            let (offset, set) = (DVec2::ZERO, info.tex_coord());
            return Transform { offset, x: DVec2::X, y: DVec2::Y, set };
        };
        let vector = |v: [f32; 2]| DVec2::from(v.map(f64::from));
        let (sin, cos) = f64::from(given.rotation()).sin_cos();
        let scale = vector(given.scale());
        Transform {
            offset: vector(given.offset()),
            // Rows run downwards.
            x: DVec2::new(cos, -sin) * scale.x,
            y: DVec2::new(sin, cos) * scale.y,
            set: given.tex_coord().unwrap_or(info.tex_coord()),
        }
    }

    /// The place of texture coordinates in the image.
    pub fn place(&self, [u, v]: [f32; 2]) -> DVec2 {
        self.offset + self.x * f64::from(u) + self.y * f64::from(v)
    }
}

/// What has been found of a material's images.
#[derive(Default)]
pub(super) struct Found {
    /// Number and mean of the base colour's.
    pub base: Option<(u32, Rgb)>,
    /// Mean over what the emission's shows.
    pub emission: Option<Rgb>,
}

/// A material's name, or its number where it has none.
pub(super) fn name(material: &::gltf::Material) -> String {
    let name = match (material.name(), material.index()) {
        (Some(name), _) => name.to_owned(),
        (None, Some(number)) => format!("material {number}"),
        (None, None) => "(default)".to_owned(),
    };
    short(&name)
}

/// As much of a name as a scene keeps.
pub(super) fn short(name: &str) -> String {
    name[..name.floor_char_boundary(limits::NAME as usize)].to_owned()
}

/// Radiance that can be reckoned with.
pub(super) fn bounded(radiance: Rgb) -> Rgb {
    // What is no number is dark.
    Rgb(radiance.0.map(|c| if c > 0.0 { c.min(BRIGHTEST) } else { 0.0 }))
}

/// Whether it is an ideal mirror.
pub(super) fn is_mirror(material: &::gltf::Material) -> bool {
    let pbr = material.pbr_metallic_roughness();
    let even = pbr.metallic_roughness_texture().is_none();
    even && pbr.metallic_factor() == 1.0 && pbr.roughness_factor() < SMOOTH
}

/// Takes a material, with notes on what is left out.
pub(super) fn take(material: &::gltf::Material, found: &Found, said: &mut Said) -> Material {
    let name = name(material);
    let pbr = material.pbr_metallic_roughness();
    let [r, g, b, alpha] = pbr.base_color_factor();
    let tint = Rgb([r, g, b].map(|c| c.clamp(0.0, 1.0)));
    let mean = tint * found.base.map_or(Rgb::splat(1.0), |(_, mean)| mean);
    let strength = material.emissive_strength().unwrap_or(1.0);
    let emitted = Rgb(material.emissive_factor()) * strength;
    let emitted = bounded(emitted * found.emission.unwrap_or(Rgb::splat(1.0)));

    let mut note = |kind, text: &str| said.add(kind, MATERIAL, &name, text);
    let mirror = is_mirror(material);
    let opaque = material.alpha_mode() == AlphaMode::Opaque || alpha >= 1.0 && found.base.is_none();
    if !opaque || material.transmission().is_some() {
        note(NoteKind::Transparency, "transparency is not supported, taken as opaque");
    }
    if !mirror && pbr.metallic_factor() > 0.0 {
        let text = "rough or partial metals are not supported, taken as diffuse of their base colour; \
                    ideal mirrors have metalness 1 and roughness below 0.05";
        note(NoteKind::Metal, text);
    } else if !mirror && pbr.roughness_factor() < 1.0 {
        note(NoteKind::Glossy, "gloss is not supported, taken as diffuse");
    }
    if material.normal_texture().is_some() {
        note(NoteKind::Texture, "normal maps are not supported, left out");
    }
    if mirror && found.base.is_some() {
        note(NoteKind::Texture, "mirrors have no images, taken as of their image's mean");
    }
    if found.emission.is_some() {
        note(NoteKind::Texture, "lamps have no images, taken as of the mean over what they show");
    }
    let texture = found.base.filter(|_| !mirror).map(|(image, _)| {
        let sampler = pbr.base_color_texture().map(|info| info.texture().sampler());
        let wraps = sampler.map_or([WrappingMode::Repeat; 2], |s| [s.wrap_s(), s.wrap_t()]);
        if wraps.contains(&WrappingMode::MirroredRepeat) {
            note(NoteKind::Texture, "images that repeat mirrored, repeated as they are");
        }
        Texture { image, tint, clamp: wraps.map(|wrap| wrap == WrappingMode::ClampToEdge) }
    });
    let reflectance = if mirror { Reflectance::Mirror(mean) } else { Reflectance::Diffuse(mean) };
    Material { name, emitted, reflectance, texture }
}
