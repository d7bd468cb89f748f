//! Rearranging a map that was checked.

#![allow(
    clippy::arithmetic_side_effects,
    clippy::cast_possible_truncation,
    clippy::indexing_slicing,
    reason = "the layout was checked with the bytes"
)]

use super::{Neighbours, row_bytes, try_cells};
use crate::format::bytes::{Writer, u16_at};
use crate::format::tiles::{FIRST_AT, TileMap, numbers};
use std::convert::Infallible;

/// Rearranges a checked map.
pub fn to_planes(map: &TileMap) -> Vec<u8> {
    let layout = map.layout;
    let entries = layout.entries;
    let rgb = &map.bytes[layout.rgb_at..][..6 * layout.values];
    let step = (0..3 * layout.values).fold(0, |step, c| gcd(u16_at(rgb, c), step)).max(1);
    let mut w = Writer(Vec::with_capacity(map.bytes.len()));
    for number in [layout.n, layout.m, entries as u32, layout.values as u32] {
        w.u32(number);
    }
    w.u16(step);

    let tiles = (layout.n * layout.n) as usize;
    let first: Vec<u32> = numbers(&map.bytes[FIRST_AT..]).take(tiles + 1).collect();
    let counts: Vec<u32> = first.windows(2).map(|w| w[1] - w[0]).collect();
    put(&mut w.0, 4, &counts);
    let mut surfaces = Vec::with_capacity(entries);
    for tile in first.windows(2) {
        let mut least = 0;
        for entry in tile[0]..tile[1] {
            let surface = map.surface(entry as usize);
            surfaces.push(surface - least);
            least = surface.wrapping_add(1);
        }
    }
    put(&mut w.0, 4, &surfaces);
    for sense in 0..2 {
        w.0.extend((0..entries).map(|e| map.state(2 * e + sense)));
    }
    let row = row_bytes(layout.m as usize);
    for k in 0..8 * layout.words {
        let byte = |mask: &[u8]| mask[k] ^ k.checked_sub(row).map_or(0, |before| mask[before]);
        w.0.extend((0..entries).map(|e| byte(map.mask(e))));
    }
    for channel in differences(map, rgb, step) {
        put(&mut w.0, 2, &channel);
    }
    w.0
}

/// What each channel of the values differs by from the expected.
fn differences(map: &TileMap, rgb: &[u8], step: u16) -> [Vec<u32>; 3] {
    let mut channels = [(); 3].map(|()| Vec::with_capacity(map.value_count()));
    let mut neighbours = Neighbours::new(map.layout.m as usize);
    for slot in 0..2 * map.layout.entries {
        neighbours.begin_slot();
        let Ok(()) = try_cells::<Infallible>(map.state(slot), map.mask(slot / 2), |cell| {
            let value = channels[0].len();
            // At most 0x7bff: the sign is clear.
            let found = [0, 1, 2].map(|c| (u16_at(rgb, 3 * value + c) / step) as i16);
            let expected = neighbours.expected(cell);
            neighbours.set(cell, found);
            let [r, g, b] = [0, 1, 2].map(|c| found[c].wrapping_sub(expected[c]));
            for (channel, d) in channels.iter_mut().zip([r, g.wrapping_sub(r), b.wrapping_sub(r)]) {
                channel.push(folded(d).into());
            }
            Ok(())
        });
    }
    channels
}

/// 0, -1, 1, -2, 2, ... as 0, 1, 2, 3, 4, ...
fn folded(difference: i16) -> u16 {
    ((difference << 1) ^ (difference >> 15)) as u16
}

/// Appends the lowest bytes of numbers in planes.
fn put(out: &mut Vec<u8>, planes: u32, numbers: &[u32]) {
    for plane in 0..planes {
        out.extend(numbers.iter().map(|v| (v >> (8 * plane)) as u8));
    }
}

fn gcd(a: u16, b: u16) -> u16 {
    if b == 0 { a } else { gcd(b, a % b) }
}
