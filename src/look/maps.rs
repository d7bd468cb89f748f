//! The total radiance maps of an opened field: read, verified and decoded when they are first looked
//! at, and kept within a bound.
//!
//! A raw map of a mapped pack takes no memory of its own; what is verified of it once holds for as long
//! as it is kept.

use super::cache::{Cache, Weight};
use super::lightfield::{LightField, LookError, chunk_of};
use super::packed::PackFile;
use crate::format::container::{ChunkKind, Directory, FileKind, Header};
use crate::format::limits::Limits;
use crate::format::tiles::{Layout, TileMap};
use crate::format::{Fault, FormatError, names};
use crate::ids::DirectionId;
use crate::psf::Psf;
use crate::textured::{self, Texture};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Where a field's maps are.
pub(super) enum Source {
    Pack {
        file: Arc<PackFile>,
        directory: Directory,
        /// By direction the place of its map's entry.
        places: Vec<usize>,
    },
    Field {
        path: PathBuf,
        header: Header,
        limits: Limits,
    },
}

/// A direction's map, checked. One that a pack holds may leave values to the texture map; as it is
/// looked up, so it is held, which takes a fraction of the memory and of the time.
pub struct Map {
    bytes: Bytes,
    layout: Layout,
    exponent: i32,
}

enum Bytes {
    Mapped(Arc<PackFile>, Range<usize>),
    Decoded(Vec<u8>),
}

impl Map {
    /// The map to look into.
    pub fn tiles(&self) -> TileMap<'_> {
        let bytes = match &self.bytes {
            Bytes::Mapped(file, range) => file.mapped(range),
            Bytes::Decoded(bytes) => bytes,
        };
        TileMap::new(bytes, &self.layout)
    }

    /// Its radiance is multiplied by two to this power.
    pub(super) fn exponent(&self) -> i32 {
        self.exponent
    }
}

impl fmt::Debug for Map {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Map").field("layout", &self.layout).finish_non_exhaustive()
    }
}

impl Weight for Map {
    fn weight(&self) -> u64 {
        let own = match &self.bytes {
            Bytes::Mapped(..) => 0,
            Bytes::Decoded(bytes) => bytes.capacity(),
        };
        (size_of::<Map>() + own) as u64
    }
}

/// The maps that are at hand, and those that cannot be.
pub(super) struct Maps {
    cache: Cache<Map>,
    failed: Mutex<BTreeMap<u32, FormatError>>,
}

impl Maps {
    /// With room for so many bytes of maps.
    pub(super) fn new(memory: u64) -> Maps {
        Maps { cache: Cache::new(memory), failed: Mutex::default() }
    }

    /// A direction's map. One that has failed once is not tried again.
    pub(super) fn get(
        &self,
        direction: u32,
        load: impl FnOnce() -> Result<Map, FormatError>,
    ) -> Result<Arc<Map>, FormatError> {
        self.cache.get(direction, || {
            if let Some(error) = self.failed().get(&direction) {
                return Err(error.clone());
            }
            load().inspect_err(|error| _ = self.failed().insert(direction, error.clone()))
        })
    }

    /// Whether no more than half of the room is taken.
    pub(super) fn has_room(&self) -> bool {
        self.cache.bytes() <= self.cache.capacity() / 2
    }

    /// Bytes of the maps that are kept.
    pub(super) fn bytes(&self) -> u64 {
        self.cache.bytes()
    }

    /// The directions of maps that have failed.
    pub(super) fn damaged(&self) -> Vec<DirectionId> {
        self.failed().keys().map(|d| DirectionId(*d)).collect()
    }

    fn failed(&self) -> MutexGuard<'_, BTreeMap<u32, FormatError>> {
        self.failed.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl LightField {
    /// A map with every value in place.
    pub(super) fn filled(&self, direction: u32, map: Arc<Map>) -> Result<Arc<Map>, Fault> {
        if !map.layout.is_textured() {
            return Ok(map);
        }
        let LightField { scene, texels, total, manifest, .. } = self;
        let resolution = manifest.parameters.resolution;
        let psf = Psf::new(self.directions.vector(DirectionId(direction)), resolution);
        let texture = Texture { scene, texels, total };
        let bytes = textured::filled(&map.tiles(), &psf, map.exponent, &texture)?;
        let (tile, surfaces) = (manifest.parameters.tile, scene.surfaces.len() as u32);
        let layout = Layout::check(&bytes, resolution, tile, surfaces, map.exponent)?;
        Ok(Arc::new(Map { layout, bytes: Bytes::Decoded(bytes), exponent: map.exponent }))
    }

    /// Reads a direction's map.
    pub(super) fn load(&self, direction: u32) -> Result<Map, FormatError> {
        match &self.source {
            Source::Pack { file, directory, places } => {
                let place = || format!("{}: direction {direction}", file.name());
                self.load_packed(file, directory, places, direction)
                    .map_err(|fault| fault.in_file(place()))
            }
            Source::Field { path, header, limits } => self.load_file(
                names::tiles(path, names::TOTAL, direction),
                header,
                limits,
                direction,
            ),
        }
    }

    fn load_packed(
        &self,
        file: &Arc<PackFile>,
        directory: &Directory,
        places: &[usize],
        direction: u32,
    ) -> Result<Map, Fault> {
        let entry = &directory.entries[places[direction as usize]];
        let Header { resolution, tile, surfaces, exponent, .. } = directory.header;
        let bytes = file.chunk(directory, entry)?;
        let layout = Layout::check_packed(&bytes, (resolution, tile), surfaces, exponent)?;
        if layout.is_textured() {
            let psf = Psf::new(self.directions.vector(DirectionId(direction)), resolution);
            textured::check(&TileMap::new(&bytes, &layout), &psf, &self.scene)?;
        }
        let from = entry.offset as usize;
        let bytes = match bytes {
            Cow::Borrowed(bytes) => Bytes::Mapped(file.clone(), from..from + bytes.len()),
            Cow::Owned(bytes) => Bytes::Decoded(bytes),
        };
        Ok(Map { bytes, layout, exponent })
    }

    fn load_file(
        &self,
        path: PathBuf,
        header: &Header,
        limits: &Limits,
        direction: u32,
    ) -> Result<Map, FormatError> {
        let name = path.display().to_string();
        let generation = self.manifest.cycle;
        let place = Header { kind: FileKind::Tiles, generation, direction, ..header.clone() };
        let bytes = chunk_of(&path, &place, ChunkKind::Total, limits).map_err(|e| match e {
            LookError::Format(e) => e,
            other => Fault::Missing(other.to_string()).in_file(&name),
        })?;
        let Header { resolution, tile, surfaces, exponent, .. } = *header;
        let layout = Layout::check(&bytes, resolution, tile, surfaces, exponent)
            .map_err(|f| f.in_file(&name))?;
        Ok(Map { layout, exponent, bytes: Bytes::Decoded(bytes) })
    }
}
