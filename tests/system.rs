//! What a real system does to a bake: kills it, gives it small, read-only and borrowed disks, few
//! file descriptors, another bake in the same place, and devices where a field should be. The exit
//! code and the message say what it was, the last commit stays, and when the trouble is over the same
//! command ends with the same bits.

#![cfg(unix)]

mod common;

use common::{Dice, obj};
use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;
use vlf::field::read_manifest;
use vlf::field::storage::Storage;
use vlf::field::storage::disk::Disk;
use vlf::field::storage::faulty::{Faults, Faulty};
use vlf::format::manifest::{Manifest, Phase};
use vlf::format::names;

const IO: i32 = 3;
const CORRUPT: i32 = 4;
const LOCKED: i32 = 6;

const VLF: &str = env!("CARGO_BIN_EXE_vlf");

/// Arguments of the smallest bake that has everything in it.
fn small(field: &Path, sync: &str) -> Vec<String> {
    let (scene, field) = (obj("cornell_mirror"), field.to_str().unwrap());
    let mut args: Vec<String> =
        ["bake", scene.to_str().unwrap(), "-o", field].map(str::to_owned).into();
    let how = "--directions 33 --resolution 16 --cycles 2 --perturb 2,1 --threads 2 --sync";
    let mirrors = "--specular maps --resample off".split(' ');
    args.extend(how.split(' ').chain([sync]).chain(mirrors).map(str::to_owned));
    args
}

/// The same, too large to be done before the test is.
fn large(field: &Path) -> Vec<String> {
    let larger = |arg: &str| match arg {
        "33" => "2049".to_owned(),
        "16" => "64".to_owned(),
        _ => arg.to_owned(),
    };
    small(field, "interval:0.1s").iter().map(|a| larger(a)).collect()
}

fn vlf(args: &[String]) -> Command {
    let mut command = Command::new(VLF);
    command.args(args).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

/// Runs a shell's script with the program and more as `$1`, `$2` and on.
fn shell(script: &str, args: &[String]) -> Command {
    let mut command = Command::new("sh");
    command.arg("-c").arg(script).arg("sh").arg(VLF).args(args).stdin(Stdio::null());
    command
}

fn manifest(field: &Path) -> Option<Manifest> {
    read_manifest(&Disk::new(field)).ok().map(|m| m.1)
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// It must have ended with this code and these words, and have named no fault of its own.
fn refused(output: &Output, code: i32, words: &[&str]) {
    let said = said(output);
    assert_eq!(output.status.code(), Some(code), "{:?}: {said}", output.status);
    for word in words {
        assert!(said.contains(word), "no `{word}` in: {said}");
    }
    assert!(!said.contains("panicked"), "{said}");
}

/// Waits for something to become so.
fn wait_for(what: &str, mut is_so: impl FnMut() -> bool) {
    let start = Instant::now();
    while !is_so() {
        assert!(start.elapsed() < Duration::from_secs(120), "waited in vain: {what}");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Starts the large bake and waits until it has done something that can be lost.
fn under_way(field: &Path) -> Child {
    let before = manifest(field).map_or(0, |m| m.sequence);
    let mut child = vlf(&large(field)).spawn().unwrap();
    wait_for("a commit with work in it", || {
        assert_eq!(child.try_wait().unwrap(), None, "it has ended");
        manifest(field).is_some_and(|m| m.sequence > before + 1 && m.done_count() > 0)
    });
    child
}

/// A finished bake of the small field that nothing has happened to, and its files.
struct Plain {
    folder: TempDir,
    digest: [u8; 16],
    files: Vec<(PathBuf, Vec<u8>)>,
}

impl Plain {
    fn new() -> Plain {
        let folder = TempDir::new().unwrap();
        let field = folder.path().join("plain.field");
        assert!(vlf(&small(&field, "none")).status().unwrap().success());
        Plain { digest: manifest(&field).unwrap().digest, files: files(&field), folder }
    }

    fn field(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Goes on with a field, to the same end.
    fn ends_the_same(&self, field: &Path) {
        let output = vlf(&small(field, "none")).output().unwrap();
        assert!(output.status.success(), "{}", said(&output));
        self.is_same(field);
    }

    fn is_same(&self, field: &Path) {
        let found = manifest(field).unwrap();
        assert_eq!((found.phase, found.digest), (Phase::Finished, self.digest));
        let names = |files: &[(PathBuf, Vec<u8>)]| {
            files.iter().map(|(name, _)| name.clone()).collect::<Vec<_>>()
        };
        let found = files(field);
        assert_eq!(names(&found), names(&self.files));
        for ((name, bytes), (_, expected)) in found.iter().zip(&self.files) {
            assert!(bytes == expected, "other bytes in {}", name.display());
        }
    }
}

/// Names of a field's files, and the bytes of those that must be the same in every bake.
fn files(field: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut all = Vec::new();
    let mut folders = vec![field.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let name = path.strip_prefix(field).unwrap().to_owned();
            let last = path.file_name().unwrap().to_string_lossy().into_owned();
            let is_same = ["manifest", "lock"].iter().all(|n| !last.starts_with(n));
            all.push((name, if is_same { fs::read(path).unwrap() } else { Vec::new() }));
        }
    }
    all.sort();
    all
}

/// What of a bake can be seen from outside: it changes with nearly every operation.
fn trace(field: &Path) -> u64 {
    let mut trace = 0u64;
    for folder in ["", "unshot-0001", "unshot-0002", names::TOTAL] {
        for entry in fs::read_dir(field.join(folder)).into_iter().flatten().flatten() {
            let length = entry.metadata().map_or(0, |m| m.len());
            for byte in entry.file_name().as_encoded_bytes() {
                trace = trace.wrapping_mul(31).wrapping_add(u64::from(*byte) + length);
            }
        }
    }
    trace
}

#[test]
fn a_hundred_bakes_killed_at_random_operations_end_with_the_same_bits() {
    const BAKES: u32 = 100;
    let plain = Plain::new();
    let mut dice = Dice(17);
    let (mut kills, mut whole) = (0, 0);
    let start = Instant::now();
    for bake in 0..BAKES {
        let field = plain.field("killed.field");
        let sync = ["none", "commit", "interval:0.002"][bake as usize % 3];
        for _ in 0..1 + dice.next() % 3 {
            let mut child = vlf(&small(&field, sync)).spawn().unwrap();
            // Some before it has begun, most after so many steps that can be seen.
            let mut steps = dice.next() % 60;
            let mut last = trace(&field);
            while steps > 0 && child.try_wait().unwrap().is_none() {
                let now = trace(&field);
                steps -= u64::from(now != last);
                last = now;
            }
            child.kill().unwrap();
            match child.wait().unwrap().code() {
                None => kills += 1,
                code => assert_eq!(code, Some(0), "it failed by itself"),
            }
            // A reader finds a field, finished or not, or none yet; never a damaged one.
            let names = Disk::new(&field).list("").unwrap_or_default();
            if names.iter().any(|n| names::MANIFESTS.contains(&n.as_str())) {
                let found = read_manifest(&Disk::new(&field)).unwrap().1;
                whole += u32::from(found.phase == Phase::Finished);
            }
        }
        plain.ends_the_same(&field);
        fs::remove_dir_all(&field).unwrap();
    }
    println!("{BAKES} bakes, {kills} kills, {whole} after the end, {:?}", start.elapsed());
    assert!(kills >= BAKES, "only {kills} were killed in time");
}

#[test]
fn killed_right_after_the_start_it_leaves_nothing_in_the_way() {
    let plain = Plain::new();
    let field = plain.field("early.field");
    for wait in 0..20 {
        let mut child = vlf(&small(&field, "none")).spawn().unwrap();
        std::thread::sleep(Duration::from_micros(500 * wait));
        child.kill().unwrap();
        child.wait().unwrap();
    }
    plain.ends_the_same(&field);
}

#[test]
fn two_bakes_in_one_place_are_kept_apart_whatever_becomes_of_the_lock_file() {
    let folder = TempDir::new().unwrap();
    let field = folder.path().join("room.field");
    let mut first = under_way(&field);
    let who = format!("process {}", first.id());
    let second = || vlf(&large(&field)).output().unwrap();
    refused(&second(), LOCKED, &["room.field", &who, "is being baked"]);
    // By another name of the same place.
    let link = folder.path().join("link.field");
    std::os::unix::fs::symlink(&field, &link).unwrap();
    refused(&vlf(&large(&link)).output().unwrap(), LOCKED, &[&who]);
    // The lock is the folder's: the file only says whose it is.
    fs::rename(field.join(names::LOCK), folder.path().join("elsewhere")).unwrap();
    refused(&second(), LOCKED, &["room.field", "another process"]);
    fs::write(field.join(names::LOCK), "\u{1b}[31mred").unwrap();
    refused(&second(), LOCKED, &["\\u{1b}[31mred"]);
    fs::remove_file(field.join(names::LOCK)).unwrap();
    refused(&second(), LOCKED, &["another process"]);
    assert_eq!(first.try_wait().unwrap(), None, "the first was disturbed");
    first.kill().unwrap();
    first.wait().unwrap();
    // The system gives the lock of the dead back; the next goes on.
    let mut next = under_way(&field);
    next.kill().unwrap();
    next.wait().unwrap();
}

/// How a disk that refuses to be written is come by.
#[derive(Debug, PartialEq)]
enum Way {
    /// A mount of our own.
    Mount,
    /// Permissions, which do not count for root.
    Permissions,
    /// Neither: a storage that refuses.
    Storage,
}

fn can_mount(folder: &Path) -> bool {
    let script = "mount -t tmpfs -o size=1m none \"$2\"";
    let folder = folder.to_str().unwrap().to_owned();
    let mut command = Command::new("unshare");
    command.args(["-rm", "sh", "-c", script, "sh", VLF, &folder]);
    command.stdout(Stdio::null()).stderr(Stdio::null());
    command.status().is_ok_and(|s| s.success())
}

/// Runs a script where it may mount what it likes.
fn with_mounts(script: &str, args: &[&Path]) -> Output {
    let mut command = Command::new("unshare");
    command.args(["-rm", "sh", "-c", script, "sh", VLF]).args(args).stdin(Stdio::null());
    command.output().unwrap()
}

fn half_done(folder: &Path) -> PathBuf {
    let field = folder.join("half.field");
    let mut child = under_way(&field);
    child.kill().unwrap();
    child.wait().unwrap();
    field
}

#[test]
fn from_a_disk_that_cannot_be_written_fields_are_read_and_not_baked() {
    let plain = Plain::new();
    let folder = plain.folder.path();
    half_done(folder);
    let before = files(folder);
    let new = folder.join("new.field");
    let bakes = [large(&folder.join("half.field")), small(&new, "none")];
    let readers = [["info", "plain.field"], ["info", "half.field"]];
    let is_writable = || fs::write(folder.join("probe"), "").is_ok();
    let run = |command: &mut Command| command.current_dir(folder).output().unwrap();
    let way = if can_mount(folder) {
        Way::Mount
    } else {
        let mut permissions = fs::metadata(folder).unwrap().permissions();
        permissions.set_readonly(true);
        for place in [folder.to_owned(), folder.join("half.field"), folder.join("plain.field")] {
            fs::set_permissions(place, permissions.clone()).unwrap();
        }
        if is_writable() { Way::Storage } else { Way::Permissions }
    };
    println!("a disk that refuses, by way of: {way:?}");
    let words = match way {
        Way::Mount => "Read-only file system",
        _ => "Permission denied",
    };
    if way == Way::Storage {
        // All that is written is refused; reading works as ever.
        let kind = Some(std::io::ErrorKind::ReadOnlyFilesystem);
        let disk = std::sync::Arc::new(Disk::new(&folder.join("half.field")));
        let reads = |log: &[String]| log.iter().position(|l| l.starts_with("create")).unwrap();
        let scene = common::scene("cornell_mirror");
        let parameters = manifest(&folder.join("half.field")).unwrap().parameters;
        let exponent = read_manifest(&*disk).unwrap().0.exponent;
        let begin = |faults| {
            let storage = std::sync::Arc::new(Faulty::new(disk.clone(), faults));
            let terms = vlf::field::Terms::default();
            let result = vlf::field::Field::create_or_resume(
                storage.clone(),
                &scene,
                &parameters,
                exponent,
                terms,
            );
            (result.err(), storage.log())
        };
        let fail = Some(reads(&begin(Faults::default()).1) as u64);
        let error = begin(Faults { fail, for_ever: true, kind, ..Faults::default() }).0.unwrap();
        assert_eq!(i32::from(vlf::exit::code(&error)), IO, "{error}");
        return;
    }
    let read_only = |args: &[String]| match way {
        Way::Mount => {
            let script = "mount --bind \"$2\" \"$2\" && mount -o remount,ro,bind \"$2\" || exit 99
                cd \"$2\"; vlf=$1; shift 2; exec \"$vlf\" \"$@\"";
            let mut command = Command::new("unshare");
            command.args(["-rm", "sh", "-c", script, "sh", VLF]).arg(folder).args(args);
            command.stdin(Stdio::null()).output().unwrap()
        }
        _ => run(&mut vlf(args)),
    };
    for args in readers {
        let output = read_only(&args.map(str::to_owned));
        assert!(output.status.success(), "{args:?}: {}", said(&output));
    }
    let picture = TempDir::new().unwrap();
    let out = picture.path().join("a.png").to_str().unwrap().to_owned();
    let look = "render plain.field --eye 0,1,3.4 --target 0,1,0 --size 16x12 --samples 1 -o";
    let look: Vec<String> = look.split(' ').chain([out.as_str()]).map(str::to_owned).collect();
    let output = read_only(&look);
    assert!(output.status.success(), "{}", said(&output));
    assert!(fs::metadata(&out).unwrap().len() > 0);
    for (args, name) in bakes.iter().zip(["half.field", "new.field"]) {
        let start = Instant::now();
        refused(&read_only(args), IO, &[name, words]);
        // Before anything is computed for it.
        assert!(start.elapsed() < Duration::from_secs(20), "{name}: {:?}", start.elapsed());
    }
    // A field that is finished has nothing to write.
    let again = read_only(&small(&folder.join("plain.field"), "none"));
    assert!(again.status.success(), "{}", said(&again));
    assert!(!new.exists());
    if way == Way::Permissions {
        for place in [folder.to_owned(), folder.join("half.field"), folder.join("plain.field")] {
            let mut permissions = fs::metadata(&place).unwrap().permissions();
            #[allow(clippy::permissions_set_readonly_false, reason = "a folder of the test's own")]
            permissions.set_readonly(false);
            fs::set_permissions(place, permissions).unwrap();
        }
    }
    assert!(files(folder) == before, "something was changed");
}

#[test]
fn on_a_disk_that_is_too_small_it_is_refused_or_stops_whole_and_goes_on_when_there_is_room() {
    let plain = Plain::new();
    let place = plain.field("disk");
    fs::create_dir(&place).unwrap();
    if !can_mount(&place) {
        println!("no mounts here: disks in memory stand for small ones, see tests/faults.rs");
        let disk = vlf::field::storage::memory::Memory::with_capacity(1000);
        assert!(disk.create("a", 1001).is_err());
        return;
    }
    println!("small disks, by way of: {:?}", Way::Mount);
    let kilobytes: u64 = plain.files.iter().map(|(_, b)| b.len() as u64 / 1024 + 4).sum();
    let mut full = 0;
    // `$1` the program, `$2` the disk, `$3` where the result goes; then the bake's own arguments.
    let script = "
        vlf=$1; disk=$2; out=$3; size=$4; shift 4
        mount -t tmpfs -o size=${size}k none \"$disk\" || exit 99
        \"$vlf\" \"$@\" 2>\"$out/refused\"; echo $? >\"$out/refused.code\"
        \"$vlf\" \"$@\" --force 2>\"$out/full\"; echo $? >\"$out/full.code\"
        \"$vlf\" info \"$disk/a.field\" >\"$out/info\" 2>&1; echo $? >\"$out/info.code\"
        \"$vlf\" \"$@\" 2>\"$out/again\"; echo $? >\"$out/again.code\"
        cp -r \"$disk/a.field\" \"$out/a.field\"";
    for part in [4, 10, 25, 40, 55, 70, 85, 95] {
        let out = plain.field(&format!("out-{part}"));
        fs::create_dir(&out).unwrap();
        let size = (kilobytes * part / 100).max(16).to_string();
        let bake = small(&place.join("a.field"), "commit");
        let mut args = vec![place.as_path(), out.as_path(), Path::new(&size)];
        args.extend(bake.iter().map(Path::new));
        let output = with_mounts(script, &args);
        assert!(output.status.success(), "{size}k: {:?} {}", output.status, said(&output));
        let text = |name: &str| fs::read_to_string(out.join(name)).unwrap();
        let code = |name: &str| text(&format!("{name}.code")).trim().parse::<i32>().unwrap();
        // Foreseen, where the estimate is not below what is there.
        if code("refused") == IO && text("refused").contains("--force") {
            assert!(text("refused").contains("is free"), "{size}k: {}", text("refused"));
        }
        if code("full") == IO {
            full += 1;
            let said = text("full");
            for word in ["a.field/", "disk is full", "intact", "run the same command again"] {
                assert!(said.contains(word), "{size}k: no `{word}` in {said}");
            }
            // Readers do not mind, where there is a commit to read.
            let info = text("info");
            assert!(code("info") == 0 || info.contains("not a VLF"), "{size}k: {info}");
            assert!([0, IO].contains(&code("again")), "{size}k: {}", text("again"));
        } else {
            assert_eq!(code("full"), 0, "{size}k: {}", text("full"));
        }
        // Where there is room it goes on.
        plain.ends_the_same(&out.join("a.field"));
    }
    println!("full {full} times of 8, {kilobytes} KiB in all");
    assert!(full >= 5, "full only {full} times");
}

#[test]
fn a_limit_on_the_size_of_files_is_a_full_disk() {
    let plain = Plain::new();
    let field = plain.field("limited.field");
    // In blocks of 512 bytes, or of 1024 in some shells.
    let script = "ulimit -f 4; exec \"$@\"";
    let output = shell(script, &small(&field, "none")).output().unwrap();
    refused(
        &output,
        IO,
        &["limited.field/", "disk is full", "intact", "run the same command again"],
    );
    plain.ends_the_same(&field);
}

/// A limit on the address space refuses the mapping, not the picture.
#[test]
fn where_a_pack_cannot_be_mapped_it_is_read() {
    let folder = TempDir::new().unwrap();
    let parameters = common::parameters(129, 128, 1);
    let baked = common::Baked::new(&common::scene("office"), &parameters);
    let pack = folder.path().join("office.vlf");
    let bytes = vlf::pack(&baked.path, &pack, vlf::Codec::Raw, &|_| {}).unwrap().bytes >> 10;
    assert!(bytes > 16 << 10, "{bytes} KiB are too few to tell");
    let picture = folder.path().join("p.exr");
    let camera = obj("office").with_file_name("camera_a.json");
    let render = |limit: Option<u64>, more: &[&str]| {
        let _ = fs::remove_file(&picture);
        let mut args = vec!["render".to_owned(), pack.display().to_string()];
        args.extend(["-o".to_owned(), picture.display().to_string()]);
        args.extend(["--camera".to_owned(), camera.display().to_string()]);
        let how = ["--size", "16x12", "--samples", "1", "--threads", "1"];
        args.extend(how.iter().chain(more).map(|a| (*a).to_owned()));
        let limit = limit.map_or("unlimited".to_owned(), |limit| limit.to_string());
        let mut command = shell(&format!("ulimit -v {limit}; exec \"$@\""), &args);
        let output = command.env("VLF_LOG", "info").output().unwrap();
        (output.status.success(), said(&output), fs::read(&picture).ok())
    };
    let (well, words, expected) = render(None, &[]);
    assert!(well && !words.contains("read instead"), "{words}");
    assert_eq!(render(None, &["--no-map"]).2, expected);
    // The least address space, in KiB, in which it can be read. Another pack of the room is too much.
    let (mut too_little, mut enough) = (0, 4 << 20);
    while enough - too_little > 1 << 10 {
        let half = u64::midpoint(too_little, enough);
        *(if render(Some(half), &["--no-map"]).0 { &mut enough } else { &mut too_little }) = half;
    }
    let (well, words, found) = render(Some(enough + (4 << 10)), &[]);
    assert!(well && words.contains("read instead"), "{words}");
    assert_eq!(found, expected);
}

#[test]
fn few_file_descriptors_are_enough() {
    let plain = Plain::new();
    for (limit, threads) in [("32", "2"), ("32", "8"), ("64", "16")] {
        let field = plain.field("narrow.field");
        let mut args = small(&field, "none");
        let at = args.iter().position(|a| a == "--threads").unwrap();
        args[at + 1] = threads.to_owned();
        let script = format!("ulimit -n {limit}; exec \"$@\"");
        let output = shell(&script, &args).output().unwrap();
        assert!(output.status.success(), "{limit}: {}", said(&output));
        plain.is_same(&field);
        fs::remove_dir_all(&field).unwrap();
    }
    // Too few even for that: said so, and nothing is damaged.
    let field = plain.field("narrow.field");
    let output = shell("ulimit -n 6; exec \"$@\"", &small(&field, "none")).output().unwrap();
    if !output.status.success() {
        refused(&output, IO, &["Too many open files"]);
    }
    plain.ends_the_same(&field);
}

#[test]
fn what_is_no_field_and_no_file_is_refused_and_left_as_it_is() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("letter.txt"), "Dear reader").unwrap();
    let pipe = Command::new("mkfifo").arg(at("pipe")).status().is_ok_and(|s| s.success());
    println!("pipes can be made here: {pipe}");
    let mut places = vec![PathBuf::from("/dev/null"), PathBuf::from("/"), at("letter.txt")];
    if pipe {
        places.push(at("pipe"));
    }
    let quickly = |args: &[String]| {
        let mut child = vlf(args).spawn().unwrap();
        let start = Instant::now();
        while child.try_wait().unwrap().is_none() {
            if start.elapsed() > Duration::from_secs(30) {
                child.kill().unwrap();
                panic!("{args:?} hangs");
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        child.wait_with_output().unwrap()
    };
    for place in &places {
        let output = quickly(&small(place, "none"));
        refused(&output, CORRUPT, &["not a VLF field", "nothing was changed"]);
        let out = at("a.png");
        let look = ["render", place.to_str().unwrap(), "-o", out.to_str().unwrap()];
        let camera = ["--eye", "0,1,3", "--target", "0,1,0"];
        let info = ["info", place.to_str().unwrap()];
        for args in [[&look[..], &camera].concat(), info.to_vec()] {
            let output = quickly(&args.iter().map(|a| (*a).to_owned()).collect::<Vec<_>>());
            let code = output.status.code();
            assert!([Some(IO), Some(CORRUPT)].contains(&code), "{args:?}: {}", said(&output));
            assert!(!said(&output).contains("panicked"), "{}", said(&output));
        }
    }
    assert_eq!(fs::read_to_string(at("letter.txt")).unwrap(), "Dear reader");
    use std::os::unix::fs::FileTypeExt;
    assert!(fs::metadata("/dev/null").unwrap().file_type().is_char_device());
    assert!(!Path::new("/lock").exists() && !Path::new("/scene").exists());
    // Nor is a link in a field followed to where something else lies.
    let field = at("linked.field");
    let mut child = under_way(&field);
    child.kill().unwrap();
    child.wait().unwrap();
    fs::create_dir(at("ours")).unwrap();
    fs::write(at("ours/000001.tiles"), "Dear reader").unwrap();
    for name in ["manifest-0.tmp", "manifest-1.tmp", "lock"] {
        let _ = fs::remove_file(field.join(name));
        std::os::unix::fs::symlink(at("letter.txt"), field.join(name)).unwrap();
    }
    std::os::unix::fs::symlink(at("ours"), field.join("unshot-0077")).unwrap();
    refused(&quickly(&large(&field)), IO, &["not a regular file"]);
    for name in ["manifest-0.tmp", "manifest-1.tmp"] {
        fs::remove_file(field.join(name)).unwrap();
    }
    let mut child = under_way(&field);
    child.kill().unwrap();
    child.wait().unwrap();
    let mut text = String::new();
    for name in ["letter.txt", "ours/000001.tiles"] {
        fs::File::open(at(name)).unwrap().read_to_string(&mut text).unwrap();
        assert_eq!(std::mem::take(&mut text), "Dear reader", "{name}");
    }
}
