//! The page cache: unshot maps of directions, read from tile files, inside a fixed budget.
//!
//! A step of the bake gathers from the maps of directions near the mirrored one; nearby steps gather
//! from nearby maps. Pages in use are held by their readers; when the budget is spent, the page that
//! was used longest ago goes first.

use super::{FieldError, read_chunk};
use crate::format::container::{ChunkKind, FileKind};
use crate::format::manifest::Parameters;
use crate::format::names;
use crate::format::tiles::{Layout, TileMap};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// One direction's tile map, checked.
pub struct Page {
    bytes: Vec<u8>,
    layout: Layout,
}

impl Page {
    /// Checks and keeps the bytes of a tile map.
    ///
    /// # Errors
    /// A map that is not sound; `path` is for the message.
    pub fn new(
        path: &Path,
        bytes: Vec<u8>,
        parameters: &Parameters,
        surfaces: u32,
        exponent: i32,
    ) -> Result<Page, FieldError> {
        let (resolution, tile) = (parameters.resolution, parameters.tile);
        let layout = Layout::check(&bytes, resolution, tile, surfaces, exponent)
            .map_err(|f| f.in_file(path.display()))?;
        Ok(Page { bytes, layout })
    }

    /// The map.
    pub fn map(&self) -> TileMap<'_> {
        TileMap::new(&self.bytes, &self.layout)
    }
}

/// What the cache did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CacheFigures {
    /// Lookups that found their page.
    pub hits: u64,
    /// Lookups that read it.
    pub misses: u64,
    /// Pages given up for others.
    pub evictions: u64,
    /// Most bytes held at once.
    pub peak: u64,
}

struct Held {
    pages: HashMap<u32, (u64, Arc<Page>)>,
    clock: u64,
    bytes: u64,
    figures: CacheFigures,
}

/// Unshot maps of one generation.
pub struct Pages<'a> {
    field: &'a Path,
    folder: String,
    parameters: &'a Parameters,
    surfaces: u32,
    exponent: i32,
    budget: u64,
    held: Mutex<Held>,
}

impl<'a> Pages<'a> {
    /// A cache over the tile files of a generation that holds at most `budget` bytes of them.
    pub fn new(
        field: &'a Path,
        generation: u32,
        parameters: &'a Parameters,
        (surfaces, exponent): (u32, i32),
        budget: u64,
    ) -> Pages<'a> {
        let held =
            Held { pages: HashMap::new(), clock: 0, bytes: 0, figures: CacheFigures::default() };
        let folder = names::generation(generation);
        Pages { field, folder, parameters, surfaces, exponent, budget, held: Mutex::new(held) }
    }

    /// The unshot map of a direction.
    ///
    /// # Errors
    /// When its file is missing or damaged.
    pub fn get(&self, direction: u32) -> Result<Arc<Page>, FieldError> {
        let mut held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        held.clock += 1;
        let now = held.clock;
        if let Some((used, page)) = held.pages.get_mut(&direction) {
            *used = now;
            let page = page.clone();
            held.figures.hits += 1;
            return Ok(page);
        }
        held.figures.misses += 1;
        drop(held);
        let page = Arc::new(self.read(direction, ChunkKind::Unshot)?);
        let size = page.bytes.len() as u64;
        let mut held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        while held.bytes + size > self.budget && !held.pages.is_empty() {
            let Some(oldest) = held.pages.iter().min_by_key(|(_, (t, _))| *t).map(|(d, _)| *d)
            else {
                break;
            };
            if let Some((_, gone)) = held.pages.remove(&oldest) {
                held.bytes -= gone.bytes.len() as u64;
                held.figures.evictions += 1;
            }
        }
        if held.bytes + size <= self.budget && !held.pages.contains_key(&direction) {
            held.bytes += size;
            held.figures.peak = held.figures.peak.max(held.bytes);
            held.pages.insert(direction, (now, page.clone()));
        }
        Ok(page)
    }

    /// A map of a direction, read past the cache.
    ///
    /// # Errors
    /// When its file is missing or damaged.
    pub fn read(&self, direction: u32, kind: ChunkKind) -> Result<Page, FieldError> {
        let path: PathBuf = names::tiles(self.field, &self.folder, direction);
        let bytes = read_chunk(&path, FileKind::Tiles, kind, direction)?;
        Page::new(&path, bytes, self.parameters, self.surfaces, self.exponent)
    }

    /// What the cache did so far.
    pub fn figures(&self) -> CacheFigures {
        self.held.lock().unwrap_or_else(PoisonError::into_inner).figures
    }
}
