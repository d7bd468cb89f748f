//! What a pack keeps of a total map: values as exact as asked for, and none that the texture map has.

use crate::format::tiles::{self, CONSTANT, DATA, TEXTURED, TileMap, half_to_f32};
use crate::ids::SurfaceId;
use crate::psf::Psf;
use crate::textured::Texture;
use serde::Serialize;
use std::borrow::Cow;

/// The smallest f16 with full precision; what is darker is measured against it.
const DIMMEST: f32 = 6.103_515_6e-5;

/// What a pack keeps of a map.
pub struct Reduced<'a> {
    /// Bytes of the map that is kept.
    pub map: Cow<'a, [u8]>,
    /// Bits of the values that its textured slots leave to the texture map, three f16 a covered cell, slot
    /// by slot.
    pub left: Vec<u16>,
}

/// A map with values off by at most `max_error`, see [`Deviation`]. Surfaces for which `keep` is false
/// are left out.
pub fn reduced<'a>(
    map: &TileMap,
    (psf, exponent): (&Psf, i32),
    texture: &Texture,
    keep: impl Fn(SurfaceId) -> bool,
    max_error: f32,
) -> Reduced<'a> {
    let (step, within) = (step(max_error), within(max_error));
    let mut left = Vec::new();
    let map = tiles::rewritten(map, keep, |slot, rgb| {
        if !matches!(slot.state, DATA | CONSTANT) {
            return slot.state;
        }
        let is_near = |found: &[u16]| {
            slot.differs_by(found).is_some_and(|bits| bits <= within) || {
                let found = found.as_chunks().0.iter();
                slot.values().zip(found).all(|(true_, found)| error(true_, *found) <= max_error)
            }
        };
        let before = left.len();
        if texture.values(psf, slot, exponent, &mut left) && is_near(&left[before..]) {
            return TEXTURED;
        }
        left.truncate(before);
        let at = rgb.len();
        slot.copy(rgb);
        rgb[at..].iter_mut().for_each(|bits| *bits = rounded(*bits, step));
        if !is_near(&rgb[at..]) {
            rgb.truncate(at);
            slot.copy(rgb);
        }
        slot.state
    });
    Reduced { map: map.into(), left }
}

/// A map without the surfaces for which `keep` is false.
pub fn kept(map: &TileMap, keep: impl Fn(SurfaceId) -> bool) -> Vec<u8> {
    tiles::rewritten(map, keep, |slot, rgb| {
        slot.copy(rgb);
        slot.state
    })
}

/// Bits of an f16, read as a number, rise with its logarithm, about 1024 a binade: their rounding to
/// multiples of this keeps a value's relative error within `max_error`.
fn step(max_error: f32) -> u16 {
    ((2048.0 * max_error / (1.0 + max_error)) as u16).max(1)
}

/// How far all bits may be off so that no value can be off by more than `max_error`, however it is
/// rounded. Values that are off by more may do as well, where another channel is brighter.
fn within(max_error: f32) -> u16 {
    (1023.0 * max_error / (1.0 + max_error)) as u16
}

/// The nearest multiple of `step` that is finite.
fn rounded(bits: u16, step: u16) -> u16 {
    let up = (bits + step / 2) / step * step;
    if up < 0x7c00 { up } else { bits / step * step }
}

/// How far a cell's value is from the true one: its worst channel against the brightest true one.
fn error(true_bits: [u16; 3], bits: [u16; 3]) -> f32 {
    if true_bits == bits {
        return 0.0;
    }
    let (true_, other) = (true_bits.map(half_to_f32), bits.map(half_to_f32));
    let most = true_.iter().fold(DIMMEST, |a, b| a.max(*b));
    let off = |c: usize| (true_[c] - other[c]).abs();
    off(0).max(off(1)).max(off(2)) / most
}

/// How far the values of a packed map are from the true ones: of each cell the worst channel, against
/// the brightest true one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Deviation {
    /// Of the cell that is off most.
    pub worst: f32,
    /// Where that is; `None` when nothing is off.
    pub at: Option<Place>,
    /// Sum over all cells.
    pub sum: f64,
    /// How many there are.
    pub cells: u64,
}

/// A surface's cells in a tile, in one sense.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Place {
    /// The direction.
    pub direction: u32,
    /// Column and row of the tile.
    pub tile: [u32; 2],
    /// The surface.
    pub surface: u32,
    /// 0 along the direction, 1 against it.
    pub sense: usize,
}

impl Deviation {
    /// Of a map, against the true one; `keep` and `left` as it was packed with, see `Reduced`. `None`
    /// when they have other cells.
    pub fn of(
        direction: u32,
        (true_, found): (&TileMap, &TileMap),
        mut left: &[u16],
        keep: impl Fn(SurfaceId) -> bool,
    ) -> Option<Deviation> {
        let mut deviation = Deviation::default();
        let mut found = found.slots();
        for slot in true_.slots().filter(|slot| keep(slot.surface)) {
            let other = found.next().filter(|other| other.is_same_place(&slot))?;
            let cells = slot.covered_count();
            deviation.cells += u64::from(cells);
            let of_slot;
            (of_slot, left) = match other.state {
                TEXTURED => left.split_at_checked(3 * cells as usize)?,
                _ => left.split_at(0),
            };
            let is_same = match other.state {
                TEXTURED => slot.differs_by(of_slot) == Some(0),
                _ => slot.is_stored_alike(&other),
            };
            if is_same {
                continue;
            }
            let packed = { of_slot.as_chunks().0.iter().copied() }.chain(other.values());
            for (value, packed) in slot.values().zip(packed) {
                let off = error(value, packed);
                deviation.sum += f64::from(off);
                if off > deviation.worst {
                    let m = true_.tile_edge();
                    let tile = [slot.origin.i / m, slot.origin.j / m];
                    let (surface, sense) = (slot.surface.0, slot.sense.slot());
                    deviation.worst = off;
                    deviation.at = Some(Place { direction, tile, surface, sense });
                }
            }
        }
        (found.next().is_none() && left.is_empty()).then_some(deviation)
    }

    /// Takes another map's in.
    pub fn add(&mut self, other: &Deviation) {
        if other.worst > self.worst {
            (self.worst, self.at) = (other.worst, other.at);
        }
        self.sum += other.sum;
        self.cells += other.cells;
    }

    /// Over all cells.
    pub fn mean(&self) -> f64 {
        self.sum / self.cells.max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_that_are_within_reach_keep_every_value_within_the_error() {
        for max_error in [0.0, 0.002, 0.01, 0.1, 0.25] {
            let within = within(max_error);
            assert!(f32::from(within) >= 900.0 * max_error / (1.0 + max_error) - 1.0);
            for bits in within..0x7c00 - within {
                for other in [bits - within, bits + within] {
                    assert!(error([bits; 3], [other; 3]) <= max_error, "{bits:#x} {other:#x}");
                }
            }
        }
    }
}
