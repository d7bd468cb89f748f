//! What a bake says of its own progress: never backwards, right at the end, and after a resume of what
//! is left only.

mod common;

use common::{parameters, scene};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use vlf::bake::{Options, Outcome, Progress, bake};
use vlf::field::Terms;

/// Bakes until so many reports have come; returns them.
fn reports(path: &std::path::Path, stop_after: usize) -> Vec<Progress> {
    let (stop, all) = (AtomicBool::new(false), Mutex::new(Vec::new()));
    let options = Options {
        memory: 1 << 30,
        threads: 1,
        stop: &stop,
        progress: &|p| {
            let mut all = all.lock().unwrap();
            all.push(*p);
            stop.store(all.len() >= stop_after, Ordering::Relaxed);
        },
        order: None,
        commit_every: 1e9,
        terms: Terms { sync: false, lock: true },
        force: false,
    };
    let outcome = bake(&scene("cornell_mirror"), &parameters(33, 16, 3), path, &options).unwrap();
    assert_eq!(outcome == Outcome::Stopped, stop_after < usize::MAX);
    all.into_inner().unwrap()
}

fn assert_forwards(reports: &[Progress]) {
    for pair in reports.windows(2) {
        let (before, after) = (pair[0], pair[1]);
        assert!(after.work >= before.work - 1e-9, "{before:?} then {after:?}");
        assert!(after.work_left <= before.work_left + 1e-9, "{before:?} then {after:?}");
        let whole = |p: &Progress| p.work + p.work_left;
        assert!((whole(&after) - whole(&before)).abs() < 1e-6, "{before:?} then {after:?}");
    }
}

#[test]
fn work_done_and_left_add_up_and_a_resumed_run_counts_its_own() {
    let folder = tempfile::TempDir::new().unwrap();
    let whole = reports(&folder.path().join("whole.field"), usize::MAX);
    assert_forwards(&whole);
    assert_eq!(whole.last().unwrap().work_left, 0.0);

    // A sweep over 33 directions, a cycle, and seven directions of the second.
    let path = folder.path().join("stopped.field");
    let first = reports(&path, 33 + 33 + 7);
    let second = reports(&path, usize::MAX);
    assert_forwards(&second);
    let (left, again) = (first.last().unwrap().work_left, second[0]);
    assert!(again.preparing && again.work <= 2.0, "{again:?}");
    // What was left, the preparing that every run does, and what the first one had kept of the directions left.
    let expected = left + 0.75 * 33.0 + 0.8 * 26.0;
    let all = again.work + again.work_left;
    assert!((all - expected).abs() < 1e-6, "{all}, not {expected}");
    assert_eq!(second.last().unwrap().work_left, 0.0);
}
