//! The field is the same to the last bit however it was baked: with any number of threads, any order
//! of directions, any memory, stopped and resumed at any place. So a bake that was interrupted needs
//! no trust, two bakes can be compared by their digests, and a difference is always a fault.

mod common;

use common::{Baked, Dice, How, bake_to, both_ways, parameters, scene};
use std::fs;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use vlf::bake::{Options, Outcome};
use vlf::field::storage::disk::Disk;
use vlf::field::{Terms, read_manifest};
use vlf::format::container::Codec;
use vlf::format::manifest::Phase;
use vlf::pack::pack;
use vlf::plan::plan;
use vlf::{Parameters, Scene, Specular, Transfer};

/// Digest of the field and bytes of its pack.
fn bits(field: &Path) -> ([u8; 16], Vec<u8>) {
    let out = field.with_extension("vlf");
    pack(field, &out, Codec::Raw, &|_| {}).unwrap();
    let manifest = read_manifest(&Disk::new(field)).unwrap().1;
    assert_eq!(manifest.phase, Phase::Finished);
    assert_ne!(manifest.digest, [0; 16]);
    (manifest.digest, fs::read(out).unwrap())
}

/// A room with a mirror: diffuse and mirror transport.
fn room() -> (Scene, Parameters) {
    let parameters = Parameters { perturbations: vec![2, 1], ..parameters(129, 32, 3) };
    (scene("cornell_mirror"), parameters)
}

#[test]
fn threads_order_and_memory_change_no_bit() {
    let (scene, parameters) = room();
    for (way, parameters) in both_ways(&parameters) {
        changes_no_bit(way, &scene, &parameters);
    }
    let clipped = Parameters { transfer: Transfer::Clip, ..parameters };
    changes_no_bit("clipped", &scene, &clipped);
}

fn changes_no_bit(way: &str, scene: &Scene, parameters: &Parameters) {
    let plain = bits(&Baked::with(scene, parameters, &How { threads: 1, ..How::default() }).path);
    let mut dice = Dice(5);
    let reversed = (0..129).rev().collect();
    let ways = [
        ("2 threads", How::default()),
        ("5 threads", How { threads: 5, ..How::default() }),
        ("reversed", How { order: Some(reversed), ..How::default() }),
        ("shuffled", How { order: Some(dice.shuffled(129)), ..How::default() }),
        (
            "shuffled, 1 thread",
            How { order: Some(dice.shuffled(129)), threads: 1, ..How::default() },
        ),
        // None is left to keep links of PSFs in.
        ("the least memory", How { memory: least_memory(scene, parameters), ..How::default() }),
        ("little memory", How { memory: 48 << 20, ..How::default() }),
        ("much memory", How { memory: 8 << 30, ..How::default() }),
        ("commits all the time", How { commit_every: 0.0, ..How::default() }),
    ];
    for (name, how) in ways {
        let other = bits(&Baked::with(scene, parameters, &how).path);
        assert_eq!(plain.0, other.0, "{way}, {name}: another digest");
        assert!(plain.1 == other.1, "{way}, {name}: another pack");
    }
}

/// The smallest grant of memory with which a bake on two threads begins.
fn least_memory(scene: &Scene, parameters: &Parameters) -> u64 {
    let options = Options {
        memory: 0,
        threads: 2,
        stop: &AtomicBool::new(false),
        progress: &|_| (),
        order: None,
        commit_every: 1e9,
        terms: Terms::default(),
        force: false,
    };
    plan(scene, parameters, &options).unwrap().memory.smallest
}

/// Clipping shares light out in another way, and must be as free of order: with two threads and few
/// commits as with five, shuffled, and committed and stopped all the time.
#[test]
fn a_clipped_field_has_the_same_bits_for_any_order_threads_and_stops() {
    let (scene, parameters) = room();
    let parameters = Parameters { transfer: Transfer::Clip, ..parameters };
    let plain = bits(&Baked::new(&scene, &parameters).path);
    let mut dice = Dice(11);
    let folder = tempfile::TempDir::new().unwrap();
    let path = folder.path().join("test.field");
    let mut stops = 0;
    loop {
        let order = Some(dice.shuffled(129));
        let how = How { order, threads: 5, commit_every: 0.0, ..How::default() };
        match bake_to(&path, &scene, &parameters, &How { stop_after: Some(20), ..how }) {
            Outcome::Finished => break,
            Outcome::Stopped => stops += 1,
        }
    }
    assert!(stops >= 4, "stopped only {stops} times");
    let other = bits(&path);
    assert_eq!(plain.0, other.0, "another digest");
    assert!(plain.1 == other.1, "another pack");
}

/// Whether a cycle has lines enough is decided from sums that are the same for any order, and a run that
/// goes on with a round under way decides as the one that began it.
#[test]
fn cycles_that_end_by_their_error_end_alike_for_any_order_threads_and_stops() {
    let (scene, parameters) = room();
    for (way, parameters) in both_ways(&parameters) {
        let parameters = Parameters { perturbations: vec![16, 8], target_error: 0.1, ..parameters };
        let plain = Baked::with(&scene, &parameters, &How { threads: 1, ..How::default() });
        let grids = plain.manifest().grids;
        assert!(grids.iter().any(|n| (2..16).contains(n)), "{way}: {grids:?} are no rounds");
        let mut dice = Dice(17);
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("test.field");
        let mut stops = 0;
        loop {
            let order = Some(dice.shuffled(129));
            let how = How { order, threads: 3, commit_every: 0.0, ..How::default() };
            match bake_to(&path, &scene, &parameters, &How { stop_after: Some(50), ..how }) {
                Outcome::Finished => break,
                Outcome::Stopped => stops += 1,
            }
        }
        assert!(stops >= 4, "{way}: stopped only {stops} times");
        let manifest = read_manifest(&Disk::new(&path)).unwrap().1;
        assert_eq!((manifest.grids, manifest.error), (grids, plain.manifest().error), "{way}");
        let (plain, other) = (bits(&plain.path), bits(&path));
        assert_eq!(plain.0, other.0, "{way}: another digest");
        assert!(plain.1 == other.1, "{way}: another pack");
    }
}

#[test]
fn other_parameters_give_other_bits() {
    let (scene, parameters) = room();
    let plain = bits(&Baked::new(&scene, &parameters).path).0;
    let other = Parameters { perturbations: vec![1], ..parameters.clone() };
    assert_ne!(plain, bits(&Baked::new(&scene, &other).path).0, "perturbations");
    let other = Parameters { one_sided: true, cycles: Some(2), ..parameters.clone() };
    assert_ne!(plain, bits(&Baked::new(&scene, &other).path).0, "cycles, sides");
    let other = Parameters { specular: Specular::Maps, ..parameters };
    assert_ne!(plain, bits(&Baked::new(&scene, &other).path).0, "mirrors");
}

#[test]
fn a_bake_that_is_stopped_again_and_again_ends_with_the_same_bits() {
    let (scene, parameters) = room();
    for (way, parameters) in both_ways(&parameters) {
        stopped_again_and_again(way, &scene, &parameters);
    }
}

fn stopped_again_and_again(way: &str, scene: &Scene, parameters: &Parameters) {
    let plain = bits(&Baked::new(scene, parameters).path);
    let mut dice = Dice(7);
    for (commit_every, threads) in [(1e9, 2), (0.0, 1)] {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("test.field");
        let mut stops = 0;
        loop {
            let stop_after = Some(1 + (dice.next() % 3) as u32);
            let order = Some(dice.shuffled(129));
            let how = How { stop_after, threads, order, commit_every, ..How::default() };
            match bake_to(&path, scene, parameters, &how) {
                Outcome::Finished => break,
                Outcome::Stopped => stops += 1,
            }
        }
        assert!(stops >= 4, "{way}: stopped only {stops} times");
        let resumed = bits(&path);
        assert_eq!(plain.0, resumed.0, "{way}, after {stops} stops: another digest");
        assert!(plain.1 == resumed.1, "{way}, after {stops} stops: another pack");
    }
}

#[test]
fn a_finished_field_is_not_baked_again() {
    let (scene, parameters) = room();
    let baked = Baked::new(&scene, &parameters);
    let before = vlf::format::names::MANIFESTS.map(|m| fs::read(baked.path.join(m)).unwrap());
    let how = How { stop_after: Some(1), ..How::default() };
    assert_eq!(bake_to(&baked.path, &scene, &parameters, &how), Outcome::Finished);
    let after = vlf::format::names::MANIFESTS.map(|m| fs::read(baked.path.join(m)).unwrap());
    assert!(before == after);
}
