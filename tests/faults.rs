//! Disks fail, run full, and do things by halves. Whatever operation fails, once or from then on, the
//! bake says which and why, writes nothing more, and keeps the field as of its last commit; the same
//! command goes on with it and ends with the same bits.

mod common;

use common::store::{Left, Tiny, for_all, in_time, newest_commit};
use common::{Dice, parameters, scene, stored};
use std::io::ErrorKind;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use vlf::bake::{BakeError, Options, Outcome, Progress, bake_in};
use vlf::field::storage::Storage;
use vlf::field::storage::faulty::{Faults, Faulty};
use vlf::field::storage::memory::Memory;
use vlf::field::{Terms, read_manifest};
use vlf::format::manifest::Phase;
use vlf::format::names;
use vlf::{FieldError, Parameters};

/// Bakes on a disk with faults. Returns what came of it, and the log.
fn bake(
    tiny: &Tiny,
    disk: &Arc<Memory>,
    faults: Faults,
) -> (Result<Outcome, BakeError>, Vec<String>) {
    let faulty = Arc::new(Faulty::new(disk.clone(), faults));
    let (storage, tiny) = (faulty.clone(), tiny.clone());
    let result = in_time(&format!("{faults:?}"), move || tiny.bake(storage));
    (result, faulty.log())
}

fn operations(tiny: &Tiny) -> u64 {
    bake(tiny, &Arc::new(Memory::default()), Faults::default()).1.len() as u64
}

/// Whether a failed operation is one that writes.
fn writes(line: &str) -> bool {
    !["list ", "open ", "read "].iter().any(|reading| line.starts_with(reading))
}

/// Whether an error is the one that a failure of this operation must give.
fn fits(error: &BakeError, failed: &str, kind: ErrorKind) -> bool {
    let BakeError::Field(error) = error else { return false };
    let full = kind == ErrorKind::StorageFull;
    match error {
        FieldError::Full { path, .. } => full && path.starts_with("memory.field"),
        FieldError::Flush { path, .. } => {
            !full && failed.starts_with("sync ") && path.starts_with("memory.field")
        }
        FieldError::Io { path, source, .. } => {
            !full
                && !failed.starts_with("sync ")
                && source.kind() == kind
                && path.starts_with("memory.field")
        }
        _ => false,
    }
}

#[test]
fn whatever_operation_fails_it_is_said_nothing_more_is_written_and_it_goes_on() {
    Tiny::both().iter().for_each(whatever_operation_fails);
}

fn whatever_operation_fails(tiny: &Tiny) {
    let operations = operations(tiny);
    let plain = tiny.undisturbed();
    let kinds =
        [ErrorKind::Other, ErrorKind::StorageFull, ErrorKind::WriteZero, ErrorKind::UnexpectedEof];
    let (cases, unnoticed) = (AtomicU64::new(0), AtomicU64::new(0));
    for_all(0..operations + 40, |k| {
        for (kind, for_ever) in kinds.iter().flat_map(|k| [(*k, false), (*k, true)]) {
            let told = format!("operation {k} of {operations}, {kind:?}, for ever {for_ever}");
            let disk = Arc::new(Memory::default());
            let faults = Faults { fail: Some(k), for_ever, kind: Some(kind), ..Faults::default() };
            let (result, log) = bake(tiny, &disk, faults);
            let Some(at) = log.iter().position(|l| l.ends_with(": failed")) else { continue };
            cases.fetch_add(1, Ordering::Relaxed);
            match &result {
                // Reading ahead and tidying up may fail; what they would have done is done later.
                Ok(_) => {
                    assert!(!writes(&log[at]) && !for_ever, "{told}: {} unnoticed", log[at]);
                    unnoticed.fetch_add(1, Ordering::Relaxed);
                }
                // The first that failed, or with several threads another soon after.
                Err(error) => {
                    let failed = log.iter().filter(|l| l.ends_with(": failed"));
                    assert!({ failed }.any(|f| fits(error, f, kind)), "{told}: {error:?}");
                }
            }
            if let Some(first) =
                (at..log.len()).find(|k| writes(&log[*k]) && log[*k].ends_with("ed"))
            {
                let after = &log[first + 1..];
                let commits = |l: &&String| l.starts_with("rename") || l.starts_with("sync folder");
                assert_eq!(after.iter().find(commits), None, "{told}: after {}", log[first]);
                // A sync that has failed is not tried again.
                if let Some(synced) = log[first].strip_prefix("sync ") {
                    let again = format!("sync {}", synced.trim_end_matches(": failed"));
                    assert!(!after.contains(&again), "{told}: {again} again");
                }
            }
            let newest = newest_commit(&*disk, "").unwrap_or_else(|e| panic!("{told}: {e}"));
            assert_eq!(tiny.bake(disk.clone()).unwrap(), Outcome::Finished, "{told}");
            let same = Left::of(&*disk).same_as(&plain);
            assert_eq!(same, Ok(()), "{told}, gone on from {newest:?}");
        }
    });
    let (cases, unnoticed) = (cases.into_inner(), unnoticed.into_inner());
    println!("{operations} operations, {cases} failures, {unnoticed} of them made good at once");
    assert!(cases >= 8 * (operations - 40), "only {cases}");
}

#[test]
fn parts_and_interruptions_change_no_bit() {
    for tiny in Tiny::both() {
        let plain = tiny.undisturbed();
        let disk = Arc::new(Memory::default());
        let (result, log) = bake(&tiny, &disk, Faults { short: true, ..Faults::default() });
        assert_eq!(result.unwrap(), Outcome::Finished);
        assert_eq!(Left::of(&*disk).same_as(&plain), Ok(()));
        assert!(log.len() as u64 > operations(&tiny) * 6 / 5, "nothing came in parts");
    }
}

#[test]
fn a_disk_that_is_too_small_is_refused_before_anything_is_made() {
    let disk = Arc::new(Memory::with_capacity(10_000));
    match Tiny::new().bake(disk.clone()) {
        Err(BakeError::Space { needs, free }) => assert!(needs.contains("iB") && free == "9.8 KiB"),
        other => panic!("{other:?}"),
    }
    assert_eq!(disk.list("").unwrap(), Vec::<String>::new());
}

#[test]
fn a_disk_that_runs_full_at_any_byte_keeps_the_last_commit_and_goes_on_when_there_is_room() {
    Tiny::both().into_iter().for_each(|tiny| runs_full(&Tiny { force: true, ..tiny }));
}

fn runs_full(tiny: &Tiny) {
    let plain = tiny.undisturbed();
    let whole = Arc::new(Memory::default());
    assert_eq!(tiny.bake(whole.clone()).unwrap(), Outcome::Finished);
    let most = whole.used();
    let (full, begun) = (AtomicU64::new(0), AtomicU64::new(0));
    for_all((0..most).step_by((most / 300) as usize), |capacity| {
        let disk = Arc::new(Memory::with_capacity(capacity));
        let told = format!("{capacity} of {most} bytes");
        match tiny.bake(disk.clone()) {
            Err(BakeError::Field(error @ FieldError::Full { .. })) => {
                let said = error.to_string();
                assert!(said.contains("memory.field/") && said.contains("intact"), "{said}");
                full.fetch_add(1, Ordering::Relaxed);
            }
            other => panic!("{told}: {other:?}"),
        }
        let newest = newest_commit(&*disk, "").unwrap_or_else(|e| panic!("{told}: {e}"));
        begun.fetch_add(u64::from(newest.is_some()), Ordering::Relaxed);
        // Still full: refused in the same words, and nothing is lost by trying.
        assert!(tiny.bake(disk.clone()).is_err(), "{told}");
        assert_eq!(newest_commit(&*disk, ""), Ok(newest), "{told}");
        disk.set_capacity(u64::MAX);
        assert_eq!(tiny.bake(disk.clone()).unwrap(), Outcome::Finished, "{told}");
        assert_eq!(Left::of(&*disk).same_as(&plain), Ok(()), "{told}");
    });
    println!("full {} times, {} of them with a commit", full.into_inner(), begun.into_inner());
}

/// Nothing that was done is lost with a full disk, however long ago the last commit was: the bake stops
/// while there is room for one more.
#[test]
fn a_disk_that_runs_full_costs_no_direction() {
    let bakes = [parameters(33, 32, 2), stored(parameters(33, 32, 2))];
    bakes.iter().for_each(costs_no_direction);
}

fn costs_no_direction(parameters: &Parameters) {
    let scene = scene("cornell_mirror");
    let run = |disk: &Arc<Memory>, progress: &(dyn Fn(&Progress) + Sync)| {
        let options = Options {
            memory: 1 << 28,
            threads: 2,
            stop: &AtomicBool::new(false),
            progress,
            order: None,
            commit_every: 1e9,
            terms: Terms::default(),
            force: true,
        };
        bake_in(disk.clone(), &scene, parameters, &options)
    };
    let whole = Arc::new(Memory::default());
    assert_eq!(run(&whole, &|_| ()).unwrap(), Outcome::Finished);
    let digest = read_manifest(&*whole).unwrap().1.digest;
    let most = whole.used();
    let (full, between) = (AtomicU64::new(0), AtomicU64::new(0));
    for_all((most / 20..most + most / 2).step_by((most / 20) as usize), |capacity| {
        let disk = Arc::new(Memory::with_capacity(capacity));
        let told = format!("{capacity} bytes of {most}");
        let done = Mutex::new(None);
        let noted = |p: &Progress| {
            let at = (p.cycle, p.phase == Phase::WritingTotals, p.done);
            let mut done = done.lock().unwrap();
            // Of two threads, the one that did less may say so last.
            *done = (*done).max(Some(at).filter(|_| !p.preparing));
        };
        match run(&disk, &noted) {
            Ok(_) => return,
            Err(BakeError::Field(FieldError::Full { .. })) => {}
            Err(other) => panic!("{told}: {other}"),
        }
        full.fetch_add(1, Ordering::Relaxed);
        let Some(done) = done.into_inner().unwrap() else { return };
        let now = read_manifest(&*disk).unwrap().1;
        let committed = (now.cycle, now.phase == Phase::WritingTotals, now.done_count());
        let next_step = done.2 == 33 && committed.2 == 0;
        assert!(committed == done || next_step, "{told}: {committed:?} of {done:?} is kept");
        between.fetch_add(u64::from(!next_step), Ordering::Relaxed);
        // What goes on begins with the next direction.
        disk.set_capacity(u64::MAX);
        assert_eq!(run(&disk, &|_| ()).unwrap(), Outcome::Finished, "{told}");
        assert_eq!(read_manifest(&*disk).unwrap().1.digest, digest, "{told}");
    });
    let (full, between) = (full.into_inner(), between.into_inner());
    println!("full {full} times, {between} of them between two directions");
    assert!(between >= 3, "only {between}");
}

#[test]
fn without_locks_a_bake_is_refused_unless_its_user_is_sure() {
    let tiny = Tiny::new();
    let disk = Arc::new(Memory::default());
    let faults = Faults { no_locks: true, ..Faults::default() };
    let bake = |lock| {
        let storage = Arc::new(Faulty::new(disk.clone(), faults));
        Tiny { lock, ..tiny.clone() }.bake(storage)
    };
    let Err(BakeError::Field(error @ FieldError::NoLocks { .. })) = bake(true) else { panic!() };
    let said = error.to_string();
    assert!(said.contains("this filesystem has no locks"), "{said}");
    assert!(said.contains("use --no-lock if you are sure"), "{said}");
    assert_eq!(disk.list("").unwrap(), Vec::<String>::new(), "something was made");
    assert_eq!(bake(false).unwrap(), Outcome::Finished);
    assert_eq!(Left::of(&*disk).same_as(&tiny.undisturbed()), Ok(()));
}

/// Bits that have gone bad since they were written: a bake that goes on never says that it is
/// finished over them. A total map is made again: stored maps of what arrived at mirrors are still there.
#[test]
fn a_bake_that_goes_on_does_not_finish_over_damage() {
    Tiny::both().iter().for_each(does_not_finish_over_damage);
}

fn does_not_finish_over_damage(tiny: &Tiny) {
    let plain = tiny.undisturbed();
    let last = operations(tiny) - 40;
    let mut damaged = 0;
    for k in last..last + 20 {
        let disk = Arc::new(Memory::default());
        let faults = Faults { fail: Some(k), for_ever: true, ..Faults::default() };
        if bake(tiny, &disk, faults).0.is_ok() {
            continue;
        }
        let manifest = read_manifest(&*disk).unwrap().1;
        let is_done = |d: &u32| manifest.phase == Phase::WritingTotals && manifest.is_done(*d);
        let Some(done) = (0..9).find(is_done) else { continue };
        let total = names::tile_file(names::TOTAL, done);
        disk.edit(&total, |bytes| bytes[322] ^= 1);
        disk.edit(names::SCENE, |bytes| bytes[322] ^= 1);
        let error = tiny.bake(disk.clone()).unwrap_err();
        assert!(error.to_string().contains("checksum mismatch"), "{error}");
        assert!(error.to_string().contains(names::SCENE), "{error}");
        disk.edit(names::SCENE, |bytes| bytes[322] ^= 1);
        assert_eq!(tiny.bake(disk.clone()).unwrap(), Outcome::Finished);
        assert_eq!(Left::of(&*disk).same_as(&plain), Ok(()));
        damaged += 1;
    }
    assert!(damaged > 4, "only {damaged}");
}

/// The least memory that a bake does not refuse.
fn least_memory(bake: impl Fn(u64) -> Result<Outcome, BakeError>) -> u64 {
    let (mut too_little, mut enough) = (0, 1u64 << 30);
    while enough - too_little > 1 << 12 {
        let half = too_little.midpoint(enough);
        match bake(half) {
            Err(BakeError::Memory { .. }) => too_little = half,
            result => {
                result.unwrap();
                enough = half;
            }
        }
    }
    enough
}

/// Not one bit depends on the memory granted, nor is more of it held.
#[test]
fn the_page_cache_changes_no_bit_and_keeps_to_its_budget() {
    let (scene, parameters) = (scene("cornell_mirror"), stored(parameters(33, 32, 3)));
    let run = |disk: &Arc<Memory>, memory, threads, order: Option<Vec<u32>>, stopped| {
        let options = Options {
            memory,
            threads,
            stop: &AtomicBool::new(stopped),
            progress: &|_| (),
            order,
            commit_every: 1e9,
            terms: Terms::default(),
            force: false,
        };
        bake_in(disk.clone(), &scene, &parameters, &options)
    };
    let mut plain: Option<[u8; 16]> = None;
    let mut evictions = 0;
    for threads in [1, 2] {
        let tried = |memory| run(&Arc::new(Memory::default()), memory, threads, None, true);
        let least = least_memory(tried);
        for memory in [least, 2 * least, 1 << 30] {
            for order in [None, Some(Dice(memory).shuffled(33))] {
                let told = format!("{threads} threads, {memory} of least {least} bytes, {order:?}");
                let disk = Arc::new(Memory::default());
                assert_eq!(run(&disk, memory, threads, order, false).unwrap(), Outcome::Finished);
                let manifest = read_manifest(&*disk).unwrap().1;
                let digest = *plain.get_or_insert(manifest.digest);
                assert_eq!(manifest.digest, digest, "{told}");
                let cache = manifest.statistics.cache;
                assert!(cache.peak > 0 && cache.peak <= memory, "{told}: {cache:?}");
                assert!(cache.hits + cache.misses > 0, "{told}: {cache:?}");
                assert!(cache.redundant <= cache.evictions, "{told}: {cache:?}");
                if memory == 1 << 30 {
                    assert_eq!((cache.redundant, cache.evictions), (0, 0), "{told}");
                }
                evictions += cache.evictions;
                println!("{told}: {cache:?}");
            }
        }
    }
    assert!(evictions > 0, "the cache never had to give anything up");
}
