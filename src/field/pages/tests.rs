use super::*;
use crate::field::storage::faulty::{Faults, Faulty};
use crate::field::storage::memory::Memory;
use crate::format::container::{self, ChunkId, Codec};
use crate::format::manifest::{Parameters, Specular, header};
use crate::format::tiles::{CoveredCell, TileMapWriter};
use crate::ids::SurfaceId;
use crate::radiance::Rgb;
use std::io::{ErrorKind, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

const UNSHOT: ChunkKind = ChunkKind::Unshot;
const ARRIVED: ChunkKind = ChunkKind::Arrived;

fn head(direction: u32) -> Header {
    let parameters = Parameters {
        directions: 9,
        resolution: 16,
        tile: 8,
        cycles: Some(1),
        unshot_fraction: 1e-3,
        perturbations: vec![1],
        texel_cells: 1.0,
        filter: 0,
        one_sided: false,
        specular: Specular::Maps,
        resample: false,
        ..Parameters::default()
    };
    header(FileKind::Tiles, [1; 16], &parameters, 1, 0, (1, direction))
}

/// A tile map with so many cells that are covered.
fn map(cells: u32) -> Vec<u8> {
    let mut writer = TileMapWriter::new(16, 8, 0);
    let cell = |cell| {
        let radiance = [Rgb::BLACK, Rgb::splat(cell as f32)];
        CoveredCell { surface: SurfaceId(0), cell, radiance }
    };
    writer.tile(&mut (0..cells).map(cell).collect::<Vec<_>>());
    (1..4).for_each(|_| writer.tile(&mut []));
    writer.finish()
}

/// Generation 1 with nine directions of one page size; direction 8's pages are larger.
fn generation() -> Arc<Memory> {
    let disk = Arc::new(Memory::default());
    disk.create_folder(&names::generation(1)).unwrap();
    for direction in 0..9 {
        let bytes = map(if direction == 8 { 64 } else { 0 });
        let id = |kind| ChunkId { kind, cycle: 1, direction };
        let chunks = [UNSHOT, ARRIVED].map(|kind| (id(kind), Codec::Raw, bytes.as_slice()));
        let file = container::to_bytes(head(direction), &chunks).unwrap();
        let name = names::tile_file(&names::generation(1), direction);
        disk.create(&name, 0).unwrap().write_all(&file).unwrap();
    }
    disk
}

/// Bytes of one of the small pages.
fn page() -> u64 {
    map(0).len() as u64
}

fn pages(budget: u64, threads: usize) -> Pages {
    Pages::new(generation(), head(container::NO_DIRECTION), budget, threads)
}

#[test]
fn a_page_is_read_once_while_there_is_room() {
    let pages = pages(100 * page(), 1);
    for _ in 0..3 {
        for direction in 0..8 {
            drop(pages.get(direction, UNSHOT).unwrap());
        }
    }
    let figures = pages.take_figures();
    assert_eq!((figures.misses, figures.hits), (8, 16));
    assert_eq!((figures.evictions, figures.redundant), (0, 0));
    assert_eq!((figures.bytes, figures.peak), (8 * page(), 8 * page()));
    assert_eq!(pages.take_figures(), CacheFigures::default());
}

#[test]
fn the_page_used_longest_ago_goes_first_and_the_budget_is_kept() {
    let pages = pages(3 * page(), 1);
    for direction in [0, 1, 2, 0, 3] {
        drop(pages.get(direction, UNSHOT).unwrap());
    }
    // Direction 1 made room for 3; 0 had been used again.
    let figures = pages.take_figures();
    assert_eq!((figures.hits, figures.misses, figures.evictions), (1, 4, 1));
    for direction in [0, 2, 3, 1] {
        drop(pages.get(direction, UNSHOT).unwrap());
    }
    let figures = pages.take_figures();
    assert_eq!((figures.hits, figures.misses), (3, 1));
    assert_eq!((figures.evictions, figures.redundant), (1, 1), "direction 1 again");
    assert!(figures.peak <= 3 * page());
}

#[test]
fn what_has_arrived_is_given_up_when_it_has_been_used() {
    let pages = pages(2 * page(), 1);
    for direction in 0..8 {
        let held = pages.get(direction, ARRIVED).unwrap();
        assert!(held.map().entry(crate::ids::Cell { i: 0, j: 0 }, SurfaceId(0)).is_none());
    }
    let figures = pages.take_figures();
    assert_eq!((figures.peak, figures.evictions, figures.redundant), (page(), 0, 0));
}

#[test]
fn a_page_larger_than_the_budget_allows_is_refused_with_both_numbers() {
    let large = map(64).len() as u64;
    assert!(large > 2 * page());
    // Two of them must have room, for each thread.
    for (budget, threads, has_room) in
        [(2 * large, 1, true), (2 * large - 1, 1, false), (2 * large, 2, false)]
    {
        let pages = pages(budget, threads);
        match pages.get(8, UNSHOT) {
            Ok(_) => assert!(has_room),
            Err(FieldError::Format(e)) => {
                let limit = budget / (2 * threads as u64);
                let Fault::Limit { value, limit: l, .. } = e.fault else { panic!("{e}") };
                assert!(!has_room);
                assert_eq!((value, l), (large, limit));
                assert!(e.to_string().contains("unshot-0001/000008.tiles"), "{e}");
                assert!(e.to_string().contains("--memory"), "{e}");
            }
            Err(e) => panic!("{e}"),
        }
        // The others can be had all the same, and nobody waits for the one that failed.
        drop(pages.get(0, UNSHOT).unwrap());
        assert_eq!(pages.get(8, UNSHOT).is_ok(), has_room);
    }
}

/// Bytes that the budget counts, which are those of all pages and of spare memory.
fn counted(pages: &Pages) -> u64 {
    let state = pages.state();
    let of = |slot: &Slot| match slot {
        Slot::Ready { page, .. } => page.buffer.room,
        Slot::Reading => 0,
    };
    assert_eq!(state.bytes, state.slots.values().map(of).sum::<u64>() + state.spare.bytes);
    state.bytes
}

/// Where a page's memory is.
fn place(held: &Held) -> *const u8 {
    held.buffer.bytes.as_ptr()
}

#[test]
fn memory_of_a_page_that_is_given_up_is_that_of_the_next() {
    let pages = pages(2 * page(), 1);
    let first = pages.get(0, UNSHOT).map(|held| place(&held)).unwrap();
    let other = pages.get(1, UNSHOT).unwrap();
    assert_ne!(place(&other), first);
    // 0 makes room for 2, and what has arrived goes at once.
    assert_eq!(pages.get(2, UNSHOT).map(|held| place(&held)).unwrap(), first);
    assert_eq!(pages.get(3, ARRIVED).map(|held| place(&held)).unwrap(), first);
    assert_eq!(pages.get(4, ARRIVED).map(|held| place(&held)).unwrap(), first);
    assert_eq!(counted(&pages), 2 * page());
}

#[test]
fn spare_memory_counts_and_is_freed_for_a_page_that_it_has_no_room_for() {
    let large = map(64).len() as u64;
    let pages = pages(2 * large, 1);
    let many = (2 * large / page()) as u32;
    assert!(many > 3, "the small ones fill the budget");
    let small: Vec<Held> = (0..8).map(|d| pages.get(d, ARRIVED).unwrap()).collect();
    drop(small);
    assert_eq!((counted(&pages), pages.state().spare.bytes), (8 * page(), 8 * page()));
    // No more small ones are freed than the large one takes.
    let held = pages.get(8, UNSHOT).unwrap();
    let freed = large.div_ceil(page()).min(8) * page();
    assert_eq!(counted(&pages), large + 8 * page() - freed);
    // The larger room serves a small page too, and is still counted whole.
    let kept = place(&held);
    drop(held);
    let room = |pages: &Pages| pages.state().spare.bytes;
    (0..8).for_each(|d| drop(pages.get(d, UNSHOT).unwrap()));
    assert!(counted(&pages) <= 2 * large && room(&pages) < large);
    assert_eq!(pages.get(8, UNSHOT).map(|held| place(&held)).unwrap(), kept, "still there");
    assert!(pages.take_figures().peak <= 2 * large);
}

#[test]
fn the_next_generation_is_read_into_the_memory_of_the_one_before() {
    let places = |pages: &Pages| -> HashSet<*const u8> {
        (0..8).map(|d| place(&pages.get(d, UNSHOT).unwrap())).collect()
    };
    let first = pages(8 * page(), 1);
    let before = places(&first);
    let second = pages(8 * page(), 1).reusing(first.into_spare());
    assert_eq!((counted(&second), second.state().spare.bytes), (8 * page(), 8 * page()));
    assert_eq!(places(&second), before);
    assert_eq!((counted(&second), second.state().spare.bytes), (8 * page(), 0));
    // A smaller budget takes less of it.
    let third = pages(3 * page() + 1, 1).reusing(second.into_spare());
    assert_eq!(counted(&third), 3 * page());
    assert!(places(&third).is_subset(&before));
    assert_eq!(third.take_figures().peak, 3 * page());
}

/// Waits until a flag is up; a cache that never wakes anyone fails the test.
fn comes(flag: &AtomicBool) -> bool {
    (0..2000).any(|_| {
        thread::sleep(Duration::from_millis(1));
        flag.load(Ordering::SeqCst)
    })
}

#[test]
fn who_finds_no_room_waits_until_another_lets_a_page_go() {
    let pages = pages(2 * page(), 1);
    let (first, second) = (pages.get(0, UNSHOT).unwrap(), pages.get(1, UNSHOT).unwrap());
    let has_third = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| {
            let third = pages.get(2, UNSHOT).unwrap();
            has_third.store(true, Ordering::SeqCst);
            drop(third);
        });
        thread::sleep(Duration::from_millis(50));
        assert!(!has_third.load(Ordering::SeqCst), "beyond the budget");
        drop(second);
        assert!(comes(&has_third), "never woken");
    });
    drop(first);
    let figures = pages.take_figures();
    assert_eq!((figures.peak, figures.evictions, figures.misses), (2 * page(), 1, 3));
    assert!(figures.wait > 0.0);
}

#[test]
fn threads_that_want_the_same_page_read_it_once() {
    let pages = pages(100 * page(), 8);
    thread::scope(|scope| {
        for _ in 0..8 {
            scope.spawn(|| (0..8).for_each(|d| drop(pages.get(d, UNSHOT).unwrap())));
        }
    });
    let figures = pages.take_figures();
    assert_eq!(figures.bytes, 8 * page());
    assert_eq!(figures.hits + figures.misses, 64);
}

/// With the least that is allowed, threads that hold one page while they ask for another never wait
/// for each other for ever, nor hold more than the budget.
#[test]
fn the_least_budget_is_enough_for_all_threads() {
    for threads in [1, 2, 4] {
        let budget = 2 * threads as u64 * page();
        let pages = pages(budget, threads);
        let done = AtomicBool::new(false);
        thread::scope(|scope| {
            scope.spawn(|| {
                thread::scope(|scope| {
                    for thread in 0..threads as u32 {
                        let pages = &pages;
                        scope.spawn(move || {
                            for round in 0..200 {
                                let one = pages.get((round + thread) % 8, UNSHOT).unwrap();
                                pages.read_ahead((round + 3) % 8, ARRIVED).unwrap();
                                drop(pages.get((3 * round + 5 * thread) % 8, UNSHOT).unwrap());
                                drop(one);
                            }
                        });
                    }
                });
                done.store(true, Ordering::SeqCst);
            });
            assert!((0..10).any(|_| comes(&done)), "{threads} threads wait for each other");
        });
        let figures = pages.take_figures();
        assert!(figures.peak <= budget, "{threads} threads: {figures:?}");
    }
}

#[test]
fn reading_ahead_takes_no_room_from_what_was_read_ahead() {
    let pages = pages(3 * page(), 1);
    for direction in 0..8 {
        pages.read_ahead(direction, UNSHOT).unwrap();
    }
    // The first three are there still; the others found no room.
    for direction in 0..3 {
        drop(pages.get(direction, UNSHOT).unwrap());
    }
    let figures = pages.take_figures();
    assert_eq!((figures.hits, figures.misses, figures.evictions), (3, 0, 0));
    assert_eq!(figures.bytes, 3 * page());
    // Pages that were used make room for the next.
    pages.read_ahead(3, UNSHOT).unwrap();
    drop(pages.get(3, UNSHOT).unwrap());
    let figures = pages.take_figures();
    assert_eq!((figures.hits, figures.misses, figures.evictions), (1, 0, 1));
    // Who wants a page takes the room of those read ahead.
    (4..7).for_each(|d| pages.read_ahead(d, UNSHOT).unwrap());
    drop(pages.get(7, UNSHOT).unwrap());
    let figures = pages.take_figures();
    assert_eq!((figures.misses, figures.peak), (1, 3 * page()));
}

#[test]
fn a_read_that_fails_is_said_to_all_who_wait_and_can_be_tried_again() {
    let disk = generation();
    // Each page takes one opening and two reads: first block and section.
    for k in 0..3 {
        let faults = Faults { fail: Some(k), kind: Some(ErrorKind::Other), ..Faults::default() };
        let storage = Arc::new(Faulty::new(disk.clone(), faults));
        let pages = Pages::new(storage, head(container::NO_DIRECTION), 2 * page(), 1);
        let failed = thread::scope(|scope| {
            let get = || pages.get(0, UNSHOT).map(drop).err().map(|e| e.to_string());
            let asked = [(); 3].map(|()| scope.spawn(get));
            asked.into_iter().filter_map(|a| a.join().unwrap()).collect::<Vec<_>>()
        });
        assert_eq!(failed.len(), 1, "operation {k}: {failed:?}");
        assert!(failed[0].contains("unshot-0001/000000.tiles"), "{failed:?}");
        // Nothing of the failed one is counted as held.
        let two = [pages.get(0, UNSHOT).unwrap(), pages.get(1, UNSHOT).unwrap()];
        assert_eq!(pages.take_figures().peak, 2 * page());
        drop(two);
    }
}

#[test]
fn a_damaged_or_missing_page_is_named_and_never_handed_out() {
    let disk = generation();
    let name = names::tile_file(&names::generation(1), 3);
    disk.edit(&name, |bytes| bytes[390] ^= 1);
    disk.remove(&names::tile_file(&names::generation(1), 4)).unwrap();
    let pages = Pages::new(disk, head(container::NO_DIRECTION), 100 * page(), 1);
    for direction in [3, 4] {
        for _ in 0..2 {
            let error = pages.get(direction, UNSHOT).err().unwrap().to_string();
            assert!(error.contains(&format!("00000{direction}.tiles")), "{error}");
            assert!(pages.read_ahead(direction, UNSHOT).is_err());
        }
    }
    assert_eq!(pages.take_figures().bytes, 0);
}
