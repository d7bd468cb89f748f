//! Small files written by hand: each feature once, and what is refused.

use crate::format::limits::Limits;
use crate::ids::SurfaceId;
use crate::radiance::Rgb;
use crate::scene::{NoteKind, Reflectance, Report, Scene, SceneError, stored};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::{DVec3, Vec2, Vec3};
use proptest::prelude::*;
use std::io;
use std::path::Path;

/// A unit square in the plane z = 0, its texture coordinates, and the indices of its two triangles: 32, 48
/// and 6 bytes behind each other, then the same triangles as strip and fan.
fn square() -> Vec<u8> {
    let corners = [[0.0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];
    let places = [[0.0f32, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]];
    let mut bytes: Vec<u8> = corners.as_flattened().iter().flat_map(|c| c.to_le_bytes()).collect();
    bytes.extend(places.as_flattened().iter().flat_map(|c| c.to_le_bytes()));
    for indices in [&[0u16, 1, 2, 0, 2, 3][..], &[1, 2, 0, 3], &[0, 1, 2, 3]] {
        bytes.extend(indices.iter().flat_map(|i| i.to_le_bytes()));
    }
    bytes
}

/// A PNG of one row of two pixels, black and white.
fn png() -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, 2, 1);
    encoder.set_color(png::ColorType::Grayscale);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(&[0, 255]).unwrap();
    writer.finish().unwrap();
    bytes
}

/// Views and accessors of [`square`]: 0 corners, 1 texture coordinates, 2 triangles, 3 strip, 4 fan.
const ACCESSORS: &str = r#"
    "bufferViews": [
        {"buffer": 0, "byteLength": 48},
        {"buffer": 0, "byteOffset": 48, "byteLength": 32},
        {"buffer": 0, "byteOffset": 80, "byteLength": 28}],
    "accessors": [
        {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0,0,0], "max": [1,1,0]},
        {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC2"},
        {"bufferView": 2, "componentType": 5123, "count": 6, "type": "SCALAR"},
        {"bufferView": 2, "byteOffset": 12, "componentType": 5123, "count": 4, "type": "SCALAR"},
        {"bufferView": 2, "byteOffset": 20, "componentType": 5123, "count": 4, "type": "SCALAR"}]"#;

/// A file of some parts around [`square`].
fn text(parts: &str) -> String {
    let data = STANDARD.encode(square());
    format!(
        r#"{{"asset": {{"version": "2.0"}}, {ACCESSORS},
        "buffers": [{{"byteLength": 108, "uri": "data:application/octet-stream;base64,{data}"}}],
        "images": [{{"uri": "my%20image.png"}}], "textures": [{{"source": 0}}], {parts}}}"#
    )
}

fn open(text: &str) -> Result<(Scene, Report), SceneError> {
    let mut file = |name: &str| match name {
        "my image.png" => Ok(png()),
        _ => Err(io::ErrorKind::NotFound.into()),
    };
    Scene::from_gltf(Path::new("s.gltf"), text.as_bytes(), &mut file, &Limits::default())
}

/// A lamp, so that there is light, and nodes and meshes of a test. Mesh 0 is the lamp's, material 0 too.
fn with_lamp(nodes: &str, meshes: &str, materials: &str) -> (Scene, Report) {
    let count = 1 + nodes.matches("\"mesh\"").count();
    let all: Vec<String> = (0..count).map(|k| k.to_string()).collect();
    let comma = if materials.is_empty() { "" } else { ", " };
    let parts = format!(
        r#""scenes": [{{"nodes": [{}]}}],
        "nodes": [{{"mesh": 0, "translation": [0, 0, 9]}}, {nodes}],
        "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0}}, "indices": 2, "material": 0}}]}}, {meshes}],
        "materials": [{{"name": "lamp", "emissiveFactor": [1, 1, 1], "pbrMetallicRoughness":
            {{"metallicFactor": 0}}}}{comma}{materials}]"#,
        all.join(", ")
    );
    open(&text(&parts)).unwrap()
}

/// One square of a material.
fn with_material(material: &str) -> (Scene, Report) {
    let mesh = r#"{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2,
        "material": 1}]}"#;
    with_lamp(r#"{"mesh": 1}"#, mesh, material)
}

fn kinds(report: &Report) -> Vec<NoteKind> {
    report.notes.iter().map(|n| n.kind).collect()
}

/// Corners of a surface in the scene's own units, and its normal.
fn corners(scene: &Scene, surface: usize) -> (Vec<DVec3>, Vec3) {
    let surface = &scene.surfaces[surface];
    let vertices = surface.polygons.iter().flat_map(|p| &p.vertices);
    (vertices.map(|v| scene.fit.to_own(*v)).collect(), surface.normal)
}

#[test]
fn triangles_strips_and_fans_make_the_same_square() {
    let primitive = |mode: u32, indices: &str| {
        let of = format!(
            r#"{{"attributes": {{"POSITION": 0}}, "mode": {mode}{indices}, "material": 1}}"#
        );
        let (scene, _) = with_lamp(
            r#"{"mesh": 1}"#,
            &format!(r#"{{"primitives": [{of}]}}"#),
            r#"{"pbrMetallicRoughness": {"metallicFactor": 0}}"#,
        );
        let surface = &scene.surfaces[1];
        let area = f64::from(surface.area()) * scene.fit.radius.powi(2);
        (scene.surfaces.len(), surface.polygons.len(), (area * 1e4).round(), surface.normal)
    };
    for (mode, indices) in
        [(4, r#", "indices": 2"#), (5, r#", "indices": 3"#), (6, r#", "indices": 4"#)]
    {
        assert_eq!(primitive(mode, indices), (2, 1, 1e4, Vec3::Z), "mode {mode}");
    }
    assert_eq!(primitive(6, ""), (2, 1, 1e4, Vec3::Z), "without indices");
    assert_eq!(primitive(4, ""), (2, 1, 5e3, Vec3::Z), "a corner is left over");
}

#[test]
fn nodes_move_turn_scale_and_mirror_their_meshes() {
    let mesh = r#"{"primitives": [{"attributes": {"POSITION": 0}, "indices": 2}]}"#;
    // One mesh three times: moved by its parent, turned about x, and mirrored in x.
    let (scene, report) = with_lamp(
        r#"{"mesh": 1, "translation": [1, 0, 0], "scale": [2, 3, 1]},
           {"mesh": 1, "rotation": [0.70710678, 0, 0, 0.70710678]},
           {"mesh": 1, "matrix": [-1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,5,1]}"#,
        mesh,
        "",
    );
    assert_eq!(report.notes.len(), 1, "the default material is a rough metal: {report}");
    let extent = |k: usize| {
        let (corners, normal) = corners(&scene, k);
        let low = corners.iter().copied().reduce(DVec3::min).unwrap();
        let high = corners.iter().copied().reduce(DVec3::max).unwrap();
        (low, high, normal)
    };
    for (k, low, high, normal) in [
        (1, [1.0, 0.0, 0.0], [3.0, 3.0, 0.0], Vec3::Z),
        (2, [0.0, 0.0, 0.0], [1.0, 0.0, 1.0], Vec3::NEG_Y),
        // Mirrored, its front still looks where it did.
        (3, [-1.0, 0.0, 5.0], [0.0, 1.0, 5.0], Vec3::Z),
    ] {
        let found = extent(k);
        assert!(found.0.distance(low.into()) < 1e-5, "{k}: {found:?}");
        assert!(found.1.distance(high.into()) < 1e-5, "{k}: {found:?}");
        assert!(found.2.distance(normal) < 1e-5, "{k}: {found:?}");
    }
}

#[test]
fn children_stand_in_their_parents_space() {
    let parts = r#""scene": 1, "scenes": [{"nodes": []}, {"nodes": [0]}],
        "nodes": [{"children": [1], "scale": [2, 2, 2]}, {"mesh": 0, "translation": [1, 0, 0]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 2, "material": 0}]}],
        "materials": [{"emissiveFactor": [1, 1, 1]}]"#;
    let (scene, _) = open(&text(parts)).unwrap();
    let low = corners(&scene, 0).0.into_iter().reduce(DVec3::min).unwrap();
    assert!(low.distance(DVec3::new(2.0, 0.0, 0.0)) < 1e-5, "{low}");
}

#[test]
fn materials_are_taken_for_diffuse_or_mirror() {
    use NoteKind::*;
    let diffuse = |c| Reflectance::Diffuse(Rgb::splat(c));
    let mirror = |c| Reflectance::Mirror(Rgb::splat(c));
    let colour = r#""baseColorFactor": [0.5, 0.5, 0.5, 1]"#;
    type Row<'a> = (&'a str, &'a str, Reflectance, &'a [NoteKind]);
    let table: &[Row] = &[
        (r#""metallicFactor": 0"#, "", diffuse(0.5), &[]),
        (r#""metallicFactor": 0, "roughnessFactor": 0.5"#, "", diffuse(0.5), &[Glossy]),
        (r#""metallicFactor": 1, "roughnessFactor": 0.04"#, "", mirror(0.5), &[]),
        (r#""roughnessFactor": 0"#, "", mirror(0.5), &[]),
        (r#""metallicFactor": 1, "roughnessFactor": 0.05"#, "", diffuse(0.5), &[Metal]),
        (r#""metallicFactor": 0.9, "roughnessFactor": 0"#, "", diffuse(0.5), &[Metal]),
        (r#""metallicFactor": 0"#, r#", "alphaMode": "BLEND""#, diffuse(0.5), &[]),
        (
            r#""metallicFactor": 0, "baseColorTexture": {"index": 0}"#,
            r#", "alphaMode": "MASK""#,
            diffuse(0.25),
            &[Transparency],
        ),
        (r#""roughnessFactor": 0, "baseColorTexture": {"index": 0}"#, "", mirror(0.25), &[Texture]),
        (r#""metallicFactor": 0"#, r#", "normalTexture": {"index": 0}"#, diffuse(0.5), &[Texture]),
    ];
    for (pbr, more, expected, notes) in table {
        let (scene, report) = with_material(&format!(
            r#"{{"name": "m", "pbrMetallicRoughness": {{{colour}, {pbr}}}{more}}}"#
        ));
        let found = scene.material_of(SurfaceId(1)).reflectance;
        assert!(
            (found.factor().0[0] - expected.factor().0[0]).abs() < 1e-6,
            "{pbr}{more}: {found:?}"
        );
        assert_eq!(found.is_mirror(), expected.is_mirror(), "{pbr}{more}");
        assert_eq!(kinds(&report), *notes, "{pbr}{more}");
    }
    let (_, report) = with_material(r#"{"name": "gold", "pbrMetallicRoughness": {}}"#);
    let said = report.notes[0].to_string();
    assert!(said.starts_with("material `gold` (s.gltf): rough or partial metals"), "{said}");
}

#[test]
fn notes_of_one_kind_are_one_with_the_names() {
    let names: Vec<String> = (1..=10).map(|k| format!(r#"{{"name": "m{k}"}}"#)).collect();
    let meshes: Vec<String> = (1..=10)
        .map(|k| {
            format!(r#"{{"primitives": [{{"attributes": {{"POSITION": 0}}, "material": {k}}}]}}"#)
        })
        .collect();
    let nodes: Vec<String> =
        (1..=10).map(|k| format!(r#"{{"mesh": {k}, "translation": [0, 0, {k}]}}"#)).collect();
    let (_, report) = with_lamp(&nodes.join(","), &meshes.join(","), &names.join(","));
    assert_eq!(report.notes.len(), 1);
    assert!(report.notes[0].subject.starts_with("10 materials `m1`, `m2`, "), "{report}");
    assert!(report.notes[0].subject.ends_with("`m8` and others"), "{report}");
}

#[test]
fn emission_has_its_strength_its_image_and_both_sides() {
    let lamp = |more: &str| {
        let (scene, report) = with_material(&format!(
            r#"{{"name": "m", "emissiveFactor": [0.5, 1, 0], "pbrMetallicRoughness": {{"metallicFactor": 0}},
                "extensions": {{"KHR_materials_emissive_strength": {{"emissiveStrength": 8}}}}{more}}}"#
        ));
        let emitters = scene.surface_ids().filter(|id| scene.material_of(*id).emitted.0[2] == 0.0);
        (
            scene.material_of(SurfaceId(1)).emitted,
            emitters.count(),
            kinds(&report),
            scene.images.len(),
        )
    };
    assert_eq!(lamp(""), (Rgb([4.0, 8.0, 0.0]), 1, vec![], 0));
    assert_eq!(lamp(r#", "doubleSided": true"#), (Rgb([4.0, 8.0, 0.0]), 2, vec![], 0));
    let (emitted, count, notes, images) = lamp(r#", "emissiveTexture": {"index": 0}"#);
    assert!((emitted.0[1] - 4.0).abs() < 0.1, "half of the image is black: {emitted:?}");
    assert_eq!((count, notes, images), (1, vec![NoteKind::Texture], 0), "its image is not kept");
    // What of the image is shown counts, here its white half.
    let moved = r#", "emissiveTexture": {"index": 0, "extensions": {"KHR_texture_transform":
        {"offset": [0.5, 0], "scale": [0.5, 1]}}}"#;
    assert!((lamp(moved).0.0[1] - 8.0).abs() < 1e-4);
}

#[test]
fn images_lie_where_their_coordinates_and_transforms_say() {
    let place = |more: &str, at: [f64; 3]| {
        let (scene, report) = with_material(&format!(
            r#"{{"name": "m", "pbrMetallicRoughness": {{"metallicFactor": 0, "baseColorFactor":
                [1, 0.5, 0.25, 1], "baseColorTexture": {{"index": 0{more}}}}}}}"#
        ));
        assert_eq!(report.notes, []);
        assert_eq!(scene.images[0].pixels, [[0; 3], [255; 3]]);
        let texture = scene.material_of(SurfaceId(1)).texture.unwrap();
        assert_eq!((texture.tint.0, texture.clamp), ([1.0, 0.5, 0.25], [false; 2]));
        let again = stored::from_bytes(&stored::to_bytes(&scene), &Limits::default()).unwrap();
        assert_eq!(again, scene);
        let surface = &scene.surfaces[1];
        let at = surface.coordinates(scene.fit.to_unit(at.into()));
        let on = surface.placement.as_deref().unwrap();
        on.origin + on.along_u * at.x + on.along_v * at.y
    };
    let near = |a: Vec2, b: [f32; 2]| {
        let off = a - Vec2::from(b);
        assert!((off - off.round()).length() < 1e-4, "{a}, not {b:?}");
    };
    near(place("", [0.25, 0.75, 0.0]), [0.25, 0.25]);
    let transform = |t: &str| format!(r#", "extensions": {{"KHR_texture_transform": {t}}}"#);
    let moved = transform(r#"{"offset": [0.1, 0.2], "scale": [2, 3]}"#);
    near(place(&moved, [0.25, 0.75, 0.0]), [0.6, 0.95]);
    // Counter-clockwise by a quarter: what was to the right is above, and rows run downwards.
    let turned = transform(r#"{"rotation": 1.5707963}"#);
    near(place(&turned, [0.25, 1.0, 0.0]), [0.0, -0.25]);
}

#[test]
fn what_an_image_lacks_is_noted() {
    use NoteKind::*;
    let with = |attributes: &str, images: &str| {
        let text = text(&format!(
            r#""scenes": [{{"nodes": [0]}}], "nodes": [{{"mesh": 0}}],
            "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0{attributes}}}, "material": 0}}]}}],
            "materials": [{{"name": "m", "emissiveFactor": [1, 1, 1], "pbrMetallicRoughness":
                {{"metallicFactor": 0, "baseColorTexture": {{"index": 0}}}}}}]"#
        ));
        let (scene, report) = open(&text.replace("my%20image.png", images)).unwrap();
        (scene.surfaces[0].placement.is_some(), kinds(&report))
    };
    let embedded = format!("data:image/png;base64,{}", STANDARD.encode(png()));
    assert_eq!(with(r#", "TEXCOORD_0": 1"#, &embedded), (true, vec![]));
    assert_eq!(with(r#", "TEXCOORD_1": 1"#, &embedded), (false, vec![NoPlaces]));
    assert_eq!(with(r#", "TEXCOORD_0": 1"#, "gone.png"), (false, vec![Image]));
    assert_eq!(with(r#", "TEXCOORD_0": 1"#, "data:image/png;base64,AAAA"), (false, vec![Image]));
    let more = r#", "TEXCOORD_0": 1, "COLOR_0": 0"#;
    assert_eq!(with(more, &embedded), (true, vec![VertexColours]));
}

/// A file with a light, a floor of 40 by 40 under it, and no lamp.
fn with_light(light: &str, height: f64) -> Result<(Scene, Report), SceneError> {
    open(&text(&format!(
        r#""extensionsUsed": ["KHR_lights_punctual"],
        "extensions": {{"KHR_lights_punctual": {{"lights": [{light}]}}}},
        "scenes": [{{"nodes": [0, 1]}}],
        "nodes": [{{"mesh": 0, "scale": [40, 40, 1], "translation": [-20, -20, 0]}},
            {{"translation": [0, 0, {height}], "scale": [3, 3, 3],
              "extensions": {{"KHR_lights_punctual": {{"light": 0}}}}}}],
        "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0}}, "indices": 2}}]}}]"#
    )))
}

/// Power of all that emits, and the extent of it, in the scene's own units.
fn lamps(scene: &Scene) -> ([f64; 3], f64) {
    let mut power = [0.0; 3];
    let mut reach: Option<(DVec3, DVec3)> = None;
    for id in scene.surface_ids() {
        let emitted = scene.material_of(id).emitted;
        if emitted.is_black() {
            continue;
        }
        let area = f64::from(scene.surface(id).area()) * scene.fit.radius.powi(2);
        (0..3).for_each(|c| power[c] += std::f64::consts::PI * f64::from(emitted.0[c]) * area);
        for corner in corners(scene, id.index()).0 {
            let (low, high) = reach.unwrap_or((corner, corner));
            reach = Some((low.min(corner), high.max(corner)));
        }
    }
    (power, reach.map_or(0.0, |(low, high)| low.distance(high)))
}

#[test]
fn a_light_becomes_a_small_lamp_of_its_power() {
    use std::f64::consts::PI;
    let near = |found: [f64; 3], expected: [f64; 3]| {
        (0..3).for_each(|c| {
            assert!((found[c] - expected[c]).abs() <= 1e-4 * expected[0], "{found:?}")
        });
    };
    let point = r#"{"type": "point", "name": "bulb", "color": [1, 0.5, 0], "intensity": 10}"#;
    let (scene, report) = with_light(point, 12.0).unwrap();
    let (power, size) = lamps(&scene);
    near(power, [40.0 * PI, 20.0 * PI, 0.0]);
    assert!(size < 2.0, "two hundredths of the scene: {size}");
    assert_eq!(report.counts.emitters, 8);
    assert!(kinds(&report).contains(&NoteKind::Light), "{report}");
    // All of it shines outwards.
    for id in scene.surface_ids().filter(|id| !scene.material_of(*id).emitted.is_black()) {
        let surface = scene.surface(id);
        let out = surface.origin - scene.fit.to_unit(DVec3::new(0.0, 0.0, 12.0));
        assert!(surface.normal.dot(out) > 0.0, "{surface:?}");
    }
    // Near the floor it is smaller, and has the same power.
    let (scene, _) = with_light(point, 0.4).unwrap();
    let (power, size) = lamps(&scene);
    near(power, [40.0 * PI, 20.0 * PI, 0.0]);
    assert!((size - 0.4 * 3f64.sqrt()).abs() < 1e-3, "{size}");

    let spot = r#"{"type": "spot", "intensity": 10, "spot": {"innerConeAngle": 0.4, "outerConeAngle": 0.4}}"#;
    let (scene, _) = with_light(spot, 12.0).unwrap();
    let cone = 2.0 * PI * (1.0 - 0.4f64.cos());
    near(lamps(&scene).0, [10.0 * cone; 3]);
    let lamp = scene.surface_ids().find(|id| !scene.material_of(*id).emitted.is_black()).unwrap();
    assert!(scene.surface(lamp).normal.distance(Vec3::NEG_Z) < 1e-5, "it shines down");

    let sun = with_light(r#"{"type": "directional"}"#, 12.0).unwrap_err().to_string();
    assert!(sun.contains("nothing emits light"), "{sun}");
}

#[test]
fn cameras_are_views() {
    let parts = r#""scenes": [{"nodes": [0, 1, 2]}],
        "nodes": [{"mesh": 0}, {"name": "eye", "camera": 0, "translation": [1, 2, 3],
            "rotation": [0, 0.70710678, 0, 0.70710678]}, {"camera": 1}],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1, "aspectRatio": 1.5}},
            {"type": "orthographic", "orthographic": {"xmag": 1, "ymag": 1, "znear": 0.1, "zfar": 9}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 2, "material": 0}]}],
        "materials": [{"emissiveFactor": [1, 1, 1], "pbrMetallicRoughness": {"metallicFactor": 0}}]"#;
    let (_, report) = open(&text(parts)).unwrap();
    assert_eq!(kinds(&report), [NoteKind::Camera]);
    let [view] = &report.cameras[..] else { panic!("{:?}", report.cameras) };
    assert_eq!((view.name.as_str(), view.camera.width, view.camera.height), ("eye", 1080, 720));
    assert!((view.camera.vfov_deg - 1f64.to_degrees()).abs() < 1e-6);
    assert!(view.camera.eye.distance(DVec3::new(1.0, 2.0, 3.0)) < 1e-6);
    // Turned by a quarter about y it looks along -x.
    assert!(view.camera.target.distance(DVec3::new(0.0, 2.0, 3.0)) < 1e-6);
    assert!(view.camera.up.distance(DVec3::Y) < 1e-6);
}

#[test]
fn a_binary_file_holds_the_same() {
    let parts = r#""scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 2, "material": 0}]}],
        "materials": [{"emissiveFactor": [1, 1, 1]}]"#;
    let (plain, _) = open(&text(parts)).unwrap();
    let data = STANDARD.encode(square());
    let uri = format!(r#", "uri": "data:application/octet-stream;base64,{data}""#);
    let json = text(parts).replace(&uri, "");
    let glb = ::gltf::Glb {
        header: ::gltf::binary::Header { magic: *b"glTF", version: 2, length: 0 },
        json: json.into_bytes().into(),
        bin: Some(square().into()),
    };
    let bytes = glb.to_vec().unwrap();
    let open = |bytes: &[u8]| {
        let none = &mut |_: &str| Err(io::ErrorKind::NotFound.into());
        Scene::from_gltf(Path::new("s.glb"), bytes, none, &Limits::default())
    };
    assert_eq!(open(&bytes).unwrap().0, plain);
    for end in 0..bytes.len() - 4 {
        assert!(!open(&bytes[..end]).unwrap_err().to_string().contains("panicked"), "{end}");
    }
    let mut short = bytes.clone();
    short[8] = 3;
    short[9..12].fill(0);
    assert!(open(&short).unwrap_err().to_string().contains("cut short"));
}

#[test]
fn what_cannot_be_taken_is_refused() {
    let sound = r#""scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0, "children": []}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 2, "material": 0}]}],
        "materials": [{"emissiveFactor": [1, 1, 1]}]"#;
    open(&text(sound)).unwrap();
    let refused = |from: &str, to: &str| {
        let whole = text(sound);
        assert!(whole.contains(from), "{from}");
        let read = open(&whole.replacen(from, to, 1));
        let said = read.expect_err(&format!("{from} -> {to}")).to_string();
        assert!(said.starts_with("s.gltf: ") && !said.contains("panicked"), "{said}");
        said
    };
    for (from, to, says) in [
        ("{\"asset\"", "{\"asset", "not glTF 2.0"),
        ("\"2.0\"", "\"1.0\"", "not glTF 2.0"),
        ("\"mesh\": 0", "\"mesh\": 7", "not glTF 2.0"),
        ("\"children\": []", "\"children\": [0]", "twice"),
        ("\"scenes\": [{\"nodes\": [0]}], ", "", "no scene"),
        ("[{\"nodes\": [0]}]", "[{\"nodes\": []}]", "no triangle"),
        ("[1, 1, 1]", "[0, 0, 0]", "nothing emits light"),
        ("data:application/octet-stream;base64,", "gone.bin?", "put the file beside it"),
        ("data:application/octet-stream;base64,", "data:;base64,!", "cannot be read"),
        ("\"byteLength\": 108", "\"byteLength\": 109", "has 108 bytes, not 109"),
        ("\"byteLength\": 48", "\"byteLength\": 47", "ends beyond its buffer view"),
        ("\"byteLength\": 48", "\"byteLength\": 480", "ends beyond its buffer"),
        ("\"count\": 4", "\"count\": 4000000000", "number of polygons"),
        ("\"count\": 6", "\"count\": 4294967295", "ends beyond its buffer view"),
        ("\"byteOffset\": 80", "\"byteOffset\": 18446744073709551000", "beyond"),
        ("\"indices\": 2", "\"indices\": 1", "holds no indices"),
        ("\"POSITION\": 0", "\"POSITION\": 1", "Missing data"),
        ("\"accessors\"", "\"others\"", "no accessor 0"),
        ("\"mesh\": 0", "\"mesh\": 0, \"scale\": [1e38, 1, 1]", "beyond 1e30"),
    ] {
        let said = refused(from, to);
        assert!(said.contains(says), "{from} -> {to}: {said}");
    }
    let none = &mut |_: &str| Err(io::ErrorKind::NotFound.into());
    let few = Limits { surfaces: 1, ..Limits::default() };
    let said = Scene::from_gltf(Path::new("s.gltf"), text(sound).as_bytes(), none, &few);
    assert!(
        said.unwrap_err().to_string().contains("polygons 2 exceeds limit 1 (--limit-surfaces)")
    );
}

proptest! {
    #[test]
    fn changed_bytes_never_panic(changes in prop::collection::vec((0usize..4000, any::<u8>()), 1..12)) {
        let parts = r#""scenes": [{"nodes": [0, 1]}], "nodes": [{"mesh": 0, "rotation": [0, 0, 0, 1]},
            {"camera": 0, "scale": [1, 2, 3]}], "cameras": [{"type": "perspective", "perspective":
            {"yfov": 1, "znear": 0.1}}], "meshes": [{"primitives": [{"attributes": {"POSITION": 0,
            "TEXCOORD_0": 1}, "indices": 2, "material": 0}]}], "materials": [{"emissiveFactor":
            [1, 1, 1], "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]"#;
        let mut bytes = text(parts).into_bytes();
        for (at, byte) in changes {
            let at = at % bytes.len();
            bytes[at] = byte;
        }
        let file = &mut |_: &str| Ok(png());
        let limits = Limits { surfaces: 1000, ..Limits::default() };
        if let Err(e) = Scene::from_gltf(Path::new("s.gltf"), &bytes, file, &limits) {
            prop_assert!(!e.to_string().contains("panicked"), "{}", e);
        }
    }
}
