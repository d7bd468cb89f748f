//! Total maps that went bad since a bake: the same command makes them again, or says why it cannot.

mod common;

use common::{Baked, How, bake_to, parameters, scene, stored};
use std::fs;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use vlf::bake::{BakeError, Options, Outcome};
use vlf::field::Terms;
use vlf::field::storage::disk::Disk;
use vlf::format::names;
use vlf::verify;

fn flip(path: &Path) {
    let mut bytes = fs::read(path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(path, bytes).unwrap();
}

fn cut(path: &Path) {
    let bytes = fs::read(path).unwrap();
    fs::write(path, &bytes[..bytes.len() - 1]).unwrap();
}

#[test]
fn damaged_total_maps_are_made_again_to_the_same_bits() {
    made_again("cornell");
    made_again("cornell_mirror");
}

fn made_again(name: &str) {
    let (scene, parameters) = (scene(name), parameters(33, 16, 2));
    let baked = Baked::new(&scene, &parameters);
    let map = |direction| names::tiles(&baked.path, names::TOTAL, direction);
    let good: Vec<_> = (0..33).map(|d| fs::read(map(d)).unwrap()).collect();
    flip(&map(0));
    cut(&map(7));
    fs::remove_file(map(20)).unwrap();
    fs::copy(map(3), map(32)).unwrap();
    assert_eq!(verify::field(&Disk::new(&baked.path), &|_| ()).unwrap().found, 4);
    assert_eq!(bake_to(&baked.path, &scene, &parameters, &How::default()), Outcome::Finished);
    for (direction, good) in (0..33).zip(good) {
        assert!(fs::read(map(direction)).unwrap() == good, "direction {direction}");
    }
    let report = verify::field(&Disk::new(&baked.path), &|_| ()).unwrap();
    assert!(report.is_sound() && report.digest == report.stated_digest);
    // The whole folder can go.
    fs::remove_dir_all(baked.path.join(names::TOTAL)).unwrap();
    assert_eq!(bake_to(&baked.path, &scene, &parameters, &How::default()), Outcome::Finished);
    assert!(verify::field(&Disk::new(&baked.path), &|_| ()).unwrap().is_sound());
}

#[test]
fn what_cannot_be_made_again_is_said_and_left_as_it_is() {
    let parameters = stored(parameters(33, 16, 2));
    let bake = |path: &Path, scene: &vlf::Scene| {
        let options = Options {
            memory: 1 << 30,
            threads: 2,
            stop: &AtomicBool::new(false),
            progress: &|_| (),
            order: None,
            commit_every: 1e9,
            terms: Terms::default(),
            force: false,
        };
        vlf::bake(scene, &parameters, path, &options)
    };
    // What arrived at mirrors is gone.
    let mirrors = scene("cornell_mirror");
    let baked = Baked::new(&mirrors, &parameters);
    let map = names::tiles(&baked.path, names::TOTAL, 5);
    flip(&map);
    let bad = fs::read(&map).unwrap();
    let error = bake(&baked.path, &mirrors).unwrap_err();
    assert!(matches!(&error, BakeError::Gone { count: 1, .. }), "{error}");
    let said = error.to_string();
    assert!(said.contains("000005.tiles") && said.contains("Bake the scene anew"), "{said}");
    assert_eq!(vlf::exit::code(&error), vlf::exit::CORRUPT);
    assert_eq!(fs::read(&map).unwrap(), bad);

    // So are the texture maps that the total maps are made of.
    let diffuse = scene("cornell");
    let baked = Baked::new(&diffuse, &parameters);
    flip(&names::tiles(&baked.path, names::TOTAL, 5));
    flip(&baked.path.join(names::textures(2)));
    let error = bake(&baked.path, &diffuse).unwrap_err();
    assert!(error.to_string().contains("textures-0002"), "{error}");
    assert_eq!(vlf::exit::code(&error), vlf::exit::CORRUPT);
}
