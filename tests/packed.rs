//! A pack shows exactly what its field shows: every pixel, by both methods, compressed or not. The
//! same field gives the same pack, and packing changes nothing of the field.

mod common;

use common::{Baked, camera, parameters, picture, scene};
use std::fs;
use std::path::Path;
use vlf::LightField;
use vlf::format::container::Codec;
use vlf::format::limits::Limits;
use vlf::look::lightfield::LookError;
use vlf::look::packed::Access;
use vlf::look::render::method::Method;
use vlf::pack::pack;

fn open_unmapped(path: &Path) -> Result<LightField, LookError> {
    LightField::open_within(path, Access::Read, &Limits::default())
}

#[test]
fn field_raw_pack_and_compressed_pack_give_the_same_pictures() {
    let baked = Baked::new(&scene("cornell_mirror"), &parameters(129, 64, 3));
    let (raw, zstd) = (baked.path.with_extension("raw"), baked.path.with_extension("vlf"));
    let raw_report = pack(&baked.path, &raw, Codec::Raw, &|_| {}).unwrap();
    let zstd_report = pack(&baked.path, &zstd, Codec::Zstd, &|_| {}).unwrap();
    assert!(zstd_report.bytes < raw_report.bytes);
    assert_eq!(raw_report.bytes, fs::metadata(&raw).unwrap().len());
    assert_eq!(zstd_report.values, raw_report.values);
    let again = baked.path.with_extension("again");
    pack(&baked.path, &again, Codec::Zstd, &|_| {}).unwrap();
    assert!(fs::read(&again).unwrap() == fs::read(&zstd).unwrap(), "packed twice, differs");

    let camera = camera("cornell_mirror", 80, 60);
    let field = baked.open();
    let packs = [
        (LightField::open(&raw).unwrap(), "raw"),
        (LightField::open(&zstd).unwrap(), "zstd"),
        (open_unmapped(&raw).unwrap(), "raw, read"),
        (open_unmapped(&zstd).unwrap(), "zstd, read"),
    ];
    for method in [Method::Trace, Method::Field] {
        let expected = picture(&field, &camera, method, 2);
        assert!(expected.pixels.iter().any(|p| p.max() > 0.1));
        for (pack, name) in &packs {
            assert!(pack.scene == field.scene && pack.total == field.total);
            let found = picture(pack, &camera, method, 2);
            assert!(found == expected, "{method:?}, {name}: another picture");
        }
    }
}

/// Packing over a pack replaces it; the old one is there until the new one is whole.
#[test]
fn a_pack_takes_the_place_of_a_pack_and_of_nothing_else() {
    let baked = Baked::new(&scene("parallel_squares"), &parameters(33, 16, 1));
    let out = baked.path.with_extension("vlf");
    pack(&baked.path, &out, Codec::Raw, &|_| {}).unwrap();
    pack(&baked.path, &out, Codec::Zstd, &|_| {}).unwrap();
    LightField::open(&out).unwrap();
    for text in ["", "a letter", "VLF"] {
        let other = baked.path.with_extension("txt");
        fs::write(&other, text).unwrap();
        let error = pack(&baked.path, &other, Codec::Raw, &|_| {}).unwrap_err();
        assert!(error.to_string().contains("nothing was changed"), "{error}");
        assert_eq!(fs::read_to_string(&other).unwrap(), text);
    }
    let left: Vec<_> =
        fs::read_dir(baked.folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(left.len(), 3, "{left:?}");
}

/// Packs are published by rename: whoever has the old one open keeps it whole.
#[test]
fn a_pack_that_is_replaced_while_it_is_open_stays_what_it_was() {
    let old = Baked::new(&scene("cornell_mirror"), &parameters(33, 16, 2));
    let new = Baked::new(&scene("parallel_squares"), &parameters(33, 16, 1));
    let camera = camera("cornell_mirror", 20, 15);
    let expected = picture(&old.open(), &camera, Method::Field, 1);
    for codec in [Codec::Raw, Codec::Zstd] {
        let path = old.path.with_extension("vlf");
        pack(&old.path, &path, codec, &|_| {}).unwrap();
        let open = [LightField::open(&path).unwrap(), open_unmapped(&path).unwrap()];
        pack(&new.path, &path, codec, &|_| {}).unwrap();
        assert_eq!(LightField::open(&path).unwrap().scene.surfaces.len(), 2);
        for field in open {
            assert!(picture(&field, &camera, Method::Field, 1) == expected, "{codec:?}");
        }
    }
}

/// Without a mapping a file that is cut short or written over is an error, not the end of the process.
#[test]
fn a_pack_that_is_cut_short_while_it_is_read_is_damaged() {
    let baked = Baked::new(&scene("cornell_mirror"), &parameters(33, 16, 2));
    let path = baked.path.with_extension("vlf");
    pack(&baked.path, &path, Codec::Raw, &|_| {}).unwrap();
    let field = open_unmapped(&path).unwrap();
    field.map(0).unwrap();
    let length = fs::metadata(&path).unwrap().len();
    let file = fs::File::options().write(true).open(&path).unwrap();
    file.set_len(length / 2).unwrap();
    field.map(0).unwrap();
    let error = field.map(32).unwrap_err();
    let said = format!("direction 32: truncated: its header says {length} bytes");
    assert!(error.to_string().contains(&said), "{error}");
    file.set_len(length).unwrap();
    let error = field.map(31).unwrap_err();
    assert!(error.to_string().contains("checksum mismatch"), "{error}");
    assert_eq!(vlf::exit::code(&error), vlf::exit::CORRUPT);
}
