//! A damaged pack gives an error or the very same light, never a panic and never other light.
//!
//! Every bit of the first 4 KiB and some of the rest is flipped, one at a time, in the small pack of
//! `format-spec/samples`, and the pack is cut at every length. Each variant is opened and looked up in
//! all directions.

use glam::Vec3;
use std::fs::{self, File};
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use twox_hash::XxHash3_64;
use vlf::format::container::{Directory, ENTRY, FIRST_BLOCK};
use vlf::look::lightfield::LookError;
use vlf::{Directions, LightField};

/// Bytes of which every bit is flipped.
const EVERY_BIT: usize = 4096;
/// Beyond them a bit in every so many bytes; no common factor with the sizes of the tables.
const STRIDE: usize = 5;

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
        field.map(direction)?.for_each(|surface, cell, both| {
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
fn flipped_bits_are_refused_or_change_nothing() {
    for (name, bits) in [("raw.vlf", 8), ("zstd.vlf", 1)] {
        let mut patient = Patient::new(name);
        let len = patient.good.len();
        let every_bit = (0..len.min(EVERY_BIT)).flat_map(|at| (0..bits).map(move |b| (at, b)));
        let some = (EVERY_BIT..len).step_by(STRIDE).map(|at| (at, at % 8));
        let (mut flips, mut unseen) = (0, Vec::new());
        for (at, bit) in every_bit.chain(some) {
            flips += 1;
            let byte = patient.good[at];
            patient.put(at, byte ^ 1 << bit);
            if !patient.is_refused(&|| format!("{name}, bit {bit} of byte {at}")) {
                unseen.push(at);
            }
            patient.put(at, byte);
        }
        // Only padding between chunks may change unseen.
        assert!(unseen.iter().all(|at| patient.good[*at] == 0), "{name}: {unseen:?}");
        assert!(10 * unseen.len() < 3 * flips, "{name}: {} of {flips} unseen", unseen.len());
    }
}

#[test]
fn every_truncation_is_refused() {
    for name in ["raw.vlf", "zstd.vlf"] {
        let patient = Patient::new(name);
        for len in (0..patient.good.len()).rev() {
            patient.file.set_len(len as u64).unwrap();
            assert!(patient.is_refused(&|| format!("{name}, {len} bytes")), "{name}, {len} bytes");
        }
    }
}

/// Makes the hashes of chunk, directory and first block fit the bytes as they now are. `None` when the
/// chunk is not in the file any more.
fn reseal(file: &mut [u8], chunk: usize) -> Option<()> {
    let number = |file: &[u8], at: usize| {
        file.get(at..at + 8)?
            .iter()
            .rev()
            .try_fold(0usize, |n, b| n.checked_mul(256).map(|n| n + usize::from(*b)))
    };
    let entry = FIRST_BLOCK + ENTRY * chunk;
    let (offset, stored) = (number(file, entry + 16)?, number(file, entry + 24)?);
    let mut identity = file[64..80].to_vec();
    identity.extend(&file[entry..entry + 12]);
    let seed = XxHash3_64::oneshot(&identity);
    let bytes = file.get(offset..offset.checked_add(stored)?)?;
    let hash = XxHash3_64::oneshot_with_seed(seed, bytes);
    file[entry + 40..entry + 48].copy_from_slice(&hash.to_le_bytes());
    let end = number(file, 88)?.checked_mul(ENTRY)?.checked_add(FIRST_BLOCK)?;
    let directory = XxHash3_64::oneshot(file.get(FIRST_BLOCK..end)?);
    file[96..104].copy_from_slice(&directory.to_le_bytes());
    let block = XxHash3_64::oneshot(&file[..248]);
    file[248..256].copy_from_slice(&block.to_le_bytes());
    Some(())
}

#[test]
fn lies_with_sound_hashes_are_refused_or_stay_in_bounds() {
    let mut patient = Patient::new("raw.vlf");
    let good = patient.good.clone();
    let directory = Directory::parse(&good, good.len() as u64).unwrap();
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
            if reseal(&mut bytes, k).is_none() {
                continue;
            }
            patient.file.seek(SeekFrom::Start(0)).unwrap();
            patient.file.write_all(&bytes).unwrap();
            match everything(&patient.path) {
                Err(LookError::Format(_)) => {}
                Err(e) => panic!("bit {bit} of byte {at}: {e}"),
                Ok(_) => taken += 1,
            }
        }
    }
    assert!(taken > 100, "only {taken} were taken: the hashes do not fit");
}
