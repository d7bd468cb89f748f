//! Before the night is spent: what a plan says of disk and memory is what the bake then takes. Of time it
//! says something; how right that is depends on what else the machine does, and is not tested here (see
//! `benches/plan-against-bake`).

mod common;

use assert_cmd::Command;
use common::{Baked, obj, parameters, scene, stored};
use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use tempfile::TempDir;
use vlf::bake::{Options, bake};
use vlf::field::Terms;
use vlf::field::storage::disk::Disk;
use vlf::format::container::Codec;
use vlf::pack::{USUAL_ERROR, pack, pack_from};
use vlf::plan::{Plan, plan};
use vlf::{Parameters, Scene, Transfer};

fn planned(scene: &Scene, parameters: &Parameters, memory: u64) -> Plan {
    let options = Options {
        memory,
        threads: 2,
        stop: &AtomicBool::new(false),
        progress: &|_| (),
        order: None,
        commit_every: 1e9,
        terms: Terms::default(),
        force: false,
    };
    plan(scene, parameters, &options).unwrap()
}

fn below(folder: &Path) -> u64 {
    let entries = fs::read_dir(folder).unwrap().map(|e| e.unwrap());
    entries
        .map(|e| if e.path().is_dir() { below(&e.path()) } else { e.metadata().unwrap().len() })
        .sum()
}

/// `said` and `done` differ by at most so many hundredths of `done`.
fn near(what: &str, said: u64, done: u64, hundredths: f64) {
    let off = 100.0 * (said as f64 / done as f64 - 1.0);
    assert!(off.abs() <= hundredths, "{what}: {said} said, {done} done: {off:+.2} %");
}

#[test]
fn bytes_on_disk_are_as_planned() {
    for (name, parameters) in [
        // More lines than are rehearsed.
        ("cornell", parameters(513, 32, 3)),
        ("cornell_mirror", parameters(513, 32, 3)),
        ("cornell_mirror", stored(parameters(513, 32, 3))),
        ("metal_sphere", parameters(513, 32, 3)),
        ("metal_sphere", stored(parameters(513, 32, 3))),
        ("parallel_squares", parameters(129, 64, 2)),
        // As many.
        ("cornell_mirror", parameters(33, 32, 4)),
        ("cornell_mirror", stored(parameters(33, 32, 4))),
    ] {
        let Parameters { directions, resolution, specular, .. } = parameters;
        let what = format!("{name}, {specular:?}, {directions} lines, {resolution} x {resolution}");
        let scene = scene(name);
        let plan = planned(&scene, &parameters, 1 << 30);
        let baked = Baked::new(&scene, &parameters);
        // Of tiny maps much is the rounding of parts, and the least change of what is lit counts.
        let hundredths = if resolution < 64 { 10.0 } else { 5.0 };
        let total = below(&baked.path.join("total"));
        near(&what, plan.disk.totals, total, hundredths);
        near(&what, plan.disk.finished, below(&baked.path), hundredths);
        let written = baked.manifest().statistics.bytes_written;
        near(&format!("{what}, written"), plan.disk.written, written, hundredths);
        assert_eq!(plan.cycles, baked.manifest().cycle, "{what}");
        for (codec, said) in
            [(Codec::Raw, plan.disk.packed_raw), (Codec::Zstd, plan.disk.packed_zstd)]
        {
            let out = baked.path.with_extension("vlf");
            let packed = pack(&baked.path, &out, codec, &|_| {}).unwrap();
            near(&format!("{what}, {codec:?}"), said, packed.bytes, hundredths);
        }
        let usual = vlf::pack::Options {
            max_error: USUAL_ERROR,
            ..vlf::pack::Options::exact(Codec::Planes)
        };
        let out = baked.path.with_extension("vlf");
        let packed = pack_from(&Disk::new(&baked.path), &out, &usual, &|_| {}).unwrap();
        near(&format!("{what}, packed"), plan.disk.packed, packed.bytes, hundredths);
        assert!(plan.disk.peak >= plan.disk.finished && plan.disk.written >= plan.disk.peak);
    }
}

/// Fragments that a bake rasterises.
fn rasterised(scene: &Scene, parameters: &Parameters, memory: u64) -> u64 {
    let folder = TempDir::new().unwrap();
    let fragments = AtomicU64::new(0);
    let options = Options {
        memory,
        threads: 2,
        stop: &AtomicBool::new(false),
        progress: &|p| _ = fragments.fetch_max(p.profile.fragments, Ordering::Relaxed),
        order: None,
        commit_every: 1e9,
        terms: Terms::default(),
        force: false,
    };
    bake(scene, parameters, &folder.path().join("x.field"), &options).unwrap();
    fragments.into_inner()
}

/// Without pages to read, memory is of use for what is known of the lines from cycle to cycle: with the useful
/// grant none of it is found twice, with the smallest all of it is.
#[test]
fn where_no_maps_are_stored_the_useful_grant_is_enough_to_find_all_links_once() {
    let scene = scene("cornell_mirror");
    // What lies in split cells is found anew in every cycle.
    let ways = [(Transfer::Sample, false), (Transfer::Clip, false), (Transfer::Sample, true)];
    for (transfer, supersample) in ways {
        let parameters = Parameters { transfer, supersample, ..parameters(513, 32, 3) };
        let plan = planned(&scene, &parameters, 1 << 30);
        let of = |memory| rasterised(&scene, &parameters, memory);
        let (least, useful, more) = (
            of(plan.memory.smallest),
            of(plan.memory.useful + plan.memory.useful / 50),
            of(1 << 30),
        );
        assert_eq!(useful, more);
        // One cycle and the total maps in the place of three and these.
        assert_eq!(least, if supersample { useful } else { 2 * useful });
        assert_eq!(plan.memory.smallest == plan.memory.useful, supersample);
    }
    let parameters = parameters(129, 32, 2);
    let plan = planned(&scene, &parameters, 1 << 30);
    let how = common::How { memory: plan.memory.smallest, ..common::How::default() };
    let cache = Baked::with(&scene, &parameters, &how).manifest().statistics.cache;
    assert_eq!((cache.hits, cache.misses, cache.peak), (0, 0, 0));
}

/// The files that are the same for any number of lines are right to the byte.
#[test]
fn scene_and_textures_are_planned_to_the_byte() {
    let (scene, parameters) = (scene("cornell_mirror"), parameters(129, 32, 2));
    let plan = planned(&scene, &parameters, 1 << 30);
    let baked = Baked::new(&scene, &parameters);
    let length = |name: &str| fs::metadata(baked.path.join(name)).unwrap().len();
    assert_eq!(plan.disk.scene, length("scene"));
    assert_eq!(plan.disk.textures, length("textures-0002"));
    assert_eq!(plan.disk.records, length("manifest-0") + length("manifest-1"));
}

/// With `auto` the rehearsal finds the number of cycles.
#[test]
fn cycles_are_those_of_the_bake() {
    let scene = scene("cornell_mirror");
    let parameters = Parameters { cycles: None, ..parameters(513, 32, 1) };
    let plan = planned(&scene, &parameters, 1 << 30);
    let cycles = Baked::new(&scene, &parameters).manifest().cycle;
    assert!(plan.cycles.abs_diff(cycles) <= 1, "{} said, {cycles} done", plan.cycles);
}

/// With the useful grant no page of stored maps is read twice; with the smallest the bake is slow, but
/// runs.
#[test]
fn the_useful_grant_is_enough_to_read_every_page_once() {
    let (scene, parameters) = (scene("cornell_mirror"), stored(parameters(513, 32, 3)));
    let plan = planned(&scene, &parameters, 1 << 30);
    assert!(plan.memory.smallest < plan.memory.useful);
    for (memory, is_useful) in [(plan.memory.useful, true), (plan.memory.smallest, false)] {
        let how = common::How { memory, ..common::How::default() };
        let cache = Baked::with(&scene, &parameters, &how).manifest().statistics.cache;
        assert_eq!(cache.redundant == 0, is_useful, "{memory} B: {cache:?}");
        assert!(planned(&scene, &parameters, memory).memory.peak <= plan.memory.peak);
    }
}

const SMALL: [&str; 8] =
    ["--directions", "33", "--resolution", "32", "--cycles", "2", "--quality", "draft"];

fn vlf(folder: &Path, command: &str, more: &[&str]) -> Command {
    let mut program = Command::new(env!("CARGO_BIN_EXE_vlf"));
    program.current_dir(folder).arg(command).arg(obj("cornell_mirror")).args(SMALL).args(more);
    program
}

#[test]
fn a_plan_is_one_json_object_and_leaves_no_trace() {
    let folder = TempDir::new().unwrap();
    let output = vlf(folder.path(), "plan", &["--json", "-o", "x.field"]).output().unwrap();
    assert!(output.status.success());
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    for (part, name) in [
        ("disk", "finished"),
        ("disk", "free"),
        ("memory", "smallest"),
        ("memory", "peak"),
        ("time", "seconds"),
    ] {
        assert!(json[part][name].as_f64().unwrap() > 0.0, "{part} {name}: {json}");
    }
    assert_eq!(json["cycles"], 2);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);

    let said = vlf(folder.path(), "plan", &[]).output().unwrap();
    let text = String::from_utf8(said.stdout).unwrap();
    assert!(text.contains("total radiance maps") && !text.contains("free"), "{text}");
    // A pack or field that is there stays as it is, and is no hindrance.
    fs::write(folder.path().join("x.field"), "a letter").unwrap();
    vlf(folder.path(), "plan", &["-o", "x.field"]).assert().success();
    assert_eq!(fs::read_to_string(folder.path().join("x.field")).unwrap(), "a letter");
}

/// The smallest grant is what the bake takes it to be, to the byte; a smaller one is planned with all
/// the same.
#[test]
fn the_smallest_grant_is_accepted_and_one_byte_less_is_refused() {
    let folder = TempDir::new().unwrap();
    let plan = |memory: &str| -> serde_json::Value {
        let mut program = vlf(folder.path(), "plan", &["--json", "--memory", memory]);
        serde_json::from_slice(&program.output().unwrap().stdout).unwrap()
    };
    let smallest = plan("64KiB")["memory"]["smallest"].as_u64().unwrap();
    assert_eq!(plan("1GiB")["memory"]["smallest"].as_u64(), Some(smallest));
    let less = (smallest - 1).to_string();
    let mut bake = vlf(folder.path(), "bake", &["-o", "x.field", "--memory", &less]);
    bake.assert().failure().code(7);
    assert!(!folder.path().join("x.field").exists());
    let enough = smallest.to_string();
    vlf(folder.path(), "bake", &["-o", "x.field", "--memory", &enough]).assert().success();

    // As it is printed, rounded up, it does too.
    let output = vlf(folder.path(), "plan", &["--memory", "64KiB"]).output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("would be refused"), "{text}");
    let line = text.lines().find(|l| l.contains("smallest --memory")).unwrap();
    let shown: String = line.split("--memory").nth(1).unwrap().split_whitespace().collect();
    vlf(folder.path(), "bake", &["-o", "y.field", "--memory", &shown]).assert().success();
}

#[test]
fn what_a_bake_would_not_understand_is_refused() {
    let folder = TempDir::new().unwrap();
    for (option, value) in [("--directions", "100"), ("--tile", "7"), ("--threads", "0")] {
        let mut program = Command::new(env!("CARGO_BIN_EXE_vlf"));
        program.current_dir(&folder).arg("plan").arg(obj("cornell")).args([option, value]);
        program.assert().failure().code(2).stdout("");
    }
}
