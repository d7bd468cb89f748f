//! Images on surfaces: where they lie, what is merged, what is noted.

use crate::format::limits::Limits;
use crate::scene::stored;
use crate::scene::{NoteKind, Placement, Report, Scene, SceneError};
use glam::{DVec3, Vec2};
use std::io;
use std::path::Path;

/// A PNG of two by two pixels: black and white above, grey and black below.
fn png() -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, 2, 2);
    encoder.set_color(png::ColorType::Grayscale);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(&[0, 255, 188, 0]).unwrap();
    writer.finish().unwrap();
    bytes
}

/// A scene of a lamp and some lines; materials `a` and `b` have the image, `c` has what is given.
fn open(lines: &str, c: &str) -> Result<(Scene, Report), SceneError> {
    let obj = format!(
        "mtllib m/s.mtl\nv 0 -9 0\nv 0 -9 1\nv 1 -9 0\nusemtl lamp\nf -3 -2 -1\n\
         v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 2 0 0\nv 2 1 0\n\
         vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvt 2 0\nvt 2 1\nvt nan 0\n{lines}"
    );
    let mtl = format!(
        "newmtl lamp\nKe 1 1 1\nnewmtl a\nmap_Kd i.png\nnewmtl b\nKd .5 .5 .5\nmap_Kd i.png\n\
         newmtl c\n{c}\n"
    );
    Scene::from_text(Path::new("s.obj"), &obj, &mut |name| match name {
        "m/s.mtl" => Ok(mtl.clone().into()),
        "m/i.png" | "m/my image.png" => Ok(png()),
        "m/bad.png" => Ok(b"no image".to_vec()),
        _ => Err(io::ErrorKind::NotFound.into()),
    })
}

const SQUARE: &str = "f 4/1 5/2 6/3 7/4\n";
const BESIDE: &str = "f 5/2 8/5 9/6 6/3\n";

/// What a surface's image is at a point of the scene's own units.
fn place(scene: &Scene, surface: usize, own: DVec3) -> Vec2 {
    let surface = &scene.surfaces[surface];
    let at = surface.coordinates(scene.fit.to_unit(own));
    let Placement { origin, along_u, along_v } = **surface.placement.as_ref().unwrap();
    origin + along_u * at.x + along_v * at.y
}

/// Whether two places show the same of an image that repeats.
fn alike(a: Vec2, b: (f32, f32)) -> bool {
    let off = a - Vec2::from(b);
    (off - off.round()).length() < 1e-4
}

#[test]
fn an_image_lies_where_its_coordinates_say() {
    let (scene, report) = open(&format!("usemtl a\n{SQUARE}usemtl b\n{BESIDE}"), "").unwrap();
    assert_eq!(report.notes, []);
    assert_eq!(scene.images.len(), 1, "stored once");
    assert_eq!(scene.images[0].pixels, [[0; 3], [255; 3], [188; 3], [0; 3]]);
    let mean = |k: usize| scene.materials[k].reflectance.factor().0[0];
    assert!((mean(1) - 1.50289 / 4.0).abs() < 1e-5 && (mean(2) - 1.50289 / 8.0).abs() < 1e-5);
    // The image's rows begin at the top, where vt has 1.
    assert!(alike(place(&scene, 1, DVec3::new(0.25, 0.75, 0.0)), (0.25, 0.25)));
    assert!(alike(place(&scene, 2, DVec3::new(1.5, 0.0, 0.0)), (1.5, 1.0)));
    let bytes = stored::to_bytes(&scene);
    assert_eq!(stored::from_bytes(&bytes, &Limits::default()).unwrap(), scene);
    let few = Limits { pixels: 3, ..Limits::default() };
    let refused = stored::from_bytes(&bytes, &few).unwrap_err().to_string();
    assert!(refused.contains("pixel count 4 exceeds limit 3 (--limit-pixels)"), "{refused}");
    for end in 0..bytes.len() {
        // Without all that textures need it is another scene at one place only.
        let plain = |s: Scene| s.images.is_empty() && stored::to_bytes(&s).len() == end;
        let found = stored::from_bytes(&bytes[..end], &Limits::default());
        assert!(found.map_or(true, plain), "{end}");
    }
}

#[test]
fn surfaces_merge_where_the_image_goes_on() {
    let surfaces =
        |lines: &str| open(&format!("usemtl a\n{lines}"), "").unwrap().0.surfaces.len() - 1;
    assert_eq!(surfaces(&format!("{SQUARE}{BESIDE}")), 1);
    assert_eq!(surfaces(&format!("{SQUARE}f 5/1 8/2 9/3 6/4\n")), 2, "it begins anew");
    assert_eq!(surfaces(&format!("{SQUARE}f 5 8 9 6\n")), 2, "it lies nowhere");
    assert_eq!(surfaces("f 4/1 5/2 6/3\nf 4/1 6/3 7/4\n"), 1, "halves of a square");
    assert_eq!(surfaces("f 4/1 5/2 6/3 7/2\n"), 2, "no affine map: two triangles");
}

#[test]
fn options_of_an_image_are_followed() {
    let square = format!("usemtl c\n{SQUARE}");
    let (scene, report) =
        open(&square, "Kd 1 1 1\nmap_Kd -s 2 4 -o .5 0 0 -clamp on my image.png").unwrap();
    assert_eq!(report.notes, []);
    let texture = scene.materials[1].texture.unwrap();
    assert_eq!(texture.clamp, [true; 2]);
    let at = place(&scene, 1, DVec3::new(0.25, 0.25, 0.0));
    assert!(at.distance(Vec2::new(1.0, 0.0)) < 1e-4, "{at}");
    let (_, report) = open(&square, "map_Kd -mm 0 2 -s i.png").unwrap();
    let text = report.notes[0].to_string();
    assert_eq!(text, "material `c` (s.mtl:9): option `-mm` of `map_Kd` is not supported, left out");
}

#[test]
fn what_of_an_image_is_not_taken_is_noted() {
    use NoteKind::*;
    let notes = |lines: &str, c: &str| {
        let (scene, report) = open(lines, c).unwrap();
        let textured = scene.materials.iter().any(|m| m.texture.is_some());
        assert!(textured || scene.surfaces.iter().all(|s| s.placement.is_none()));
        report.notes.iter().map(|n| (n.kind, n.line)).collect::<Vec<_>>()
    };
    let square = format!("usemtl c\n{SQUARE}");
    assert_eq!(notes(&square, "map_Kd i.png"), []);
    assert_eq!(notes(&square, "Kd 0 0 0\nmap_Kd i.png"), [(TextureOnly, 10)]);
    assert_eq!(notes(&square, "map_Kd gone.png"), [(Image, 9)]);
    assert_eq!(notes(&square, "Kd .5 .5 .5\nmap_Kd bad.png"), [(Image, 10)]);
    assert_eq!(notes(&square, "map_Kd"), [(Image, 9)]);
    assert_eq!(notes(&square, "illum 3\nKs 1 1 1\nmap_Kd i.png"), [(Texture, 11)]);
    assert_eq!(notes(&square, "map_Kd i.png\nmap_Ke i.png"), [(Texture, 8)]);
    let bare = "usemtl c\nf 4 5 6 7\nf 4/1 5/2 6/7\nf 4/1 5 6/3\n";
    assert_eq!(notes(bare, "map_Kd i.png"), [(NoPlaces, 21)]);
    assert_eq!(notes(bare, "map_Kd gone.png"), [(Image, 9)]);
    let (_, report) = open(&square, "map_Kd gone.png").unwrap();
    let said = report.notes[0].to_string();
    assert!(
        said.starts_with("material `c` (s.mtl:9): image `m/gone.png` cannot be read: "),
        "{said}"
    );
    assert!(said.ends_with("; taken as diffuse 0.80 0.80 0.80"), "{said}");
}
