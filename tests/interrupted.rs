//! Bake overnight, kill it, lose seconds. A bake that is killed at any moment, by a power cut or by
//! its owner, goes on when the same command is given again, and ends with the same bits. Asked
//! politely it stops at once, keeps what it has done, and says how to go on.

#![cfg(unix)]

mod common;

use common::{Dice, obj};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;
use vlf::field::read_manifest;
use vlf::field::storage::disk::Disk;
use vlf::format::manifest::{Manifest, Phase};

/// Both ways of mirrors: their maps stored, and paths followed through them.
const WAYS: [&str; 2] = ["--specular maps --resample off", "--specular trace"];

fn command(field: &Path, directions: &str, way: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_vlf"));
    command.arg("bake").arg(obj("cornell_mirror")).arg("-o").arg(field);
    command.args(["--directions", directions, "--resolution", "64", "--cycles", "3"]);
    command.args(["--perturb", "2,1", "--threads", "2", "--sync", "interval:0.1s"]);
    command.args(way.split(' '));
    command.stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

fn manifest(field: &Path) -> Option<Manifest> {
    read_manifest(&Disk::new(field)).ok().map(|m| m.1)
}

/// Waits until the field exists, so that a signal meets the bake and not the loader.
fn begun(field: &Path, child: &mut Child) {
    let start = Instant::now();
    while manifest(field).is_none() && child.try_wait().unwrap().is_none() {
        assert!(start.elapsed() < Duration::from_secs(60), "the bake does not begin");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Sends a signal to a bake, which may be at its end already.
fn signal(child: &Child, name: &str) {
    let mut kill = Command::new("kill");
    kill.arg(name).arg(child.id().to_string()).stderr(Stdio::null()).status().unwrap();
}

#[test]
fn a_bake_that_is_killed_again_and_again_ends_with_the_same_bits() {
    WAYS.iter().for_each(|way| killed_again_and_again(way));
}

fn killed_again_and_again(way: &str) {
    let folder = TempDir::new().unwrap();
    let plain = folder.path().join("plain.field");
    let start = Instant::now();
    assert!(command(&plain, "129", way).status().unwrap().success());
    let whole = start.elapsed();
    let expected = manifest(&plain).unwrap();

    let field = folder.path().join("killed.field");
    let mut dice = Dice(11);
    let (mut kills, mut stops) = (0, 0);
    for round in 0..200 {
        if kills >= 4 && stops >= 4 {
            break;
        }
        if manifest(&field).is_some_and(|m| m.phase == Phase::Finished) {
            // It came to its end between two signals: that must have ended well; begin another.
            assert_eq!(manifest(&field).unwrap().digest, expected.digest, "after {kills} kills");
            std::fs::remove_dir_all(&field).unwrap();
        }
        let mut child = command(&field, "129", way).spawn().unwrap();
        if round % 2 == 0 {
            // Asked politely, it commits in the middle of a cycle what the next one must take up.
            begun(&field, &mut child);
            std::thread::sleep(whole.mul_f64(0.25 * dice.unit()));
            signal(&child, "-INT");
            stops += i32::from(child.wait().unwrap().code() == Some(130));
        } else {
            std::thread::sleep(whole.mul_f64(0.6 * dice.unit()));
            child.kill().unwrap();
            kills += i32::from(!child.wait().unwrap().success());
        }
    }
    assert!(kills >= 4 && stops >= 4, "only {kills} killed and {stops} stopped in time");
    assert!(command(&field, "129", way).status().unwrap().success());
    let resumed = manifest(&field).unwrap();
    assert_eq!(resumed.phase, Phase::Finished);
    assert_eq!(resumed.digest, expected.digest, "after {kills} kills");
    assert_eq!(resumed.ledger, expected.ledger, "after {kills} kills");
    assert_eq!(resumed.statistics.fragments, expected.statistics.fragments);
    // Nothing of the killed ones is left lying about.
    let names = |path: &Path| {
        let mut names: Vec<_> =
            std::fs::read_dir(path).unwrap().map(|e| e.unwrap().file_name()).collect();
        names.sort();
        names
    };
    assert_eq!(names(&field), names(&plain));
}

#[test]
fn interrupted_politely_it_stops_keeps_its_work_and_says_how_to_go_on() {
    for (name, code, way) in [("-INT", 130, WAYS[0]), ("-TERM", 143, WAYS[1])] {
        let folder = TempDir::new().unwrap();
        let field = folder.path().join("room.field");
        let child = command(&field, "2049", way).spawn().unwrap();
        // Past the first directions, so that there is something to keep.
        let start = Instant::now();
        while manifest(&field).is_none_or(|m| m.done_count() == 0) {
            assert!(start.elapsed() < Duration::from_secs(60), "the bake does not begin");
            std::thread::sleep(Duration::from_millis(1));
        }
        signal(&child, name);
        let asked = Instant::now();
        let output = child.wait_with_output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{name}: {said}");
        assert!(asked.elapsed() < Duration::from_secs(10), "{name}: took {:?}", asked.elapsed());
        assert!(said.contains("run the same command again"), "{name}: {said}");
        let kept = manifest(&field).unwrap();
        assert_ne!(kept.phase, Phase::Finished);
        assert!(kept.cycle > 0 || kept.done_count() > 0, "{name}: nothing was kept: {said}");
        let at = format!("direction {} of 2049", kept.done_count());
        assert!(said.contains(&at), "{name}: no `{at}` in {said}");
    }
}
