//! Links: what the exchange of a PSF found, kept from cycle to cycle as far as memory allows.
//!
//! In: the values that look at each other along the lines of a PSF, and where the paths end that its
//! mirrors show. Out: the same in a later cycle, in which only the light is another (section 4.1: the
//! exchange buffer depends on the rays alone). What is not kept is found again, to the same bits.

use crate::ids::{DirectionId, SmallCell};
use crate::radiance::Rgb;
use std::collections::HashMap;
use std::mem::size_of_val;
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// What a mirror shows along a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shown {
    /// The texture value at the end of the path, or that of the space outside.
    pub from: u32,
    /// What part of its light the path's mirrors carry on.
    pub carried: Rgb,
    /// The value that receives it: a texel's, a mirror's, or that of the space outside.
    pub to: u32,
    /// The line's cell.
    pub cell: SmallCell,
}

/// What a mirror sees along a line without another between.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seen {
    /// The value that it sees, or that of the space outside.
    pub from: u32,
    /// The mirror's value.
    pub mirror: u32,
    /// The line's cell.
    pub cell: SmallCell,
}

/// What travels along the lines of a PSF.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Links {
    /// Diffuse values that look at each other.
    pub pairs: Vec<[u32; 2]>,
    /// The cell of each pair, where cells are clipped; otherwise none.
    pub cells: Vec<SmallCell>,
    /// What mirrors see.
    pub seen: Vec<Seen>,
    /// What mirrors show.
    pub shown: Vec<Shown>,
    /// Fragments of the layers in which they were found.
    pub fragments: u64,
}

impl Links {
    /// Forgets all, but keeps the memory.
    pub fn clear(&mut self) {
        self.pairs.clear();
        self.cells.clear();
        self.seen.clear();
        self.shown.clear();
    }

    /// Bytes of memory of a copy.
    fn bytes(&self) -> i64 {
        let lists = size_of_val(self.pairs.as_slice())
            + size_of_val(self.cells.as_slice())
            + size_of_val(self.seen.as_slice())
            + size_of_val(self.shown.as_slice());
        lists as i64 + A_PSF
    }
}

/// Bytes that a PSF's links take beside their lists: the map's entry and what an allocator adds.
const A_PSF: i64 = 256;

/// The links of PSFs, by direction and perturbation.
pub struct Kept {
    links: Mutex<HashMap<(DirectionId, u32), Arc<Links>>>,
    room: AtomicI64,
}

impl Kept {
    /// Room for so many bytes.
    pub fn new(room: u64) -> Kept {
        let room = AtomicI64::new(i64::try_from(room).unwrap_or(i64::MAX));
        Kept { links: Mutex::default(), room }
    }

    /// Whether there is room for any more.
    pub fn has_room(&self) -> bool {
        self.room.load(Ordering::Relaxed) > 0
    }

    /// The links of a PSF, if they were kept.
    pub fn get(&self, id: DirectionId, number: u32) -> Option<Arc<Links>> {
        let links = self.links.lock().unwrap_or_else(PoisonError::into_inner);
        links.get(&(id, number)).cloned()
    }

    /// Keeps a copy of a PSF's links, if there is room for it.
    pub fn put(&self, id: DirectionId, number: u32, links: &Links) {
        let bytes = links.bytes();
        if self.room.fetch_sub(bytes, Ordering::Relaxed) < bytes {
            self.room.fetch_add(bytes, Ordering::Relaxed);
            return;
        }
        let copy = Arc::new(links.clone());
        self.links.lock().unwrap_or_else(PoisonError::into_inner).insert((id, number), copy);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_are_kept_while_there_is_room_for_them() {
        let links = Links { pairs: vec![[1, 2]; 100], fragments: 7, ..Links::default() };
        let each = links.bytes() as u64;
        assert!(each > 800);
        let kept = Kept::new(2 * each + each / 2);
        let id = DirectionId;
        (0..4).for_each(|k| kept.put(id(k), 1, &links));
        let held: Vec<bool> = (0..4).map(|k| kept.get(id(k), 1).is_some()).collect();
        assert_eq!(held, [true, true, false, false]);
        assert_eq!(kept.get(id(1), 1).as_deref(), Some(&links));
        assert_eq!(kept.get(id(1), 0), None, "another perturbation");
        assert!(kept.has_room(), "for smaller ones");
        assert!(!Kept::new(0).has_room());
    }
}
