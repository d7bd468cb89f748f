//! A field, and a picture of it by either method, is the same to the last bit with every level of instructions
//! that the processor has, each forced; one that it does not have is refused.

mod common;

use assert_cmd::Command;
use common::{Baked, obj, parameters, scene};
use std::path::Path;
use tempfile::TempDir;

/// The levels, and whether this processor has them.
fn levels() -> [(&'static str, bool); 4] {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::is_x86_feature_detected as has;
        [
            ("portable", true),
            ("sse4.2", has!("sse4.2") && has!("popcnt")),
            ("avx2", has!("avx2") && has!("fma")),
            // What came with Ice Lake; older processors with a part of it make do with AVX2.
            ("avx512", has!("avx512f") && has!("avx512vbmi2") && has!("avx512vpopcntdq")),
        ]
    }
    #[cfg(not(target_arch = "x86_64"))]
    [("portable", true), ("sse4.2", false), ("avx2", false), ("avx512", false)]
}

/// Runs a small clipped bake of a room with mirrors, with these instructions; what it says, and whether it
/// was refused.
fn bake(level: Option<&str>) -> Result<String, String> {
    let folder = TempDir::new().unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_vlf"));
    command.env_remove("VLF_SIMD");
    command.envs(level.map(|level| ("VLF_SIMD", level)));
    let size = ["--directions", "129", "--resolution", "64", "--cycles", "2", "--perturb", "2,1"];
    let more = ["--transfer", "clip", "--json", "-o", "a.field"];
    let run = command.current_dir(folder.path()).arg("bake").arg(obj("cornell_mirror"));
    let output = run.args(size).args(more).output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    match output.status.code() {
        Some(0) => {
            let said: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
            Ok(said["digest"].as_str().unwrap().to_owned())
        }
        Some(2) => Err(text(output.stderr)),
        code => panic!("{code:?}: {}", text(output.stderr)),
    }
}

#[test]
fn every_level_of_instructions_gives_the_same_field() {
    let usual = bake(None).unwrap();
    for (level, has) in levels() {
        match (bake(Some(level)), has) {
            (Ok(digest), true) => assert_eq!(digest, usual, "{level}"),
            (Err(said), false) => assert!(said.contains("this processor has no"), "{said}"),
            (found, has) => panic!("{level}, which the processor has: {has}; {found:?}"),
        }
    }
    assert!(bake(Some("mmx")).unwrap_err().contains("there are portable, sse4.2, avx2, avx512"));
}

/// The bytes of a picture of a field, drawn in packets with these instructions.
fn picture(field: &Path, method: &str, level: &str) -> Vec<u8> {
    let out = field.with_extension("exr");
    let mut command = Command::new(env!("CARGO_BIN_EXE_vlf"));
    command.env("VLF_SIMD", level).arg("render").arg(field).arg("-o").arg(&out);
    let camera = obj("cornell_mirror").with_file_name("camera_a.json");
    command.args(["--samples", "1", "--size", "91x67", "--method", method]);
    command.arg("--camera").arg(camera).assert().success();
    std::fs::read(out).unwrap()
}

#[test]
fn every_level_of_instructions_shows_the_same_picture() {
    let baked = Baked::new(&scene("cornell_mirror"), &parameters(129, 64, 2));
    for method in ["field", "trace"] {
        let portable = picture(&baked.path, method, "portable");
        for (level, _) in levels().into_iter().filter(|(_, has)| *has) {
            assert!(picture(&baked.path, method, level) == portable, "{method}, {level}");
        }
    }
}
