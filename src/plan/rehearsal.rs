//! The rehearsal: the same bake with fewer lines, in memory.

use super::Time;
use super::sample::Sample;
use crate::bake::memory::{Extent, Need};
use crate::bake::step::Shared;
use crate::bake::{BakeError, Options, Progress, bake_in};
use crate::directions::Directions;
use crate::field::storage::memory::Memory;
use crate::field::storage::{Input, Lock, LockError, Output, Storage};
use crate::field::{FieldError, files, read_manifest};
use crate::format::container::{ChunkKind, Codec, FileKind, NO_DIRECTION, encode};
use crate::format::manifest::{Manifest, Parameters, Phase};
use crate::format::names;
use crate::format::tiles::{self, DARK, Layout, TileMap};
use crate::ids::{DirectionId, SurfaceId};
use crate::pack::usual_size;
use crate::psf::Psf;
use crate::radiance::Rgb;
use crate::scene::texels;
use crate::textured::Texture;
use std::collections::BTreeMap;
use std::io;
use std::ops::Sub;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// Seconds of a processor that a file of maps takes to be made, written, synced, read and removed, more
/// than in memory; and those of each of its bytes. Measured on ext4; the disk itself is taken to keep up.
const A_FILE: f64 = 2e-4;
const A_BYTE: f64 = 7e-9;

/// Seconds of a processor that a mirror's look into a page takes more when the page has to come from
/// memory, and bytes of pages that its caches hold. The rehearsal's few pages stay in the caches.
const A_LOOK: f64 = 7e-7;
const NEAR: f64 = 6e6;

/// Seconds of a processor that a page takes more to be read again from a file than from memory.
const A_READ: f64 = 1.3e-5;

/// What a rehearsal showed.
pub struct Rehearsal {
    /// Its lines.
    pub lines: u32,
    /// Its last commit record.
    pub manifest: Manifest,
    /// Total texture maps in the end, two values a texel.
    pub total: Vec<Rgb>,
    /// Bytes of the scene's file; of the scene, and with zstd.
    pub scene: (u64, [u64; 2]),
    /// Mean bytes of a direction's maps by generation, the first one's at 0.
    pub generations: Vec<Generation>,
    /// By what compression divides the bytes of total texture maps, of total radiance maps, and of
    /// mirrors' values among them in a usual pack.
    pub ratios: [f64; 3],
    threads: u32,
    marks: Marks,
}

/// Mean bytes of a direction's maps of mirrors in one generation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Generation {
    /// Of its unshot map.
    pub unshot: f64,
    /// Of its map of all that arrived.
    pub arrived: f64,
    /// Of the values in the latter.
    pub values: f64,
}

/// A moment: seconds on the clock and of processors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Moment([f64; 2]);

impl Moment {
    fn now(since: Instant) -> Moment {
        Moment([since.elapsed().as_secs_f64(), processor_seconds().unwrap_or(0.0)])
    }

    fn map(self, f: impl Fn(f64) -> f64) -> Moment {
        Moment(self.0.map(f))
    }

    fn at_least_none(self) -> Moment {
        self.map(|s| s.max(0.0))
    }

    fn and(self, other: Moment) -> Moment {
        Moment([self.0[0] + other.0[0], self.0[1] + other.0[1]])
    }
}

impl Sub for Moment {
    type Output = Moment;

    fn sub(self, other: Moment) -> Moment {
        Moment([self.0[0] - other.0[0], self.0[1] - other.0[1]])
    }
}

/// Seconds of processors that this process has taken, where the system says.
fn processor_seconds() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    // Behind the name, which is in brackets; in hundredths of a second on every common machine.
    let mut ticks = stat.rsplit_once(')')?.1.split_whitespace().skip(11).map(str::parse::<f64>);
    Some((ticks.next()?.ok()? + ticks.next()?.ok()?) / 100.0)
}

#[derive(Default)]
struct Marks {
    begun: Moment,
    /// When a direction was looked along, before the first cycle.
    sweeps: Vec<Moment>,
    /// Of each step, when directions were done.
    reports: BTreeMap<(bool, u32), Vec<Moment>>,
    commits: Vec<Moment>,
    ended: Moment,
}

/// A folder in memory that notes when commits were made and how large the mirrors' maps were.
struct Watched {
    inner: Memory,
    since: Instant,
    seen: Mutex<(Vec<Moment>, Vec<Generation>)>,
}

fn lock<T>(of: &Mutex<T>) -> MutexGuard<'_, T> {
    of.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Watched {
    /// Mean bytes of the maps in a generation's folder.
    fn generation(&self, folder: &str) -> Result<Generation, FieldError> {
        let files = self.inner.list(folder).unwrap_or_default();
        let part = 1.0 / files.len().max(1) as f64;
        let mut mean = Generation::default();
        for file in files {
            let mut file = files::open(&self.inner, &format!("{folder}/{file}"), FileKind::Tiles)?;
            let header = file.directory.header.clone();
            let unshot = file.find(ChunkKind::Unshot, header.direction)?;
            let arrived = file.find(ChunkKind::Arrived, header.direction)?;
            let bytes = file.chunk(&arrived)?;
            let layout = Layout::check(
                &bytes,
                header.resolution,
                header.tile,
                header.surfaces,
                header.exponent,
            )
            .map_err(|f| f.in_file(file.path.display()))?;
            let values = TileMap::new(&bytes, &layout).value_count();
            mean.unshot += unshot.raw as f64 * part;
            mean.arrived += arrived.raw as f64 * part;
            mean.values += 6.0 * values as f64 * part;
        }
        Ok(mean)
    }
}

impl Storage for Watched {
    fn place(&self) -> &Path {
        self.inner.place()
    }

    fn make(&self) -> io::Result<()> {
        self.inner.make()
    }

    fn lock(&self, note: &str) -> Result<Lock, LockError> {
        self.inner.lock(note)
    }

    fn list(&self, folder: &str) -> io::Result<Vec<String>> {
        self.inner.list(folder)
    }

    fn open(&self, name: &str) -> io::Result<Box<dyn Input>> {
        self.inner.open(name)
    }

    fn create(&self, name: &str, reserve: u64) -> io::Result<Box<dyn Output>> {
        self.inner.create(name, reserve)
    }

    fn rename(&self, from: &str, to: &str) -> io::Result<()> {
        self.inner.rename(from, to)?;
        // Only commits give names.
        let now = Moment::now(self.since);
        let mut seen = lock(&self.seen);
        seen.0.push(now);
        let folder = names::generation(seen.1.len() as u32 + 1);
        if self.inner.list(&folder).is_ok_and(|files| !files.is_empty()) {
            let generation = self.generation(&folder).map_err(io::Error::other)?;
            seen.1.push(generation);
        }
        Ok(())
    }

    fn remove(&self, name: &str) -> io::Result<()> {
        self.inner.remove(name)
    }

    fn create_folder(&self, folder: &str) -> io::Result<()> {
        self.inner.create_folder(folder)
    }

    fn remove_folder(&self, folder: &str) -> io::Result<()> {
        self.inner.remove_folder(folder)
    }

    fn sync_file(&self, name: &str) -> io::Result<()> {
        self.inner.sync_file(name)
    }

    fn sync_folder(&self, folder: &str) -> io::Result<()> {
        self.inner.sync_folder(folder)
    }

    fn free(&self) -> Option<u64> {
        self.inner.free()
    }
}

impl Rehearsal {
    /// Bakes with so many lines, and as much less memory for pages than the `pages` of the whole bake.
    ///
    /// # Errors
    /// Of the bake.
    pub fn new(
        shared: &Shared,
        lines: u32,
        pages: u64,
        options: &Options,
    ) -> Result<Rehearsal, BakeError> {
        // Fewer lines are noisier, as their number to the power of -3/2: what ends a cycle's rounds must come as
        // late with them as with all.
        let fewer = f64::from(shared.parameters.directions) / f64::from(lines);
        let target_error = (shared.parameters.target_error * fewer.powf(1.5)).min(1.0);
        let parameters = Parameters {
            directions: lines,
            thinned: 0,
            refined: 1.0,
            target_error,
            ..shared.parameters.clone()
        };
        let threads = options.threads.max(1) as u64;
        let need = {
            let directions = Directions::with_lines(lines);
            let directions = directions.as_ref().unwrap_or(shared.directions);
            let shared = Shared { directions, parameters: &parameters, ..*shared };
            Need::new(&shared, &Extent::probe(&shared), threads)
        };
        let part = f64::from(lines) / f64::from(shared.parameters.directions);
        let held = need.links + (pages as f64 * part) as u64;
        let memory = need.smallest().max(need.fixed[0].max(need.fixed[1]) + held);

        let since = Instant::now();
        let storage = Arc::new(Watched { inner: Memory::default(), since, seen: Mutex::default() });
        let marks = Mutex::new(Marks { begun: Moment::now(since), ..Marks::default() });
        let stop = AtomicBool::new(false);
        let report = |p: &Progress| {
            let now = Moment::now(since);
            let mut marks = lock(&marks);
            let step = (p.phase != Phase::Propagating, p.cycle);
            match p.preparing {
                true => marks.sweeps.push(now),
                false => marks.reports.entry(step).or_default().push(now),
            }
        };
        let rehearsing = Options {
            memory,
            stop: &stop,
            progress: &report,
            order: None,
            commit_every: f64::INFINITY,
            terms: crate::field::Terms { sync: false, ..options.terms },
            force: true,
            ..*options
        };
        bake_in(storage.clone(), shared.scene, &parameters, &rehearsing)?;
        let mut marks = marks.into_inner().unwrap_or_else(PoisonError::into_inner);
        marks.ended = Moment::now(since);
        let generations = {
            let mut seen = lock(&storage.seen);
            marks.commits = std::mem::take(&mut seen.0);
            std::mem::take(&mut seen.1)
        };
        Rehearsal::read(&storage.inner, shared, (generations, marks), threads as u32)
    }

    /// Looks at what was baked.
    fn read(
        storage: &dyn Storage,
        shared: &Shared,
        (generations, marks): (Vec<Generation>, Marks),
        threads: u32,
    ) -> Result<Rehearsal, BakeError> {
        let (_, manifest) = read_manifest(storage)?;
        let lines = manifest.parameters.directions;
        let zstd = |bytes: &[u8]| {
            let encoded =
                encode(Codec::Zstd, bytes).map_err(FieldError::io("encode", storage.place()));
            Ok::<u64, FieldError>(encoded?.len() as u64)
        };
        let chunk = |name: &str, file, kind, direction| {
            files::read_chunk(storage, name, file, (kind, direction))
        };
        let scene = chunk(names::SCENE, FileKind::Scene, ChunkKind::Scene, NO_DIRECTION)?;
        let name = names::textures(manifest.cycle);
        let textures = chunk(&name, FileKind::Textures, ChunkKind::TotalTexture, NO_DIRECTION)?;
        let in_file = |f: crate::format::Fault| FieldError::from(f.in_file(&name));
        let total = texels::from_bytes(&textures, 2 * shared.texels.len()).map_err(in_file)?;
        let Shared { scene: of, texels, exponent, .. } = *shared;
        let texture = Texture { scene: of, texels, total: &total };
        let few = Directions::with_lines(lines);
        let few = few.as_ref().unwrap_or(shared.directions);
        let is_mirror = |id: SurfaceId| of.material_of(id).reflectance.is_mirror();
        let Parameters { resolution, tile, .. } = *shared.parameters;
        let (mut raw, mut packed) = (0, 0);
        // Mirrors' values alone, if there are any, and what they take in a usual pack.
        let (mut values, mut usual) = (0, 0);
        for direction in 0..lines {
            let name = names::tile_file(names::TOTAL, direction);
            let map = chunk(&name, FileKind::Tiles, ChunkKind::Total, direction)?;
            (raw, packed) = (raw + map.len() as u64, packed + zstd(&map)?);
            if !shared.parameters.totals_from_store() {
                continue;
            }
            let psf = Psf::new(few.vector(DirectionId(direction)), resolution);
            let size = |map: &[u8]| {
                let layout =
                    Layout::check(map, resolution, tile, of.surfaces.len() as u32, exponent);
                let layout = layout.map_err(|f| FieldError::from(f.in_file(&name)))?;
                let tiles = TileMap::new(map, &layout);
                let dark = tiles::rewritten(&tiles, is_mirror, |_, _| DARK);
                usual_size(&tiles, (&psf, exponent), &texture, is_mirror).map(|size| (size, dark))
            };
            let ((bytes, count), dark) = size(&map)?;
            let ((tables, _), _) = size(&dark)?;
            (usual, values) = (usual + bytes.saturating_sub(tables), values + 6 * count);
        }
        let ratio = |raw: u64, packed: u64| packed as f64 / raw.max(1) as f64;
        let stored = files::read(storage, names::SCENE)?.len() as u64;
        Ok(Rehearsal {
            lines,
            total,
            scene: (stored, [scene.len() as u64, zstd(&scene)?]),
            generations,
            ratios: [
                ratio(textures.len() as u64, zstd(&textures)?),
                ratio(raw, packed),
                ratio(values, usual),
            ],
            threads,
            marks,
            manifest,
        })
    }

    /// Cycles that it took.
    pub fn cycles(&self) -> u32 {
        self.manifest.cycle
    }

    /// How much work it was: fragments, and pages taken in hand, each of which stands for an excerpt.
    pub fn work(&self) -> u64 {
        let statistics = &self.manifest.statistics;
        statistics.fragments + 20 * (statistics.cache.hits + statistics.cache.misses)
    }

    /// What the steps of the whole bake will take, with so many bytes of pages held.
    pub fn steps(&self, shared: &Shared, sample: &Sample, pages: u64) -> Steps {
        let Marks { begun, sweeps, reports, commits, ended } = &self.marks;
        let lines = f64::from(self.lines);
        let all = f64::from(shared.parameters.directions);
        let mut steps = Steps { processor: processor_seconds().is_some(), ..Steps::default() };
        let mut before = *begun;
        for (k, ((totals, cycle), reports)) in reports.iter().enumerate() {
            let (Some(first), Some(last)) = (reports.first(), reports.last()) else { continue };
            // The axes take too large a part of few lines; perturbed ones are away from them.
            let grids = self.manifest.grids.get(*cycle as usize).copied().unwrap_or(1);
            let thinned = shared.parameters.grids(*cycle).thinned;
            let (turned, part) = match totals {
                true => (0.0, 1.0),
                false => (f64::from(grids.max(1) - 1), 0.25f64.powi(thinned as i32)),
            };
            let fragments = (turned + sample.fragments) / (turned + 1.0);
            let direction = self.direction(reports);
            let rounds = (reports.len() as f64 / lines).max(1.0);
            let begun = direction.map(|s| s * f64::from(self.threads));
            let preparing = (*first - before - begun).at_least_none();
            // The first commit is that of the empty field.
            let end = if *totals { *ended } else { commits.get(k + 1).copied().unwrap_or(*last) };
            let rest = (end - *last).at_least_none();
            let step = direction
                .map(|s| s * all * rounds * part * fragments)
                .and(self.files((k, *totals), sample, all))
                .and(rest);
            if k == 0 {
                let sweeps = sweeps.chunks(self.lines as usize).map(|s| self.direction(s));
                let sweeps = sweeps.fold(Moment::default(), Moment::and);
                let fixed = (preparing - sweeps.map(|s| s * lines)).at_least_none();
                steps.beginning = fixed.and(sweeps.map(|s| s * all * sample.fragments));
                steps.steps.push(step);
            } else {
                let looks = if *totals { Moment::default() } else { self.looks(all, pages) };
                steps.steps.push(preparing.and(step).and(looks));
            }
            before = end;
        }
        steps
    }

    /// What a direction takes, from when each was done.
    fn direction(&self, done: &[Moment]) -> Moment {
        let (Some(first), Some(last)) = (done.first(), done.last()) else {
            return Moment::default();
        };
        // The first directions of all threads come at once.
        let between = done.len().saturating_sub(self.threads as usize).max(1);
        (*last - *first).map(|s| s / between as f64)
    }

    /// What the mirrors' looks into pages take in a cycle more than in the rehearsal, which had as much
    /// less room for pages as it had less of them.
    fn looks(&self, directions: f64, pages: u64) -> Moment {
        let cache = &self.manifest.statistics.cache;
        let cycles = f64::from(self.manifest.cycle.max(2) - 1);
        let of_all = |count: u64| count as f64 / cycles * directions / f64::from(self.lines);
        let (looks, reads) = (of_all(cache.hits + cache.misses), of_all(cache.redundant));
        let far = |pages: f64| 1.0 - (NEAR / pages.max(1.0)).min(1.0);
        let farther = (far(pages as f64) - far(cache.peak as f64)).max(0.0);
        let processor = looks * A_LOOK * farther + reads * A_READ;
        Moment([processor / f64::from(self.threads), processor])
    }

    /// What a step's files take on a disk more than in memory.
    fn files(&self, (step, totals): (usize, bool), sample: &Sample, directions: f64) -> Moment {
        let maps = sample.generations.get(step).map(|g| g.unshot + g.arrived);
        let bytes = if totals { Some(sample.file) } else { maps };
        let processor = bytes.map_or(0.0, |bytes| directions * (A_FILE + A_BYTE * bytes));
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        Moment([processor / cores as f64, processor])
    }
}

/// Seconds of a bake's steps.
#[derive(Default)]
pub struct Steps {
    beginning: Moment,
    /// The cycles, then the total maps.
    steps: Vec<Moment>,
    processor: bool,
}

impl Steps {
    /// Steps of so many seconds.
    #[cfg(test)]
    pub fn of(seconds: &[f64]) -> Steps {
        let steps = seconds.iter().map(|s| Moment([*s, 0.0])).collect();
        Steps { steps, ..Steps::default() }
    }

    /// Seconds of each cycle, and at last of the total maps.
    pub fn seconds(&self) -> impl Iterator<Item = f64> {
        self.steps.iter().map(|s| s.0[0])
    }

    /// Seconds in all.
    pub fn time(&self, threads: u32) -> Time {
        let sum = |steps: &[Moment]| steps.iter().fold(Moment::default(), |sum, s| sum.and(*s));
        let totals = self.steps.last().copied().unwrap_or_default();
        let cycles = sum(&self.steps[..self.steps.len().saturating_sub(1)]);
        let all = self.beginning.and(cycles).and(totals);
        Time {
            threads,
            seconds: all.0[0],
            beginning: self.beginning.0[0],
            cycles: cycles.0[0],
            totals: totals.0[0],
            processor: self.processor.then_some(all.0[1]),
        }
    }
}
