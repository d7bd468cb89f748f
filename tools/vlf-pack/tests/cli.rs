//! `vlf-pack` packs finished fields and replaces nothing but packs.

use assert_cmd::Command;
use std::fs;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use tempfile::TempDir;
use vlf::bake::{Options, Outcome, bake};
use vlf::field::Terms;
use vlf::field::files::open_at;
use vlf::format::container::FileKind;
use vlf::format::limits::Limits;
use vlf::{LightField, Parameters, Scene};

fn field(path: &Path, stop: bool) {
    let (scene, _) = Scene::bundled("cornell").unwrap();
    let parameters = Parameters {
        directions: 33,
        resolution: 16,
        tile: 16,
        cycles: Some(1),
        unshot_fraction: 1e-3,
        perturbations: vec![1],
        texel_cells: 1.0,
        refined: 1.0,
        supersample: false,
        filter: 0,
        one_sided: false,
        ..Parameters::default()
    };
    let stop = AtomicBool::new(stop);
    let options = Options {
        memory: 1 << 30,
        threads: 1,
        stop: &stop,
        progress: &|_| {},
        order: None,
        commit_every: 10.0,
        terms: Terms::default(),
        force: false,
    };
    let outcome = bake(&scene, &parameters, path, &options).unwrap();
    assert_eq!(outcome == Outcome::Finished, !stop.into_inner());
}

fn vlf_pack(folder: &TempDir, args: &[&str]) -> std::process::Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_vlf-pack"));
    command.current_dir(folder.path()).args(args).output().unwrap()
}

#[test]
fn a_finished_field_becomes_one_file() {
    let folder = TempDir::new().unwrap();
    field(&folder.path().join("room.field"), false);
    for codec in ["raw", "zstd", "planes"] {
        let args =
            ["room.field", "-o", "room.vlf", "--codec", codec, "--json", "--max-error", "0.02"];
        let output = vlf_pack(&folder, &args);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(report["directions"], 33);
        let length = fs::metadata(folder.path().join("room.vlf")).unwrap().len();
        assert_eq!(report["bytes"], length);
        assert!(report["deviation"]["worst"].as_f64().unwrap() < 0.02);
        for section in ["record", "scene", "textures", "maps"] {
            let section = &report[section];
            assert!(section["before"].as_u64() > Some(0) && section["after"].as_u64() > Some(0));
        }
        LightField::open(&folder.path().join("room.vlf")).unwrap();
    }
}

#[test]
fn the_report_says_what_became_of_each_section_and_what_was_lost() {
    let folder = TempDir::new().unwrap();
    field(&folder.path().join("room.field"), false);
    let said = |args: &[&str]| {
        let output = vlf_pack(&folder, &[&["room.field", "-o", "room.vlf"], args].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    };
    let lossy = said(&["--max-error", "0.1"]);
    for words in ["scene", "texture maps", "total radiance maps", " : 1", "off by", "in the worst"]
    {
        assert!(lossy.contains(words), "{words}: {lossy}");
    }
    assert!(said(&["--max-error", "0"]).contains("nothing lost"));
    assert!(said(&["--codec", "raw"]).contains("nothing lost"));
    said(&["--diffuse", "texture", "--memory", "4MiB", "--threads", "1"]);
}

#[test]
fn what_is_wrong_is_said_and_nothing_is_overwritten() {
    let folder = TempDir::new().unwrap();
    field(&folder.path().join("room.field"), false);
    field(&folder.path().join("half.field"), true);
    fs::write(folder.path().join("letter.txt"), "Dear reader").unwrap();
    fs::create_dir(folder.path().join("photos")).unwrap();
    fs::write(folder.path().join("photos/one.jpg"), "not ours").unwrap();
    for (args, code, words) in [
        (&["half.field", "-o", "out.vlf"][..], 2, &["half.field", "not finished"][..]),
        (&["gone.field", "-o", "out.vlf"], 3, &["gone.field"]),
        (&["photos", "-o", "out.vlf"], 4, &["photos"]),
        (&["room.field", "-o", "letter.txt"], 4, &["letter.txt", "nothing was changed"]),
        (&["room.field", "-o", "photos"], 4, &["photos", "nothing was changed"]),
        (&["room.field", "-o", "nowhere/out.vlf"], 3, &["nowhere"]),
        (&["room.field"], 2, &["--output"]),
        (&["room.field", "-o", "out.vlf", "--codec", "zip"], 2, &["zip", "zstd"]),
        (&["room.field", "-o", "out.vlf", "--fast"], 2, &["--fast"]),
        (&["room.field", "-o", "out.vlf", "--max-error", "0.3"], 2, &["0 to 0.25"]),
        (&["room.field", "-o", "out.vlf", "--max-error", "NaN"], 2, &["0 to 0.25"]),
        (&["room.field", "-o", "out.vlf", "--memory", "1kiB"], 7, &["--memory", "1.0 KiB"]),
        (&["room.field", "-o", "out.vlf", "--limit-tile", "8"], 7, &["16", "8 (--limit-tile)"]),
    ] {
        let output = vlf_pack(&folder, args);
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{args:?}: {said}");
        assert!(output.stdout.is_empty(), "{args:?}");
        words.iter().for_each(|word| assert!(said.contains(word), "{args:?}: {said}"));
        assert!(!folder.path().join("out.vlf").exists(), "{args:?}");
    }
    assert_eq!(fs::read_to_string(folder.path().join("letter.txt")).unwrap(), "Dear reader");
    assert_eq!(fs::read_dir(folder.path().join("photos")).unwrap().count(), 1);

    // A field with a damaged map is found out before anything is written.
    let map = vlf::format::names::tiles(&folder.path().join("room.field"), "total", 7);
    let mut bytes = fs::read(&map).unwrap();
    let chunk = open_at(&map, FileKind::Tiles, &Limits::default()).unwrap().directory.entries[0];
    bytes[(chunk.offset + chunk.stored / 2) as usize] ^= 1;
    fs::write(&map, bytes).unwrap();
    let output = vlf_pack(&folder, &["room.field", "-o", "out.vlf"]);
    assert_eq!(output.status.code(), Some(4));
    assert!(!folder.path().join("out.vlf").exists());
}
