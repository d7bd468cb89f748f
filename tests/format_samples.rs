//! The samples of `format-spec/`: files of a tiny field, sound and damaged, that every later version
//! must go on to read, or to refuse for the reason stated.
//!
//! `VLF_WRITE_SAMPLES=1 cargo test --release --test format_samples` makes them again and then fails,
//! so that nobody makes them again unseen.

mod sealing;

use glam::Vec3;
use serde_json::{Value, json};
use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
use twox_hash::{XxHash3_64, XxHash3_128};
use vlf::bake::{self, Options, Outcome};
use vlf::field::Terms;
use vlf::field::storage::disk::Disk;
use vlf::format::container::{
    self, ChunkKind, Codec, Directory, ENTRY, FIRST_BLOCK, FileKind, Header,
};
use vlf::format::limits::Limits;
use vlf::format::manifest::{Manifest, Phase, Statistics, record_from_bytes};
use vlf::format::tiles::{Layout, TileMap, to_planes};
use vlf::format::{Fault, FormatError};
use vlf::look::lightfield::LookError;
use vlf::pack::{Diffuse, Options as PackOptions};
use vlf::scene::{stored, texels};
use vlf::{LightField, Parameters, Rgb, Scene, Specular, SurfaceId, Transfer};

const OBJ: &str = "\
mtllib tiny.mtl
v -1 0 1\nv 1 0 1\nv 1 0 -1\nv -1 0 -1
v -0.5 1.5 -0.5\nv 0.5 1.5 -0.5\nv 0.5 1.5 0.5\nv -0.5 1.5 0.5
v 1 1.5 -1\nv -1 1.5 -1
usemtl floor\nf 1 2 3 4
usemtl lamp\nf 5 6 7 8
usemtl mirror\nf 4 3 9 10
";

const MTL: &str = "\
newmtl floor\nKd 0.6 0.5 0.4
newmtl lamp\nKd 0 0 0\nKe 8 8 6
newmtl mirror\nillum 3\nKd 0 0 0\nKs 0.9 0.9 0.9
";

/// The sound samples, and whether two makings are the same byte for byte. In the others only what
/// they hold is: a compressor may find another frame for it, and a manifest says how long it took.
const SOUND: [(&str, bool); 12] = [
    ("manifest", false),
    ("scene", false),
    (IMAGES, false),
    ("textures", false),
    ("sums", false),
    ("unshot.tiles", true),
    ("total.tiles", true),
    ("raw.vlf", true),
    ("zstd.vlf", false),
    ("planes.vlf", false),
    ("textured.vlf", false),
    ("mirrors.vlf", false),
];

/// The scene of another field, with images.
const IMAGES: &str = "images/scene";

/// The packs that hold all of the field, and those that leave something to the texture map.
const LOSSLESS: [&str; 3] = ["raw.vlf", "zstd.vlf", "planes.vlf"];
const OTHERS: [&str; 2] = ["textured.vlf", "mirrors.vlf"];

/// A damaged sample: its name, the sound one that it is made from, how, and what a reader must say.
struct Damage {
    name: &'static str,
    from: &'static str,
    make: fn(&[u8]) -> Vec<u8>,
    fault: fn(&Fault) -> bool,
}

const DAMAGED: [Damage; 23] = [
    Damage {
        name: "flipped-bit-in-first-block.tiles",
        from: "total.tiles",
        make: |b| edited(b, |b| b[44] ^= 1),
        fault: |f| matches!(f, Fault::Checksum { what, offset: 0 } if what == "first block"),
    },
    Damage {
        name: "flipped-bit-in-directory.tiles",
        from: "total.tiles",
        make: |b| edited(b, |b| b[FIRST_BLOCK + 16] ^= 64),
        fault: |f| matches!(f, Fault::Checksum { what, offset: 256 } if what == "directory"),
    },
    Damage {
        name: "flipped-bit-in-chunk.tiles",
        from: "total.tiles",
        make: |b| edited(b, |b| b[FIRST_BLOCK + ENTRY + 200] ^= 4),
        fault: |f| matches!(f, Fault::Checksum { what, offset: 320 } if what == "Total of direction 0"),
    },
    Damage {
        name: "flipped-bit-in-frame.vlf",
        from: "zstd.vlf",
        make: |b| edited(b, |b| *chunk_of(b, ChunkKind::Scene).last_mut().unwrap() ^= 1),
        fault: |f| matches!(f, Fault::Checksum { what, .. } if what == "Scene"),
    },
    Damage {
        name: "truncated.tiles",
        from: "total.tiles",
        make: |b| b[..b.len() - 1].to_vec(),
        fault: |f| matches!(f, Fault::Truncated { expected, actual } if *expected == actual + 1),
    },
    Damage {
        name: "surplus.tiles",
        from: "total.tiles",
        make: |b| [b, &[0]].concat(),
        fault: |f| matches!(f, Fault::Surplus(1)),
    },
    Damage {
        name: "swapped-chunks.vlf",
        from: "raw.vlf",
        make: with_two_chunks_swapped,
        fault: |f| matches!(f, Fault::Checksum { what, .. } if what.starts_with("Total of")),
    },
    Damage {
        name: "moved-chunk.tiles",
        from: "total.tiles",
        // Says everywhere that it belongs to direction 1; only the chunk's own hash knows better.
        make: |b| {
            resealed(b, |b| {
                b[84] = 1;
                b[FIRST_BLOCK + 8] = 1;
            })
        },
        fault: |f| matches!(f, Fault::Checksum { what, .. } if what == "Total of direction 1"),
    },
    Damage {
        name: "newer-major-version.tiles",
        from: "total.tiles",
        make: |b| resealed(b, |b| b[12] = 2),
        fault: |f| matches!(f, Fault::Version { major: 2, minor: 0 }),
    },
    Damage {
        name: "unknown-required-feature.tiles",
        from: "total.tiles",
        make: |b| resealed(b, |b| b[16] = 1 << 7),
        fault: |f| matches!(f, Fault::Feature(7)),
    },
    Damage {
        name: "reserved-byte-set.tiles",
        from: "total.tiles",
        make: |b| resealed(b, |b| b[130] = 1),
        fault: |f| matches!(f, Fault::Invalid(_)),
    },
    Damage {
        name: "reserved-byte-in-entry-set.tiles",
        from: "total.tiles",
        make: |b| resealed(b, |b| b[FIRST_BLOCK + 60] = 1),
        fault: |f| matches!(f, Fault::Invalid(_)),
    },
    Damage {
        name: "other-byte-order.tiles",
        from: "total.tiles",
        make: |b| resealed(b, |b| b[8..12].reverse()),
        fault: |f| matches!(f, Fault::ByteOrder),
    },
    Damage {
        name: "text-mode.tiles",
        from: "total.tiles",
        make: |b| [&b[..4], &b[5..]].concat(),
        fault: |f| matches!(f, Fault::TextMode),
    },
    Damage {
        name: "another-kind.tiles",
        from: "scene",
        make: <[u8]>::to_vec,
        fault: |f| matches!(f, Fault::Invalid(_)),
    },
    Damage {
        name: "padding-byte-set.vlf",
        from: "raw.vlf",
        make: |b| edited(b, |b| b[padding(b)] = 1),
        fault: |f| matches!(f, Fault::Invalid(what) if what.contains("padding")),
    },
    Damage {
        name: "raw-length-off-by-one.vlf",
        from: "zstd.vlf",
        make: |b| sealing::rebuilt(b, &|chunks| chunks[1].raw += 1),
        fault: |f| matches!(f, Fault::Invalid(what) if what.contains("another size")),
    },
    Damage {
        name: "two-frames.vlf",
        from: "zstd.vlf",
        // The second frame says that it holds nothing, and holds nothing.
        make: |b| sealing::rebuilt(b, &|chunks| chunks[1].bytes.extend(EMPTY_FRAME)),
        fault: |f| matches!(f, Fault::Invalid(what) if what.contains("another size")),
    },
    Damage {
        name: "planes-of-another-length.vlf",
        from: "planes.vlf",
        make: |b| sealing::rebuilt(b, &|chunks| chunks[3].bytes = EMPTY_FRAME.to_vec()),
        fault: |f| matches!(f, Fault::Invalid(what) if what.contains("bytes wanted")),
    },
    Damage {
        name: "textured-mirror.vlf",
        from: "raw.vlf",
        make: |b| {
            sealing::rebuilt(b, &|chunks| {
                assert!(chunks[3..].iter_mut().any(|map| texture_a_slot(&mut map.bytes, 2)));
            })
        },
        fault: |f| matches!(f, Fault::Invalid(what) if what.contains("a mirror")),
    },
    Damage {
        name: "textured.tiles",
        from: "total.tiles",
        make: |b| sealing::rebuilt(b, &|chunks| assert!(texture_a_slot(&mut chunks[0].bytes, 0))),
        fault: |f| matches!(f, Fault::Invalid(what) if what.contains("none of dark, constant")),
    },
    Damage {
        name: "overlap.vlf",
        from: "raw.vlf",
        make: |b| with_chunk_moved(b, 4, -64),
        fault: |f| matches!(f, Fault::Invalid(what) if what.starts_with("chunk 4 is not where")),
    },
    Damage {
        name: "hole.vlf",
        from: "raw.vlf",
        make: |b| with_chunk_moved(b, 4, 64),
        fault: |f| matches!(f, Fault::Invalid(what) if what.starts_with("chunk 4 is not where")),
    },
];

fn edited(bytes: &[u8], edit: impl FnOnce(&mut [u8])) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    edit(&mut bytes);
    bytes
}

/// Edits first block and directory, then makes their hashes fit again.
fn resealed(bytes: &[u8], edit: impl FnOnce(&mut [u8])) -> Vec<u8> {
    edited(bytes, |b| {
        edit(b);
        sealing::seal_head(b).unwrap();
    })
}

/// A zstd frame of no bytes, which says so.
const EMPTY_FRAME: [u8; 9] = [0x28, 0xb5, 0x2f, 0xfd, 0x20, 0, 1, 0, 0];

/// Says of a tile map's first dark slot of a surface that it is textured, if it has one.
fn texture_a_slot(map: &mut [u8], surface: u32) -> bool {
    let [n, entries] = [0, 8].map(|at| number(&map[at..at + 4]) as usize);
    let surfaces = (16 + 4 * (n * n + 1)).next_multiple_of(8);
    let values = (surfaces + 4 * entries).next_multiple_of(8);
    let states = values + 8 * entries;
    let of = |slot: usize| number(&map[surfaces + 4 * (slot / 2)..][..4]) as u32;
    let slot = (0..2 * entries).find(|slot| of(*slot) == surface && map[states + slot] == 0);
    if let Some(slot) = slot {
        map[states + slot] = 3;
    }
    slot.is_some()
}

/// Where the first byte of padding is.
fn padding(file: &[u8]) -> usize {
    let mut ends =
        (0..sealing::chunks(file).unwrap()).map(|k| sealing::stored(file, k).unwrap().end);
    ends.find(|end| end % 64 != 0).unwrap()
}

/// Moves a chunk, and all behind it, by a multiple of 64 bytes.
fn with_chunk_moved(file: &[u8], chunk: usize, by: i64) -> Vec<u8> {
    let from = sealing::stored(file, chunk).unwrap().start;
    let mut out = match by {
        0.. => [&file[..from], &vec![0; by as usize], &file[from..]].concat(),
        _ => [&file[..from - by.unsigned_abs() as usize], &file[from..]].concat(),
    };
    for k in chunk..sealing::chunks(file).unwrap() {
        let at = sealing::entry(k).start + 16;
        let offset = number(&file[at..at + 8]).wrapping_add_signed(by);
        out[at..at + 8].copy_from_slice(&offset.to_le_bytes());
    }
    sealing::seal(&mut out);
    out
}

/// The stored bytes of a chunk.
fn chunk_of(file: &mut [u8], kind: ChunkKind) -> &mut [u8] {
    let directory = Directory::parse(file, file.len() as u64, &Limits::default()).unwrap();
    let entry = directory.entries.iter().find(|e| e.id.kind == kind).unwrap();
    &mut file[entry.offset as usize..][..entry.stored as usize]
}

/// Swaps the bytes of two maps of one length.
fn with_two_chunks_swapped(pack: &[u8]) -> Vec<u8> {
    let directory = Directory::parse(pack, pack.len() as u64, &Limits::default()).unwrap();
    let bytes = |i: usize| {
        let entry = &directory.entries[i];
        entry.offset as usize..(entry.offset + entry.stored) as usize
    };
    let maps = 3..directory.entries.len();
    let pairs = maps.clone().flat_map(|a| maps.clone().map(move |b| (a, b)));
    let (a, b) = { pairs }
        .find(|(a, b)| {
            let (one, two) = (&pack[bytes(*a)], &pack[bytes(*b)]);
            one.len() == two.len() && one != two
        })
        .expect("no two maps have one length");
    edited(pack, |out| {
        out[bytes(a)].copy_from_slice(&pack[bytes(b)]);
        out[bytes(b)].copy_from_slice(&pack[bytes(a)]);
    })
}

fn spec() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("format-spec")
}

/// A little-endian number of up to eight bytes.
fn number(bytes: &[u8]) -> u64 {
    bytes.iter().rev().fold(0, |sum, b| sum << 8 | u64::from(*b))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

fn tiny_scene() -> Scene {
    let mut library = |_: &str| Ok(MTL.into());
    Scene::from_text(Path::new("tiny.obj"), OBJ, &mut library).unwrap().0
}

/// The tiny scene with an image of two by two pixels on its floor, not repeated across its rows.
fn tiny_scene_with_image() -> Scene {
    let mut image = Vec::new();
    let mut encoder = png::Encoder::new(&mut image, 2, 2);
    encoder.set_color(png::ColorType::Rgb);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(&PIXELS).unwrap();
    writer.finish().unwrap();
    let obj = OBJ.replace("f 1 2 3 4", "vt 0 0\nvt 3 0\nvt 3 1\nvt 0 1\nf 1/1 2/2 3/3 4/4");
    let mtl = MTL.replace("0.6 0.5 0.4", "0.6 0.5 0.4\nmap_Kd i.png");
    let mut file =
        |name: &str| Ok(if name == "i.png" { image.clone() } else { mtl.clone().into() });
    Scene::from_text(Path::new("tiny.obj"), &obj, &mut file).unwrap().0
}

/// The image of [`tiny_scene_with_image`].
const PIXELS: [u8; 12] = [255, 0, 0, 0, 255, 0, 0, 0, 255, 188, 188, 188];

fn parameters() -> Parameters {
    Parameters {
        directions: 9,
        resolution: 8,
        tile: 4,
        cycles: Some(3),
        unshot_fraction: 1e-3,
        perturbations: vec![1],
        thinned: 0,
        texel_cells: 1.0,
        refined: 1.0,
        supersample: false,
        filter: 0,
        one_sided: false,
        transfer: Transfer::Sample,
        specular: Specular::Maps,
        resample: false,
        target_error: 0.0,
    }
}

/// Bakes the tiny scene; stops in the given cycle after its first direction.
fn bake_tiny(path: &Path, stop_in: Option<u32>) -> Outcome {
    bake_scene(&tiny_scene(), path, stop_in)
}

fn bake_scene(scene: &Scene, path: &Path, stop_in: Option<u32>) -> Outcome {
    let stop = AtomicBool::new(false);
    let progress = |p: &bake::Progress| {
        if !p.preparing && p.phase == Phase::Propagating && Some(p.cycle) == stop_in {
            stop.store(true, Ordering::Relaxed);
        }
    };
    let options = Options {
        memory: 256 << 20,
        threads: 1,
        stop: &stop,
        progress: &progress,
        order: Some((0..9).collect()),
        commit_every: 1e9,
        terms: Terms::default(),
        force: false,
    };
    bake::bake(scene, &parameters(), path, &options).unwrap()
}

/// The sound samples, made now.
fn made() -> &'static HashMap<&'static str, Vec<u8>> {
    static MADE: OnceLock<HashMap<&str, Vec<u8>>> = OnceLock::new();
    MADE.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let (field, half) = (folder.path().join("tiny.field"), folder.path().join("half.field"));
        assert_eq!(bake_tiny(&field, None), Outcome::Finished);
        assert_eq!(bake_tiny(&half, Some(1)), Outcome::Stopped);
        let images = folder.path().join("images.field");
        assert_eq!(bake_scene(&tiny_scene_with_image(), &images, Some(0)), Outcome::Stopped);
        let pack = |options| {
            let out = folder.path().join("tiny.vlf");
            vlf::pack::pack_from(&Disk::new(&field), &out, &options, &|_| ()).unwrap();
            fs::read(out).unwrap()
        };
        let exact = |codec| pack(PackOptions::exact(codec));
        let lossy = PackOptions { max_error: 0.01, ..PackOptions::exact(Codec::Planes) };
        let read = |path: PathBuf| fs::read(path).unwrap();
        HashMap::from([
            ("manifest", read(half.join("manifest-1"))),
            ("scene", read(half.join("scene"))),
            (IMAGES, read(images.join("scene"))),
            ("textures", read(half.join("textures-0001"))),
            ("sums", read(half.join("sums-00000003"))),
            ("unshot.tiles", read(half.join("unshot-0001/000000.tiles"))),
            ("total.tiles", read(field.join("total/000000.tiles"))),
            ("raw.vlf", exact(Codec::Raw)),
            ("zstd.vlf", exact(Codec::Zstd)),
            ("planes.vlf", exact(Codec::Planes)),
            ("textured.vlf", pack(lossy)),
            ("mirrors.vlf", pack(PackOptions { diffuse: Diffuse::Texture, ..lossy })),
        ])
    })
}

fn sample(name: &str) -> Vec<u8> {
    let path = spec().join("samples").join(name);
    fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// First block and every chunk, decoded.
fn contents(file: &[u8]) -> (Header, Vec<(container::ChunkId, Vec<u8>)>) {
    let directory = Directory::parse(file, file.len() as u64, &Limits::default()).unwrap();
    let chunks = directory.entries.iter();
    let chunks = chunks.map(|e| (e.id, directory.chunk(file, e).unwrap().into_owned())).collect();
    (directory.header, chunks)
}

fn open_pack(bytes: &[u8]) -> Result<LightField, LookError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sample.vlf");
    fs::write(&path, bytes).unwrap();
    LightField::open(&path)
}

/// Where the radiance of the samples is looked up: surface, point in the unit ball, direction.
fn places() -> Vec<(u32, Vec3, Vec3)> {
    let scene = tiny_scene();
    let mut places = Vec::new();
    for id in scene.surface_ids() {
        let s = scene.surface(id);
        for (x, y) in [(0.5, 0.5), (0.25, 0.75)] {
            let point = s.origin + s.u * (s.extent.x * x) + s.v * (s.extent.y * y);
            for slope in [0.0, 0.7] {
                places.push((id.0, point, (s.normal + s.u * slope + s.v * 0.2).normalize()));
            }
        }
    }
    places
}

fn looked_up(field: &LightField) -> Vec<[f32; 3]> {
    places()
        .iter()
        .map(|(s, p, away)| field.radiance(SurfaceId(*s), *p, *away).unwrap().0)
        .collect()
}

/// What `expected.json` says.
fn expected(files: &HashMap<&'static str, Vec<u8>>) -> Value {
    let field = open_pack(&files["raw.vlf"]).unwrap();
    let radiance: Vec<_> = { places().into_iter() }
        .zip(looked_up(&field))
        .map(|((surface, point, away), radiance)| {
            let (point, away) = (point.to_array(), away.to_array());
            json!({"surface": surface, "point": point, "away": away, "radiance": radiance})
        })
        .collect();
    let (header, _) = contents(&files["raw.vlf"]);
    let other = |name| (name, looked_up(&open_pack(&files[name]).unwrap()));
    json!({
        "others": HashMap::from(OTHERS.map(other)),
        "field": hex(&header.field),
        "digest": hex(&field.manifest.digest),
        "exponent": header.exponent,
        "surfaces": header.surfaces,
        "parameters": field.manifest.parameters,
        "radiance": radiance,
    })
}

#[test]
fn samples_are_those_of_this_version() {
    if std::env::var_os("VLF_WRITE_SAMPLES").is_some() {
        write_samples();
        panic!(
            "the samples have been made again; look at them, then run without VLF_WRITE_SAMPLES"
        );
    }
    for (name, same_bytes) in SOUND {
        let (ours, kept) = (&made()[name], sample(name));
        if same_bytes {
            assert!(ours == &kept, "{name}: other bytes than when it was made");
        } else if name != "manifest" {
            assert!(contents(ours) == contents(&kept), "{name}: holds something else");
        }
    }
    let manifest = |bytes: &[u8]| {
        let (header, mut manifest) =
            Manifest::from_file("manifest", bytes, &Limits::default()).unwrap();
        manifest.statistics = Statistics::default();
        (header, manifest)
    };
    assert_eq!(manifest(&made()["manifest"]), manifest(&sample("manifest")));
}

/// A sample that is read like the one that it is made from, but must not be changed.
const READ_ONLY: &str = "read-only.tiles";

fn read_only(total: &[u8]) -> Vec<u8> {
    resealed(total, |b| b[24] = 1 << 7)
}

#[test]
fn a_feature_required_to_write_does_not_keep_from_reading() {
    let (sound, file) = (sample("total.tiles"), sample(READ_ONLY));
    assert!(file == read_only(&sound), "made otherwise");
    read_all(READ_ONLY, &file).unwrap();
    let ((header, chunks), sound) = (contents(&file), contents(&sound));
    assert_eq!(chunks, sound.1);
    assert_eq!(header.check_writable(), Err(Fault::ReadOnlyFeature(7)));
    assert_eq!(sound.0.check_writable(), Ok(()));
    let text = fs::read_to_string(spec().join("README.md")).unwrap();
    assert!(text.contains(READ_ONLY), "{READ_ONLY} is not in the specification");
}

fn write_samples() {
    let folder = spec().join("samples");
    fs::create_dir_all(folder.join("damaged")).unwrap();
    fs::create_dir_all(folder.join("images")).unwrap();
    for (name, bytes) in made() {
        fs::write(folder.join(name), bytes).unwrap();
    }
    fs::write(folder.join(READ_ONLY), read_only(&made()["total.tiles"])).unwrap();
    for damage in &DAMAGED {
        let bytes = (damage.make)(&made()[damage.from]);
        fs::write(folder.join("damaged").join(damage.name), bytes).unwrap();
    }
    write_seeds();
    let text = serde_json::to_string_pretty(&expected(made())).unwrap();
    fs::write(folder.join("expected.json"), text + "\n").unwrap();
}

/// What the samples' chunks hold, for the fuzz targets to begin with.
fn write_seeds() {
    let seeds = spec().with_file_name("fuzz").join("corpus-seeds");
    for name in ["manifest", "scene", IMAGES, "unshot.tiles", "total.tiles", "raw.vlf"] {
        for (place, (id, bytes)) in contents(&made()[name]).1.into_iter().enumerate() {
            let target = match id.kind {
                ChunkKind::Record => "manifest",
                ChunkKind::Scene => "stored",
                ChunkKind::Unshot | ChunkKind::Arrived | ChunkKind::Total => "tile",
                _ => continue,
            };
            let write = |target: &str, bytes: &[u8]| {
                fs::create_dir_all(seeds.join(target)).unwrap();
                fs::write(
                    seeds.join(target).join(format!("{name}-{place}").replace('/', "-")),
                    bytes,
                )
                .unwrap();
            };
            write(target, &bytes);
            if target == "tile" && name != "raw.vlf" {
                let layout = Layout::check(&bytes, 8, 4, 3, 0).unwrap();
                write("planes", &to_planes(&TileMap::new(&bytes, &layout)));
            }
        }
    }
}

#[test]
fn sound_samples_say_what_is_expected() {
    let kept: HashMap<_, _> = SOUND.iter().map(|(name, _)| (*name, sample(name))).collect();
    let said: Value = serde_json::from_slice(&sample("expected.json")).unwrap();
    // Through text, so that both went through one parser.
    let says: Value = serde_json::from_str(&expected(&kept).to_string()).unwrap();
    assert_eq!(says, said);
    let (raw_header, _) = contents(&kept["raw.vlf"]);
    let packs = LOSSLESS.map(|name| open_pack(&kept[name]).unwrap());
    let raw = &packs[0];
    packs.iter().for_each(|pack| assert_eq!(looked_up(raw), looked_up(pack)));
    let is_textured = |(id, map): &(container::ChunkId, Vec<u8>)| {
        let layout = || Layout::check_packed(map, (8, 4), 3, raw_header.exponent);
        id.kind == ChunkKind::Total && layout().unwrap().is_textured()
    };
    assert!(contents(&kept["textured.vlf"]).1.iter().any(is_textured));
    // Off by what was asked for, and mirrors by as much.
    let textured = looked_up(&open_pack(&kept["textured.vlf"]).unwrap());
    assert!(textured != looked_up(raw));
    for (found, true_) in textured.iter().zip(looked_up(raw)) {
        let near = |c: usize| (found[c] - true_[c]).abs() <= 0.0101 * true_[0].max(true_[2]);
        assert!((0..3).all(near), "{found:?}, not {true_:?}");
    }
    // What the scene alone decides: the lamp shines 8 8 6 from its front, to within f16.
    let lamp = looked_up(raw)[4];
    assert!((lamp[0] - 8.0).abs() < 0.01 && (lamp[2] - 6.0).abs() < 0.01, "{lamp:?}");
    assert!(looked_up(raw)[0].iter().all(|c| *c > 0.1), "the floor is dark");

    let (_, manifest) =
        Manifest::from_file("manifest", &kept["manifest"], &Limits::default()).unwrap();
    assert_eq!((manifest.phase, manifest.cycle), (Phase::Propagating, 1));
    assert!(manifest.has_sums && manifest.done_count() == 1 && manifest.is_done(0));
    assert_eq!(manifest.parameters, parameters());
    let (header, chunks) = contents(&kept["scene"]);
    assert_eq!(stored::from_bytes(&chunks[0].1, &Limits::default()).unwrap(), tiny_scene());
    assert_eq!(manifest.scene_hash, XxHash3_128::oneshot(&chunks[0].1).to_le_bytes());
    let layout = bake::texels(&tiny_scene(), &parameters());
    for (_, bytes) in contents(&kept["textures"]).1 {
        texels::from_bytes(&bytes, 2 * layout.len()).unwrap();
    }
    let sums = &contents(&kept["sums"]).1[0].1;
    let head = 2 * 10 * 16 + 4 * header.surfaces as usize;
    assert_eq!(sums.len(), head + 2 * 2 * layout.len() * 32);
    for name in ["unshot.tiles", "total.tiles"] {
        for (_, bytes) in contents(&kept[name]).1 {
            Layout::check(&bytes, 8, 4, header.surfaces, header.exponent).unwrap();
        }
    }
}

/// The field's identity and the digest, worked out as the specification says.
#[test]
fn identity_and_digest_are_as_specified() {
    let pack = sample("raw.vlf");
    let (header, chunks) = contents(&pack);
    let (record, scene) = (&chunks[0].1, &chunks[1].1);
    let scene_hash = XxHash3_128::oneshot(scene).to_le_bytes();
    // Revision and parameters stand at the record's beginning, the hash of the scene behind them.
    let until_hash = record.windows(16).position(|w| w == scene_hash).unwrap() + 16;
    assert_eq!(header.field, XxHash3_128::oneshot(&record[..until_hash]).to_le_bytes());
    // A tile file's chunk has its own hash, which the pack's has too when it is stored alike.
    let tiles = sample("total.tiles");
    let directory = Directory::parse(&tiles, tiles.len() as u64, &Limits::default()).unwrap();
    let packed = Directory::parse(&pack, pack.len() as u64, &Limits::default()).unwrap();
    let entry = packed.find(ChunkKind::Total, 0).unwrap();
    assert_eq!(directory.entries[0].hash, entry.hash);
    let mut seed = header.field.to_vec();
    seed.extend(8u32.to_le_bytes());
    seed.extend(3u32.to_le_bytes());
    seed.extend(0u32.to_le_bytes());
    let stored = &pack[entry.offset as usize..][..entry.stored as usize];
    assert_eq!(entry.hash, XxHash3_64::oneshot_with_seed(XxHash3_64::oneshot(&seed), stored));
}

/// Reads a file of the name's kind to the last number.
fn read_all(name: &str, bytes: &[u8]) -> Result<(), FormatError> {
    if name.ends_with(".vlf") {
        let field = match open_pack(bytes) {
            Err(LookError::Format(e)) => return Err(e),
            other => other.unwrap(),
        };
        return (0..9).try_for_each(|d| field.map(d).map(|_| ()));
    }
    let directory = container::open(name, bytes, FileKind::Tiles, &Limits::default())?;
    let Header { resolution, tile, surfaces, exponent, .. } = directory.header;
    let chunk = |entry| {
        let bytes = directory.chunk(bytes, entry)?;
        Layout::check(&bytes, resolution, tile, surfaces, exponent).map(|_| ())
    };
    directory.entries.iter().try_for_each(chunk).map_err(|f| f.in_file(name))
}

#[test]
fn damaged_samples_are_refused_for_the_right_reason() {
    let text = fs::read_to_string(spec().join("README.md")).unwrap();
    for name in { ["total.tiles", "unshot.tiles"].iter() }.chain(&LOSSLESS).chain(&OTHERS) {
        read_all(name, &sample(name)).unwrap();
    }
    for damage in &DAMAGED {
        let bytes = sample(&format!("damaged/{}", damage.name));
        let error = read_all(damage.name, &bytes).expect_err(damage.name);
        assert!((damage.fault)(&error.fault), "{}: {error}", damage.name);
        assert!(text.contains(damage.name), "{} is not in the specification", damage.name);
        assert!(bytes == (damage.make)(&sample(damage.from)), "{}: made otherwise", damage.name);
    }
}

/// The rows `| offset | bytes | name |...` of the table under a heading.
fn table(heading: &str) -> Vec<(usize, usize, String)> {
    let text = fs::read_to_string(spec().join("README.md")).unwrap();
    let (_, rest) = text.split_once(heading).unwrap_or_else(|| panic!("no heading {heading}"));
    let rows = rest.lines().skip_while(|l| !l.starts_with('|')).take_while(|l| l.starts_with('|'));
    let cell = |row: &str, i: usize| row.split('|').nth(i).unwrap().trim().to_owned();
    rows.filter_map(|row| {
        Some((cell(row, 1).parse().ok()?, cell(row, 2).parse().ok()?, cell(row, 3)))
    })
    .collect()
}

/// Checks that a table's rows follow one another without a hole up to `end`.
fn is_gapless(rows: &[(usize, usize, String)], end: usize) {
    let mut at = 0;
    for (offset, size, name) in rows {
        assert_eq!(*offset, at, "{name}");
        at += size;
    }
    assert_eq!(at, end);
}

#[test]
fn the_first_block_is_as_specified() {
    let rows = table("## First block");
    is_gapless(&rows, FIRST_BLOCK);
    for (name, _) in SOUND {
        let file = sample(name);
        let directory = Directory::parse(&file, file.len() as u64, &Limits::default()).unwrap();
        let h = &directory.header;
        let table = &file[FIRST_BLOCK..][..ENTRY * directory.entries.len()];
        for (offset, size, field) in &rows {
            let bytes = &file[*offset..offset + size];
            let value = match field.as_str() {
                "magic" => number(&container::MAGIC),
                "byte order" => 0x0102_0304,
                "major version" => 1,
                "file kind" => h.kind as u64,
                "directions" => h.directions.into(),
                "resolution" => h.resolution.into(),
                "tile" => h.tile.into(),
                "exponent" => u64::from(h.exponent as u32),
                "surfaces" => h.surfaces.into(),
                "generation" => h.generation.into(),
                "direction" => h.direction.into(),
                "chunks" => directory.entries.len() as u64,
                "directory hash" => XxHash3_64::oneshot(table),
                "file length" => file.len() as u64,
                "first block hash" => XxHash3_64::oneshot(&file[..248]),
                "field" => {
                    assert_eq!(bytes, h.field);
                    continue;
                }
                "optional" => u64::from(name == "mirrors.vlf"),
                "minor version" | "required to read" | "required to write" | "reserved" => {
                    assert!(bytes.iter().all(|b| *b == 0), "{name}: {field}");
                    continue;
                }
                other => panic!("the specification names `{other}`"),
            };
            assert_eq!(number(bytes), value, "{name}: {field} at {offset}");
        }
    }
}

#[test]
fn a_directory_entry_is_as_specified() {
    let rows = table("## Directory");
    is_gapless(&rows, ENTRY);
    for (name, _) in SOUND {
        let file = sample(name);
        let directory = Directory::parse(&file, file.len() as u64, &Limits::default()).unwrap();
        for (i, entry) in directory.entries.iter().enumerate() {
            for (offset, size, field) in &rows {
                let bytes = &file[FIRST_BLOCK + ENTRY * i + offset..][..*size];
                let value = match field.as_str() {
                    "chunk kind" => entry.id.kind as u64,
                    "cycle" => entry.id.cycle.into(),
                    "direction" => entry.id.direction.into(),
                    "codec" => entry.codec as u64,
                    "offset" => entry.offset,
                    "stored length" => entry.stored,
                    "raw length" => entry.raw,
                    "chunk hash" => entry.hash,
                    "reserved" => {
                        assert!(bytes.iter().all(|b| *b == 0), "{name}: {field}");
                        continue;
                    }
                    other => panic!("the specification names `{other}`"),
                };
                assert_eq!(number(bytes), value, "{name}: {field} of entry {i}");
            }
        }
    }
}

/// Takes numbers off the front of bytes: a reader that shares nothing with the library's.
struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn take(&mut self, n: usize) -> &[u8] {
        let (taken, rest) = self.0.split_at(n);
        self.0 = rest;
        taken
    }
    fn u8(&mut self) -> u8 {
        self.take(1)[0]
    }
    fn u32(&mut self) -> u32 {
        number(self.take(4)) as u32
    }
    fn u64(&mut self) -> u64 {
        number(self.take(8))
    }
    fn f64(&mut self) -> f64 {
        f64::from_bits(self.u64())
    }
    fn f32(&mut self) -> f32 {
        f32::from_bits(self.u32())
    }
}

#[test]
fn the_record_is_as_specified() {
    for (file, values) in [("manifest", 1), ("raw.vlf", 3)] {
        let record = contents(&sample(file)).1.swap_remove(0).1;
        let manifest: Manifest = record_from_bytes(&record).unwrap();
        let mut r = Bytes(&record);
        assert_eq!(r.u32(), manifest.revision);
        let p = &manifest.parameters;
        assert_eq!([r.u32(), r.u32(), r.u32()], [p.directions, p.resolution, p.tile]);
        assert_eq!((r.u8(), r.u32()), (1, p.cycles.unwrap()));
        assert_eq!(r.f64(), p.unshot_fraction);
        assert_eq!(r.u64(), 1);
        assert_eq!((r.u32(), r.u32()), (p.perturbations[0], p.thinned));
        assert_eq!((r.f64(), r.f64()), (p.texel_cells, p.refined));
        assert_eq!((r.u8(), r.u32(), r.u8()), (0, p.filter, 0));
        assert_eq!((r.u32(), r.u32()), (p.transfer as u32, p.specular as u32));
        assert_eq!((r.u8(), r.f64()), (0, p.target_error));
        assert_eq!(r.take(16), manifest.scene_hash);
        assert_eq!(r.u32(), manifest.phase as u32);
        assert_eq!(r.u32(), manifest.cycle);
        assert_eq!(r.u64(), 2);
        assert_eq!(r.take(2), manifest.done);
        assert_eq!((r.u64(), r.u8() == 1), (manifest.sequence, manifest.has_sums));
        assert_eq!(r.u64(), values);
        for l in &manifest.ledger {
            assert_eq!(r.u32(), l.cycle);
            let in_out = [l.emitted, l.carried_in, l.absorbed, l.left, l.unshot_diffuse];
            let rest = [l.unshot_mirror, l.holes, l.sampling, l.quantised];
            for value in in_out.into_iter().chain(rest) {
                assert_eq!(r.f64(), value);
            }
        }
        assert_eq!(r.u64(), manifest.grids.len() as u64);
        manifest.grids.iter().for_each(|grids| assert_eq!(r.u32(), *grids));
        let e = &manifest.error;
        assert_eq!([r.f64(), r.f64()], [e.relmse, e.noise]);
        assert_eq!(r.u64(), e.worst.len() as u64);
        for s in &e.worst {
            assert_eq!((r.u32(), [r.f64(), r.f64()]), (s.surface, [s.relmse, s.part]));
        }
        let s = &manifest.statistics;
        assert_eq!(r.f64(), s.seconds);
        let counts = [r.u64(), r.u64(), r.u64(), r.u64(), r.u64()];
        assert_eq!(counts, [s.fragments, s.gathers, s.holes, s.bytes_written, s.entries]);
        let c = &s.cache;
        for count in [c.hits, c.misses, c.evictions, c.redundant, c.bytes, c.peak] {
            assert_eq!(r.u64(), count);
        }
        assert_eq!(r.f64(), c.wait);
        assert_eq!((r.u8() == 1).then(|| r.f64()), s.sync);
        assert_eq!(r.take(16), manifest.digest);
        assert!(r.0.is_empty());
    }
}

#[test]
fn scenes_are_as_specified() {
    for (name, scene) in [("scene", tiny_scene()), (IMAGES, tiny_scene_with_image())] {
        let bytes = contents(&sample(name)).1.swap_remove(0).1;
        is_as_specified(&mut Bytes(&bytes), &scene);
    }
}

fn is_as_specified(r: &mut Bytes, scene: &Scene) {
    assert_eq!([r.f64(), r.f64(), r.f64()], scene.fit.centre.to_array());
    assert_eq!(r.f64(), scene.fit.radius);
    let rgb = |r: &mut Bytes| Rgb([r.f32(), r.f32(), r.f32()]);
    let vec3 = |r: &mut Bytes| Vec3::new(r.f32(), r.f32(), r.f32());
    assert_eq!(r.u32() as usize, scene.materials.len());
    for material in &scene.materials {
        let length = r.u32() as usize;
        assert_eq!(r.take(length), material.name.as_bytes());
        assert_eq!(rgb(r), material.emitted);
        assert_eq!(r.u8() == 1, material.reflectance.is_mirror());
        assert_eq!(rgb(r), material.reflectance.factor());
    }
    assert_eq!(r.u32() as usize, scene.surfaces.len());
    for s in &scene.surfaces {
        assert_eq!(r.u32(), s.material.0);
        for vector in [s.normal, s.origin, s.u, s.v] {
            assert_eq!(vec3(r), vector);
        }
        assert_eq!([r.f32(), r.f32()], s.extent.to_array());
        assert_eq!(r.u8(), s.fineness);
        assert_eq!(r.u32() as usize, s.polygons.len());
        for polygon in &s.polygons {
            assert_eq!(r.u32() as usize, polygon.vertices.len());
            for vertex in &polygon.vertices {
                assert_eq!(vec3(r), *vertex);
            }
        }
    }
    if !scene.images.is_empty() {
        assert_eq!([r.u32(), r.u32(), r.u32()], [1, 2, 2]);
        assert_eq!(r.take(12), PIXELS);
        assert_eq!([r.u32(), r.u32(), r.u32()], [1, 0, 0], "the floor's");
        assert_eq!(r.u8(), 0);
        assert_eq!(rgb(r).0, [0.6, 0.5, 0.4]);
        assert_eq!([r.u32(), r.u32()], [1, 0], "the floor");
        // Three images along its longest edge, whichever way u runs on it.
        let places = [[r.f32(), r.f32()], [r.f32(), r.f32()], [r.f32(), r.f32()]];
        let (floor, [x, y]) = (&scene.surfaces[0], [places[1], places[2]]);
        let edges = [x, y].map(|[s, t]| s.abs().max(t.abs()));
        let shown = [edges[0] * floor.extent.x, edges[1] * floor.extent.y];
        assert!((shown[0].max(shown[1]) - 3.0).abs() < 1e-4, "{shown:?}");
        assert!((shown[0].min(shown[1]) - 1.0).abs() < 1e-4, "{shown:?}");
    }
    assert!(r.0.is_empty());
}

/// Reads a tile map as the specification says and compares every cell with the library's reading.
#[test]
fn a_tile_map_is_as_specified() {
    for file in ["total.tiles", "unshot.tiles", "raw.vlf"] {
        let (header, chunks) = contents(&sample(file));
        let is_map =
            |kind| [ChunkKind::Unshot, ChunkKind::Arrived, ChunkKind::Total].contains(&kind);
        for (_, bytes) in chunks.into_iter().filter(|(id, _)| is_map(id.kind)) {
            let layout = Layout::check(&bytes, 8, 4, header.surfaces, header.exponent).unwrap();
            let mut read = Vec::new();
            TileMap::new(&bytes, &layout).for_each(|s, c, both| read.push((s.0, c.i, c.j, both)));
            assert_eq!(read, by_hand(&bytes, header.exponent), "{file}");
        }
    }
}

fn by_hand(bytes: &[u8], exponent: i32) -> Vec<(u32, u32, u32, [Rgb; 2])> {
    let u32_at = |at: usize| number(&bytes[at..at + 4]) as usize;
    let pad = |at: usize| at.div_ceil(8) * 8;
    let (n, m, e, v) = (u32_at(0), u32_at(4), u32_at(8), u32_at(12));
    let words = (m * m).div_ceil(64);
    let surface_at = pad(16 + 4 * (n * n + 1));
    let value_at = pad(surface_at + 4 * e);
    let state_at = pad(value_at + 8 * e);
    let mask_at = pad(state_at + 2 * e);
    let rgb_at = mask_at + 8 * words * e;
    assert_eq!(bytes.len(), pad(rgb_at + 6 * v));
    let rgb = |value: usize| {
        let channel = |c: usize| {
            let bits = number(&bytes[rgb_at + 6 * value + 2 * c..][..2]) as u16;
            half::f16::from_bits(bits).to_f32() * 2f32.powi(exponent)
        };
        Rgb([channel(0), channel(1), channel(2)])
    };
    let mut out = Vec::new();
    for tile in 0..n * n {
        for entry in u32_at(16 + 4 * tile)..u32_at(20 + 4 * tile) {
            let mut rank = 0;
            for inside in 0..m * m {
                let word = number(&bytes[mask_at + 8 * (words * entry + inside / 64)..][..8]);
                if word >> (inside % 64) & 1 == 0 {
                    continue;
                }
                let both = [0, 1].map(|slot| {
                    let first = u32_at(value_at + 4 * (2 * entry + slot));
                    match bytes[state_at + 2 * entry + slot] {
                        0 => Rgb::BLACK,
                        1 => rgb(first),
                        _ => rgb(first + rank),
                    }
                });
                rank += 1;
                let (i, j) = (tile % n * m + inside % m, tile / n * m + inside / m);
                out.push((u32_at(surface_at + 4 * entry) as u32, i as u32, j as u32, both));
            }
        }
    }
    out
}

/// The lines, from the formulas of the specification alone.
#[test]
fn directions_are_as_specified() {
    for k in 0..=4u32 {
        let m = 1i32 << k;
        let set = vlf::Directions::new(k);
        let mut vectors: Vec<[f64; 3]> = Vec::new();
        for y in -m..=m {
            for x in -m..=m {
                let (u, v) = (f64::from(x.abs()) / f64::from(m), f64::from(y.abs()) / f64::from(m));
                let r = u + v;
                if r > 1.0 {
                    continue;
                }
                let phi = if r == 0.0 { 1.0 } else { (v - u) / r + 1.0 };
                let (sin, cos) = (phi * std::f64::consts::FRAC_PI_4).sin_cos();
                let flat = r * (2.0 - r * r).sqrt();
                let sign = |s: i32| if s < 0 { -1.0 } else { 1.0 };
                let d = [sign(x) * cos * flat, sign(y) * sin * flat, 1.0 - r * r];
                let opposite = |e: &[f64; 3]| {
                    d.iter().zip(e).map(|(a, b)| (a + b).powi(2)).sum::<f64>() < 1e-20
                };
                if !vectors.iter().any(opposite) {
                    vectors.push(d);
                }
            }
        }
        assert_eq!(vectors.len(), set.len(), "k = {k}");
        for (id, d) in set.ids().zip(vectors) {
            assert_eq!(set.vector(id).to_array(), d.map(|c| c as f32), "k = {k}, line {}", id.0);
        }
    }
}
