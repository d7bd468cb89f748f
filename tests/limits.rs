//! Limits on what a file may state: what is above one is refused by a message that names the flag,
//! what is at one is not, and a flag that is raised lets more pass.

mod common;
mod sealing;

use std::fs;
use std::path::{Path, PathBuf};
use vlf::format::container::{ChunkKind, Codec, Directory};
use vlf::format::limits::Limits;
use vlf::look::packed::Access;
use vlf::verify::{self, Trouble};
use vlf::{LightField, field};

/// A limit: its flag, and how to set it.
type Setting = (&'static str, fn(&mut Limits, u64));

const DIRECTIONS: Setting = ("--limit-directions", |l, n| l.directions = n as u32);
const RESOLUTION: Setting = ("--limit-resolution", |l, n| l.resolution = n as u32);
const TILE: Setting = ("--limit-tile", |l, n| l.tile = n as u32);
const SURFACES: Setting = ("--limit-surfaces", |l, n| l.surfaces = n as u32);
const TEXELS: Setting = ("--limit-texels", |l, n| l.texels = n);
const CHUNK: Setting = ("--limit-chunk", |l, n| l.chunk = n);

fn with((_, set): Setting, value: u64) -> Limits {
    let mut limits = Limits::default();
    set(&mut limits, value);
    limits
}

fn sample(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("format-spec/samples").join(name)
}

/// Opens a field or a pack and looks at all of its maps.
fn looked_at(path: &Path, limits: &Limits) -> Result<(), String> {
    let field = LightField::open_within(path, Access::Mapped, limits).map_err(|e| e.to_string())?;
    (0..field.directions.len() as u32)
        .try_for_each(|d| field.map(d).map(|_| ()))
        .map_err(|e| e.to_string())
}

/// The figures of a pack, each with the limit that it must keep.
fn figures(pack: &Path) -> [(Setting, u64); 6] {
    let bytes = fs::read(pack).unwrap();
    let length = bytes.len() as u64;
    let Directory { header, entries } =
        Directory::parse(&bytes, length, &Limits::default()).unwrap();
    let most = |kinds: &[ChunkKind]| {
        entries.iter().filter(|e| kinds.contains(&e.id.kind)).map(|e| e.raw).max().unwrap()
    };
    [
        (DIRECTIONS, header.directions.into()),
        (RESOLUTION, header.resolution.into()),
        (TILE, header.tile.into()),
        (SURFACES, header.surfaces.into()),
        (TEXELS, most(&[ChunkKind::TotalTexture]) / 24),
        (CHUNK, most(&[ChunkKind::Scene, ChunkKind::Total])),
    ]
}

#[test]
fn a_good_field_and_its_pack_are_refused_below_their_figures_and_not_at_them() {
    let baked = common::Baked::new(&common::scene("cornell"), &common::parameters(33, 16, 1));
    let pack = baked.path.with_extension("vlf");
    vlf::pack(&baked.path, &pack, Codec::Raw, &|_| ()).unwrap();
    for (setting, figure) in figures(&pack) {
        let flag = setting.0;
        let disk = |limits| field::storage::disk::Disk::within(&baked.path, limits);
        let at = with(setting, figure);
        for path in [&baked.path, &pack] {
            assert_eq!(looked_at(path, &at), Ok(()), "{flag} {figure}");
        }
        assert!(verify::field(&disk(at), &|_| ()).unwrap().is_sound());
        assert!(verify::pack(&pack, &at, &|_| ()).unwrap().is_sound());

        let below = with(setting, figure - 1);
        let names_flag = |said: String| assert!(said.contains(flag), "{flag}: {said}");
        for path in [&baked.path, &pack] {
            names_flag(looked_at(path, &below).expect_err(flag));
        }
        for result in [verify::field(&disk(below), &|_| ()), verify::pack(&pack, &below, &|_| ())] {
            match result {
                Err(e) => names_flag(e.to_string()),
                Ok(report) => {
                    assert_eq!(report.trouble(), Some(Trouble::Limited), "{flag}");
                    names_flag(report.findings[0].to_string());
                }
            }
        }
        let out = baked.path.with_extension("again");
        let options = vlf::pack::Options::exact(Codec::Raw);
        let packed = vlf::pack::pack_from(&disk(below), &out, &options, &|_| ());
        names_flag(packed.expect_err(flag).to_string());
    }
}

#[test]
fn a_count_above_its_limit_is_refused_and_with_the_flag_raised_is_not() {
    let published = Limits::PUBLISHED;
    let good = fs::read(sample("raw.vlf")).unwrap();
    for (setting, at, value, what) in [
        (RESOLUTION, 48, published.resolution * 2, "resolution 16384 exceeds limit 8192"),
        (TILE, 52, published.tile * 2, "tile size 512 exceeds limit 256"),
        (SURFACES, 60, u32::MAX, "surface count 4294967295 exceeds limit 16777216"),
    ] {
        let mut bytes = good.clone();
        bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
        sealing::seal_head(&mut bytes).unwrap();
        let parse = |limits: &Limits| Directory::parse(&bytes, bytes.len() as u64, limits);
        let said = parse(&published).unwrap_err().to_string();
        assert_eq!(said, format!("{what} ({})", setting.0));
        let raised = parse(&with(setting, value.into()));
        assert!(!raised.is_err_and(|e| e.to_string().contains("limit")), "{what}: still");
    }
    // There is no lattice of more lines, so no flag helps.
    let mut bytes = good.clone();
    bytes[44..48].copy_from_slice(&524_290u32.to_le_bytes());
    sealing::seal_head(&mut bytes).unwrap();
    let raised = with(DIRECTIONS, u32::MAX.into());
    let said = Directory::parse(&bytes, bytes.len() as u64, &raised).unwrap_err().to_string();
    assert_eq!(said, "direction count 524290 exceeds limit 524289");
}
