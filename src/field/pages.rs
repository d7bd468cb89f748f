//! The page cache: tile maps of a generation, read from its files inside a fixed budget.
//!
//! A page is one section of one direction's tile file, decoded and checked. Its bytes are reserved
//! before it is read: other pages that nobody holds make room, the one that was used longest ago
//! first, and if all are held the reader waits. Pages that are read ahead make room only at the cost
//! of used ones, so that readers ahead never chase each other's pages out.
//!
//! The memory of a page that is given up is that of the next one. Left to the allocator, which keeps a
//! store for each thread, what one thread gave back would not be found by another: small caches grew
//! to twice their budget.

use super::storage::Storage;
use super::{FieldError, files};
use crate::format::container::{ChunkKind, FileKind, Header};
use crate::format::manifest::CacheFigures;
use crate::format::tiles::{Layout, TileMap};
use crate::format::{Fault, names};
use std::collections::{BTreeMap, HashMap, HashSet};
use std::ops::Deref;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// Which section of which direction.
pub type Key = (u32, ChunkKind);

/// Memory for a page of up to `room` bytes; that many of the budget are its.
struct Buffer {
    bytes: Vec<u8>,
    room: u64,
}

/// Memory of pages that were given up, for the next ones.
#[derive(Default)]
pub struct Spare {
    /// By their room.
    buffers: BTreeMap<u64, Vec<Vec<u8>>>,
    /// Room of all.
    bytes: u64,
}

impl Spare {
    fn put(&mut self, Buffer { bytes, room }: Buffer) {
        self.buffers.entry(room).or_default().push(bytes);
        self.bytes += room;
    }

    /// The smallest that has room for so many bytes.
    fn take(&mut self, bytes: u64) -> Option<Buffer> {
        let room = *self.buffers.range(bytes..).next()?.0;
        self.take_of(room)
    }

    /// Frees the largest ones until so many bytes are free or none is left; returns the bytes freed.
    fn free(&mut self, bytes: u64) -> u64 {
        let before = self.bytes;
        while before - self.bytes < bytes {
            let Some(room) = self.buffers.last_key_value().map(|(room, _)| *room) else { break };
            self.take_of(room);
        }
        before - self.bytes
    }

    fn take_of(&mut self, room: u64) -> Option<Buffer> {
        let same = self.buffers.get_mut(&room)?;
        let bytes = same.pop()?;
        if same.is_empty() {
            self.buffers.remove(&room);
        }
        self.bytes -= room;
        Some(Buffer { bytes, room })
    }
}

/// One direction's tile map, checked.
pub struct Page {
    buffer: Buffer,
    layout: Layout,
}

impl Page {
    /// The map.
    pub fn map(&self) -> TileMap<'_> {
        TileMap::new(&self.buffer.bytes, &self.layout)
    }
}

/// What stands for a page in the cache.
enum Slot {
    /// Someone is reading it.
    Reading,
    Ready {
        page: Arc<Page>,
        used: u64,
        holders: u32,
        /// Read ahead, and not asked for yet.
        fresh: bool,
    },
}

#[derive(Default)]
struct State {
    slots: HashMap<Key, Slot>,
    /// Pages that nobody holds, by the time of their last use; fresh ones apart.
    idle: BTreeMap<u64, Key>,
    idle_fresh: BTreeMap<u64, Key>,
    clock: u64,
    /// Of all pages, and of the memory that is kept for the next ones.
    bytes: u64,
    spare: Spare,
    given_up: HashSet<Key>,
    figures: CacheFigures,
}

/// The pages of one generation.
pub struct Pages {
    storage: Arc<dyn Storage>,
    header: Header,
    folder: String,
    budget: u64,
    /// The largest page that can be had by all who may want two at once.
    largest: u64,
    state: Mutex<State>,
    changed: Condvar,
}

/// A page that its holder may look at; nobody gives it up meanwhile.
pub struct Held<'a> {
    // Dropped in this order: when the hold is let go, the cache alone has the page.
    page: Arc<Page>,
    _hold: Hold<'a>,
}

/// Keeps a page from being given up.
struct Hold<'a> {
    pages: &'a Pages,
    key: Key,
}

impl Deref for Held<'_> {
    type Target = Page;

    fn deref(&self) -> &Page {
        &self.page
    }
}

impl Drop for Hold<'_> {
    fn drop(&mut self) {
        self.pages.release(self.key);
    }
}

impl State {
    /// Takes the page used longest ago out, if any is idle; fresh ones only when told so.
    fn give_one_up(&mut self, fresh_too: bool) -> bool {
        let used = self.idle.pop_first();
        let gone = used.or_else(|| fresh_too.then(|| self.idle_fresh.pop_first()).flatten());
        let Some((_, key)) = gone else { return false };
        self.forget(key);
        self.figures.evictions += 1;
        self.given_up.insert(key);
        true
    }

    /// Takes a page that nobody holds out and keeps its memory.
    fn forget(&mut self, key: Key) {
        if let Some(Slot::Ready { page, .. }) = self.slots.remove(&key)
            && let Some(page) = Arc::into_inner(page)
        {
            self.spare.put(page.buffer);
        }
    }

    /// Memory for a page out of the spare, or new if a budget has room for it. Spare memory that is too
    /// small makes way for new.
    fn room(&mut self, bytes: u64, budget: u64) -> Option<Buffer> {
        let mut buffer = self.spare.take(bytes);
        if buffer.is_none() {
            self.bytes -= self.spare.free(bytes);
            if self.bytes + bytes <= budget {
                self.bytes += bytes;
                buffer = Some(Buffer { bytes: Vec::new(), room: bytes });
            }
        }
        self.figures.peak = self.figures.peak.max(self.bytes);
        buffer
    }

    fn tick(&mut self) -> u64 {
        self.clock += 1;
        self.clock
    }
}

impl Pages {
    /// A cache over the tile files of a generation that holds at most `budget` bytes of them for so many
    /// threads. `header` is that of the generation's files.
    pub fn new(storage: Arc<dyn Storage>, header: Header, budget: u64, threads: usize) -> Pages {
        let folder = names::generation(header.generation);
        // A thread holds one page while it reads another.
        let largest = budget / (2 * threads.max(1) as u64);
        let (state, changed) = (Mutex::default(), Condvar::new());
        Pages { storage, header, folder, budget, largest, state, changed }
    }

    /// The same with memory of the cache before it.
    pub fn reusing(mut self, mut spare: Spare) -> Pages {
        spare.free(spare.bytes.saturating_sub(self.budget));
        let state = self.state.get_mut().unwrap_or_else(PoisonError::into_inner);
        (state.bytes, state.spare) = (spare.bytes, spare);
        self
    }

    /// Gives all pages up; returns their memory.
    pub fn into_spare(self) -> Spare {
        let mut state = self.state.into_inner().unwrap_or_else(PoisonError::into_inner);
        let keys: Vec<Key> = state.slots.keys().copied().collect();
        keys.into_iter().for_each(|key| state.forget(key));
        state.spare
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait<'a>(&self, state: MutexGuard<'a, State>) -> MutexGuard<'a, State> {
        self.changed.wait(state).unwrap_or_else(PoisonError::into_inner)
    }

    /// A section of a direction, from memory or from its file. A thread may hold one page while it
    /// asks for another, not more.
    ///
    /// # Errors
    /// When the file is missing or damaged, or its section larger than the budget allows.
    pub fn get(&self, direction: u32, kind: ChunkKind) -> Result<Held<'_>, FieldError> {
        let key = (direction, kind);
        let mut began = None;
        let mut state = self.state();
        loop {
            let now = state.tick();
            let state_ = &mut *state;
            match state_.slots.get_mut(&key) {
                Some(Slot::Ready { page, used, holders, fresh }) => {
                    if *holders == 0 {
                        let idle = if *fresh { &mut state_.idle_fresh } else { &mut state_.idle };
                        idle.remove(used);
                    }
                    (*used, *fresh) = (now, false);
                    *holders += 1;
                    let page = page.clone();
                    match began {
                        None => state.figures.hits += 1,
                        Some(_) => count_wait(&mut state.figures, began),
                    }
                    return Ok(Held { page, _hold: Hold { pages: self, key } });
                }
                Some(Slot::Reading) => {
                    began.get_or_insert_with(Instant::now);
                    state = self.wait(state);
                }
                None => break,
            }
        }
        began.get_or_insert_with(Instant::now);
        state.slots.insert(key, Slot::Reading);
        drop(state);
        let page = self.bring(key, true)?;
        let mut state = self.state();
        count_wait(&mut state.figures, began);
        match page {
            Some(page) => Ok(Held { page, _hold: Hold { pages: self, key } }),
            // Never: who may wait gets the page.
            None => Err(self.fault(direction, Fault::Missing(format!("{kind:?}")))),
        }
    }

    /// Reads a section ahead of its use, if there is room that no fresh page takes.
    ///
    /// # Errors
    /// As [`Pages::get`].
    pub fn read_ahead(&self, direction: u32, kind: ChunkKind) -> Result<(), FieldError> {
        let key = (direction, kind);
        let mut state = self.state();
        if state.slots.contains_key(&key) {
            return Ok(());
        }
        state.slots.insert(key, Slot::Reading);
        drop(state);
        self.bring(key, false).map(|_| ())
    }

    /// Reads a page whose slot says so. Who `wants` it gets it and holds it then; others may go without.
    fn bring(&self, key: Key, wants: bool) -> Result<Option<Arc<Page>>, FieldError> {
        let read = self.read(key, wants);
        let mut state = self.state();
        let result = match read {
            Ok(Some(page)) => {
                let (page, used) = (Arc::new(page), state.tick());
                if !wants {
                    state.idle_fresh.insert(used, key);
                }
                let wanted = wants.then(|| page.clone());
                let slot = Slot::Ready { page, used, holders: u32::from(wants), fresh: !wants };
                state.slots.insert(key, slot);
                Ok(wanted)
            }
            other => {
                state.slots.remove(&key);
                other.map(|_| None)
            }
        };
        drop(state);
        self.changed.notify_all();
        result
    }

    fn read(&self, key: Key, may_wait: bool) -> Result<Option<Page>, FieldError> {
        let (direction, kind) = key;
        let name = names::tile_file(&self.folder, direction);
        let header = Header { direction, ..self.header.clone() };
        let mut file = files::open(&*self.storage, &name, FileKind::Tiles)?.belongs(&header)?;
        let entry = file.find(kind, direction)?;
        if entry.raw > self.largest {
            let limit = self.largest;
            let what = "page of unshot radiance (grant the bake more --memory): its length";
            return Err(
                self.fault(direction, Fault::Limit { what, value: entry.raw, limit, flag: None })
            );
        }
        let Some(Buffer { bytes, room }) = self.reserve(entry.raw, may_wait) else {
            return Ok(None);
        };
        let page = file.chunk_into(&entry, bytes).and_then(|bytes| {
            let Header { resolution, tile, surfaces, exponent, .. } = self.header;
            let layout = Layout::check(&bytes, resolution, tile, surfaces, exponent)
                .map_err(|f| f.in_file(file.path.display()))?;
            Ok(Page { buffer: Buffer { bytes, room }, layout })
        });
        let mut state = self.state();
        match &page {
            Ok(_) => {
                state.figures.bytes += entry.raw;
                state.figures.redundant += u64::from(state.given_up.contains(&key));
            }
            Err(_) => state.bytes -= room,
        }
        page.map(Some)
    }

    /// Memory for a page, for which idle ones may be given up. Who may wait does until there is some.
    fn reserve(&self, bytes: u64, may_wait: bool) -> Option<Buffer> {
        let mut state = self.state();
        loop {
            let buffer = state.room(bytes, self.budget);
            if buffer.is_some() {
                return buffer;
            }
            if !state.give_one_up(may_wait) {
                if !may_wait {
                    return None;
                }
                state = self.wait(state);
            }
        }
    }

    fn release(&self, key: Key) {
        let mut state = self.state();
        let state_ = &mut *state;
        if let Some(Slot::Ready { holders, used, .. }) = state_.slots.get_mut(&key) {
            *holders -= 1;
            if *holders == 0 {
                state_.idle.insert(*used, key);
                // What has arrived before is wanted once a cycle.
                if key.1 == ChunkKind::Arrived {
                    state_.idle.remove(used);
                    state_.forget(key);
                }
            }
        }
        drop(state);
        self.changed.notify_all();
    }

    fn fault(&self, direction: u32, fault: Fault) -> FieldError {
        let name = names::tile_file(&self.folder, direction);
        fault.in_file(self.storage.place().join(name).display()).into()
    }

    /// What the cache did since it was last asked.
    pub fn take_figures(&self) -> CacheFigures {
        std::mem::take(&mut self.state().figures)
    }
}

fn count_wait(figures: &mut CacheFigures, began: Option<Instant>) {
    figures.misses += 1;
    figures.wait += began.map_or(0.0, |b| b.elapsed().as_secs_f64());
}

#[cfg(test)]
mod tests;
