//! The program is kind to mistakes: whatever is wrong is said in one clear message on standard error,
//! the exit code says what kind of thing it is, and nothing that was there is overwritten. What is
//! asked for as JSON is one JSON object and nothing else.

mod common;

use assert_cmd::Command;
use common::{BOX_ON_A_FLOOR, Baked, How, WHITE_AND_LAMP, bake_to, obj, parameters, scene};
use std::fs;
use std::path::Path;
use tempfile::TempDir;
use vlf::field::storage::Storage;
use vlf::field::storage::disk::Disk;
use vlf::format::container::Codec;
use vlf::look::image::read_exr;
use vlf::pack::pack;

const USAGE: i32 = 2;
const IO: i32 = 3;
const CORRUPT: i32 = 4;
const LOCKED: i32 = 6;
const LIMIT: i32 = 7;
const IDENTITY: i32 = 8;

fn vlf(folder: &TempDir) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_vlf"));
    command.current_dir(folder.path());
    command
}

/// Runs the program, which must fail with this code, say each of `words` on standard error and print
/// nothing. Returns what it said.
fn refused(folder: &TempDir, args: &[&str], code: i32, words: &[&str]) -> String {
    let output = vlf(folder).args(args).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(code), "{args:?}: {said}");
    assert!(output.stdout.is_empty(), "{args:?}: on standard output");
    for word in words {
        assert!(said.contains(word), "{args:?}: no `{word}` in: {said}");
    }
    assert!(!said.contains("panicked"), "{args:?}: {said}");
    said
}

/// A folder with a scene `box.obj` in it.
fn folder() -> TempDir {
    let folder = TempDir::new().unwrap();
    write(&folder, "box.obj", &format!("mtllib box.mtl\n{BOX_ON_A_FLOOR}"));
    write(&folder, "box.mtl", WHITE_AND_LAMP);
    folder
}

fn write(folder: &TempDir, name: &str, text: &str) {
    fs::write(folder.path().join(name), text).unwrap();
}

const BAKE: [&str; 8] =
    ["--directions", "33", "--resolution", "32", "--cycles", "2", "--quality", "draft"];

/// `vlf bake box.obj -o OUT` of a small field with more arguments.
fn bake<'a>(out: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    [&["bake", "box.obj", "-o", out][..], &BAKE, more].concat()
}

/// The same with one of the small field's options another.
fn bake_but<'a>(out: &'a str, option: &str, value: &'a str) -> Vec<&'a str> {
    let mut args = bake(out, &[]);
    let at = args.iter().position(|a| *a == option).unwrap();
    args[at + 1] = value;
    args
}

#[test]
fn scenes_that_cannot_be_lit_are_refused_before_anything_is_made() {
    let folder = folder();
    write(&folder, "empty.obj", "");
    write(&folder, "points.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n");
    write(&folder, "library.obj", "mtllib gone.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    write(&folder, "dark.obj", "mtllib dark.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n");
    write(&folder, "dark.mtl", "newmtl a\nKd 0.5 0.5 0.5\n");
    write(&folder, "broken.obj", "v 0 0 0\nv 1 0 x\n");
    fs::write(folder.path().join("binary.obj"), [0xff, 0xfe, 0, 1, 2]).unwrap();
    for (scene, code, words) in [
        ("gone.obj", IO, &["gone.obj", "cannot be read"][..]),
        (".", IO, &["cannot be read"]),
        ("empty.obj", CORRUPT, &["empty.obj", "no face"]),
        ("points.obj", CORRUPT, &["points.obj", "no face"]),
        ("library.obj", IO, &["library.obj:1", "gone.mtl"]),
        ("dark.obj", CORRUPT, &["dark.obj", "nothing emits light", "Ke"]),
        ("broken.obj", CORRUPT, &["broken.obj:2"]),
        ("binary.obj", CORRUPT, &["binary.obj"]),
    ] {
        refused(&folder, &["bake", scene, "-o", "out.field"], code, words);
        assert!(!folder.path().join("out.field").exists(), "{scene}");
    }
}

#[test]
fn parameters_that_make_no_sense_are_refused_before_anything_is_made() {
    let folder = folder();
    for (option, value, code, words) in [
        ("--directions", "100", USAGE, &["--directions 100", "129"][..]),
        ("--directions", "0", USAGE, &["--directions 0"]),
        ("--directions", "many", USAGE, &["--directions"]),
        ("--resolution", "0", USAGE, &["--resolution 0"]),
        ("--resolution", "1000000", USAGE, &["--resolution 1000000"]),
        ("--cycles", "0", USAGE, &["--cycles"]),
        ("--cycles", "some", USAGE, &["--cycles", "auto"]),
    ] {
        refused(&folder, &bake_but("out.field", option, value), code, words);
    }
    for (more, code, words) in [
        (&["--tile", "7"][..], USAGE, &["--tile 7", "divide"][..]),
        (&["--tile", "0"], USAGE, &["--tile 0"]),
        (&["--perturb", "0"], USAGE, &["--perturb"]),
        (&["--threads", "0"], USAGE, &["--threads 0"]),
        (&["--texel", "0"], USAGE, &["texel"]),
        (&["--texel", "NaN"], USAGE, &["texel"]),
        (&["--memory", "64KiB"], LIMIT, &["needs at least", "iB"]),
        (&["--memory", "lots"], USAGE, &["--memory"]),
        (&["--colour"], USAGE, &["--colour"]),
    ] {
        refused(&folder, &bake("out.field", more), code, words);
    }
    assert!(!folder.path().join("out.field").exists());
    refused(&folder, &["bake", "box.obj"], USAGE, &["--output"]);
    refused(&folder, &["blend"], USAGE, &["blend"]);
    refused(&folder, &[], USAGE, &["Usage"]);
}

/// The least memory that is named must do.
#[test]
fn the_memory_that_a_refusal_asks_for_is_enough() {
    let folder = folder();
    let said = refused(&folder, &bake("out.field", &["--memory", "64KiB"]), LIMIT, &[]);
    let after = said.split("at least ").nth(1).unwrap();
    let needs: String = after.split(" of ").next().unwrap().replace(' ', "");
    vlf(&folder).args(bake("out.field", &["--memory", &needs])).assert().success();
}

#[test]
fn what_is_not_a_field_is_not_baked_over() {
    let folder = folder();
    write(&folder, "letter.txt", "Dear reader");
    fs::create_dir(folder.path().join("photos")).unwrap();
    write(&folder, "photos/one.jpg", "not ours");
    for out in ["letter.txt", "photos"] {
        refused(
            &folder,
            &bake(out, &[]),
            CORRUPT,
            &[out, "not a VLF field", "nothing was changed"],
        );
    }
    assert_eq!(fs::read_to_string(folder.path().join("letter.txt")).unwrap(), "Dear reader");
    let photos: Vec<_> = fs::read_dir(folder.path().join("photos")).unwrap().collect();
    assert_eq!(photos.len(), 1, "{photos:?}");
    refused(&folder, &bake("letter.txt/out.field", &[]), IO, &["letter.txt"]);
}

/// Small bake of the bundled scene, and its pack.
fn baked() -> (Baked, TempDir) {
    let baked = Baked::new(&scene("cornell_mirror"), &parameters(33, 32, 2));
    let folder = TempDir::new().unwrap();
    pack(&baked.path, &folder.path().join("room.vlf"), Codec::Zstd, &|_| {}).unwrap();
    (baked, folder)
}

const LOOK: [&str; 4] = ["--eye", "0,1,3.4", "--target", "0,1,0"];

#[test]
fn cameras_that_can_see_nothing_are_refused() {
    let (_baked, folder) = baked();
    let look = |eye: &str, more: &[&str], code: i32, words: &[&str]| {
        let args = [&["render", "room.vlf", "-o", "out.png", "--eye", eye][..], more].concat();
        refused(&folder, &args, code, words);
        assert!(!folder.path().join("out.png").exists());
    };
    let target = ["--target", "0,1,0"];
    look("0,1,0", &target, USAGE, &["target"]);
    look("0,1", &target, USAGE, &["--eye"]);
    look("0,one,2", &target, USAGE, &["--eye"]);
    look("0,nan,2", &target, USAGE, &["eye"]);
    look("0,1,3", &[], USAGE, &["--target"]);
    look("0,1,3", &["--target", "0,1,0", "--up", "0,0,1"], USAGE, &["up"]);
    for size in ["0x0", "0x10", "1000000x1000000", "20000x1"] {
        look("0,1,3", &["--target", "0,1,0", "--size", size], USAGE, &["pixels"]);
    }
    for size in ["100", "axb", "-1x5", "99999999999x1"] {
        look("0,1,3", &["--target", "0,1,0", &format!("--size={size}")], USAGE, &["--size"]);
    }
    look("0,1,3", &["--target", "0,1,0", "--samples", "0"], USAGE, &["--samples"]);
    look("0,1,3", &["--target", "0,1,0", "--vfov", "180"], USAGE, &["vfov"]);
    look("0,1,3", &["--target", "0,1,0", "--camera", "a.json"], USAGE, &["--camera"]);
    let camera = ["render", "room.vlf", "-o", "out.png", "--camera"];
    refused(&folder, &[&camera[..], &["gone.json"]].concat(), IO, &["gone.json"]);
    write(&folder, "bad.json", "{\"eye\": 1}");
    refused(&folder, &[&camera[..], &["bad.json"]].concat(), CORRUPT, &["bad.json", "camera"]);
}

#[test]
fn an_eye_inside_a_closed_solid_is_told_so() {
    let folder = folder();
    vlf(&folder).args(bake("box.field", &[])).assert().success();
    let look = ["render", "box.field", "-o", "out.png", "--target", "3,3,3", "--eye"];
    refused(&folder, &[&look[..], &["0,0.4,0"]].concat(), USAGE, &["inside", "solid"]);
    refused(&folder, &[&look[..], &["0,0.9,0"]].concat(), USAGE, &["lies on surface"]);
    assert!(!folder.path().join("out.png").exists());
}

#[test]
fn pictures_replace_pictures_of_their_kind_only() {
    let (_baked, folder) = baked();
    let render = |out: &str| -> Vec<String> {
        [&["render", "room.vlf", "--size", "8x6", "--samples", "1", "-o", out][..], &LOOK]
            .concat()
            .into_iter()
            .map(str::to_owned)
            .collect()
    };
    let refused = |out: &str, code, words: &[&str]| {
        let args = render(out);
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        refused(&folder, &args, code, words);
    };
    write(&folder, "letter.png", "Dear reader");
    refused("letter.png", IO, &["letter.png", "nothing was changed"]);
    assert_eq!(fs::read_to_string(folder.path().join("letter.png")).unwrap(), "Dear reader");
    fs::create_dir(folder.path().join("folder.exr")).unwrap();
    write(&folder, "folder.exr/keep", "me");
    refused("folder.exr", IO, &["folder.exr"]);
    assert!(folder.path().join("folder.exr/keep").exists());
    refused("out.jpg", USAGE, &[".exr or .png"]);
    refused("out", USAGE, &[".exr or .png"]);
    refused("nowhere/out.png", IO, &["nowhere"]);
    for out in ["a.png", "a.exr"] {
        for _again in 0..2 {
            vlf(&folder).args(render(out)).assert().success();
        }
    }
    fs::copy(folder.path().join("a.png"), folder.path().join("b.exr")).unwrap();
    refused("b.exr", IO, &["b.exr", "nothing was changed"]);
}

#[test]
fn a_path_is_a_film_or_numbered_pictures_and_all_around_is_one_or_six() {
    let (_baked, folder) = baked();
    let view = |time: f64, x: f64| {
        format!(
            r#"{{"time":{time},"eye":[{x},1,0.5],"target":[0,1,-1],"up":[0,1,0],"vfov_deg":70}}"#
        )
    };
    write(&folder, "walk.json", &format!(r#"{{"views":[{},{}]}}"#, view(2.0, 0.0), view(3.0, 0.2)));
    let render = |more: &[&str]| {
        let few = ["render", "room.vlf", "--samples", "1", "--size", "16x8"];
        vlf(&folder).args(few).args(more).output().unwrap()
    };
    let walk = |more: &[&str]| render(&[&["--path", "walk.json", "--fps", "4"], more].concat());
    let names = |begin: &str| -> usize {
        let all = fs::read_dir(folder.path()).unwrap().flatten();
        all.filter(|e| e.file_name().to_string_lossy().starts_with(begin)).count()
    };
    // Both ends of the second have a frame.
    let a = walk(&["-o", "a.png"]);
    assert!(a.status.success(), "{}", String::from_utf8_lossy(&a.stderr));
    assert_eq!(names("a-000"), 5);
    assert!(folder.path().join("a-0004.png").exists());
    let film = walk(&["-o", "-"]);
    assert!(film.status.success());
    assert!(film.stdout.starts_with(b"YUV4MPEG2 W16 H8 F4000:1000"));
    let (header, frame) =
        (film.stdout.iter().position(|b| *b == b'\n').unwrap() + 1, 6 + 3 * 16 * 8);
    assert_eq!(film.stdout.len(), header + 5 * frame);
    assert!(walk(&["-o", "a.y4m"]).status.success());
    assert_eq!(fs::read(folder.path().join("a.y4m")).unwrap(), film.stdout);
    // A walk's first frame is the picture from there.
    let still =
        [&["-o", "still.exr", "--eye", "0,1,0.5", "--target", "0,1,-1", "--vfov", "70"][..]];
    assert!(render(&still.concat()).status.success());
    assert!(walk(&["-o", "b.exr"]).status.success());
    let picture = |name: &str| fs::read(folder.path().join(name)).unwrap();
    assert!(picture("still.exr") == picture("b-0000.exr"));
    assert!(picture("b-0004.exr") != picture("b-0000.exr"));

    let look = &LOOK[..];
    assert!(render(&[look, &["-o", "c.png", "--projection", "cube"]].concat()).status.success());
    assert_eq!(names("c-"), 6);
    let round = [look, &["-o", "d.png", "--projection", "equirectangular"]].concat();
    assert!(render(&round).status.success());

    let refuse = |args: &[&str], words: &[&str]| {
        let few = ["render", "room.vlf", "--samples", "1"];
        refused(&folder, &[&few[..], args].concat(), USAGE, words);
    };
    refuse(&["--path", "walk.json", "-o", "-", "--json"], &["--json"]);
    refuse(&[look, &["-o", "e.y4m"]].concat(), &["--path"]);
    refuse(&["--path", "walk.json", "-o", "e.y4m", "--projection", "cube"], &["six pictures"]);
    refuse(&["--path", "walk.json", "-o", "e.png", "--fps", "0"], &["frames a second"]);
    write(&folder, "bad.json", &format!(r#"{{"views":[{},{}]}}"#, view(2.0, 0.0), view(1.0, 0.2)));
    refused(
        &folder,
        &["render", "room.vlf", "-o", "e.png", "--path", "bad.json"],
        USAGE,
        &["view 1", "time"],
    );
}

#[test]
fn unfinished_and_damaged_fields_are_not_shown() {
    let (baked, folder) = baked();
    let at = |name: &str| folder.path().join(name);
    let look = |field: &str, code, words: &[&str]| {
        let args = [
            &["render", field, "-o", "out.png", "--size", "40x30", "--method", "field"][..],
            &LOOK,
        ]
        .concat();
        let said = refused(&folder, &args, code, words);
        assert!(!at("out.png").exists(), "{field}");
        said
    };
    let how = How { stop_after: Some(2), ..How::default() };
    bake_to(&at("half.field"), &scene("cornell_mirror"), &parameters(33, 32, 2), &how);
    look("half.field", USAGE, &["not finished", "vlf bake"]);
    look("gone.vlf", IO, &["gone.vlf"]);
    fs::write(at("empty.vlf"), "").unwrap();
    look("empty.vlf", CORRUPT, &["empty.vlf"]);
    fs::write(at("letter.vlf"), "Dear reader").unwrap();
    look("letter.vlf", CORRUPT, &["letter.vlf"]);
    fs::create_dir(at("folder")).unwrap();
    look("folder", CORRUPT, &["folder"]);

    let whole = fs::read(at("room.vlf")).unwrap();
    let mut dice = common::Dice(3);
    for part in [0.001, 0.01, 0.1, 0.5, 0.99] {
        let length = (whole.len() as f64 * part) as usize;
        fs::write(at("cut.vlf"), &whole[..length]).unwrap();
        look("cut.vlf", CORRUPT, &["cut.vlf"]);
    }
    fs::write(at("cut.vlf"), &whole[..whole.len() - 1]).unwrap();
    look("cut.vlf", CORRUPT, &["cut.vlf"]);
    // A flipped bit is found, or it is in padding or in a map that the picture does not need.
    let intact = {
        let args = [
            &["render", "room.vlf", "-o", "good.exr", "--size", "40x30", "--method", "field"][..],
            &LOOK,
        ]
        .concat();
        vlf(&folder).args(args).assert().success();
        fs::read(at("good.exr")).unwrap()
    };
    let mut found = 0;
    for _ in 0..40 {
        let mut bytes = whole.clone();
        let bit = dice.next() as usize % (8 * bytes.len());
        bytes[bit / 8] ^= 1 << (bit % 8);
        fs::write(at("bad.vlf"), bytes).unwrap();
        let args = [
            &["render", "bad.vlf", "-o", "bad.exr", "--size", "40x30", "--method", "field"][..],
            &LOOK,
        ]
        .concat();
        let output = vlf(&folder).args(args).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        match output.status.code() {
            Some(0) => {
                assert!(fs::read(at("bad.exr")).unwrap() == intact, "bit {bit} shows");
                fs::remove_file(at("bad.exr")).unwrap();
            }
            Some(CORRUPT | 5 | LIMIT) => {
                found += 1;
                assert!(said.contains("bad.vlf"), "bit {bit}: {said}");
                assert!(!at("bad.exr").exists(), "bit {bit}");
            }
            code => panic!("bit {bit}: exit {code:?}: {said}"),
        }
    }
    assert!(found > 10, "only {found} of 40 flipped bits were found");
    drop(baked);
}

#[test]
fn a_field_in_use_and_a_field_of_another_bake_are_left_alone() {
    let folder = folder();
    vlf(&folder).args(bake("box.field", &[])).assert().success();
    let manifests = vlf::format::names::MANIFESTS.map(|m| folder.path().join("box.field").join(m));
    let read = || manifests.each_ref().map(|m| fs::read(m).unwrap());
    let before = read();
    let other = bake_but("box.field", "--resolution", "16");
    refused(&folder, &other, IDENTITY, &["box.field", "resolution 32, not 16"]);
    let other = bake("box.field", &["--one-sided"]);
    refused(&folder, &other, IDENTITY, &["box.field"]);
    write(&folder, "box.mtl", &WHITE_AND_LAMP.replace("0.8", "0.7"));
    refused(&folder, &bake("box.field", &[]), IDENTITY, &["another scene"]);
    write(&folder, "box.mtl", WHITE_AND_LAMP);

    let held = Disk::new(&folder.path().join("box.field")).lock("someone").unwrap();
    refused(&folder, &bake("box.field", &[]), LOCKED, &["box.field", "someone"]);
    drop(held);
    vlf(&folder).args(bake("box.field", &[])).assert().success();
    assert!(read() == before);
}

/// Strings in files do nothing to the terminal, are cut short, and name no file.
#[test]
fn strings_from_files_are_inert() {
    const EVIL: &str = "\u{1b}]0;title\u{7}\u{1b}[31m../../evil\u{202e}";
    const SHOWN: &str = "\\u{1b}]0;title\\u{7}\\u{1b}[31m../../evil\\u{202e}";
    let folder = folder();
    let long = format!("{EVIL}{}", "x".repeat(3000));
    let said = |args: &[&str], word: &str| {
        let output = vlf(&folder).args(args).output().unwrap();
        let all = [output.stdout, output.stderr].concat();
        let all = String::from_utf8(all).unwrap();
        let is_inert = |c: char| c == '\n' || !c.is_control() && c != '\u{202e}';
        assert!(all.chars().all(is_inert), "{args:?}: {all:?}");
        assert!(all.lines().all(|l| l.len() < 600), "{args:?}: {all}");
        assert!(all.contains(word), "{args:?}: no `{word}` in {all}");
        all
    };
    // A material's name: in the OBJ, the field and the pack.
    let [obj, mtl] = [&format!("mtllib box.mtl\n{BOX_ON_A_FLOOR}"), WHITE_AND_LAMP]
        .map(|text| text.replace("white", &long));
    write(&folder, "box.obj", &obj);
    write(&folder, "box.mtl", &format!("{mtl}map_Ks x.png\n").replace("Ke", "map_Bump b.png\nKe"));
    said(&bake("box.field", &[]), "");
    said(&["info", "box.field"], "finished");
    said(&["verify", "box.field"], "sound");
    let eye = ["--eye=0,0,0", "--target=0,1,0", "-o", "box.png"];
    said(&[&["render", "box.field"], &eye[..]].concat(), "");
    // One that no library defines; a library that is not there; a word for a number.
    write(&folder, "box.mtl", WHITE_AND_LAMP);
    said(&bake("other.field", &[]), SHOWN);
    write(&folder, "no.obj", &format!("mtllib {long}\n{BOX_ON_A_FLOOR}"));
    said(&["bake", "no.obj", "-o", "no.field"], SHOWN);
    write(&folder, "no.obj", &format!("v 0 0 {EVIL}\n"));
    said(&["bake", "no.obj", "-o", "no.field"], "is not a number");
    let longer = BOX_ON_A_FLOOR.replace("white", &"x".repeat(4097));
    write(&folder, "no.obj", &longer);
    said(&["bake", "no.obj", "-o", "no.field"], "more than 4096 bytes");
    // A camera's field.
    let escaped = serde_json::to_string(&long).unwrap();
    write(&folder, "eye.json", &format!("{{{escaped}: 1}}"));
    let camera = ["render", "box.field", "--camera", "eye.json", "-o", "box.png"];
    said(&camera, "not a camera");
    // Who holds a lock.
    let held = Disk::new(&folder.path().join("box.field")).lock(&long).unwrap();
    said(&bake("box.field", &[]), SHOWN);
    drop(held);
    assert!(!folder.path().join("../../evil").exists() && !folder.path().join("evil").exists());
}

/// Every command that opens what another may have made.
#[test]
fn a_limit_that_is_passed_is_named_with_its_flag() {
    let folder = folder();
    vlf(&folder).args(bake("box.field", &["--limit-surfaces", "8"])).assert().success();
    let surfaces = ["--limit-surfaces", "1"];
    let named = ["exceeds limit 1 (--limit-surfaces)"];
    let eye: &[&str] = &["render", "-o", "box.png", "--eye=0,1,3", "--target=0,1,0", "box.field"];
    for command in [&["info", "box.field"], &["verify", "box.field"], eye] {
        refused(&folder, &[command, &surfaces].concat(), LIMIT, &named);
    }
    // The scene itself has as many polygons, a field of it as many surfaces.
    for command in ["plan", "bake"] {
        let asked = [command, "box.obj", "-o", "box.field", "--limit-surfaces", "1"];
        let named = ["box.obj: number of polygons 2", named[0]];
        refused(&folder, &asked, LIMIT, &named);
    }
    let resumed = bake("box.field", &["--limit-directions", "9"]);
    refused(&folder, &resumed, LIMIT, &["direction count 33", "(--limit-directions)"]);
    let short = bake("other.field", &["--limit-scene", "300"]);
    refused(&folder, &short, LIMIT, &["exceeds limit 300 (--limit-scene)"]);
    let fine = bake("other.field", &["--limit-texels", "8"]);
    refused(&folder, &fine, LIMIT, &["texel count", "exceeds limit 8 (--limit-texels)"]);
    assert!(!folder.path().join("other.field").exists());
}

#[test]
fn stats_say_where_the_time_went() {
    let folder = folder();
    let baked = |more: &[&str]| {
        let output = vlf(&folder).args(bake("box.field", more)).output().unwrap();
        assert!(output.status.success());
        fs::remove_dir_all(folder.path().join("box.field")).unwrap();
        String::from_utf8(output.stdout).unwrap()
    };
    let said: serde_json::Value =
        serde_json::from_str(&baked(&["--threads", "1", "--stats", "--json"])).unwrap();
    let stats = &said["stats"];
    // What earlier cycles found of a PSF was kept, and the PSF not rasterised again.
    let fragments = |said: &serde_json::Value, of: &str| said[of]["fragments"].as_u64().unwrap();
    assert!(fragments(&said, "stats") < fragments(&said, "statistics"));
    assert!(stats["pairs"].as_u64() > Some(0) && stats["map_bytes"].as_u64() > Some(0), "{stats}");
    assert_eq!(stats["texel_touches"].as_u64(), stats["pairs"].as_u64().map(|n| 4 * n));
    // One thread is at one thing at a time, and all of its time is accounted for.
    let stages: Vec<f64> =
        stats["stages"].as_object().unwrap().values().map(|s| s.as_f64().unwrap()).collect();
    let [sum, whole] = [stages.iter().sum(), stats["seconds"].as_f64().unwrap()];
    assert!((sum - whole).abs() < 1e-6 && stages.iter().all(|s| *s >= 0.0), "{stats}");
    // With the least memory none of it is kept, and all is rasterised again.
    let plan = [&["plan", "box.obj", "--json", "--threads", "1"][..], &BAKE].concat();
    let output = vlf(&folder).args(plan).output().unwrap();
    let plan: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let least = plan["memory"]["smallest"].to_string();
    let least = baked(&["--threads", "1", "--stats", "--json", "--memory", &least]);
    let least: serde_json::Value = serde_json::from_str(&least).unwrap();
    assert_eq!(fragments(&least, "stats"), fragments(&said, "statistics"));
    assert_eq!(least["digest"], said["digest"]);
    assert!(baked(&["--stats"]).contains("texels touched"));
    assert!(!baked(&[]).contains("texels touched"));
}

#[test]
fn json_is_one_object_and_nothing_else() {
    let folder = folder();
    let object = |args: &[&str]| -> serde_json::Value {
        let output = vlf(&folder).args(args).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let value: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert!(value.is_object(), "{args:?}");
        value
    };
    let made = object(&bake("box.field", &["--json"]));
    assert_eq!(made["phase"], "Finished");
    assert_eq!(made["report"]["counts"]["polygons"], 8);
    let field = folder.path().join("box.field");
    pack(&field, &folder.path().join("box.vlf"), Codec::Zstd, &|_| {}).unwrap();
    for name in ["box.field", "box.vlf"] {
        let info = object(&["info", name, "--json"]);
        assert_eq!(info["digest"], made["digest"]);
        assert_eq!(info["ledger"], made["ledger"], "{name}");
        assert_eq!(info["ledger"].as_array().unwrap().len(), 2);
        assert!(info["ledger"][0]["residual"].as_f64().unwrap().abs() < 1e-3);
        assert_eq!(info["parameters"]["directions"], 33);
        // The same for people.
        let output = vlf(&folder).args(["info", name]).output().unwrap();
        let said = String::from_utf8(output.stdout).unwrap();
        for word in ["33 directions", "energy", "absorbed", "finished after 2 cycles", "digest"] {
            assert!(said.contains(word), "{name}: no `{word}` in {said}");
        }
    }
    let look = ["--eye", "2,2,3", "--target", "0,0.5,0", "--size", "16x12", "--json"];
    for out in ["a.exr", "b.exr"] {
        let picture = object(&[&["render", "box.vlf", "-o", out][..], &look].concat());
        assert_eq!(picture["size"], serde_json::json!([16, 12]));
    }
    let compared = object(&["compare", "a.exr", "b.exr", "--json"]);
    assert!(compared.as_object().unwrap().values().any(|v| v.as_f64() == Some(0.0)), "{compared}");
}

/// A probe says what the one pixel of a picture shows whose ray it is.
#[test]
fn a_probe_says_what_a_pixel_shows() {
    let baked = Baked::new(&scene("cornell_mirror"), &parameters(129, 32, 2));
    let folder = &baked.folder;
    let out = baked.path.with_extension("vlf");
    pack(&baked.path, &out, Codec::Planes, &|_| {}).unwrap();
    let pack = out.to_str().unwrap();
    let mut materials = Vec::new();
    for target in ["0,0.2,0", "-0.9,1,0.1", "0.9,0.7,-0.4", "0.1,1.98,0.1"] {
        let ray = ["--eye", "0,1,0.9", "--target", target];
        let output = vlf(folder).args(["probe", pack, "--json"]).args(ray).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let said: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        materials.push(said["material"].to_string());
        let text = vlf(folder).args(["probe", pack]).args(ray).output().unwrap().stdout;
        let text = String::from_utf8(text).unwrap();
        for method in ["field", "trace"] {
            let picture = folder.path().join("one.exr");
            let args = ["render", pack, "--method", method, "--size", "1x1", "--samples", "1"];
            let out = ["-o", picture.to_str().unwrap()];
            vlf(folder).args(args).args(out).args(ray).assert().success();
            let pixel = read_exr(&picture).unwrap().pixels[0];
            for (channel, shown) in pixel.0.iter().enumerate() {
                let found = said[method][channel].as_f64().unwrap();
                let near = (found - f64::from(*shown)).abs() <= 1e-3 * f64::from(*shown) + 1e-6;
                assert!(near, "{target}, {method}: {said}, not {pixel:?}");
            }
            assert!(text.contains(&format!("{method}  {:.3}", pixel.0[0])[..10]), "{text}");
        }
    }
    materials.sort();
    materials.dedup();
    assert!(materials.len() > 1, "{materials:?}");
    let args = ["probe", pack, "--eye", "0,1,9", "--target", "0,1,10"];
    let output = vlf(folder).args(args).output().unwrap();
    assert!(String::from_utf8(output.stdout).unwrap().contains("meets no surface"));
    let same = ["probe", pack, "--eye", "0,1,0", "--target", "0,1,0"];
    refused(folder, &same, USAGE, &["the same place"]);
}

#[test]
fn help_names_every_command() {
    let folder = TempDir::new().unwrap();
    let output = vlf(&folder).arg("--help").output().unwrap();
    assert!(output.status.success());
    let said = String::from_utf8(output.stdout).unwrap();
    for command in [
        "demo", "bake", "info", "verify", "render", "probe", "compare", "scene", "vlf-pack",
        "vlf-view",
    ] {
        assert!(said.contains(command), "no `{command}` in {said}");
    }
    for command in ["demo", "bake", "info", "verify", "render", "probe", "compare", "scene"] {
        vlf(&folder).args([command, "--help"]).assert().success();
    }
    vlf(&folder).arg("--version").assert().success();
}

#[test]
fn a_bundled_scene_is_written_once_and_bakes() {
    let folder = TempDir::new().unwrap();
    vlf(&folder).args(["scene", "cornell_mirror", "-o", "room.obj"]).assert().success();
    let again = ["scene", "cornell", "-o", "room.obj"];
    refused(&folder, &again, IO, &["room.obj"]);
    refused(&folder, &["scene", "nowhere", "-o", "x.obj"], USAGE, &["nowhere", "cornell"]);
    let bundled = fs::read_to_string(obj("cornell_mirror").with_extension("mtl")).unwrap();
    assert_eq!(fs::read_to_string(folder.path().join("room.mtl")).unwrap(), bundled);
    let bake = [&["bake", "room.obj", "-o", "room.field"][..], &BAKE].concat();
    vlf(&folder).args(bake).assert().success();
    assert!(Path::new(&folder.path().join("room.field")).is_dir());
}
