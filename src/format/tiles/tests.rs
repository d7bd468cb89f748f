//! Tile maps written and read, and damaged.

use super::*;
use crate::ids::{Cell, Sense, SurfaceId};
use crate::radiance::Rgb;
use proptest::prelude::*;

fn cell(surface: u32, cell: u32, along: f32, against: f32) -> CoveredCell {
    let radiance = [Rgb::splat(along), Rgb::splat(against)];
    CoveredCell { surface: SurfaceId(surface), cell, radiance }
}

fn two_tiles() -> Vec<u8> {
    let mut w = TileMapWriter::new(8, 4, 0);
    w.tile(&mut [cell(3, 1, 0.5, 0.0), cell(1, 0, 2.0, 1.0), cell(3, 15, 0.25, 0.0)]);
    w.tile(&mut []);
    w.tile(&mut []);
    w.tile(&mut [cell(3, 5, 0.125, 4.0)]);
    w.finish()
}

#[test]
fn what_was_written_is_read_and_nothing_else() {
    let bytes = two_tiles();
    let layout = Layout::check(&bytes, 8, 4, 4, 0).unwrap();
    let map = TileMap::new(&bytes, &layout);
    let read = |i, j, s, sense| {
        map.entry(Cell { i, j }, SurfaceId(s)).and_then(|e| e.radiance(Cell { i, j }, sense))
    };
    assert_eq!(read(1, 0, 3, Sense::Along), Some(Rgb::splat(0.5)));
    assert_eq!(read(3, 3, 3, Sense::Along), Some(Rgb::splat(0.25)));
    assert_eq!(read(3, 3, 3, Sense::Against), Some(Rgb::BLACK));
    assert_eq!(read(0, 0, 1, Sense::Against), Some(Rgb::splat(1.0)));
    assert_eq!(read(5, 5, 3, Sense::Against), Some(Rgb::splat(4.0)));
    assert_eq!(read(0, 0, 3, Sense::Along), None);
    assert_eq!(read(5, 0, 3, Sense::Along), None);
    let mut count = 0;
    map.for_each(|_, _, _| count += 1);
    assert_eq!(count, 4);
}

#[test]
fn any_flipped_byte_is_refused_or_stays_in_bounds() {
    let good = two_tiles();
    for at in 0..good.len() {
        for bit in 0..8 {
            let mut bytes = good.clone();
            bytes[at] ^= 1 << bit;
            if let Ok(layout) = Layout::check(&bytes, 8, 4, 4, 0) {
                TileMap::new(&bytes, &layout).for_each(|_, _, both| {
                    assert!(both.iter().all(|r| r.is_physical()));
                });
            }
        }
    }
}

proptest! {
    #[test]
    fn radiance_keeps_eleven_bits(v in 1e-4f32..1.0, power in -25i32..25) {
        let most = 1.7 * 10f32.powi(power);
        let exponent = exponent_for(most);
        let mut w = TileMapWriter::new(1, 1, exponent);
        w.tile(&mut [cell(0, 0, v * most, most)]);
        let bytes = w.finish();
        let layout = Layout::check(&bytes, 1, 1, 1, exponent).unwrap();
        let at = Cell { i: 0, j: 0 };
        let entry = TileMap::new(&bytes, &layout).entry(at, SurfaceId(0)).unwrap();
        let back = entry.radiance(at, Sense::Along).unwrap().0[0];
        prop_assert!((back / (v * most) - 1.0).abs() < 5e-4, "{back} {}", v * most);
    }

    #[test]
    fn random_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        let _ = Layout::check(&bytes, 8, 4, 4, 0);
    }
}
