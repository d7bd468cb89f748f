//! What packing did, by section, and what was lost in it.

use super::Packed;
use super::reduce::Deviation;
use serde::Serialize;

/// Bytes of a part before and after.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Section {
    /// In the field, decoded.
    pub before: u64,
    /// In the pack, stored.
    pub after: u64,
}

impl Section {
    /// Takes a chunk in.
    pub fn add(&mut self, before: usize, after: usize) {
        self.before += before as u64;
        self.after += after as u64;
    }

    /// How many times smaller it is.
    pub fn ratio(&self) -> f64 {
        self.before as f64 / self.after.max(1) as f64
    }
}

/// What packing did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct PackReport {
    /// The record.
    pub record: Section,
    /// The scene.
    pub scene: Section,
    /// The Total Texture Map.
    pub textures: Section,
    /// The total radiance maps.
    pub maps: Section,
    /// Bytes of the pack.
    pub bytes: u64,
    /// Values that the maps store (three f16 each).
    pub values: u64,
    /// Directions.
    pub directions: u32,
    /// How far a value may be off.
    pub max_error: f32,
    /// How far the values are off: every map was decoded again and held against the true one.
    pub deviation: Deviation,
    /// The same, over all cells.
    pub mean_error: f64,
}

impl PackReport {
    pub(super) fn add(&mut self, map: &Packed) {
        self.maps.before += map.from;
        self.maps.after += map.stored.len() as u64;
        self.values += map.values;
        self.deviation.add(&map.deviation);
        self.mean_error = self.deviation.mean();
    }

    /// All sections, named.
    pub fn sections(&self) -> [(&'static str, Section); 4] {
        [
            ("record", self.record),
            ("scene", self.scene),
            ("texture maps", self.textures),
            ("total radiance maps", self.maps),
        ]
    }

    /// All sections as one.
    pub fn whole(&self) -> Section {
        let sections = self.sections();
        Section {
            before: sections.iter().map(|(_, s)| s.before).sum(),
            after: sections.iter().map(|(_, s)| s.after).sum(),
        }
    }
}
