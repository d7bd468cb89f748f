//! The resolved scene as bytes: the scene section of a field and of a pack.
//!
//! In: a [`Scene`]; out: bytes, and back, with every promise of [`Scene`] checked again, since the
//! bytes may come from anywhere.

use super::{Fit, Image, Material, Placement, Polygon, Reflectance, Scene, Surface, Texture};
use crate::format::bytes::{Reader, Writer};
use crate::format::limits::{self, Limits};
use crate::format::{Fault, room_for};
use crate::ids::MaterialId;
use crate::radiance::Rgb;
use glam::{DVec3, Vec2, Vec3};

const MIRROR: u8 = 1;

/// The bytes of a scene.
pub fn to_bytes(scene: &Scene) -> Vec<u8> {
    let mut w = Writer::default();
    scene.fit.centre.to_array().into_iter().for_each(|v| w.f64(v));
    w.f64(scene.fit.radius);
    w.u32(scene.materials.len() as u32);
    for material in &scene.materials {
        w.text(&material.name);
        material.emitted.0.into_iter().for_each(|v| w.f32(v));
        w.u8(u8::from(material.reflectance.is_mirror()) * MIRROR);
        material.reflectance.factor().0.into_iter().for_each(|v| w.f32(v));
    }
    w.u32(scene.surfaces.len() as u32);
    for surface in &scene.surfaces {
        w.u32(surface.material.0);
        for vector in [surface.normal, surface.origin, surface.u, surface.v] {
            vector.to_array().into_iter().for_each(|v| w.f32(v));
        }
        surface.extent.to_array().into_iter().for_each(|v| w.f32(v));
        w.u8(surface.fineness);
        w.u32(surface.polygons.len() as u32);
        for polygon in &surface.polygons {
            w.u32(polygon.vertices.len() as u32);
            for vertex in &polygon.vertices {
                vertex.to_array().into_iter().for_each(|v| w.f32(v));
            }
        }
    }
    if !scene.images.is_empty() {
        write_images(scene, &mut w);
    }
    w.0
}

/// What only textured scenes have, behind everything else.
fn write_images(scene: &Scene, w: &mut Writer) {
    w.u32(scene.images.len() as u32);
    for image in &scene.images {
        w.u32(image.width);
        w.u32(image.height);
        w.0.extend_from_slice(image.pixels.as_flattened());
    }
    let textures = || scene.materials.iter().zip(0..).filter_map(|(m, k)| Some((k, m.texture?)));
    w.u32(textures().count() as u32);
    for (material, Texture { image, tint, clamp }) in textures() {
        w.u32(material);
        w.u32(image);
        w.u8(u8::from(clamp[0]) | u8::from(clamp[1]) << 1);
        tint.0.into_iter().for_each(|v| w.f32(v));
    }
    let placed =
        || scene.surfaces.iter().zip(0..).filter_map(|(s, k)| Some((k, s.placement.as_deref()?)));
    w.u32(placed().count() as u32);
    for (surface, Placement { origin, along_u, along_v }) in placed() {
        w.u32(surface);
        [origin, along_u, along_v].into_iter().for_each(|v| {
            w.f32(v.x);
            w.f32(v.y);
        });
    }
}

fn vec3(r: &mut Reader) -> Result<Vec3, Fault> {
    Ok(Vec3::new(r.f32()?, r.f32()?, r.f32()?))
}

fn require(holds: bool, what: &str) -> Result<(), Fault> {
    if holds { Ok(()) } else { Err(Fault::invalid(format!("scene: {what}"))) }
}

fn material(r: &mut Reader) -> Result<Material, Fault> {
    let name = r.text(limits::NAME)?;
    let emitted = Rgb(vec3(r)?.to_array());
    let mirror = r.u8()?;
    let factor = Rgb(vec3(r)?.to_array());
    require(mirror <= MIRROR, "a material is of no known kind")?;
    require(emitted.is_physical(), "emitted radiance is negative or not finite")?;
    require(factor.is_physical() && factor.max() <= 1.0, "a reflectance is not in [0, 1]")?;
    let reflectance = match mirror {
        MIRROR => Reflectance::Mirror(factor),
        _ => Reflectance::Diffuse(factor),
    };
    Ok(Material { name, emitted, reflectance, texture: None })
}

fn surface(r: &mut Reader, materials: usize) -> Result<Surface, Fault> {
    let material = MaterialId(r.u32()?);
    let [normal, origin, u, v] = [vec3(r)?, vec3(r)?, vec3(r)?, vec3(r)?];
    let extent = Vec2::new(r.f32()?, r.f32()?);
    require(material.index() < materials, "a surface's material does not exist")?;
    let unit = |a: Vec3| (a.length() - 1.0).abs() < 1e-3;
    let frame = unit(normal) && unit(u) && unit(v) && u.cross(v).dot(normal) > 0.99;
    require(frame && origin.length() < 3.0, "a surface's frame is not one")?;
    require(extent.min_element() >= 0.0 && extent.max_element() <= 3.0, "a surface's extent")?;
    let fineness = r.u8()?;
    require(fineness <= limits::FINENESS, "a surface's texels are finer than any")?;
    // Each takes a count and three corners at least.
    let count = r.count(4 + 3 * 12)?;
    let mut polygons = Vec::with_capacity(count);
    for _ in 0..count {
        let corners = r.count(12)?;
        require(corners >= 3, "a polygon has fewer than three corners")?;
        let mut vertices = Vec::with_capacity(corners);
        for _ in 0..corners {
            let vertex = vec3(r)?;
            require(vertex.length() <= 1.0, "a vertex lies outside the unit ball")?;
            vertices.push(vertex);
        }
        polygons.push(Polygon { vertices });
    }
    require(!polygons.is_empty(), "a surface has no polygon")?;
    Ok(Surface { material, normal, origin, u, v, extent, fineness, polygons, placement: None })
}

fn vec2(r: &mut Reader) -> Result<Vec2, Fault> {
    Ok(Vec2::new(r.f32()?, r.f32()?))
}

/// An image; its pixels are taken from those that the limits allow.
fn image(r: &mut Reader, pixels: &mut u64, limits: &Limits) -> Result<Image, Fault> {
    let (width, height) = (r.u32()?, r.u32()?);
    require(width > 0 && height > 0, "an image has no pixel")?;
    let count = u64::from(width) * u64::from(height);
    *pixels = limits.check_pixels(pixels.saturating_add(count))?;
    let bytes = r.take(usize::try_from(count.saturating_mul(3)).unwrap_or(usize::MAX))?;
    let mut pixels = room_for(count, || "image".into())?;
    pixels.extend_from_slice(bytes.as_chunks().0);
    Ok(Image { width, height, pixels })
}

/// Numbers that rise strictly and stay below `end`.
fn rising(r: &mut Reader, last: &mut Option<u32>, end: usize) -> Result<usize, Fault> {
    let number = r.u32()?;
    let rises = last.is_none_or(|last| number > last) && (number as usize) < end;
    require(rises, "textures are out of order")?;
    *last = Some(number);
    Ok(number as usize)
}

/// What only textured scenes have.
fn read_images(r: &mut Reader, scene: &mut Scene, limits: &Limits) -> Result<(), Fault> {
    let (images, mut pixels) = (r.count(8 + 3)?, 0);
    require(images > 0, "it has an empty list of images")?;
    scene.images = (0..images).map(|_| image(r, &mut pixels, limits)).collect::<Result<_, _>>()?;
    let mut last = None;
    for _ in 0..r.count(21)? {
        let material = rising(r, &mut last, scene.materials.len())?;
        let material = &mut scene.materials[material];
        let (image, clamp, tint) = (r.u32()?, r.u8()?, Rgb(vec3(r)?.to_array()));
        require((image as usize) < images, "a texture's image does not exist")?;
        require(clamp <= 3, "a texture ends in no known way")?;
        require(tint.is_physical() && tint.max() <= 1.0, "a reflectance is not in [0, 1]")?;
        require(!material.reflectance.is_mirror(), "a mirror has a texture")?;
        material.texture = Some(Texture { image, tint, clamp: [clamp & 1 != 0, clamp & 2 != 0] });
    }
    last = None;
    for _ in 0..r.count(28)? {
        let surface = rising(r, &mut last, scene.surfaces.len())?;
        let surface = &mut scene.surfaces[surface];
        let placement = Placement { origin: vec2(r)?, along_u: vec2(r)?, along_v: vec2(r)? };
        require(placement.is_sound(), "an image lies nowhere")?;
        let textured = scene.materials[surface.material.index()].texture.is_some();
        require(textured, "an image lies on a surface without one")?;
        surface.placement = Some(Box::new(placement));
    }
    Ok(())
}

/// The scene that bytes hold.
///
/// # Errors
/// The first number that breaks a promise of [`Scene`]; bytes that end early or too late.
pub fn from_bytes(bytes: &[u8], limits: &Limits) -> Result<Scene, Fault> {
    let mut r = Reader::new(bytes);
    let centre = DVec3::new(r.f64()?, r.f64()?, r.f64()?);
    let radius = r.f64()?;
    require(centre.is_finite() && radius.is_finite() && radius > 0.0, "its fit is not one")?;
    let count = r.count(29)?;
    let materials = (0..count).map(|_| material(&mut r)).collect::<Result<Vec<_>, _>>()?;
    // Each takes its frame, its extent and one polygon at least.
    let count = r.count(4 + 14 * 4 + 1 + 4 + 40)?;
    limits.check_surfaces(count as u32)?;
    let surfaces =
        (0..count).map(|_| surface(&mut r, materials.len())).collect::<Result<Vec<_>, _>>()?;
    let fit = Fit { centre, radius };
    let mut scene = Scene { surfaces, materials, images: Vec::new(), fit };
    if r.left() > 0 {
        read_images(&mut r, &mut scene, limits)?;
    }
    r.end()?;
    Ok(scene)
}
