//! A damaged pack gives an error or the very same light, never a panic and never other light.
//!
//! Every bit of the small packs of `format-spec/samples` is flipped, one at a time, and they are cut at
//! every length. Then they are made to lie, with sound hashes: one number or one chunk at a time. Each
//! variant is opened and looked up in all directions.

mod common;
mod sealing;

use glam::Vec3;
use sealing::{Chunk, rebuilt};
use std::fs::{self, File};
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::Instant;
use vlf::format::container::{Directory, ENTRY, FIRST_BLOCK};
use vlf::format::limits::{self, Limits};
use vlf::format::{Fault, names};
use vlf::look::lightfield::LookError;
use vlf::{Directions, LightField};

/// All that a pack says: what it is, every cell of every map, and the radiance of every surface in
/// directions all around.
fn everything(path: &Path) -> Result<Vec<u32>, LookError> {
    let field = LightField::open(path)?;
    let mut all: Vec<u32> = Vec::new();
    all.extend(format!("{:?} {:?}", field.manifest, field.scene).bytes().map(u32::from));
    let bits = |rgb: vlf::Rgb| {
        assert!(rgb.is_physical(), "{rgb:?}");
        rgb.0.map(f32::to_bits)
    };
    all.extend(field.total.iter().flat_map(|v| bits(*v)));
    for direction in 0..field.directions.len() as u32 {
        field.map(direction)?.tiles().for_each(|surface, cell, both| {
            all.extend([surface.0, cell.i, cell.j]);
            all.extend(both.into_iter().flat_map(bits));
        });
    }
    let around = Directions::new(1);
    for id in field.scene.surface_ids() {
        let surface = field.scene.surface(id);
        let point =
            surface.origin + 0.4 * (surface.u * surface.extent.x + surface.v * surface.extent.y);
        for line in around.ids() {
            // Off the lattice, so that three lines count.
            let away = (around.vector(line) + Vec3::new(0.1, 0.07, 0.05)).normalize();
            for away in [away, -away] {
                all.extend(bits(field.radiance(id, point, away)?));
            }
        }
    }
    Ok(all)
}

/// A pack that is damaged in place, one way after the other.
struct Patient {
    _folder: tempfile::TempDir,
    path: PathBuf,
    file: File,
    good: Vec<u8>,
    whole: Vec<u32>,
}

impl Patient {
    fn new(name: &str) -> Patient {
        let samples = Path::new(env!("CARGO_MANIFEST_DIR")).join("format-spec/samples");
        let good = fs::read(samples.join(name)).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        fs::write(&path, &good).unwrap();
        let file = File::options().write(true).open(&path).unwrap();
        let whole = everything(&path).unwrap();
        assert!(whole.len() > 1000);
        Patient { _folder: folder, path, file, good, whole }
    }

    fn replace(&mut self, bytes: &[u8]) {
        self.file.set_len(bytes.len() as u64).unwrap();
        self.file.seek(SeekFrom::Start(0)).unwrap();
        self.file.write_all(bytes).unwrap();
    }

    /// The fault for which these bytes are refused; `None` when they say what the pack always said.
    fn fault(&mut self, bytes: &[u8], what: &dyn Fn() -> String) -> Option<Fault> {
        self.replace(bytes);
        match everything(&self.path) {
            Err(LookError::Format(e)) => Some(e.fault),
            Err(e) => panic!("{}: {e}", what()),
            Ok(read) => {
                assert!(read == self.whole, "{}: other light", what());
                None
            }
        }
    }

    fn put(&mut self, at: usize, byte: u8) {
        self.file.seek(SeekFrom::Start(at as u64)).unwrap();
        self.file.write_all(&[byte]).unwrap();
    }

    /// Whether the pack is refused as it now is. Otherwise it must say what it always said.
    fn is_refused(&self, what: &dyn Fn() -> String) -> bool {
        match everything(&self.path) {
            Err(LookError::Format(_)) => true,
            Err(e) => panic!("{}: {e}", what()),
            Ok(read) => {
                assert!(read == self.whole, "{}: other light", what());
                false
            }
        }
    }
}

#[test]
fn every_flipped_bit_is_refused() {
    for name in ["raw.vlf", "zstd.vlf", "textured.vlf"] {
        let mut patient = Patient::new(name);
        for at in 0..patient.good.len() {
            let byte = patient.good[at];
            for bit in 0..8 {
                let what = || format!("{name}, bit {bit} of byte {at}");
                patient.put(at, byte ^ 1 << bit);
                assert!(patient.is_refused(&what), "{}: unseen", what());
            }
            patient.put(at, byte);
        }
    }
}

#[test]
fn every_truncation_is_refused() {
    for name in ["raw.vlf", "zstd.vlf", "textured.vlf"] {
        let patient = Patient::new(name);
        for len in (0..patient.good.len()).rev() {
            patient.file.set_len(len as u64).unwrap();
            assert!(patient.is_refused(&|| format!("{name}, {len} bytes")), "{name}, {len} bytes");
        }
    }
}

#[test]
fn lies_with_sound_hashes_are_refused_or_stay_in_bounds() {
    let mut patient = Patient::new("raw.vlf");
    let good = patient.good.clone();
    let directory = Directory::parse(&good, good.len() as u64, &Limits::default()).unwrap();
    let mut taken = 0;
    for (k, entry) in directory.entries.iter().enumerate().take(5) {
        let own = FIRST_BLOCK + ENTRY * k..FIRST_BLOCK + ENTRY * (k + 1);
        let block = if k == 0 { 0..FIRST_BLOCK - 8 } else { 0..0 };
        let chunk = entry.offset as usize..(entry.offset + entry.stored) as usize;
        for (at, bit) in
            block.chain(own).chain(chunk).flat_map(|at| (0..8).map(move |bit| (at, bit)))
        {
            let mut bytes = good.clone();
            bytes[at] ^= 1 << bit;
            if sealing::seal_chunk(&mut bytes, k).and(sealing::seal_head(&mut bytes)).is_none() {
                continue;
            }
            patient.replace(&bytes);
            match everything(&patient.path) {
                Err(LookError::Format(_)) => {}
                Err(e) => panic!("bit {bit} of byte {at}: {e}"),
                Ok(_) => taken += 1,
            }
        }
    }
    assert!(taken > 100, "only {taken} were taken: the hashes do not fit");
}

/// A bit in each mask of features, one at a time: unknown ones are refused, or keep from writing, or
/// do nothing.
#[test]
fn unknown_features_mean_what_their_mask_says() {
    let mut patient = Patient::new("raw.vlf");
    for bit in 0..64 {
        let mut with = |mask: usize| {
            let mut bytes = patient.good.clone();
            bytes[mask + bit / 8] ^= 1 << (bit % 8);
            sealing::seal_head(&mut bytes).unwrap();
            let fault = patient.fault(&bytes, &|| format!("bit {bit} of the mask at {mask}"));
            (
                fault,
                Directory::parse(&bytes, bytes.len() as u64, &Limits::default()).map(|d| d.header),
            )
        };
        let (read, write) = (with(16), with(24));
        let feature = Fault::Feature(bit as u32);
        assert!(feature.is_unsupported());
        assert_eq!(read, (Some(feature.clone()), Err(feature)));
        let read_only = Fault::ReadOnlyFeature(bit as u32);
        assert!(read_only.is_unsupported());
        assert_eq!(write.0, None);
        assert_eq!(write.1.unwrap().check_writable(), Err(read_only));
        // The first optional one is known: it says where diffuse light is looked up.
        if bit > 0 {
            let optional = with(32);
            assert_eq!(optional.0, None);
            assert_eq!(optional.1.unwrap().check_writable(), Ok(()));
        }
    }
}

/// Every number of the first block and of the entries is 0, 1, and about every power of two at which
/// something may wrap, with sound hashes.
#[test]
fn hostile_numbers_are_refused_at_once() {
    const EXPONENT: usize = 56;
    const OPTIONAL: usize = 32;
    let values = [0, 1, (1 << 31) - 1, 1 << 31, (1 << 31) + 1, u32::MAX.into(), 1 << 32];
    let values = values.into_iter().chain([(1 << 32) + 1, 1 << 63, (1 << 63) + 1, u64::MAX]);
    let of_block = [(12, 2), (14, 2), (80, 4), (84, 4)].into_iter();
    let of_block = of_block.chain((40..64).step_by(4).map(|at| (at, 4)));
    let of_block = of_block.chain([16, 24, 32, 88, 96, 104].map(|at| (at, 8)));
    let of_entry = [(0, 4), (4, 4), (8, 4), (12, 4), (16, 8), (24, 8), (32, 8), (40, 8)];
    for name in ["raw.vlf", "zstd.vlf", "textured.vlf"] {
        let mut patient = Patient::new(name);
        let entries = sealing::chunks(&patient.good).unwrap();
        let of_entries = (0..entries)
            .flat_map(|k| of_entry.map(|(at, size)| (sealing::entry(k).start + at, size)));
        let fields: Vec<(usize, usize)> = of_block.clone().chain(of_entries).collect();
        for ((at, size), value) in
            fields.iter().flat_map(|field| values.clone().map(move |value| (*field, value)))
        {
            let mut bytes = patient.good.clone();
            let field = &mut bytes[at..at + size];
            // That scales all light; nothing else in the file says how much there is.
            if at == EXPONENT && (-100..=100).contains(&(value as u32 as i32)) {
                continue;
            }
            // That looks diffuse light up elsewhere, in the texture map.
            if at == OPTIONAL && value & 1 == 1 {
                continue;
            }
            field.copy_from_slice(&value.to_le_bytes()[..size]);
            (0..entries).for_each(|k| _ = sealing::seal_chunk(&mut bytes, k));
            _ = sealing::seal_head(&mut bytes);
            let began = Instant::now();
            patient.fault(&bytes, &|| format!("{name}: {value} at {at}"));
            assert!(began.elapsed().as_secs() < 5, "{name}: {value} at {at} takes long");
        }
    }
}

const RECORD: usize = 0;
const SCENE: usize = 1;
const TEXTURE: usize = 2;
const MAP: usize = 3;

/// A zstd frame that states its content size.
fn frame(raw: &[u8]) -> Vec<u8> {
    zstd::bulk::compress(raw, 3).unwrap()
}

/// What is done to the chunks of a pack that stores them raw.
type Tampering = fn(&mut Vec<Chunk>);

#[test]
fn tampered_chunks_are_refused() {
    let cases: [(&str, Tampering); 24] = [
        ("a raw length one too small", |c| c[SCENE].raw -= 1),
        ("a raw length one too large", |c| c[SCENE].raw += 1),
        ("a record with a byte more", |c| {
            c[RECORD].bytes.push(0);
            c[RECORD].raw += 1;
        }),
        ("a scene with a byte less", |c| {
            c[SCENE].bytes.pop();
            c[SCENE].raw -= 1;
        }),
        ("a texture map with a value more", |c| {
            c[TEXTURE].bytes.extend([0; 12]);
            c[TEXTURE].raw += 12;
        }),
        ("a tile map with a byte more", |c| {
            c[MAP].bytes.push(0);
            c[MAP].raw += 1;
        }),
        ("a tile map with a byte less", |c| {
            c[MAP].bytes.pop();
            c[MAP].raw -= 1;
        }),
        ("a frame and a raw length one too small", |c| {
            let frame = frame(&c[SCENE].bytes);
            let raw = c[SCENE].bytes.len() - 1;
            c[SCENE].put(1, raw, frame);
        }),
        ("a frame and a raw length one too large", |c| {
            let frame = frame(&c[SCENE].bytes);
            let raw = c[SCENE].bytes.len() + 1;
            c[SCENE].put(1, raw, frame);
        }),
        ("a frame called raw", |c| {
            let frame = frame(&c[SCENE].bytes);
            c[SCENE].put(0, frame.len(), frame);
        }),
        ("no frame, called one", |c| c[SCENE].codec = 1),
        ("two frames", |c| {
            let (one, two) = c[SCENE].bytes.split_at(100);
            let frames = [frame(one), frame(two)].concat();
            let raw = c[SCENE].bytes.len();
            c[SCENE].put(1, raw, frames);
        }),
        ("a skippable frame before the frame", |c| {
            let skippable = [0x50, 0x2a, 0x4d, 0x18, 4, 0, 0, 0, 1, 2, 3, 4];
            let frames = [&skippable[..], &frame(&c[SCENE].bytes)].concat();
            let raw = c[SCENE].bytes.len();
            c[SCENE].put(1, raw, frames);
        }),
        ("a skippable frame alone", |c| {
            let skippable = [0x50, 0x2a, 0x4d, 0x18, 0, 0, 0, 0];
            c[SCENE].put(1, 0, skippable.to_vec());
        }),
        ("a frame that does not state its size", |c| {
            let frame = zstd::stream::encode_all(&c[SCENE].bytes[..], 3).unwrap();
            let raw = c[SCENE].bytes.len();
            c[SCENE].put(1, raw, frame);
        }),
        ("bytes behind the frame", |c| {
            let frame = [&frame(&c[SCENE].bytes)[..], &[0]].concat();
            let raw = c[SCENE].bytes.len();
            c[SCENE].put(1, raw, frame);
        }),
        ("a record of more zeros than a record may have", |c| {
            let zeros = vec![0; limits::RECORD as usize + 1];
            c[RECORD].put(1, zeros.len(), frame(&zeros));
        }),
        ("a texture map of more zeros than there are texels", |c| {
            let zeros = vec![0; 48 << 20];
            c[TEXTURE].put(1, zeros.len(), frame(&zeros));
        }),
        ("a tile map of more zeros than there are cells", |c| {
            let zeros = vec![0; 1 << 20];
            c[MAP].put(1, zeros.len(), frame(&zeros));
        }),
        ("a map of another cycle", |c| c[MAP].id[4] += 1),
        ("the maps of two lines swapped, and their entries with them", |c| c.swap(MAP, MAP + 1)),
        ("a map twice", |c| c[MAP + 1] = c[MAP].clone()),
        ("a map missing", |c| _ = c.remove(MAP + 1)),
        ("a chunk that packs do not have", |c| c[TEXTURE].id[0] = 4),
    ];
    let mut patient = Patient::new("raw.vlf");
    let good = patient.good.clone();
    assert!(rebuilt(&good, &|_| ()) == good);
    for (name, tamper) in cases {
        let fault = patient.fault(&rebuilt(&good, &tamper), &|| name.to_owned());
        let fault = fault.unwrap_or_else(|| panic!("{name}: not refused"));
        assert!(!matches!(fault, Fault::Checksum { .. }), "{name}: {fault}");
    }
    // Whatever is stored, it may be a frame.
    let frames = rebuilt(&good, &|chunks| {
        for chunk in chunks {
            let frame = frame(&chunk.bytes);
            chunk.put(1, chunk.bytes.len(), frame);
        }
    });
    assert_eq!(patient.fault(&frames, &|| "frames".to_owned()), None);
}

/// Sound chunks where they do not belong, with the hashes they had: what only the hash's seed tells.
#[test]
fn sound_chunks_in_the_wrong_place_are_refused() {
    let mut patient = Patient::new("raw.vlf");
    let good = patient.good.clone();
    let maps = MAP..sealing::chunks(&good).unwrap();
    let bytes = |k| sealing::stored(&good, k).unwrap();
    let mut swapped = 0;
    for (a, b) in maps.clone().flat_map(|a| maps.clone().map(move |b| (a, b))) {
        if bytes(a).len() != bytes(b).len() || good[bytes(a)] == good[bytes(b)] {
            continue;
        }
        let mut file = good.clone();
        file[bytes(a)].copy_from_slice(&good[bytes(b)]);
        let hash = good[sealing::entry(b)][40..48].to_vec();
        file[sealing::entry(a)][40..48].copy_from_slice(&hash);
        sealing::seal_head(&mut file).unwrap();
        let fault = patient.fault(&file, &|| format!("map {b} as {a}"));
        assert!(matches!(fault, Some(Fault::Checksum { .. })), "map {b} as {a}: {fault:?}");
        swapped += 1;
    }
    assert!(swapped > 0);
    // The same map, as it would be of a bake that went on for another cycle.
    let older = rebuilt(&good, &|chunks| chunks[MAP].id[4] -= 1);
    let mut file = good.clone();
    let hash = older[sealing::entry(MAP)][40..48].to_vec();
    file[sealing::entry(MAP)][40..48].copy_from_slice(&hash);
    sealing::seal_head(&mut file).unwrap();
    let fault = patient.fault(&file, &|| "an older map".to_owned());
    assert!(matches!(fault, Some(Fault::Checksum { .. })), "{fault:?}");
}

#[test]
fn chunks_lie_in_order_without_hole_or_overlap() {
    let mut patient = Patient::new("raw.vlf");
    let good = patient.good.clone();
    let chunks = sealing::chunks(&good).unwrap();
    let mut file_with = |what: &str, file: Vec<u8>| {
        let fault = patient.fault(&file, &|| what.to_owned());
        assert!(fault.is_some(), "{what}: not refused");
    };
    // Each chunk 64 bytes earlier or later, into its neighbours or away from them.
    for chunk in 0..chunks {
        for by in [-64, 64, 1i64] {
            let mut file = good.clone();
            let at = sealing::entry(chunk).start + 16;
            let offset = sealing::number(&good[at..at + 8]).wrapping_add_signed(by);
            file[at..at + 8].copy_from_slice(&offset.to_le_bytes());
            sealing::seal(&mut file);
            file_with(&format!("chunk {chunk} by {by}"), file);
        }
    }
    let sealed = |mut file: Vec<u8>| {
        sealing::seal(&mut file);
        file
    };
    file_with("a byte behind the end", sealed([&good[..], &[0]].concat()));
    file_with("a block behind the end", sealed([&good[..], &[0; 64]].concat()));
    file_with("a byte less", sealed(good[..good.len() - 1].to_vec()));
    file_with("a zip before the beginning", [b"PK\x03\x04", &good[..]].concat());
    // A block between the directory and the first chunk, all offsets with it.
    let mut file = good.clone();
    let first = sealing::stored(&good, 0).unwrap().start;
    file.splice(first..first, [0; 64]);
    for chunk in 0..chunks {
        let at = sealing::entry(chunk).start + 16;
        let offset = sealing::number(&good[at..at + 8]) + 64;
        file[at..at + 8].copy_from_slice(&offset.to_le_bytes());
    }
    file_with("a hole", sealed(file));
}

/// Files of a field that are sound but belong to another line, generation or field.
#[test]
fn sound_files_in_the_wrong_place_are_refused() {
    let scene = common::scene("parallel_squares");
    let baked = common::Baked::new(&scene, &common::parameters(33, 16, 1));
    let other = common::Baked::new(&scene, &common::parameters(33, 32, 1));
    let cycle = LightField::open(&baked.path).unwrap().manifest.cycle;
    let textures = names::textures(cycle);
    let total = |direction| names::tiles(&baked.path, names::TOTAL, direction);
    let others = names::tiles(&other.path, names::TOTAL, 7);
    let others_textures = other.path.join(names::textures(cycle));
    for (from, to) in [
        (total(6), total(7)),
        (others, total(7)),
        (other.path.join(names::SCENE), baked.path.join(names::SCENE)),
        (others_textures, baked.path.join(&textures)),
    ] {
        let own = fs::read(&to).unwrap();
        fs::copy(&from, &to).unwrap();
        let fault = LightField::open(&baked.path)
            .and_then(|field| Ok(field.map(7).map(|_| ())?))
            .expect_err(&format!("{} for {}", from.display(), to.display()));
        assert!(fault.to_string().contains("belongs to another"), "{fault}");
        fs::write(&to, own).unwrap();
    }
    LightField::open(&baked.path).unwrap().map(7).unwrap();
}
