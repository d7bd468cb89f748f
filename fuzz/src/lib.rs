//! What the fuzz targets do with their bytes, and `tests/fuzz_regressions.rs` with those that once did
//! harm. Whatever the bytes are: an error or a sound value comes out, no panic, and no more memory or
//! time than the bytes are worth.

#[path = "../../tests/sealing/mod.rs"]
mod sealing;

use std::cell::RefCell;
use std::fs;
use std::io;
use std::path::Path;
use tempfile::TempDir;
use vlf::format::container::{ChunkKind, Directory, FIRST_BLOCK, Header};
use vlf::format::limits::Limits;
use vlf::format::manifest::{Manifest, record_from_bytes, record_to_bytes};
use vlf::format::tiles::{Layout, TileMap, from_planes, to_planes};
use vlf::scene::{Fit, Report, stored as stored_scene};
use vlf::{Camera, Cell, LightField, Scene, SceneError, Sense, SurfaceId};

/// A target: its name and what it does.
pub type Target = (&'static str, fn(&[u8]));

/// All targets.
pub const TARGETS: [Target; 9] = [
    ("header", header),
    ("tile", tile),
    ("planes", planes),
    ("manifest", manifest),
    ("stored", stored),
    ("pack", pack),
    ("scene", scene),
    ("gltf", gltf),
    ("camera", camera),
];

/// Runs a target so that a panic ends the process, but not one that the library catches: the reader of
/// OBJ stands between it and another's code.
pub fn guarded(target: fn(&[u8]), data: &[u8]) {
    thread_local!(static MESSAGE: RefCell<String> = const { RefCell::new(String::new()) });
    static QUIET: std::sync::Once = std::sync::Once::new();
    QUIET.call_once(|| {
        std::panic::set_hook(Box::new(|panic| {
            MESSAGE.with(|m| *m.borrow_mut() = panic.to_string());
        }));
    });
    if std::panic::catch_unwind(|| target(data)).is_err() {
        MESSAGE.with(|m| eprintln!("{}", m.borrow()));
        std::process::abort();
    }
}

/// The bytes as they are, and with hashes and length that fit.
fn as_is_and_sealed(data: &[u8]) -> [Vec<u8>; 2] {
    let mut sealed = data.to_vec();
    sealing::seal(&mut sealed);
    [data.to_vec(), sealed]
}

/// First block and directory, then all chunks as far as they can be decoded.
pub fn header(data: &[u8]) {
    for file in as_is_and_sealed(data) {
        let length = file.len() as u64;
        let head = Directory::length(&file, length, &Limits::default());
        let Ok(directory) = Directory::parse(&file, length, &Limits::default()) else { continue };
        // What parses the whole file parses its head.
        let head = &file[..head.expect("a directory without a length")];
        assert_eq!(Directory::parse(head, length, &Limits::default()).as_ref(), Ok(&directory));
        _ = directory.header.check_writable();
        let mut end = head.len().max(FIRST_BLOCK) as u64;
        for entry in &directory.entries {
            assert!(entry.offset >= end);
            end = entry.offset + entry.stored;
            let chunk = directory.chunk(&file, entry);
            assert!(chunk.is_err() || chunk.is_ok_and(|bytes| bytes.len() as u64 == entry.raw));
        }
        assert!(end <= length);
    }
}

/// A tile map, as it is and with its tables made to agree; every cell of it is looked up.
pub fn tile(data: &[u8]) {
    let exponent = data.len() as i32 % 201 - 100;
    if let Some(numbers) = data.get(..8) {
        let n = sealing::number(&numbers[..4]).min(32) as u32;
        let m = sealing::number(&numbers[4..]).min(256) as u32;
        if let Ok(layout) = Layout::check(data, n * m, m, u32::MAX, exponent) {
            look_at_all(&TileMap::new(data, &layout), n * m);
        }
    }
    if let Some((map, resolution, m)) = mended(data) {
        let layout = Layout::check(&map, resolution, m, u32::MAX, exponent);
        look_at_all(&TileMap::new(&map, &layout.expect("the tables agree")), resolution);
    }
}

/// Planes of a tile map, for the length that their own numbers give and one that they do not. What
/// comes of them, if it is a map, comes again of its planes.
pub fn planes(data: &[u8]) {
    let number = |at: usize| data.get(at..at + 4).map_or(0, sealing::number);
    let [n, m, entries, values] = [0, 4, 8, 12].map(number);
    let table = |size: u64| size.next_multiple_of(8);
    let (Some(tiles), Some(cells)) = (n.checked_mul(n), m.checked_mul(m)) else { return };
    if tiles.max(cells).max(entries).max(values) > 1 << 20 {
        return;
    }
    let tables =
        table(16 + 4 * (tiles + 1)) + table(4 * entries) + 8 * entries + table(2 * entries);
    let raw = table(tables + 8 * cells.div_ceil(64) * entries + 6 * values);
    assert!(from_planes(data, raw + 8).is_err());
    let Ok(map) = from_planes(data, raw) else { return };
    assert_eq!(map.len() as u64, raw);
    let (resolution, tile) = ((n * m) as u32, m as u32);
    if let Ok(layout) = Layout::check_packed(&map, (resolution, tile), u32::MAX, 0) {
        let again = to_planes(&TileMap::new(&map, &layout));
        assert_eq!(from_planes(&again, raw).as_ref(), Ok(&map));
    }
}

fn look_at_all(map: &TileMap, resolution: u32) {
    let mut cells = 0;
    map.for_each(|surface, cell, both| {
        cells += 1;
        assert!(both.iter().all(|rgb| rgb.is_physical()));
        if resolution <= 64 {
            let entry = map.entry(cell, surface).expect("a cell without its entry");
            let senses = [Sense::Along, Sense::Against];
            assert_eq!(senses.map(|sense| entry.radiance(cell, sense)), both.map(Some));
        }
    });
    assert!(cells >= map.entry_count());
    assert_eq!(map.entry(Cell { i: 0, j: 0 }, SurfaceId(u32::MAX)).map(|_| ()), None);
}

/// A tile map with small tables that agree, of tables that may not; with its resolution and tile.
fn mended(data: &[u8]) -> Option<(Vec<u8>, u32, u32)> {
    let head = data.get(..12)?;
    let [n, m, entries] = [0, 4, 8].map(|at| sealing::number(&head[at..at + 4]) as usize);
    let (n, m, entries) = (n % 4 + 1, m % 17 + 1, entries % 33);
    let words = (m * m).div_ceil(64);
    let mut rest = data[12..].iter().copied();
    let mut number = |size: usize| {
        (0..size).map(|_| rest.next().unwrap_or(1)).rev().fold(0, |n, b| n << 8 | u64::from(b))
    };
    let mut first: Vec<u64> = (0..n * n).map(|_| number(1) % (entries as u64 + 1)).collect();
    first.push(entries as u64);
    first.sort_unstable();
    first[0] = 0;
    // Rising everywhere is more than rising in each tile.
    let surfaces: Vec<u64> = (0..entries as u64).map(|e| e * 256 + number(1)).collect();
    let states: Vec<u64> = (0..2 * entries).map(|_| number(1) % 3).collect();
    let (mut masks, mut values, mut total) = (Vec::new(), Vec::new(), 0);
    for entry in 0..entries {
        let mask: Vec<u64> = (0..words)
            .map(|word| {
                let bits = (m * m - 64 * word).min(64);
                number(8) & (u64::MAX >> (64 - bits)) | u64::from(word == 0)
            })
            .collect();
        let covered: u32 = mask.iter().map(|word| word.count_ones()).sum();
        for state in &states[2 * entry..2 * entry + 2] {
            values.push(total);
            total += [0, 1, u64::from(covered)][*state as usize];
        }
        masks.extend(mask);
    }
    let mut map: Vec<u8> = Vec::new();
    let mut put = |size: usize, numbers: &mut dyn Iterator<Item = u64>| {
        numbers.for_each(|v| map.extend(&v.to_le_bytes()[..size]));
        map.resize(map.len().next_multiple_of(8), 0);
    };
    put(4, &mut [n as u64, m as u64, entries as u64, total].into_iter());
    put(4, &mut first.into_iter());
    put(4, &mut surfaces.into_iter());
    put(4, &mut values.into_iter());
    put(1, &mut states.into_iter());
    put(8, &mut masks.into_iter());
    // Neither negative nor infinite.
    put(2, &mut (0..3 * total).map(|_| number(2) % 0x7c00));
    Some((map, (n * m) as u32, m as u32))
}

/// A record, and what is checked of it against the first block it would stand behind.
pub fn manifest(data: &[u8]) {
    let Ok(manifest) = record_from_bytes::<Manifest>(data) else { return };
    let again: Vec<u8> = record_to_bytes(&manifest).expect("it was small enough");
    assert_eq!(again, data);
    let p = &manifest.parameters;
    let kind = vlf::format::container::FileKind::Manifest;
    let header: Header = vlf::format::manifest::header(kind, [0; 16], p, 3, 0, (0, u32::MAX));
    if p.directions <= 1 << 20 && manifest.check(&header).is_ok() {
        assert!(manifest.done_count() as usize <= 8 * manifest.done.len());
        (0..p.directions).for_each(|d| _ = manifest.is_done(d));
    }
    manifest.ledger.iter().for_each(|cycle| _ = cycle.residual());
}

/// The bytes of a stored scene.
pub fn stored(data: &[u8]) {
    let Ok(scene) = stored_scene::from_bytes(data, &Limits::default()) else { return };
    assert_eq!(stored_scene::to_bytes(&scene), data);
    _ = vlf::scene::texels::Texels::count(&scene, 0.1);
}

/// A whole pack: opened, all maps read, and looked up at a few places of every surface.
pub fn pack(data: &[u8]) {
    thread_local!(static FOLDER: TempDir = TempDir::new().unwrap());
    let path = FOLDER.with(|folder| folder.path().join("fuzzed.vlf"));
    for file in as_is_and_sealed(data) {
        fs::write(&path, &file).unwrap();
        let Ok(field) = LightField::open(&path) else { continue };
        for direction in 0..field.directions.len() as u32 {
            if let Ok(map) = field.map(direction) {
                map.tiles()
                    .for_each(|_, _, both| assert!(both.iter().all(|rgb| rgb.is_physical())));
            }
        }
        for id in field.scene.surface_ids().take(8) {
            let s = field.scene.surface(id);
            for (x, y, slope) in [(0.5, 0.5, 0.0), (0.1, 0.9, 0.7), (1.1, 0.0, -3.0)] {
                let point = s.origin + s.u * (s.extent.x * x) + s.v * (s.extent.y * y);
                let away = (s.normal + s.u * slope + s.v * 0.2).normalize();
                for away in [away, -away] {
                    if let Ok(radiance) = field.radiance(id, point, away) {
                        assert!(radiance.is_physical(), "{radiance:?}");
                    }
                }
            }
        }
        let directory =
            Directory::parse(&file, file.len() as u64, &Limits::default()).expect("it was opened");
        assert_eq!(directory.entries[0].id.kind, ChunkKind::Record);
    }
}

/// The text of an OBJ, a zero byte, the text of its MTL, a zero byte, its image. A scene that comes of it can
/// be stored.
pub fn scene(data: &[u8]) {
    let mut parts = data.splitn(3, |byte| *byte == 0);
    let mut part = || parts.next().unwrap_or_default();
    let (obj, mtl, image) = (part(), part(), part());
    let mut file = |name: &str| match name {
        "missing.mtl" => Err(io::Error::from(io::ErrorKind::NotFound)),
        "i.png" => Ok(image.to_vec()),
        _ => Ok(mtl.to_vec()),
    };
    is_sound(Scene::from_text(Path::new("fuzzed.obj"), &String::from_utf8_lossy(obj), &mut file));
}

/// A glTF file, and as it were its images and buffers. The reader is another's: its panics are errors.
pub fn gltf(data: &[u8]) {
    let limits = Limits { surfaces: 10_000, ..Limits::default() };
    let mut file = |name: &str| match name {
        "gone" => Err(io::Error::from(io::ErrorKind::NotFound)),
        _ => Ok(data.to_vec()),
    };
    is_sound(Scene::from_gltf(Path::new("fuzzed.gltf"), data, &mut file, &limits));
}

/// A scene that was read can be stored and read again; a refusal says something.
fn is_sound(read: Result<(Scene, Report), SceneError>) {
    match read {
        Err(e) => assert!(!e.to_string().is_empty()),
        Ok((scene, report)) => {
            assert!(!format!("{report:?}").is_empty());
            let bytes = stored_scene::to_bytes(&scene);
            let again = stored_scene::from_bytes(&bytes, &Limits::default());
            assert_eq!(again.expect("a scene that was read is sound"), scene);
        }
    }
}

/// A camera's JSON. A camera that is sound has sound rays.
pub fn camera(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let Ok(camera) = Camera::from_json(text) else { return };
    let view = camera.view(&Fit { centre: glam::DVec3::ZERO, radius: 1.0 });
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    for (x, y) in [(0.0, 0.0), (width, 0.0), (0.5 * width, 0.5 * height), (width, height)] {
        let (origin, direction) = view.ray(x, y);
        assert!(direction.is_finite() && (direction.length() - 1.0).abs() < 1e-3, "{direction}");
        assert!(!origin.is_nan());
    }
}
