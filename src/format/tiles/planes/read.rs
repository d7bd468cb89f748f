//! Putting planes that come from a file together again.

use super::{Neighbours, length, row_bytes, try_cells};
use crate::format::bytes::{Reader, Writer};
use crate::format::limits::MOST_CELLS;
use crate::format::tiles::{CONSTANT, DATA, Parts};
use crate::format::{Fault, room_for};

/// The map of `raw` bytes that planes were made from. What it holds is not checked beyond that its
/// tables have their places: that is [`Layout::check`](crate::format::tiles::Layout::check)'s.
///
/// # Errors
/// When the numbers of tables do not add up to the lengths, or contradict each other.
pub fn from_planes(planes: &[u8], raw: u64) -> Result<Vec<u8>, Fault> {
    let bad = |what: &str| Fault::invalid(format!("planes: {what}"));
    let mut r = Reader::new(planes);
    let [n, m, entries, values] = [r.u32()?, r.u32()?, r.u32()?, r.u32()?];
    let step = r.u16()?;
    let [tiles, words] = [u64::from(n).saturating_pow(2), mask_words(m)];
    let counted = length(tiles, words, entries.into(), values.into());
    let parts = Parts::new(n.into(), m.into(), entries.into(), values.into());
    let fits = counted == Some(planes.len() as u64) && parts.is_some_and(|p| p.end == raw);
    if !fits || !(1..=MOST_CELLS).contains(&m) || step == 0 {
        return Err(bad("their length is not the one that their numbers add up to"));
    }
    let index = |v: u64| usize::try_from(v).map_err(|_| bad("more than memory has room for"));
    let [tiles, words, count] = [index(tiles)?, index(words)?, index(entries.into())?];

    let mut w = Writer(room_for(raw, || "a tile map".into())?);
    [n, m, entries, values].into_iter().for_each(|v| w.u32(v));
    let counts = take(&mut r, 4, tiles)?;
    let mut behind = 0u32;
    w.u32(0);
    for count in &counts {
        behind = behind.checked_add(*count).ok_or_else(|| bad("too many entries"))?;
        w.u32(behind);
    }
    if behind != entries {
        return Err(bad("tiles have another number of entries"));
    }
    w.pad(8);
    let mut differences = take(&mut r, 4, count)?.into_iter();
    for count in &counts {
        let mut least = 0u32;
        for difference in differences.by_ref().take(*count as usize) {
            let surface = least.wrapping_add(difference);
            w.u32(surface);
            least = surface.wrapping_add(1);
        }
    }
    w.pad(8);

    let along = r.take(count)?;
    let states: Vec<u8> =
        { along.iter().zip(r.take(count)?) }.flat_map(|(a, b)| [*a, *b]).collect();
    let masks = masks(&mut r, m as usize, words.saturating_mul(8), count)?;
    let slots = || {
        let masks = masks.chunks_exact(words.saturating_mul(8));
        masks.zip(states.as_chunks::<2>().0).flat_map(|(mask, s)| s.map(|state| (state, mask)))
    };
    let mut start = 0u32;
    for (state, mask) in slots() {
        w.u32(start);
        start = start.wrapping_add(match state {
            DATA => mask.iter().map(|byte| byte.count_ones()).fold(0, u32::wrapping_add),
            CONSTANT => 1,
            _ => 0,
        });
    }
    if start != values {
        return Err(bad("slots have another number of values"));
    }
    w.pad(8);
    w.0.extend_from_slice(&states);
    w.pad(8);
    w.0.extend_from_slice(&masks);

    let [red, green, blue] = [(); 3]
        .map(|()| take(&mut r, 2, values as usize))
        .map(|channel| channel.map(Vec::into_iter));
    let (mut red, mut green, mut blue) = (red?, green?, blue?);
    let mut neighbours = Neighbours::new(m as usize);
    for (state, mask) in slots() {
        neighbours.begin_slot();
        try_cells(state, mask, |cell| {
            let next = [red.next(), green.next(), blue.next()];
            let [Some(r), Some(g), Some(b)] = next else { return Err(bad("values are missing")) };
            let [r, g, b] = [r, g, b].map(unfolded);
            let expected = neighbours.expected(cell);
            let differences = [r, g.wrapping_add(r), b.wrapping_add(r)];
            let mut found = expected;
            found.iter_mut().zip(differences).for_each(|(v, d)| *v = v.wrapping_add(d));
            neighbours.set(cell, found);
            found.into_iter().for_each(|v| w.u16(v.cast_unsigned().wrapping_mul(step)));
            Ok(())
        })?;
    }
    w.pad(8);
    match w.0.len() as u64 == raw {
        true => Ok(w.0),
        false => Err(bad("they make a map of another length")),
    }
}

fn mask_words(m: u32) -> u64 {
    u64::from(m).saturating_pow(2).div_ceil(64)
}

/// Takes `count` numbers of which the lowest bytes stand in planes.
fn take(r: &mut Reader, planes: u32, count: usize) -> Result<Vec<u32>, Fault> {
    let mut numbers = room_for(count as u64, || "planes".into())?;
    numbers.resize(count, 0u32);
    for plane in 0..planes {
        let shift = plane.wrapping_mul(8) % 32;
        let bytes = r.take(count)?;
        numbers.iter_mut().zip(bytes).for_each(|(v, b)| *v |= u32::from(*b) << shift);
    }
    Ok(numbers)
}

/// Takes the masks of `count` entries, `size` bytes each.
fn masks(r: &mut Reader, m: usize, size: usize, count: usize) -> Result<Vec<u8>, Fault> {
    // Without entries their length does not bound the size of one.
    if count == 0 {
        return Ok(Vec::new());
    }
    let bytes = count.saturating_mul(size);
    let mut masks = room_for(bytes as u64, || "masks".into())?;
    masks.resize(bytes, 0u8);
    for k in 0..size {
        let column = r.take(count)?;
        let before = k.checked_sub(row_bytes(m));
        for (mask, byte) in masks.chunks_exact_mut(size).zip(column) {
            let above = before.and_then(|before| mask.get(before)).copied().unwrap_or(0);
            if let Some(out) = mask.get_mut(k) {
                *out = byte ^ above;
            }
        }
    }
    Ok(masks)
}

/// The inverse of the writer's `folded`.
fn unfolded(code: u32) -> i16 {
    // Two planes make no more.
    let code = u16::try_from(code).unwrap_or_default();
    (code >> 1).cast_signed() ^ (code & 1).cast_signed().wrapping_neg()
}
