//! The page cache at work: the order in which directions are taken, and what little memory costs.

mod common;

use common::{Baked, How, parameters, scene};
use vlf::bake::{BakeError, Options, bake};
use vlf::field::Terms;
use vlf::format::manifest::CacheFigures;
use vlf::{Parameters, Scene};

/// The smallest grant that a bake on one thread takes, in steps of 64 KiB.
fn smallest(scene: &Scene, parameters: &Parameters) -> u64 {
    let refused = |memory: u64| {
        let folder = tempfile::TempDir::new().unwrap();
        let options = Options {
            memory,
            threads: 1,
            stop: &std::sync::atomic::AtomicBool::new(true),
            progress: &|_| {},
            order: None,
            commit_every: 1e9,
            terms: Terms { sync: false, lock: true },
            force: false,
        };
        let result = bake(scene, parameters, &folder.path().join("x.field"), &options);
        matches!(result, Err(BakeError::Memory { .. }))
    };
    (1..).map(|k| k << 16).find(|memory| !refused(*memory)).unwrap()
}

fn figures(scene: &Scene, parameters: &Parameters, how: How) -> CacheFigures {
    Baked::with(scene, parameters, &how).manifest().statistics.cache
}

#[test]
fn along_the_curve_little_memory_costs_few_reads() {
    let (scene, parameters) = (scene("cornell_mirror"), parameters(513, 64, 2));
    let memory = smallest(&scene, &parameters) + (256 << 10);
    let how = How { memory, threads: 1, ..How::default() };
    let plenty = figures(&scene, &parameters, How { threads: 1, ..How::default() });
    let curve = figures(&scene, &parameters, how.clone());
    let by_id = Some((0..513).collect());
    let rows = figures(&scene, &parameters, How { order: by_id, ..how });
    assert_eq!((plenty.redundant, plenty.evictions), (0, 0), "{plenty:?}");
    assert!(curve.evictions > 0, "{curve:?}");
    println!("{plenty:?}\n{curve:?}\n{rows:?}");
    assert!(curve.redundant < rows.redundant, "{curve:?}, {rows:?}");
}
