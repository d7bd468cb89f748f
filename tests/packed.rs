//! A pack shows exactly what its field shows: every pixel, by both methods, compressed or not. The
//! same field gives the same pack, and packing changes nothing of the field.

mod common;

use common::{Baked, camera, parameters, picture, scene};
use std::fs;
use std::path::Path;
use vlf::field::storage::disk::Disk;
use vlf::format::container::Codec;
use vlf::format::limits::Limits;
use vlf::look::lightfield::LookError;
use vlf::look::packed::Access;
use vlf::look::packet::LANES;
use vlf::look::render::Look;
use vlf::look::render::method::Method;
use vlf::look::render::primary::{BAND, Band, Primary};
use vlf::look::render::raytrace::Raytrace;
use vlf::pack::{Diffuse, Options, PackError, PackReport, pack, pack_from};
use vlf::paths::{MAX_DEPTH, Paths};
use vlf::scene::texels;
use vlf::{Cell, LightField, Rgb, Side, SurfaceId, Visible};

fn open_unmapped(path: &Path) -> Result<LightField, LookError> {
    LightField::open_within(path, Access::Read, &Limits::default())
}

fn packed(baked: &Baked, out: &Path, options: &Options) -> Result<PackReport, PackError> {
    pack_from(&Disk::new(&baked.path), out, options, &|_| {})
}

/// Every covered cell of a direction's map, with the radiance of both senses.
fn cells(field: &LightField, direction: u32) -> Vec<(SurfaceId, Cell, [Rgb; 2])> {
    let mut cells = Vec::new();
    field
        .map(direction)
        .unwrap()
        .tiles()
        .for_each(|surface, cell, both| cells.push((surface, cell, both)));
    cells
}

/// The promise of `--max-error`, told again by a reader: no cell's channel is off by more than that part
/// of its brightest one. What is darker than 2^-22 of the brightest lamp, its channel rounded up to a
/// power of two, is measured against that.
#[test]
fn no_cell_is_off_by_more_than_the_error_asked_for() {
    let baked = Baked::new(&scene("cornell_mirror"), &parameters(129, 64, 3));
    let field = baked.open();
    let out = baked.path.with_extension("vlf");
    let lamp = field.scene.materials.iter().map(|m| m.emitted.max()).fold(0.0, f32::max);
    let dimmest = (lamp.log2().ceil() - 22.0).exp2();
    let exact = pack(&baked.path, &out, Codec::Planes, &|_| {}).unwrap();
    for codec in [Codec::Zstd, Codec::Planes] {
        for max_error in [0.05, 0.01, 0.001] {
            let options = Options { codec, max_error, ..Options::exact(codec) };
            let report = packed(&baked, &out, &options).unwrap();
            let pack = LightField::open(&out).unwrap();
            let (mut worst, mut sum, mut count) = (0f32, 0f64, 0u64);
            for direction in 0..129 {
                let (there, here) = (cells(&field, direction), cells(&pack, direction));
                assert_eq!(there.len(), here.len());
                for (there, here) in there.iter().zip(&here) {
                    assert_eq!((there.0, there.1), (here.0, here.1));
                    for (there, here) in there.2.iter().zip(&here.2) {
                        let off = (0..3).map(|c| (there.0[c] - here.0[c]).abs());
                        let off = off.fold(0.0, f32::max) / there.max().max(dimmest);
                        worst = worst.max(off);
                        sum += f64::from(off);
                        count += 1;
                    }
                }
            }
            assert!(worst <= max_error, "{codec:?}: off by {worst}, not {max_error}");
            assert!(worst > 0.3 * max_error, "{codec:?}: off by {worst} of {max_error} only");
            assert!((f64::from(report.deviation.worst) / f64::from(worst) - 1.0).abs() < 0.01);
            assert_eq!(report.deviation.cells, count);
            assert!((report.mean_error * count as f64 / sum - 1.0).abs() < 0.01, "{report:?}");
            if codec == Codec::Planes {
                assert!(2 * report.maps.after < exact.maps.after, "{report:?}");
            }
            // A pixel is a mean of cells, so it is off no more than they are.
            let camera = camera("cornell_mirror", 60, 45);
            let pictures = [&field, &pack].map(|field| picture(field, &camera, Method::Field, 1));
            for (there, here) in pictures[0].pixels.iter().zip(&pictures[1].pixels) {
                let off = (0..3).map(|c| (there.0[c] - here.0[c]).abs()).fold(0.0, f32::max);
                assert!(off <= 3.0 * max_error * there.mean() + 1e-6, "{there:?}, not {here:?}");
            }
        }
    }
}

/// Diffuse surfaces' maps are a resampling of the texture map: without them a pack shows what that has,
/// and mirrors as ever.
#[test]
fn a_pack_without_diffuse_maps_looks_to_the_texture_map() {
    let baked = Baked::new(&scene("cornell_mirror"), &parameters(129, 64, 3));
    let field = baked.open();
    let out = baked.path.with_extension("vlf");
    for codec in [Codec::Raw, Codec::Planes] {
        let exact = Options::exact(codec);
        let with = packed(&baked, &out, &exact).unwrap();
        let options = Options { diffuse: Diffuse::Texture, ..exact };
        let without = packed(&baked, &out, &options).unwrap();
        assert!(2 * without.maps.after < with.maps.after, "{without:?}");
        let pack = LightField::open(&out).unwrap();
        let is_mirror = |id| field.scene.material_of(id).reflectance.is_mirror();
        for direction in 0..129 {
            let mirrors = cells(&field, direction).into_iter().filter(|(id, ..)| is_mirror(*id));
            assert!(mirrors.eq(cells(&pack, direction)), "{codec:?}");
        }
        for id in field.scene.surface_ids() {
            let s = field.scene.surface(id);
            for (x, y, slope) in [(0.5, 0.5, 0.0), (0.13, 0.71, 0.4), (0.9, 0.1, -1.5)] {
                let point = s.origin + s.u * (s.extent.x * x) + s.v * (s.extent.y * y);
                let away = (s.normal + s.u * slope).normalize();
                let expected = match is_mirror(id) {
                    true => field.radiance(id, point, away).unwrap(),
                    false => texels::sample(&field.texels, &field.total, id, s, Side::Front, point),
                };
                assert_eq!(pack.radiance(id, point, away).unwrap(), expected);
            }
        }
    }
}

#[test]
fn threads_and_memory_change_no_byte_of_a_pack() {
    let baked = Baked::new(&scene("cornell_mirror"), &parameters(129, 32, 2));
    let out = baked.path.with_extension("vlf");
    let options = Options { max_error: 0.01, ..Options::exact(Codec::Planes) };
    let PackError::Memory { needed, granted: 1000 } =
        packed(&baked, &out, &Options { memory: 1000, ..options }).unwrap_err()
    else {
        panic!("another error")
    };
    assert!(!out.exists());
    let mut expected = None;
    for (threads, memory) in [(1, needed), (3, 5 * needed), (2, 1 << 30)] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| packed(&baked, &out, &Options { memory, ..options })).unwrap();
        let bytes = fs::read(&out).unwrap();
        assert!(expected.get_or_insert_with(|| bytes.clone()) == &bytes, "{threads}, {memory}");
    }
    let too_little = Options { memory: needed - 1, ..options };
    assert!(matches!(packed(&baked, &out, &too_little), Err(PackError::Memory { .. })));
}

#[test]
fn field_raw_pack_and_compressed_pack_give_the_same_pictures() {
    let baked = Baked::new(&scene("cornell_mirror"), &parameters(129, 64, 3));
    let (raw, zstd) = (baked.path.with_extension("raw"), baked.path.with_extension("vlf"));
    let planes = baked.path.with_extension("planes");
    let raw_report = pack(&baked.path, &raw, Codec::Raw, &|_| {}).unwrap();
    let zstd_report = pack(&baked.path, &zstd, Codec::Zstd, &|_| {}).unwrap();
    assert!(zstd_report.bytes < raw_report.bytes);
    assert_eq!(raw_report.bytes, fs::metadata(&raw).unwrap().len());
    let planes_report = pack(&baked.path, &planes, Codec::Planes, &|_| {}).unwrap();
    assert!(planes_report.bytes < zstd_report.bytes);
    for report in [raw_report, zstd_report, planes_report] {
        assert_eq!((report.deviation.worst, report.deviation.at), (0.0, None));
        assert!(report.deviation.cells >= report.values);
    }
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
        (LightField::open(&planes).unwrap(), "planes"),
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

/// Rays of a packet are looked up together; each finds to the last bit what it finds alone, on walls, in mirrors
/// and on what is thinner than a cell. That it is the same with all of the processor's instructions, tests/dispatch
/// shows.
#[test]
fn a_packet_shows_what_its_rays_show_one_by_one() {
    for (name, least) in [("cornell_mirror", 0.9), ("office", 0.9), ("torture", 0.5)] {
        let baked = Baked::new(&scene(name), &parameters(129, 32, 2));
        let out = baked.path.with_extension("vlf");
        pack(&baked.path, &out, Codec::Planes, &|_| {}).unwrap();
        let left = baked.path.with_extension("left");
        let diffuse = Diffuse::Texture;
        packed(&baked, &left, &Options { diffuse, ..Options::exact(Codec::Planes) }).unwrap();
        for path in [&out, &left] {
            let field = LightField::open(path).unwrap();
            let visible = Visible::new(&field.scene);
            let camera = camera(name, 122, 90);
            let view = camera.view(&field.scene.fit);
            let primary = Primary::new(&visible, &view, (camera.width, camera.height));
            let (mut together, mut alone) = (field.accessor(), field.accessor_for(1));
            let paths = Paths { scene: &field.scene, visible: &visible, max_depth: MAX_DEPTH };
            let mut traced = Raytrace { paths, texels: &field.texels, values: &field.total };
            let (mut band, mut met, mut shown) = (Band::default(), 0, 0);
            for k in 0..(camera.height as usize).div_ceil(BAND) {
                primary.draw(k, &mut band, |_, packet| {
                    let mut all = [Rgb::splat(-1.0); LANES];
                    Look::packet(&mut traced, packet, &mut all);
                    for (k, rgb) in all.iter().enumerate() {
                        let one = packet.hit(k).map(|hit| traced.radiance(packet.dir(k), &hit));
                        assert_eq!(one.unwrap_or(Rgb::BLACK), *rgb, "{:?}", packet.hit(k));
                    }
                    let found = together.radiances(packet, &mut all);
                    for (k, rgb) in all.iter().enumerate() {
                        let hit = packet.hit(k);
                        met += usize::from(hit.is_some());
                        if found >> k & 1 == 0 {
                            continue;
                        }
                        shown += 1;
                        let hit = hit.expect("what is shown is met");
                        let one = alone.radiance(hit.surface, hit.point, -packet.dir(k)).unwrap();
                        assert_eq!(one.0.map(f32::to_bits), rgb.0.map(f32::to_bits), "{hit:?}");
                    }
                });
            }
            let all = *path == out;
            assert!(shown as f64 > if all { least * met as f64 } else { 0.0 }, "{name}: {shown}");
            assert!(all || shown < met);
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

/// A walk through a pack whose maps take many times the memory that they may: the same pictures, and
/// no more memory than was given, however many threads look.
#[test]
fn a_pack_far_larger_than_memory_shows_the_same_and_keeps_to_the_memory() {
    let baked = Baked::new(&scene("cornell_mirror"), &parameters(513, 32, 2));
    let field = baked.open();
    let out = baked.path.with_extension("vlf");
    let mut camera = camera("cornell_mirror", 40, 30);
    let mut walk = Vec::new();
    for step in 0..6 {
        camera.eye.x += 0.05 * f64::from(step);
        walk.push(camera);
    }
    let pictures = |field: &LightField| -> Vec<_> {
        walk.iter().map(|camera| picture(field, camera, Method::Field, 1)).collect()
    };
    let expected = pictures(&field);
    for (codec, access) in [(Codec::Planes, Access::Mapped), (Codec::Raw, Access::Read)] {
        pack(&baked.path, &out, codec, &|_| {}).unwrap();
        let open = || LightField::open_within(&out, access, &Limits::default()).unwrap();
        let all = open();
        (0..513).for_each(|direction| _ = all.map(direction).unwrap());
        let memory = all.memory() / 8;
        let pack = open().with_memory(memory);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(4).build().unwrap();
        assert!(pool.install(|| pictures(&pack)) == expected, "{codec:?}");
        assert!(pack.memory() <= memory && 2 * pack.memory() > memory, "{codec:?}");
        // Nothing kept at all is slow, and right.
        assert!(picture(&open().with_memory(0), &walk[0], Method::Field, 1) == expected[0]);
    }
}

/// What is fetched ahead of a picture is what it needs, nearly all of it and nothing else, and no more than half of
/// what memory may hold.
#[test]
fn maps_fetched_ahead_are_those_that_the_picture_needs() {
    let baked = Baked::new(&scene("cornell_mirror"), &parameters(513, 32, 2));
    let out = baked.path.with_extension("vlf");
    pack(&baked.path, &out, Codec::Raw, &|_| {}).unwrap();
    let camera = camera("cornell_mirror", 160, 120);
    let fetched = open_unmapped(&out).unwrap();
    let visible = Visible::new(&fetched.scene);
    fetched.fetch(&visible, &camera);
    let ahead = fetched.memory();
    let looked = open_unmapped(&out).unwrap();
    assert!(
        picture(&fetched, &camera, Method::Field, 1) == picture(&looked, &camera, Method::Field, 1)
    );
    assert!(5 * ahead > 4 * looked.memory(), "{ahead} of {}", looked.memory());
    // No map that the picture did without.
    assert_eq!(fetched.memory(), looked.memory());
    let small = open_unmapped(&out).unwrap().with_memory(ahead / 2);
    small.fetch(&visible, &camera);
    assert!((1..ahead / 2).contains(&small.memory()));
}
