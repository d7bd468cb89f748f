//! A textured surface is lit, and lights others, as one of plain pieces would be, and what a field needs
//! of an image is in the field.

mod common;

use common::{Baked, How, bake_to, mean_radiance, obj, parameters};
use std::fs;
use std::path::Path;
use tempfile::TempDir;
use vlf::field::storage::disk::Disk;
use vlf::pack::pack;
use vlf::{Codec, LightField, Outcome, Rgb, Scene, SurfaceId, verify};

/// A PNG of squares, black and white by turns, of so many along an edge; the first is white.
fn checkers(along: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, along, along);
    encoder.set_color(png::ColorType::Grayscale);
    let of = |k: u32| if (k % along + k / along).is_multiple_of(2) { 255 } else { 0 };
    let pixels: Vec<u8> = (0..along * along).map(of).collect();
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(&pixels).unwrap();
    writer.finish().unwrap();
    bytes
}

/// A scene with an image called `i.png`.
fn scene_with(obj: &str, mtl: &str, image: &[u8]) -> Scene {
    let obj = format!("mtllib s.mtl\n{obj}");
    let (scene, report) = Scene::from_text(Path::new("s.obj"), &obj, &mut |name| match name {
        "i.png" => Ok(image.to_vec()),
        _ => Ok(mtl.into()),
    })
    .unwrap();
    assert_eq!(report.notes, []);
    scene
}

/// The furnace with another material, `floor`, on its floor.
fn furnace(floor: &str) -> (String, String) {
    let text = fs::read_to_string(obj("furnace")).unwrap().replace("mtllib", "#");
    let text = text.replacen(
        "f 1 2 3 4",
        "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl floor\nf 1/1 2/2 3/3 4/4\nusemtl wall",
        1,
    );
    let walls = "newmtl wall\nKd .5 .5 .5\nKe 1 1 1\n";
    (text, format!("{walls}newmtl floor\nKe 1 1 1\n{floor}\n"))
}

/// In a furnace every texel receives the same: it shows what its own part of the image reflects, and the
/// whole reflects what a plain grey floor does.
#[test]
fn an_image_that_is_grey_in_the_mean_reflects_as_much_as_grey() {
    let parameters = parameters(129, 64, 1);
    let (text, plain) = furnace("Kd .4 .4 .4");
    let plain = Baked::new(&scene_with(&text, &plain, &[]), &parameters);
    for along in [6, 1000] {
        let (text, mtl) = furnace("Kd .8 .8 .8\nmap_Kd i.png");
        let scene = scene_with(&text, &mtl, &checkers(along));
        let baked = Baked::new(&scene, &parameters);
        let field = baked.open();
        let lattice = field.texels.lattices[0];
        let floor: Vec<Rgb> = (0..lattice.len()).map(|k| field.total[2 * k]).collect();
        let mean = floor.iter().map(|v| f64::from(v.mean())).sum::<f64>() / floor.len() as f64;
        assert!((mean - 1.4).abs() < 1e-4, "{along}: {mean}");
        let corner = f64::from(floor[0].mean());
        let spread = floor.iter().map(|v| (f64::from(v.mean()) - 1.4).abs()).fold(0.0, f64::max);
        match along {
            // The lowest row of the image begins with black.
            6 => assert!((corner - 1.0).abs() < 1e-4 && spread > 0.399, "{corner}, {spread}"),
            _ => assert!(spread < 2e-3, "finer than texels: {spread}"),
        }
        let [own, grey] = [&baked, &plain].map(|b| b.manifest().ledger[0].clone());
        let off = (own.absorbed - grey.absorbed) / grey.absorbed;
        assert!(off.abs() < 1e-5, "{along}: absorbed {} and {}", own.absorbed, grey.absorbed);
        let off = (own.unshot_diffuse - grey.unshot_diffuse) / grey.unshot_diffuse;
        assert!(off.abs() < 1e-5, "{along}: carried on");
    }
}

/// A box of 2 by 2 by 2 with a lamp under its ceiling; the floor is `floor`.
fn room(floor: &str) -> String {
    format!(
        "v -1 -1 1\nv 1 -1 1\nv 1 -1 -1\nv -1 -1 -1\nv -1 1 1\nv 1 1 1\nv 1 1 -1\nv -1 1 -1\n\
         v -.3 .9 .3\nv .3 .9 .3\nv .3 .9 -.3\nv -.3 .9 -.3\n\
         usemtl lamp\nf 12 11 10 9\nusemtl back\nf 4 3 7 8\nusemtl front\nf 2 1 5 6\n\
         usemtl left\nf 1 4 8 5\nusemtl right\nf 3 2 6 7\nusemtl ceiling\nf 5 8 7 6\n{floor}"
    )
}

const ROOM: &str = "newmtl lamp\nKd 0 0 0\nKe 10 10 10\nnewmtl back\nKd .7 .7 .7\nnewmtl front\n\
    Kd .7 .7 .7\nnewmtl left\nKd .7 .7 .7\nnewmtl right\nKd .7 .7 .7\nnewmtl ceiling\nKd .7 .7 .7\n";

#[test]
fn a_checkered_floor_lights_a_room_as_squares_of_two_colours_do() {
    const ALONG: u32 = 5;
    let parameters = parameters(513, 64, 4);
    let textured = scene_with(
        &room("vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl floor\nf 1/1 2/2 3/3 4/4\n"),
        &format!("{ROOM}newmtl floor\nKd .8 .8 .8\nmap_Kd i.png\n"),
        &checkers(ALONG),
    );
    let mut squares = String::new();
    for (column, row) in (0..ALONG * ALONG).map(|k| (k % ALONG, k / ALONG)) {
        let at = |c: u32| -1.0 + 2.0 * f64::from(c) / f64::from(ALONG);
        let (x, z) = ([at(column), at(column + 1)], [-at(row), -at(row + 1)]);
        for (a, b) in [(0, 0), (1, 0), (1, 1), (0, 1)] {
            squares += &format!("v {} -1 {}\n", x[a], z[b]);
        }
        let material = if (column + row).is_multiple_of(2) { "white" } else { "black" };
        squares += &format!("usemtl {material}\nf -4 -3 -2 -1\n");
    }
    let plain = scene_with(
        &room(&squares),
        &format!("{ROOM}newmtl white\nKd .8 .8 .8\nnewmtl black\nKd 0 0 0\n"),
        &[],
    );
    let [textured, plain] = [textured, plain].map(|s| Baked::new(&s, &parameters).open());
    for wall in ["back", "front", "left", "right", "ceiling"] {
        let [a, b] = [&textured, &plain].map(|field| mean_radiance(field, wall));
        assert!((a - b).abs() < 5e-3 * b, "{wall}: {a} textured, {b} of squares");
    }
    let floor = mean_radiance(&textured, "floor");
    let white = mean_radiance(&plain, "white") * 13.0 / 25.0;
    assert!((floor - white).abs() < 5e-3 * white, "{floor} textured, {white} of squares");
}

#[test]
fn a_field_needs_no_image_file() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (text, mtl) = furnace("map_Kd i.png");
    fs::write(at("s.obj"), format!("mtllib s.mtl\n{text}")).unwrap();
    fs::write(at("s.mtl"), mtl).unwrap();
    fs::write(at("i.png"), checkers(7)).unwrap();
    let (scene, report) = Scene::open(&at("s.obj")).unwrap();
    assert_eq!(report.notes, []);
    let parameters = parameters(33, 32, 2);
    let straight = Baked::with(&scene, &parameters, &How { threads: 1, ..How::default() });

    let path = at("s.field");
    let stopping = How { stop_after: Some(40), commit_every: 0.0, ..How::default() };
    assert_eq!(bake_to(&path, &scene, &parameters, &stopping), Outcome::Stopped);
    fs::remove_file(at("i.png")).unwrap();
    assert_eq!(bake_to(&path, &scene, &parameters, &How::default()), Outcome::Finished);
    let disk = Disk::new(&path);
    assert_eq!(vlf::field::read_manifest(&disk).unwrap().1.digest, straight.manifest().digest);
    assert!(verify::field(&disk, &|_| ()).unwrap().is_sound());

    pack(&path, &at("s.vlf"), Codec::Zstd, &|_| ()).unwrap();
    let (field, packed) =
        (LightField::open(&path).unwrap(), LightField::open(&at("s.vlf")).unwrap());
    assert_eq!(packed.scene, scene);
    assert_eq!((field.scene, field.total), (scene, packed.total));

    // Without its image the scene is another, and the field is not gone on with.
    let (other, report) = Scene::open(&at("s.obj")).unwrap();
    assert!(report.notes[0].to_string().contains("image `i.png` cannot be read"));
    assert_eq!(other.material_of(SurfaceId(0)).texture, None);
}
