//! What a field or pack says of itself is true. `vlf verify` finds every flipped bit, every missing, cut,
//! grown or misplaced file, and names it; what is sound it calls sound, at any point of a bake; and
//! looking changes nothing.

mod common;

mod sealing;

use assert_cmd::Command;
use common::{Baked, How, bake_into, bake_to, both_ways, camera, parameters, scene, stored};
use sealing::{Chunk, rebuilt};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::SystemTime;
use tempfile::TempDir;
use vlf::field::storage::disk::Disk;
use vlf::field::storage::memory::Memory;
use vlf::field::storage::{Input, Lock, LockError, Output, Storage};
use vlf::field::{FieldError, read_manifest};
use vlf::format::container::{ChunkKind, Codec, Directory, NO_DIRECTION};
use vlf::format::limits::Limits;
use vlf::format::manifest::{Manifest, Phase};
use vlf::look::render::method::{mark, take_tolerant};
use vlf::pack::{Diffuse, Options as PackOptions, pack, pack_from};
use vlf::verify::{self, Report, Trouble};
use vlf::{LightField, Method, Outcome, Parameters, Visible};

const CORRUPT: i32 = 4;

fn vlf(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_vlf"));
    command.current_dir(folder);
    command
}

fn check(storage: &dyn Storage) -> Report {
    verify::field(storage, &|_| ()).unwrap()
}

/// A small bake in memory that is stopped after so many reports of progress; with mirrors' maps stored,
/// so that it has files of all kinds.
fn memory(stop_after: Option<u32>) -> Arc<Memory> {
    memory_of(&stored(parameters(9, 16, 2)), stop_after)
}

fn memory_of(parameters: &Parameters, stop_after: Option<u32>) -> Arc<Memory> {
    let storage = Arc::new(Memory::default());
    let how = How { threads: 1, stop_after, commit_every: 0.0, ..How::default() };
    let ended = bake_into(storage.clone(), &scene("cornell_mirror"), parameters, &how);
    assert_eq!(ended == Outcome::Finished, stop_after.is_none());
    storage
}

/// All files of a field in memory.
fn files(storage: &Memory) -> Vec<String> {
    let mut all = Vec::new();
    for name in storage.list("").unwrap() {
        match storage.list(&name) {
            Ok(inside) => all.extend(inside.into_iter().map(|file| format!("{name}/{file}"))),
            Err(_) => all.push(name),
        }
    }
    all
}

fn length(storage: &Memory, name: &str) -> usize {
    storage.open(name).unwrap().length().unwrap() as usize
}

/// A field on the disk for damage of all kinds, and another bake's beside it.
fn patient() -> (TempDir, std::path::PathBuf) {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("room.field");
    bake_to(&path, &scene("cornell_mirror"), &stored(parameters(33, 32, 2)), &How::default());
    (folder, path)
}

/// Files below a folder with their bytes and times.
fn state(path: &Path) -> BTreeMap<String, (Vec<u8>, SystemTime)> {
    let mut all = BTreeMap::new();
    for entry in fs::read_dir(path).unwrap().map(|e| e.unwrap().path()) {
        let name = entry.display().to_string();
        let time = fs::metadata(&entry).unwrap().modified().unwrap();
        if entry.is_dir() {
            all.insert(name, (Vec::new(), time));
            all.extend(state(&entry));
        } else {
            all.insert(name, (fs::read(&entry).unwrap(), time));
        }
    }
    all
}

#[test]
fn sound_fields_are_sound_wherever_the_bake_stands() {
    for (way, parameters) in both_ways(&parameters(9, 16, 2)) {
        println!("{way}");
        is_sound_at_any_stop(&parameters);
    }
}

fn is_sound_at_any_stop(parameters: &Parameters) {
    // Files and chunks: two manifests and the scene, textures (3 chunks), sums, 9 tile files of
    // unshot maps (2 chunks) a generation if they are stored, 9 of total maps.
    let mirrors = u64::from(parameters.stores_mirrors());
    let mut seen = Vec::new();
    for stop in [1, 4, 9, 10, 14, 19, 23, 27] {
        let storage = memory_of(parameters, Some(stop));
        let report = check(&*storage);
        assert!(report.is_sound(), "{stop}: {:?}", report.findings);
        let state = report.state.unwrap();
        let manifest = read_manifest(&*storage).unwrap().1;
        assert_eq!((state.commit, state.done), (manifest.sequence, manifest.done_count()));
        let done = u64::from(state.done);
        let (textures, sums) = (u64::from(state.cycle > 0), u64::from(manifest.has_sums));
        let shot = 9 * textures * mirrors;
        let (files, maps) = match state.phase {
            Phase::Propagating => (mirrors * done, 2),
            _ => (done, 1),
        };
        assert_eq!(report.files, 3 + textures + sums + shot + files, "{stop}: {state:?}");
        let chunks = 3 + 3 * textures + sums + 2 * shot + maps * files;
        assert_eq!(report.chunks, chunks, "{stop}: {state:?}");
        assert_eq!((report.digest, report.stated_digest), (None, None));
        seen.push((state.phase, state.cycle, manifest.has_sums));
    }
    for (phase, cycle, sums) in [
        (Phase::Propagating, 0, true),
        (Phase::Propagating, 1, true),
        (Phase::WritingTotals, 2, false),
    ] {
        assert!(seen.contains(&(phase, cycle, sums)), "no stop in {phase:?} {cycle}: {seen:?}");
    }
    let storage = memory_of(parameters, None);
    let report = check(&*storage);
    assert!(report.is_sound(), "{:?}", report.findings);
    assert_eq!((report.files, report.chunks), (13, 15));
    let bytes: usize = files(&storage).iter().map(|name| length(&storage, name)).sum();
    assert_eq!(report.bytes, bytes as u64);
    assert_eq!(report.digest, report.stated_digest);
    assert!(report.digest.is_some());
}

#[test]
fn sound_packs_are_sound() {
    let (folder, field) = patient();
    let lossy = PackOptions { max_error: 0.01, ..PackOptions::exact(Codec::Planes) };
    for (options, name) in [
        (PackOptions::exact(Codec::Raw), "raw.vlf"),
        (PackOptions::exact(Codec::Zstd), "zstd.vlf"),
        (lossy, "planes.vlf"),
        (PackOptions { diffuse: Diffuse::Texture, ..lossy }, "mirrors.vlf"),
    ] {
        let path = folder.path().join(name);
        pack_from(&Disk::new(&field), &path, &options, &|_| ()).unwrap();
        let report = verify::pack(&path, &Limits::default(), &|_| ()).unwrap();
        assert!(report.is_sound(), "{name}: {:?}", report.findings);
        assert_eq!((report.files, report.chunks), (1, 3 + 33));
        assert_eq!(report.bytes, fs::metadata(&path).unwrap().len());
        assert_eq!(report.stated_digest, check(&Disk::new(&field)).digest);
        let output = vlf(folder.path()).args(["verify", name, "--digest"]).output().unwrap();
        assert!(output.status.success());
        let said = String::from_utf8(output.stdout).unwrap();
        for word in ["36 chunks", "sound", &report.stated_digest.unwrap()] {
            assert!(said.contains(word), "no `{word}` in {said}");
        }
    }
}

#[test]
fn a_damaged_chunk_of_a_pack_is_named_and_hides_no_other() {
    let (folder, field) = patient();
    let path = folder.path().join("room.vlf");
    pack(&field, &path, Codec::Zstd, &|_| ()).unwrap();
    let good = fs::read(&path).unwrap();
    let directory = Directory::parse(&good, good.len() as u64, &Limits::default()).unwrap();
    let mut bad = good.clone();
    for (kind, direction) in [
        (ChunkKind::Record, NO_DIRECTION),
        (ChunkKind::TotalTexture, NO_DIRECTION),
        (ChunkKind::Total, 7),
        (ChunkKind::Total, 32),
    ] {
        bad[directory.find(kind, direction).unwrap().offset as usize + 20] ^= 1;
    }
    fs::write(&path, &bad).unwrap();
    found(
        folder.path(),
        "room.vlf",
        &["record", "total texture map", "total map of direction 7", "direction 32", "offset 0x"],
    );
    fs::write(&path, &good[..good.len() - 64]).unwrap();
    let output = vlf(folder.path()).args(["verify", "room.vlf"]).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(CORRUPT), "{said}");
    assert!(said.contains("room.vlf: truncated"), "{said}");
}

/// A file by a later version is not damaged, and one that the system does not give is neither.
#[test]
fn other_versions_and_unreadable_files_have_exit_codes_of_their_own() {
    let (folder, field) = patient();
    let path = field.join("total/000007.tiles");
    let good = fs::read(&path).unwrap();
    let mut newer = good.clone();
    newer[12] = 9;
    fs::write(&path, newer).unwrap();
    let code = |name| vlf(folder.path()).args(["verify", name]).output().unwrap().status.code();
    assert_eq!(code("room.field"), Some(5));
    fs::remove_file(&path).unwrap();
    fs::create_dir(&path).unwrap();
    assert_eq!(code("room.field"), Some(3));
    fs::remove_file(field.join("total/000008.tiles")).unwrap();
    assert_eq!(code("room.field"), Some(CORRUPT), "the worse of the two");
    assert_eq!(code("nowhere.vlf"), Some(3));
    assert_eq!(code("total"), Some(3));
}

/// Runs `vlf verify` on a damaged field or pack: it must say each of `words` on both outputs.
fn found(folder: &Path, name: &str, words: &[&str]) {
    let output = vlf(folder).args(["verify", name]).output().unwrap();
    let (out, err) = (String::from_utf8(output.stdout), String::from_utf8(output.stderr));
    let (out, err) = (out.unwrap(), err.unwrap());
    assert_eq!(output.status.code(), Some(CORRUPT), "{words:?}: {out}{err}");
    for word in words {
        assert!(out.contains(word), "no `{word}` in {out}");
        assert!(err.contains(word), "no `{word}` in {err}");
    }
    let output = vlf(folder).args(["verify", name, "--json"]).output().unwrap();
    assert_eq!(output.status.code(), Some(CORRUPT));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(json["sound"], false);
    assert!(json["found"].as_u64().unwrap() > 0);
}

#[test]
fn every_kind_of_damage_is_named() {
    let (folder, field) = patient();
    let other = folder.path().join("other.field");
    bake_to(&other, &scene("cornell"), &parameters(33, 32, 2), &How::default());
    let half = folder.path().join("half.field");
    let how = How { stop_after: Some(40), ..How::default() };
    bake_to(&half, &scene("cornell_mirror"), &stored(parameters(33, 32, 2)), &how);
    let manifest = read_manifest(&Disk::new(&half)).unwrap().1;
    assert!(manifest.cycle == 1 && manifest.has_sums && manifest.done_count() > 0);
    let sums = format!("sums-{:08}", manifest.sequence);
    let flip = |at: usize| move |bytes: &mut Vec<u8>| bytes[at] ^= 4;
    let cut = |bytes: &mut Vec<u8>| bytes.truncate(bytes.len() - 1);
    let grow = |bytes: &mut Vec<u8>| bytes.extend([0; 12]);
    let last = |bytes: &mut Vec<u8>| *bytes.last_mut().unwrap() ^= 1;
    type Change<'a> = &'a dyn Fn(&mut Vec<u8>);
    let changes: &[(&str, &str, Change, &[&str])] = &[
        ("room.field", "total/000017.tiles", &flip(400), &["17", "total map", "checksum mismatch"]),
        ("room.field", "total/000003.tiles", &flip(20), &["direction 3", "first block"]),
        ("room.field", "total/000004.tiles", &flip(270), &["direction 4", "directory"]),
        ("room.field", "total/000032.tiles", &cut, &["direction 32", "truncated"]),
        ("room.field", "total/000000.tiles", &grow, &["direction 0", "12 unexpected bytes"]),
        ("room.field", "textures-0002", &flip(5000), &["texture map", "checksum mismatch"]),
        ("room.field", "textures-0002", &cut, &["truncated"]),
        ("room.field", "scene", &flip(400), &["scene", "checksum mismatch at offset 0x140"]),
        ("room.field", "scene", &last, &["padding", "is not zero"]),
        ("room.field", "manifest-0", &flip(400), &["record", "checksum mismatch"]),
        ("room.field", "manifest-1", &flip(90), &["first block", "checksum mismatch"]),
        ("half.field", &sums, &flip(3000), &["sums", "checksum mismatch"]),
        ("half.field", "unshot-0001/000009.tiles", &flip(800), &["direction 9", "checksum"]),
        ("half.field", "manifest-0", &flip(500), &["record", "checksum mismatch"]),
        ("half.field", "manifest-1", &cut, &["truncated"]),
    ];
    for (name, file, change, words) in changes {
        let path = folder.path().join(name).join(file);
        let good = fs::read(&path).unwrap();
        let mut bad = good.clone();
        change(&mut bad);
        fs::write(&path, bad).unwrap();
        found(folder.path(), name, &[&[*file][..], words].concat());
        fs::write(&path, &good).unwrap();
    }

    let missing = [
        ("room.field", "total/000020.tiles"),
        ("room.field", "textures-0002"),
        ("room.field", "scene"),
    ];
    let missing =
        [&missing[..], &[("half.field", &sums), ("half.field", "unshot-0001/000000.tiles")]];
    for (name, file) in missing.concat() {
        let path = folder.path().join(name).join(file);
        let aside = folder.path().join("aside");
        fs::rename(&path, &aside).unwrap();
        found(folder.path(), name, &[file, "is missing"]);
        fs::rename(&aside, &path).unwrap();
    }

    // Sound files in wrong places: swapped, another field's, another generation's.
    let (a, b) = (field.join("total/000005.tiles"), field.join("total/000006.tiles"));
    let (five, six) = (fs::read(&a).unwrap(), fs::read(&b).unwrap());
    fs::write(&a, &six).unwrap();
    fs::write(&b, &five).unwrap();
    found(
        folder.path(),
        "room.field",
        &["000005.tiles", "direction 6", "000006.tiles", "direction 5"],
    );
    fs::write(&a, fs::read(other.join("total/000005.tiles")).unwrap()).unwrap();
    fs::write(&b, &six).unwrap();
    found(folder.path(), "room.field", &["total/000005.tiles", "belongs to another field"]);
    fs::write(&a, &five).unwrap();
    let (a, b) = (half.join("unshot-0001/000005.tiles"), half.join("unshot-0002/000005.tiles"));
    if b.exists() {
        let good = fs::read(&a).unwrap();
        fs::copy(&b, &a).unwrap();
        found(folder.path(), "half.field", &["unshot-0001/000005.tiles", "generation 2"]);
        fs::write(&a, good).unwrap();
    }
    // A commit record under the other's name.
    let records = ["manifest-0", "manifest-1"].map(|m| fs::read(field.join(m)).unwrap());
    fs::write(field.join("manifest-1"), &records[0]).unwrap();
    found(folder.path(), "room.field", &["manifest-1", "is of commit"]);
    fs::write(field.join("manifest-1"), &records[1]).unwrap();

    for field in [&field, &half] {
        assert!(check(&Disk::new(field)).is_sound(), "not put right again");
    }
}

#[test]
fn all_that_is_damaged_is_found_and_the_list_ends() {
    let (_folder, field) = patient();
    for direction in [2, 9, 31] {
        fs::remove_file(field.join(format!("total/{direction:06}.tiles"))).unwrap();
    }
    fs::write(field.join("total/000010.tiles"), "").unwrap();
    let report = check(&Disk::new(&field));
    let directions: Vec<_> = report.findings.iter().map(|f| f.direction.unwrap()).collect();
    assert_eq!((directions, report.found), (vec![2, 9, 10, 31], 4));

    let many = Arc::new(Memory::default());
    let how = How { threads: 1, ..How::default() };
    bake_into(many.clone(), &scene("parallel_squares"), &parameters(129, 16, 1), &how);
    for direction in 0..129 {
        many.remove(&format!("total/{direction:06}.tiles")).unwrap();
    }
    let report = check(&*many);
    assert_eq!((report.found, report.findings.len()), (129, verify::LISTED));
    assert_eq!(report.trouble(), Some(Trouble::Damaged));
}

#[test]
fn with_both_commit_records_damaged_nothing_is_touched() {
    let (folder, field) = patient();
    for name in ["manifest-0", "manifest-1"] {
        let mut bytes = fs::read(field.join(name)).unwrap();
        bytes[330] ^= 1;
        fs::write(field.join(name), bytes).unwrap();
    }
    let before = state(&field);
    let output = vlf(folder.path()).args(["verify", "room.field"]).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(CORRUPT), "{said}");
    assert!(said.contains("no valid commit record; nothing was changed"), "{said}");
    let output = vlf(folder.path()).args(["verify", "room.field", "--json"]).output().unwrap();
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(json["sound"], false);
    assert!(json["error"].as_str().unwrap().contains("no valid commit record"));
    assert!(state(&field) == before);
}

/// Not even a lock file: the folder may be read-only, or another's.
#[test]
fn who_only_looks_writes_nothing() {
    let (folder, field) = patient();
    let pack_path = folder.path().join("room.vlf");
    pack(&field, &pack_path, Codec::Zstd, &|_| ()).unwrap();
    let read_only = |is: bool| {
        for path in state(&field).into_keys().map(std::path::PathBuf::from).chain([field.clone()]) {
            #[cfg(unix)]
            {
                use std::os::unix::fs::PermissionsExt;
                let mode = match (path.is_dir(), is) {
                    (true, true) => 0o555,
                    (true, false) => 0o755,
                    (false, true) => 0o444,
                    (false, false) => 0o644,
                };
                fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
            }
            let _ = (&path, is);
        }
    };
    read_only(true);
    let (before, packed) = (state(&field), fs::metadata(&pack_path).unwrap().modified().unwrap());
    for name in ["room.field", "room.vlf"] {
        for command in ["info", "verify"] {
            vlf(folder.path()).args([command, name]).assert().success();
        }
        let render = ["render", name, "-o", "out.exr", "--eye", "0,1,3.4", "--target", "0,1,0"];
        let small = ["--size", "16x12", "--samples", "1", "--method", "field"];
        vlf(folder.path()).args(render).args(small).assert().success();
    }
    assert!(state(&field) == before);
    assert_eq!(fs::metadata(&pack_path).unwrap().modified().unwrap(), packed);
    read_only(false);
}

/// Runs on one thread: thousands of small checks.
fn alone<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap().install(work)
}

#[test]
fn every_flipped_bit_is_found() {
    // One field in the midst of its second cycle, one finished: all kinds of files.
    let mut flips = 0;
    for stop_after in [Some(14), None] {
        let storage = memory(stop_after);
        let report = check(&*storage);
        assert!(report.is_sound());
        // The sums of the commit before are not part of the field.
        let own = format!("sums-{:08}", report.state.unwrap().commit);
        let is_old = |name: &str| name.starts_with("sums-") && name != own;
        for name in files(&storage).iter().filter(|n| !is_old(n)) {
            let bits = 8 * length(&storage, name);
            // All of the first file's of a kind up to its chunk, then some.
            let head =
                if name.ends_with("/000000.tiles") || !name.contains('/') { 8 * 384 } else { 0 };
            let some = (head..bits).step_by(8 * 41 + 3);
            let unseen = alone(|| {
                (0..head.min(bits)).chain(some).find(|bit| {
                    let flip = || storage.edit(name, |bytes| bytes[bit / 8] ^= 1 << (bit % 8));
                    flip();
                    flips += 1;
                    let result = verify::field(&*storage, &|_| ());
                    flip();
                    match result {
                        Ok(report) => !report.findings.iter().any(|f| f.file == *name),
                        // A flipped version is one that is not supported.
                        Err(FieldError::Format(e)) => !e.fault.is_unsupported(),
                        Err(_) => true,
                    }
                })
            });
            assert_eq!(unseen, None, "{name}: this bit makes no difference");
        }
    }
    assert!(flips > 10_000, "{flips}");
}

#[test]
fn every_truncation_is_found() {
    for (stop_after, names) in [
        (
            Some(14),
            &["manifest-0", "scene", "textures-0001", "sums-", "unshot-0001/000003.tiles"][..],
        ),
        (None, &["manifest-1", "total/000008.tiles"]),
    ] {
        let storage = memory(stop_after);
        for start in names {
            let name = files(&storage).into_iter().rfind(|n| n.starts_with(start)).unwrap();
            let mut good = Vec::new();
            storage.edit(&name, |bytes| good.clone_from(bytes));
            // Of long files every length up to the first chunk, and some.
            let lengths =
                (0..good.len()).filter(|n| *n < 700 || n % 13 == 0 || n + 70 > good.len());
            let unseen = alone(|| {
                lengths.into_iter().find(|length| {
                    storage.edit(&name, |bytes| bytes.truncate(*length));
                    let report = verify::field(&*storage, &|_| ());
                    storage.edit(&name, |bytes| bytes.clone_from(&good));
                    !report.unwrap().findings.iter().any(|f| f.file == name)
                })
            });
            assert_eq!(unseen, None, "{name}: cut to this length makes no difference");
        }
    }
}

/// The smallest field that has files of all kinds, in the midst of its second cycle and finished.
fn smallest(stop_after: Option<u32>) -> Memory {
    let storage = Arc::new(Memory::default());
    let how = How { threads: 1, stop_after, commit_every: 0.0, ..How::default() };
    let tiny = common::store::Tiny::new().scene;
    let parameters = stored(Parameters { tile: 4, ..parameters(3, 8, 2) });
    bake_into(storage.clone(), &tiny, &parameters, &how);
    storage.after_power_loss(|| 0)
}

/// Calls `spoils` for every one of so many spoilt fields, on two threads with a field each; it says
/// whether the spoiling was seen. Returns the first that was not.
fn first_unseen(
    field: &Memory,
    count: usize,
    spoils: impl Fn(&Memory, usize) -> bool + Sync,
) -> Option<usize> {
    let half = |from: usize| {
        let own = field.after_power_loss(|| 0);
        alone(|| (from..count).step_by(2).find(|k| !spoils(&own, *k)))
    };
    let (even, odd) = std::thread::scope(|scope| {
        let odd = scope.spawn(|| half(1));
        (half(0), odd.join().unwrap())
    });
    even.into_iter().chain(odd).min()
}

/// Not some, all of them: of a field that is small enough for it.
#[test]
fn every_single_bit_and_every_single_length_of_the_smallest_field_matters() {
    let (mut bits, mut lengths) = (0, 0);
    let mut kinds = std::collections::BTreeSet::new();
    for stop_after in [Some(5), None] {
        let field = smallest(stop_after);
        let report = check(&field);
        assert!(report.is_sound(), "{:?}", report.findings);
        let own = format!("sums-{:08}", report.state.unwrap().commit);
        let is_old = |name: &str| name.starts_with("sums-") && name != own;
        for name in files(&field).iter().filter(|n| !is_old(n)) {
            let found = |field: &Memory| match verify::field(field, &|_| ()) {
                Ok(report) => report.findings.iter().any(|f| f.file == *name),
                // A flipped version is one that is not supported.
                Err(FieldError::Format(e)) => e.fault.is_unsupported(),
                Err(_) => false,
            };
            kinds.insert(name.split(['-', '/']).next().unwrap().to_owned());
            let length = length(&field, name);
            let unseen = first_unseen(&field, 8 * length, |field, bit| {
                let flip = || field.edit(name, |bytes| bytes[bit / 8] ^= 1 << (bit % 8));
                flip();
                let found = found(field);
                flip();
                found
            });
            assert_eq!(unseen, None, "{name}: this bit makes no difference");
            let mut good = Vec::new();
            field.edit(name, |bytes| good.clone_from(bytes));
            let unseen = first_unseen(&field, length, |field, length| {
                field.edit(name, |bytes| bytes.truncate(length));
                let found = found(field);
                field.edit(name, |bytes| bytes.clone_from(&good));
                found
            });
            assert_eq!(unseen, None, "{name}: cut to this length makes no difference");
            bits += 8 * length;
            lengths += length;
        }
    }
    println!("{bits} bits, {lengths} lengths");
    let all = ["manifest", "scene", "sums", "textures", "total", "unshot"];
    assert_eq!(kinds.iter().map(String::as_str).collect::<Vec<_>>(), all);
}

#[test]
fn every_flipped_bit_of_a_pack_is_found() {
    let folder = TempDir::new().unwrap();
    let samples = Path::new(env!("CARGO_MANIFEST_DIR")).join("format-spec/samples");
    for name in ["raw.vlf", "zstd.vlf"] {
        let good = fs::read(samples.join(name)).unwrap();
        let path = folder.path().join(name);
        for bit in 0..8 * good.len() {
            let mut bad = good.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            fs::write(&path, bad).unwrap();
            let sound = alone(|| verify::pack(&path, &Limits::default(), &|_| ()))
                .is_ok_and(|r| r.is_sound());
            assert!(!sound, "{name}: bit {bit} makes no difference");
        }
    }
}

/// Whoever can write a file can make its hashes fit: what the bytes say is checked too, and the digest
/// tells a field from one with other numbers.
#[test]
fn lies_with_sound_hashes_are_found() {
    let (half, whole) = (memory(Some(14)), memory(None));
    let newest = |storage: &Memory| {
        let manifest = read_manifest(storage).unwrap().1;
        (vlf::format::names::manifest(manifest.sequence), manifest.sequence)
    };
    let (record, _) = newest(&whole);
    let sums = format!("sums-{:08}", newest(&half).1);
    // Two tallies of ten numbers, and one number a surface.
    let head = 2 * 160 + 4 * read_manifest(&*half).unwrap().0.surfaces as usize;
    type Lie<'a> = &'a dyn Fn(&mut Vec<Chunk>);
    let from_end = |chunk: &mut Chunk, n: usize, byte: &dyn Fn(u8) -> u8| {
        let at = chunk.bytes.len() - n;
        chunk.bytes[at] = byte(chunk.bytes[at]);
    };
    // A tile map's bytes end with halves and up to 6 bytes of padding.
    let lies: &[(&Arc<Memory>, &str, Lie, &str)] = &[
        (&whole, "total/000002.tiles", &|c| from_end(&mut c[0], 9, &|_| 0x7e), "not finite"),
        (&whole, "total/000003.tiles", &|c| c[0].bytes[0] = 9, "its tiles are not"),
        (&whole, "total/000003.tiles", &|c| c.clear(), "does not hold the chunks"),
        (&whole, "textures-0002", &|c| c[0].bytes[3] = 0xbf, "negative or not finite"),
        (&whole, "textures-0002", &|c| c[1].bytes[..4].fill(0xff), "negative or not finite"),
        (&whole, "textures-0002", &|c| shorten(&mut c[1], 24), "texels take"),
        (&whole, record, &|c| c[0].bytes[0] ^= 1, "identity"),
        (&whole, record, &|c| shorten(&mut c[0], 1), "no valid commit record"),
        (&half, &sums, &|c| shorten(&mut c[0], 64), "texels take"),
        (&half, &sums, &|c| c[0].bytes[15] = 0x80, "a total is out of range"),
        (&half, &sums, &|c| c[0].bytes[9 * 16 + 8] = 1, "a total is out of range"),
        (&half, &sums, &|c| c[0].bytes[160 + 15] = 0x80, "a total is out of range"),
        (&half, &sums, &|c| c[0].bytes[head + 7] = 0x80, "texel's are negative"),
        (&half, &sums, &|c| without_lines(&mut c[0].bytes[head..]), "light of no line"),
        (&half, "unshot-0001/000004.tiles", &|c| drop(c.pop()), "does not hold the chunks"),
        (&half, "unshot-0001/000004.tiles", &|c| c[1].bytes[12] ^= 1, "arrived map"),
    ];
    for (storage, name, lie, word) in lies {
        let mut good = Vec::new();
        storage.edit(name, |bytes| {
            good.clone_from(bytes);
            *bytes = rebuilt(bytes, lie);
        });
        if *word == "no valid commit record" {
            // Half of the truth is left: the record before.
            let report = check(&***storage);
            assert!(report.findings[0].what.starts_with("record:"), "{:?}", report.findings);
            assert_eq!(report.state.unwrap().commit + 1, newest_of(&good));
        } else {
            let report = check(&***storage);
            let said = report.findings.iter().find(|f| f.file == *name).map(ToString::to_string);
            assert!(said.as_ref().is_some_and(|s| s.contains(word)), "{name}, {word}: {said:?}");
            assert_eq!(report.found, 1, "{:?}", report.findings);
        }
        storage.edit(name, |bytes| *bytes = good);
        assert!(check(&***storage).is_sound());
    }

    // A number that could be true.
    whole.edit("total/000005.tiles", |bytes| {
        *bytes = rebuilt(bytes, &|c| from_end(&mut c[0], 10, &|b| b ^ 1));
    });
    let report = check(&*whole);
    assert_eq!(report.found, 1);
    assert_ne!(report.digest, report.stated_digest);
    let said = report.findings[0].to_string();
    assert!(said.contains(record) && said.contains("digest"), "{said}");

    // The same in a pack.
    let samples = Path::new(env!("CARGO_MANIFEST_DIR")).join("format-spec/samples");
    let good = fs::read(samples.join("raw.vlf")).unwrap();
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("lie.vlf");
    let lies: &[(Lie, &str)] = &[
        (&|c| map_of(c, 2).bytes[12] ^= 1, "total map of direction 2: tile map"),
        (&|c| c[2].bytes[3] = 0xbf, "total texture map: texture map: a radiance"),
        (&|c| c[0].bytes[0] ^= 1, "record: its identity"),
        (&|c| drop(c.pop()), "holds 11 chunks, not 12"),
        (&|c| c.swap(3, 4), "another chunk"),
    ];
    // A file that says that it has no diffuse surfaces in its maps, and has.
    let mut left_out = good.clone();
    left_out[32] = 1;
    sealing::seal_head(&mut left_out).unwrap();
    let mirror = fs::read(samples.join("damaged/textured-mirror.vlf")).unwrap();
    for (bytes, word) in [(left_out, "that was left out"), (mirror, "a mirror, or a surface on")] {
        fs::write(&path, bytes).unwrap();
        let report = verify::pack(&path, &Limits::default(), &|_| ()).unwrap();
        let said: Vec<_> = report.findings.iter().map(ToString::to_string).collect();
        assert!(said.iter().any(|s| s.contains(word)), "{word}: {said:?}");
    }
    for (lie, word) in lies {
        fs::write(&path, rebuilt(&good, lie)).unwrap();
        // Some lies are told by the directory already.
        match verify::pack(&path, &Limits::default(), &|_| ()) {
            Ok(report) => {
                let said: Vec<_> = report.findings.iter().map(ToString::to_string).collect();
                assert!(said.iter().any(|s| s.contains(word)), "{word}: {said:?}");
            }
            Err(error) => assert_eq!(vlf::exit::code(&error), vlf::exit::CORRUPT, "{error}"),
        }
    }
}

/// The map of a line among a pack's chunks.
fn map_of(chunks: &mut [Chunk], line: u32) -> &mut Chunk {
    chunks.iter_mut().find(|chunk| chunk.id[8..] == line.to_le_bytes()).unwrap()
}

/// Says of all sums that no line was added to them.
fn without_lines(sums: &mut [u8]) {
    sums.chunks_exact_mut(32).for_each(|texel| texel[24..].fill(0));
}

/// Takes bytes from the end of a chunk.
fn shorten(chunk: &mut Chunk, bytes: usize) {
    let length = chunk.bytes.len() - bytes;
    chunk.bytes.truncate(length);
    chunk.raw = length as u64;
}

/// The commit that the bytes of a manifest record.
fn newest_of(bytes: &[u8]) -> u64 {
    Manifest::from_file("", bytes, &Limits::default()).unwrap().1.sequence
}

/// A disk under which a bake goes on: with each look at a commit record there is a new one.
struct Moving {
    states: Vec<Arc<Memory>>,
    looks: AtomicU32,
    place: std::path::PathBuf,
}

impl Moving {
    fn new(states: Vec<Arc<Memory>>) -> Moving {
        Moving { states, looks: AtomicU32::new(0), place: "moving.field".into() }
    }

    /// Each attempt looks at the records when it begins, checks them, and looks again at its end; the
    /// next commit comes after the first two.
    fn now(&self) -> &Memory {
        let look = self.looks.load(Ordering::Relaxed) as usize;
        &self.states[((look + 1) / 3).min(self.states.len() - 1)]
    }
}

impl Storage for Moving {
    fn place(&self) -> &Path {
        &self.place
    }
    fn open(&self, name: &str) -> std::io::Result<Box<dyn Input>> {
        let opened = self.now().open(name);
        if name == "manifest-1" {
            self.looks.fetch_add(1, Ordering::Relaxed);
        }
        opened
    }
    fn list(&self, folder: &str) -> std::io::Result<Vec<String>> {
        self.now().list(folder)
    }
    fn make(&self) -> std::io::Result<()> {
        unreachable!("a check writes nothing")
    }
    fn lock(&self, _: &str) -> Result<Lock, LockError> {
        unreachable!("a check takes no lock")
    }
    fn create(&self, _: &str, _: u64) -> std::io::Result<Box<dyn Output>> {
        unreachable!("a check writes nothing")
    }
    fn rename(&self, _: &str, _: &str) -> std::io::Result<()> {
        unreachable!("a check writes nothing")
    }
    fn remove(&self, _: &str) -> std::io::Result<()> {
        unreachable!("a check writes nothing")
    }
    fn create_folder(&self, _: &str) -> std::io::Result<()> {
        unreachable!("a check writes nothing")
    }
    fn remove_folder(&self, _: &str) -> std::io::Result<()> {
        unreachable!("a check writes nothing")
    }
    fn sync_folder(&self, _: &str) -> std::io::Result<()> {
        unreachable!("a check writes nothing")
    }
    fn sync_file(&self, _: &str) -> std::io::Result<()> {
        unreachable!("a check writes nothing")
    }
    fn free(&self) -> Option<u64> {
        None
    }
}

/// A field as it is after each of its first commits.
fn commits(count: usize) -> Vec<Arc<Memory>> {
    let storage = Arc::new(Memory::default());
    let how = How { threads: 1, stop_after: Some(1), ..How::default() };
    let (scene, parameters) = (scene("cornell_mirror"), parameters(9, 16, 2));
    let states = (0..count).map(|_| {
        bake_into(storage.clone(), &scene, &parameters, &how);
        // Nothing is lost by luck: a copy.
        Arc::new(storage.after_power_loss(|| 0))
    });
    states.collect()
}

#[test]
fn a_field_that_moves_on_is_looked_at_again() {
    let states = commits(8);
    let first = read_manifest(&*states[0]).unwrap().1;
    // The sums of the first commit have gone when they are looked for.
    states[1].remove(&format!("sums-{:08}", first.sequence)).unwrap();
    let report = check(&Moving::new(states[..2].to_vec()));
    assert!(report.is_sound(), "{:?}", report.findings);
    assert_eq!(report.state.unwrap().commit, first.sequence + 1);

    // They always have.
    for (state, next) in states.iter().zip(&states[1..]) {
        let sequence = read_manifest(&**state).unwrap().1.sequence;
        let _ = next.remove(&format!("sums-{sequence:08}"));
    }
    let Err(error) = verify::field(&Moving::new(states), &|_| ()) else { panic!("caught up") };
    assert!(matches!(error, FieldError::Moving(_)), "{error}");
    assert_eq!(vlf::exit::code(&error), 6);

    // What two commits in a row lack is damage, though the bake goes on.
    let states = commits(8);
    for (state, next) in states.iter().zip(&states[1..]) {
        let sequence = read_manifest(&**state).unwrap().1.sequence;
        let _ = next.remove(&format!("sums-{sequence:08}"));
        next.remove("scene").unwrap();
    }
    let report = check(&Moving::new(states));
    let files: Vec<_> = report.findings.iter().map(|f| f.file.as_str()).collect();
    assert_eq!(files, ["scene"]);
}

/// A bake in a thread of its own; checks that begin at any time find nothing wrong.
#[test]
fn a_field_is_checked_while_it_is_baked() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("room.field");
    let how = How { commit_every: 0.0, threads: 1, ..How::default() };
    let (scene, parameters) = (scene("cornell_mirror"), parameters(33, 32, 4));
    std::thread::scope(|threads| {
        let bake = threads.spawn(|| bake_to(&path, &scene, &parameters, &how));
        let mut checks = 0;
        while !bake.is_finished() {
            match verify::field(&Disk::new(&path), &|_| ()) {
                Ok(report) => {
                    assert!(report.is_sound(), "{:?}", report.findings);
                    checks += 1;
                }
                Err(FieldError::Moving(_)) => {}
                // Before the first commit there is no field.
                Err(error) => assert_eq!(checks, 0, "{error}"),
            }
        }
        assert!(checks > 3, "only {checks} checks");
    });
    assert!(check(&Disk::new(&path)).is_sound());
}

#[test]
fn pixels_that_need_a_damaged_map_are_marked_if_asked_for() {
    let baked = Baked::new(&scene("cornell_mirror"), &parameters(129, 32, 2));
    let camera = camera("cornell_mirror", 40, 30);
    let how = (Method::Field, vlf::look::render::Options { samples: 4, ..Default::default() });
    let whole = |field: &LightField| {
        take_tolerant(field, &Visible::new(&field.scene), &camera, how, &|_| ())
    };
    let field = baked.open();
    let (good, none) = whole(&field);
    assert!(none.is_empty() && field.damaged().is_empty());
    // A flipped bit, a missing file and a sound one of another direction.
    let file = |direction: u32| baked.path.join(format!("total/{direction:06}.tiles"));
    let mut hurt = Vec::new();
    for direction in (0..129).step_by(8) {
        match direction % 3 {
            0 => fs::remove_file(file(direction)).unwrap(),
            1 => drop(fs::copy(file(direction + 1), file(direction)).unwrap()),
            _ => {
                let mut bytes = fs::read(file(direction)).unwrap();
                bytes[500] ^= 1;
                fs::write(file(direction), bytes).unwrap();
            }
        }
        hurt.push(direction);
    }
    let field = baked.open();
    let (mut picture, missing) = whole(&field);
    assert!(!missing.is_empty() && missing.len() < good.pixels.len(), "{} missing", missing.len());
    let damaged = field.damaged();
    assert!(!damaged.is_empty() && damaged.iter().all(|d| hurt.contains(&d.0)), "{damaged:?}");
    for (at, pixel) in picture.pixels.iter().enumerate() {
        assert!(missing.contains(&at) || *pixel == good.pixels[at], "pixel {at}");
    }
    mark(&mut picture, &missing, None);
    for at in &missing {
        let [r, g, b] = picture.pixels[*at].0;
        assert!(r > 0.0 && g == 0.0 && b == r);
    }

    // The same from the program: refused unless asked for.
    let eye = [
        "--camera",
        &common::obj("cornell_mirror").with_file_name("camera_a.json").display().to_string(),
    ]
    .map(str::to_owned);
    let render = |more: &[&str]| {
        let mut command = vlf(baked.folder.path());
        command.args([
            "render",
            "test.field",
            "-o",
            "out.png",
            "--size",
            "40x30",
            "--method",
            "field",
        ]);
        command.args(&eye).args(more).output().unwrap()
    };
    let output = render(&[]);
    assert_eq!(output.status.code(), Some(CORRUPT));
    assert!(!baked.folder.path().join("out.png").exists());
    let output = render(&["--tolerate", "--json"]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{said}");
    assert!(said.contains("magenta") && said.contains("directions"), "{said}");
    assert_eq!(said.matches("warning").count(), 1, "{said}");
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(json["marked_pixels"].as_u64().unwrap() > 0);
    assert!(!json["damaged_directions"].as_array().unwrap().is_empty());
    let png = fs::read(baked.folder.path().join("out.png")).unwrap();
    assert!(png.starts_with(b"\x89PNG"));
}
