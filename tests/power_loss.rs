//! The power goes at any moment of a bake, and the disk keeps of what it was not told to keep
//! whatever it likes. What was committed is there, whole; the same command goes on with it and ends
//! with the same bits. And because a test that finds nothing proves nothing: leave out any one of
//! the syncs that a commit consists of, and these tests find the loss.

mod common;

use common::Dice;
use common::store::{Left, Tiny, for_all, newest_commit};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use vlf::bake::Outcome;
use vlf::field::storage::faulty::{Faults, Faulty};
use vlf::field::storage::memory::Memory;
use vlf::format::names;

/// Losses for each operation: of all that was not synced, and of any part of it.
const SEEDS: u64 = 3;

/// Whether the last operation is a sync that is only said to be done; see [`Faults::unsynced`].
type Skips = fn(&[String]) -> bool;

/// Bakes until the power goes before operation `k`. Returns how many commits had returned by then,
/// or `None` if the bake came to its end before.
fn until(disk: &Arc<Memory>, tiny: &Tiny, k: u64, unsynced: Option<Skips>) -> Option<u64> {
    let faults = Faults { fail: Some(k), for_ever: true, unsynced, ..Faults::default() };
    let faulty = Arc::new(Faulty::new(disk.clone(), faults));
    let result = tiny.bake(faulty.clone());
    // A bake that ends well has been told of no failure, or only when it tidied up.
    if result.is_ok() && faulty.operations() <= k {
        return None;
    }
    let (mut commits, mut renamed) = (0, false);
    for line in faulty.log().iter().filter(|l| !l.ends_with(": failed")) {
        if line.starts_with("rename manifest-") {
            renamed = true;
        } else if line == "sync folder " && renamed {
            (commits, renamed) = (commits + 1, false);
        }
    }
    Some(commits)
}

/// What the disk holds when the power comes back.
fn after(disk: &Memory, k: u64, seed: u64) -> Memory {
    let mut dice = Dice(1000 * k + seed);
    // The first seed loses all that it may.
    disk.after_power_loss(|| if seed == 0 { 1 } else { dice.next() })
}

/// Checks that the newest commit is the last that had returned, or the one that was under way.
/// Returns its number, 0 when there is none.
fn kept(disk: &Memory, least: u64, most: u64) -> Result<u64, String> {
    let newest = newest_commit(disk, "")?.unwrap_or(0);
    match (least..=most).contains(&newest) {
        true => Ok(newest),
        false => Err(format!("commit {newest} is left, and {least} had returned")),
    }
}

/// Goes on without faults, to the same end.
fn goes_on(disk: Memory, tiny: &Tiny, plain: &Left) -> Result<(), String> {
    let disk = Arc::new(disk);
    match tiny.bake(disk.clone()) {
        Ok(Outcome::Finished) => Left::of(&*disk).same_as(plain),
        other => Err(format!("does not go on: {other:?}")),
    }
}

/// Number of operations of a whole bake, about: which thread does what first is left to chance.
fn operations(tiny: &Tiny) -> u64 {
    let faulty = Arc::new(Faulty::new(Arc::new(Memory::default()), Faults::default()));
    tiny.bake(faulty.clone()).unwrap();
    faulty.operations()
}

#[test]
fn power_lost_at_any_operation_costs_nothing_that_was_committed() {
    Tiny::both().iter().for_each(power_lost_at_any_operation);
}

fn power_lost_at_any_operation(tiny: &Tiny) {
    let (plain, operations) = (tiny.undisturbed(), operations(tiny));
    let losses = AtomicU64::new(0);
    for_all(0..operations + 40, |k| {
        let disk = Arc::new(Memory::default());
        let Some(returned) = until(&disk, tiny, k, None) else { return };
        for seed in 0..SEEDS {
            let check = || -> Result<(), String> {
                let left = after(&disk, k, seed);
                let newest = kept(&left, returned, returned + 1)?;
                // The commit before is kept whole too: it stands in when the newest is damaged.
                if newest > 1 {
                    let left = after(&disk, k, seed);
                    let record = names::manifest(newest);
                    left.edit(record, |bytes| bytes[300] ^= 1);
                    let before = newest_commit(&left, record)?;
                    if before != Some(newest - 1) {
                        return Err(format!("without commit {newest} commit {before:?} is newest"));
                    }
                    goes_on(left, tiny, &plain)?;
                }
                goes_on(left, tiny, &plain)
            };
            if let Err(e) = check() {
                panic!("power lost at operation {k} of {operations}, seed {seed}: {e}");
            }
            losses.fetch_add(1, Ordering::Relaxed);
        }
    });
    let losses = losses.into_inner();
    println!("{operations} operations, {losses} losses of power");
    assert!(losses >= SEEDS * (operations - 40), "only {losses}");
}

/// A loss while the bake recovers from one, or from a kill, which loses nothing by itself but leaves
/// the next run with what was never synced.
#[test]
fn power_lost_again_while_recovering_costs_nothing_more() {
    Tiny::both().iter().for_each(power_lost_again);
}

fn power_lost_again(tiny: &Tiny) {
    let (plain, operations) = (tiny.undisturbed(), operations(tiny));
    let losses = AtomicU64::new(0);
    for_all((0..operations).step_by(7), |k| {
        for (round, killed) in [false, true, false, true].into_iter().enumerate() {
            let mut dice = Dice(k + operations * round as u64);
            // Early operations are those of the recovery itself.
            let again = dice.next() % if round < 2 { 16 } else { operations };
            let mut check = || -> Result<bool, String> {
                let disk = Arc::new(Memory::default());
                let Some(returned) = until(&disk, tiny, k, None) else { return Ok(false) };
                // A killed bake leaves the disk as it is: the system has not gone.
                let disk = if killed { disk } else { Arc::new(after(&disk, k, dice.next() % 9)) };
                let taken_up = kept(&disk, returned, returned + 1)?;
                let Some(more) = until(&disk, tiny, again, None) else { return Ok(false) };
                let least = match more {
                    // The kill may have come between a commit and its last sync.
                    0 if killed => returned,
                    _ => taken_up + more,
                };
                let left = after(&disk, again, dice.next() % 3);
                kept(&left, least, taken_up + more + 1)?;
                goes_on(left, tiny, &plain)?;
                Ok(true)
            };
            match check() {
                Ok(lost) => losses.fetch_add(u64::from(lost), Ordering::Relaxed),
                Err(e) => panic!("operation {k}, killed {killed}, then operation {again}: {e}"),
            };
        }
    });
    let losses = losses.into_inner();
    println!("{losses} second losses of power");
    assert!(losses > operations / 7, "only {losses}");
}

/// A run that left syncing to the system was killed, which loses nothing; the next run syncs, and
/// what it says is committed is, whoever wrote it.
#[test]
fn what_an_earlier_run_did_not_sync_the_next_one_does() {
    Tiny::both().iter().for_each(the_next_one_syncs);
}

fn the_next_one_syncs(tiny: &Tiny) {
    let hasty = Tiny { sync: false, ..tiny.clone() };
    let (plain, operations) = (tiny.undisturbed(), operations(&hasty));
    let losses = AtomicU64::new(0);
    for_all((0..operations).step_by(2), |k| {
        let mut dice = Dice(k);
        let again = dice.next() % operations;
        let check = || -> Result<(), String> {
            let disk = Arc::new(Memory::default());
            if until(&disk, &hasty, k, None).is_none() {
                return Ok(());
            }
            let taken_up = newest_commit(&*disk, "")?.unwrap_or(0);
            let Some(more) = until(&disk, tiny, again, None) else { return Ok(()) };
            if more == 0 {
                return Ok(());
            }
            for seed in 0..SEEDS {
                let left = after(&disk, again, seed);
                kept(&left, taken_up + more, taken_up + more + 1)?;
                goes_on(left, tiny, &plain)?;
                losses.fetch_add(1, Ordering::Relaxed);
            }
            Ok(())
        };
        if let Err(e) = check() {
            panic!("killed at operation {k}, power lost at {again} of the next run: {e}");
        }
    });
    println!("{} losses of power after a run that did not sync", losses.into_inner());
}

fn last(log: &[String]) -> &str {
    log.last().map_or("", String::as_str)
}

/// Whether the last operation syncs the field's folder right after a manifest was renamed.
fn ends_a_commit(log: &[String]) -> bool {
    let before = log.len().checked_sub(2).map(|k| log[k].as_str());
    last(log) == "sync folder " && before.is_some_and(|b| b.starts_with("rename manifest-"))
}

/// Every kind of sync that a bake does.
const SYNCS: [(&str, Skips); 8] = [
    ("tile files", |log| last(log).ends_with(".tiles")),
    ("sums", |log| last(log).starts_with("sync sums-")),
    ("textures", |log| last(log).starts_with("sync textures-")),
    ("the scene", |log| last(log) == "sync scene"),
    ("folders of tile files", |log| {
        last(log).starts_with("sync folder ") && last(log) != "sync folder "
    }),
    ("the field's folder before the manifest", |log| {
        last(log) == "sync folder " && !ends_a_commit(log)
    }),
    ("the manifest before it gets its name", |log| last(log).starts_with("sync manifest-")),
    ("the field's folder after the manifest", ends_a_commit),
];

#[test]
fn no_sync_can_be_left_out_unnoticed() {
    Tiny::both().iter().for_each(no_sync_is_idle);
}

fn no_sync_is_idle(tiny: &Tiny) {
    let operations = operations(tiny);
    for (name, unsynced) in SYNCS {
        let (losses, found) = (AtomicU64::new(0), AtomicU64::new(0));
        for_all(0..operations, |k| {
            let disk = Arc::new(Memory::default());
            let Some(returned) = until(&disk, tiny, k, Some(unsynced)) else { return };
            for seed in 0..4 * SEEDS {
                losses.fetch_add(1, Ordering::Relaxed);
                if kept(&after(&disk, k, seed), returned, returned + 1).is_err() {
                    found.fetch_add(1, Ordering::Relaxed);
                }
            }
        });
        let (losses, found) = (losses.into_inner(), found.into_inner());
        println!("without the sync of {name}: {found} of {losses} losses of power found");
        assert!(found > 0, "the sync of {name} can be left out and nobody notices");
    }
}

/// All syncs that a bake does are of the kinds above, so that the table is the whole table.
#[test]
fn every_sync_is_of_a_kind_that_was_left_out() {
    for tiny in Tiny::both() {
        let faulty = Arc::new(Faulty::new(Arc::new(Memory::default()), Faults::default()));
        tiny.bake(faulty.clone()).unwrap();
        let log = faulty.log();
        for k in (0..log.len()).filter(|k| log[*k].starts_with("sync ")) {
            let kinds = SYNCS.iter().filter(|(_, is)| is(&log[..=k])).count();
            assert_eq!(kinds, 1, "{} after {}", log[k], log[k - 1]);
        }
    }
}
