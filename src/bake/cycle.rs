//! The loops: cycles over directions, and what is committed between them.
//!
//! A step reads generation c and writes generation c + 1; sums over directions are whole numbers. So
//! the state of a bake is the committed generation, the sums so far and the set of directions they
//! hold, and any interruption costs at most the time since the last commit.

mod progress;

mod rounds;

mod sums;

pub mod supplied;

use super::ahead::{Wanted, ahead};
use super::estimate::{Errors, Totals, by_surface, estimate};
use super::layers::Outlines;
use super::ledger::{Tally, Units, account, channels, received, texture_power};
use super::links::Kept;
use super::marks::Marks;
use super::memory::Need;
use super::profile::{Profile, Stage};
use super::reach;
use super::step::{Again, Cycle, Few, Made, Scratch, Shared, shoot};
use super::totals::{self, Mirrors};
use super::transfer::{self, Current, FROM_OUTSIDE, Fixed, Quantum, Shot};
use super::{BakeError, LEDGER_TOLERANCE, MOST_CYCLES, Options, Outcome, count_run};
use crate::directions::Directions;
use crate::field::pages::{Pages, Spare};
use crate::field::writer::{self, Maps};
use crate::field::{Field, FieldError};
use crate::format::container::{ChunkKind, FileKind, NO_DIRECTION};
use crate::format::manifest::{CycleLedger, Grids, Parameters, Phase};
use crate::format::names;
use crate::ids::{DirectionId, SurfaceId};
use crate::paths::{MAX_DEPTH, Paths};
use crate::radiance::Rgb;
use crate::scene::Scene;
use crate::scene::areas::areas;
use crate::scene::reflectances::Reflectances;
use crate::scene::texels::Texels;
use crate::visible::Visible;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;
use supplied::Supplied;

/// A bake under way.
pub struct Bake<'a> {
    scene: &'a Scene,
    texels: &'a Texels,
    directions: &'a Directions,
    outlines: Outlines,
    areas: Vec<f32>,
    reflectances: Reflectances,
    parameters: Parameters,
    field: Field,
    quantum: Quantum,
    need: Need,
    options: &'a Options<'a>,
    pool: rayon::ThreadPool,
    committed: Instant,
    counted: Instant,
    marks: Marks,
    /// Memory of the page cache, between cycles.
    spare: Spare,
    /// What paths through mirrors meet, where any are followed.
    visible: Option<Visible>,
    /// Surfaces that have lines enough in the cycle under way.
    supplied: Supplied,
    /// The part of all texels that are not theirs.
    lacking: f64,
    /// PSFs that this run has rasterised in the steps that it has ended, or what takes as long.
    work: f64,
    /// Directions of the step under way that an earlier run did.
    done_before: u32,
    /// What PSFs exchanged in the cycles so far.
    kept: Kept,
    /// The first cycle whose PSFs' links this run may have kept.
    known_from: u32,
    /// Where the time of this run went, but for the walk under way.
    profile: Profile,
}

/// Senders are few when they have less than this part of all area.
const FEW: f64 = 0.25;

/// Of what must be free on a disk, how many times as much is plenty.
const PLENTY: u64 = 64;

/// Milliseconds for which a disk with plenty of room is not asked again.
const PAUSE: u64 = 20;

/// What the lines of a cycle have brought.
struct Brought {
    /// Next Texture Maps, of all lines.
    next: Vec<Rgb>,
    /// The same of half of them.
    half: Vec<Rgb>,
    /// Area of each value that looks at anything, in the fitted scene's units squared.
    open: Vec<f64>,
}

/// What ended a loop over directions.
enum Walk {
    Done,
    Stopped,
}

impl<'a> Bake<'a> {
    /// Takes up a field that is not finished. `most` is the brightest emitted radiance.
    ///
    /// # Errors
    /// When threads cannot be started.
    pub fn new(
        scene: &'a Scene,
        texels: &'a Texels,
        directions: &'a Directions,
        field: Field,
        (most, need): (f32, Need),
        options: &'a Options<'a>,
    ) -> Result<Bake<'a>, BakeError> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(options.threads.max(1))
            .build()
            .map_err(|e| BakeError::Parameter(format!("--threads: {e}")))?;
        let has_mirrors = scene.materials.iter().any(|m| m.reflectance.is_mirror());
        let follows = has_mirrors && !field.manifest().parameters.totals_from_store();
        let outlines = pool.install(|| Outlines::new(scene, texels));
        let mut bake = Bake {
            visible: follows.then(|| Visible::new(scene)),
            scene,
            texels,
            directions,
            areas: pool.install(|| home_areas(scene, texels, &outlines)),
            reflectances: pool.install(|| Reflectances::new(scene, texels)),
            outlines,
            parameters: field.manifest().parameters.clone(),
            field,
            quantum: Quantum::new(most),
            need,
            options,
            pool,
            committed: Instant::now(),
            counted: Instant::now(),
            marks: Marks::default(),
            spare: Spare::default(),
            supplied: Supplied::default(),
            lacking: 1.0,
            work: 0.0,
            done_before: 0,
            kept: Kept::new(need.spare(options.memory)),
            known_from: 0,
            profile: Profile::default(),
        };
        let sync = options.terms.sync.then_some(options.commit_every);
        bake.field.manifest_mut().statistics.sync = sync;
        bake.known_from = match bake.shared().is_linked() && bake.kept.has_room() {
            true => bake.field.manifest().cycle + 1,
            false => u32::MAX,
        };
        bake.marks = bake.reach();
        bake.end_step(progress::PREPARING);
        Ok(bake)
    }

    /// The texture values that no light can come to.
    fn reach(&self) -> Marks {
        let lines: Vec<DirectionId> = self.directions.ids().collect();
        let looks = AtomicUsize::new(0);
        let looked = || {
            let looks = looks.fetch_add(1, Ordering::Relaxed) + 1;
            self.report(true, looks as u32);
            !self.options.stop.load(Ordering::Relaxed)
        };
        self.pool.install(|| reach::marks(&self.shared(), &lines, looked))
    }

    /// Runs to the end, or until asked to stop.
    ///
    /// # Errors
    /// Of any step; what was committed stays.
    pub fn run(mut self, started: Instant) -> Result<Outcome, BakeError> {
        self.counted = started;
        // What is known of sealed values may be half of it then.
        if self.options.stop.load(Ordering::Relaxed) {
            return Ok(Outcome::Stopped);
        }
        while self.field.manifest().phase == Phase::Propagating {
            if let Walk::Stopped = self.cycle()? {
                return Ok(Outcome::Stopped);
            }
        }
        self.kept = Kept::new(0);
        if let Walk::Stopped = self.totals()? {
            return Ok(Outcome::Stopped);
        }
        Ok(Outcome::Finished)
    }

    /// Sends light on, and nothing else: what is wrong with each surface then; `None` when asked to stop.
    ///
    /// # Errors
    /// Of any step.
    pub fn errors(mut self) -> Result<Option<Vec<Errors>>, BakeError> {
        while self.field.manifest().phase == Phase::Propagating {
            // Asked first, since what is known of sealed values may be half of it then.
            if self.options.stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            if let Walk::Stopped = self.cycle()? {
                return Ok(None);
            }
        }
        let total = self.texture(ChunkKind::TotalTexture)?;
        let half = self.texture(ChunkKind::HalfTexture)?;
        let areas: Vec<f64> = self.areas.iter().flat_map(|a| [f64::from(*a); 2]).collect();
        let maps = Totals { all: &total, half: &half };
        let by_surface = || by_surface(self.scene, self.texels, &areas, maps);
        Ok(Some(self.pool.install(by_surface)))
    }

    fn shared(&self) -> Shared<'_> {
        Shared {
            scene: self.scene,
            texels: self.texels,
            outlines: &self.outlines,
            directions: self.directions,
            parameters: &self.parameters,
            quantum: self.quantum,
            exponent: self.field.header_of(FileKind::Tiles, (0, 0)).exponent,
        }
    }

    /// A texture map that the cycle under way shoots from, or adds to.
    fn texture(&self, kind: ChunkKind) -> Result<Vec<Rgb>, FieldError> {
        match self.field.manifest().cycle {
            0 => Ok(super::emission(self.scene, self.texels)),
            cycle => self.field.read_texture(cycle, kind, 2 * self.texels.len()),
        }
    }

    fn pages(&self, phase: Phase) -> Pages {
        let cycle = self.field.manifest().cycle;
        let header = self.field.header_of(FileKind::Tiles, (cycle, NO_DIRECTION));
        let fixed = self.need.fixed[usize::from(phase != Phase::Propagating)];
        let budget = self.options.memory.saturating_sub(fixed);
        Pages::new(self.field.shared_storage(), header, budget, self.options.threads)
    }

    /// Goes on with the cycle under way, to its end and commit.
    fn cycle(&mut self) -> Result<Walk, BakeError> {
        let cycle = self.field.manifest().cycle;
        let shots: Vec<Shot> = {
            let shot = self.texture(ChunkKind::CurrentTexture)?;
            let shot = shot.into_iter().map(transfer::shot);
            shot.chain([FROM_OUTSIDE]).collect()
        };
        let mut tally = Tally::default();
        // The first worker's sums are the bake's own; the others' are added to them.
        let workers: Vec<Mutex<Scratch>> =
            self.pool.broadcast(|_| Mutex::new(Scratch::new(self.texels)));
        if self.field.manifest().has_sums {
            (tally, self.supplied) = self.read_sums(&mut lock(&workers[0]).sums)?;
        }
        self.field.manifest_mut().grids.resize(cycle as usize + 1, 0);
        let stores_mirrors = self.shared().stores_mirrors();
        let folder = names::generation(cycle + 1);
        if stores_mirrors && !self.all_done() {
            self.field.begin_folder(&folder)?;
        }
        let spare = std::mem::take(&mut self.spare);
        let pages =
            (stores_mirrors && cycle > 0).then(|| self.pages(Phase::Propagating).reusing(spare));
        let senders = self.few_senders(cycle);
        let lamps = senders.as_ref().and_then(|senders| self.only(senders));
        self.begin_step();
        while !self.is_over(&workers[0], senders.is_some())? {
            let lacking = self.supplied.lacking();
            self.lacking = self.supplied.lacking_part(self.texels);
            let shared = self.shared();
            let what = Cycle {
                number: cycle,
                current: Current { shots: &shots, quantum: self.quantum },
                pages: pages.as_ref(),
                paths: self.paths().filter(|_| !stores_mirrors),
                grids: self.round(cycle),
                thinned: self.parameters.grids(cycle).thinned,
                few: senders
                    .as_deref()
                    .map(|senders| Few { senders, paths: self.paths_in(lamps.as_ref()) }),
                lacking: lacking.as_deref(),
                kept: Some(Again { links: &self.kept, next: self.next_grids(cycle) }),
                marks: &self.marks,
            };
            let wanted =
                Wanted { pages: what.pages, gathers: true, shared: &shared, marks: &self.marks };
            let place = (folder.as_str(), cycle + 1);
            let (done, walk) = self.walk(place, &wanted, |direction, worker| {
                let mut scratch = lock(&workers[worker]);
                let made = shoot(&shared, &what, DirectionId(direction), &mut scratch)?;
                let maps = |made: Made| {
                    vec![(ChunkKind::Unshot, made.unshot), (ChunkKind::Arrived, made.arrived)]
                };
                Ok(made.map(maps).unwrap_or_default())
            })?;
            let partial = lacking.is_some();
            gather_sums(&workers, if partial { &mut self.supplied.partial } else { &mut tally });
            self.supplied.restore(self.texels, &mut lock(&workers[0]).sums);
            workers.iter().for_each(|worker| self.profile.add(&lock(worker).watch.take()));
            done.iter().for_each(|d| self.field.manifest_mut().mark_done(*d));
            self.count_pages(pages.as_ref());
            if !self.all_done() {
                self.checkpoint(&lock(&workers[0]).sums, &tally)?;
            }
            if let Walk::Stopped = walk {
                return Ok(Walk::Stopped);
            }
        }
        drop(shots);
        self.spare = pages.map(Pages::into_spare).unwrap_or_default();
        self.end_step(self.work_of(cycle, self.round(cycle)));
        let sums = workers
            .into_iter()
            .next()
            .map(|w| w.into_inner().unwrap_or_else(PoisonError::into_inner));
        let mut sums = sums.map(|s| s.sums).unwrap_or_default();
        sums.iter_mut().for_each(|half| half.truncate(2 * self.texels.len()));
        let began = Instant::now();
        self.end_cycle(cycle, &mut sums, &tally, senders.is_some())?;
        (self.supplied, self.lacking) = (Supplied::default(), 1.0);
        self.profile.spend(Stage::Textures, began.elapsed().as_secs_f64());
        Ok(Walk::Done)
    }

    /// The PSFs of the cycle after one, if there may be one.
    fn next_grids(&self, cycle: u32) -> Option<Grids> {
        let next = cycle + 1;
        let is_last = self.parameters.cycles.is_some_and(|cycles| next >= cycles);
        (!is_last).then(|| self.parameters.grids(next))
    }

    /// Counts what the page cache did into the field's figures.
    fn count_pages(&mut self, pages: Option<&Pages>) {
        if let Some(pages) = pages {
            self.field.manifest_mut().statistics.cache.add(&pages.take_figures());
        }
    }

    /// The paths through mirrors, where any are followed.
    fn paths(&self) -> Option<Paths<'_>> {
        self.paths_in(self.visible.as_ref())
    }

    fn paths_in<'b>(&'b self, visible: Option<&'b Visible>) -> Option<Paths<'b>> {
        Some(Paths { scene: self.scene, visible: visible?, max_depth: MAX_DEPTH })
    }

    /// The surfaces that send in a cycle, if they are few: emitters in the first one, and mirrors that
    /// send on what they show.
    fn few_senders(&self, cycle: u32) -> Option<Vec<bool>> {
        if cycle > 0 || self.parameters.grids(cycle).perturbations == 1 {
            return None;
        }
        let relays = !self.parameters.stores_mirrors();
        let sends = |id| {
            let material = self.scene.material_of(id);
            !material.emitted.is_black() || (relays && material.reflectance.is_mirror())
        };
        let senders: Vec<bool> = self.scene.surface_ids().map(sends).collect();
        let area = |only: bool| {
            let surfaces = self.scene.surfaces.iter().zip(&senders);
            surfaces.filter(|(_, s)| **s || !only).map(|(s, _)| f64::from(s.area())).sum::<f64>()
        };
        (area(true) < FEW * area(false)).then_some(senders)
    }

    /// What paths through mirrors meet of few senders, where any are followed.
    fn only(&self, senders: &[bool]) -> Option<Visible> {
        let follows = self.visible.is_some() && !self.parameters.stores_mirrors();
        follows.then(|| Visible::of(self.scene, |id| senders[id.index()]))
    }

    fn all_done(&self) -> bool {
        self.field.manifest().done_count() == self.parameters.directions
    }

    /// Takes directions that are not done until all are, the commit is due, or a stop is asked for; the
    /// maps that steps make are written to the folder of a generation. Returns those that were done.
    /// None is begun that the disk has no room for, with those under way and a commit of them all.
    fn walk(
        &self,
        place: (&str, u32),
        wanted: &Wanted,
        step: impl Fn(u32, usize) -> Result<Maps, FieldError> + Sync,
    ) -> Result<(Vec<u32>, Walk), FieldError> {
        let manifest = self.field.manifest();
        let needed = self.need.room[usize::from(manifest.phase != Phase::Propagating)];
        let (began, asked_again) = (Instant::now(), AtomicU64::new(0));
        let room = || -> Result<(), FieldError> {
            let now = began.elapsed().as_millis() as u64;
            if now >= asked_again.load(Ordering::Relaxed) {
                let free = self.field.check_room(needed)?;
                let pause = if free / PLENTY > needed { PAUSE } else { 0 };
                asked_again.store(now + pause, Ordering::Relaxed);
            }
            Ok(())
        };
        room()?;
        let curve = || self.directions.curve().iter().map(|id| id.0).collect();
        let order = self.options.order.clone().unwrap_or_else(curve);
        let todo: Vec<u32> = order.into_iter().filter(|d| !manifest.is_done(*d)).collect();
        let stop = || self.options.stop.load(Ordering::Relaxed);
        let due = || self.committed.elapsed().as_secs_f64() > self.options.commit_every;
        let (failed, done) = (AtomicBool::new(false), Mutex::new(Vec::new()));
        let enough = || {
            let some = !lock(&done).is_empty();
            stop() || failed.load(Ordering::Relaxed) || room().is_err() || (some && due())
        };
        writer::behind(&self.field, place, |queue| {
            ahead(wanted, &todo, self.options.threads, enough, |directions| {
                let results = self.pool.broadcast(|context| {
                    for direction in directions {
                        if stop() || failed.load(Ordering::Relaxed) || room().is_err() {
                            continue;
                        }
                        let maps = step(direction, context.index());
                        let put = |maps: Maps| match maps.is_empty() {
                            true => Ok(()),
                            false => queue.put(direction, maps),
                        };
                        if let Err(error) = maps.and_then(put) {
                            failed.store(true, Ordering::Relaxed);
                            return Err(error);
                        }
                        let count = {
                            let mut done = lock(&done);
                            done.push(direction);
                            done.len() as u32
                        };
                        self.report(false, manifest.done_count() + count);
                    }
                    Ok(())
                });
                results.into_iter().collect::<Result<(), FieldError>>()
            })
        })?;
        let done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
        Ok((done, if stop() { Walk::Stopped } else { Walk::Done }))
    }

    /// Adds the time since the last call to the field's own.
    fn count_seconds(&mut self) {
        let seconds = self.counted.elapsed().as_secs_f64();
        self.counted = Instant::now();
        self.field.manifest_mut().statistics.seconds += seconds;
    }

    /// Makes the next generation's texture maps, closes the ledger and commits.
    fn end_cycle(
        &mut self,
        cycle: u32,
        sums: &mut [Vec<Fixed>; 2],
        tally: &Tally,
        few_send: bool,
    ) -> Result<(), BakeError> {
        let grids = self.round(cycle).end;
        let [half, sums] = sums;
        add_sums(sums, half, 1);
        let units = Units {
            quantum: self.quantum,
            share: self.share(self.parameters.grids(cycle).thinned),
            cell: self.ray() * self.scene.fit.radius.powi(2),
            perturbations: grids,
            relays: !self.parameters.stores_mirrors(),
        };
        let raw = light(sums);
        let [half, sums] = self.levelled([half, sums], grids, few_send);
        let tally = &self.supplied.tally(tally, grids, (raw, light(&sums)));
        // Later cycles' light comes from all around: more of the filter would blur what shadows it has.
        let most = if cycle == 0 { self.parameters.filter } else { self.least_filter() };
        let brought = self.brought([&half, &sums], grids, few_send, most);
        let is_odd = |v: &Rgb| !v.is_physical();
        if let Some(at) = brought.next.iter().position(is_odd) {
            let surface = self.texels.surface_of[at / 2];
            return Err(BakeError::Radiance { cycle, surface });
        }

        let scale = self.scene.fit.radius.powi(2);
        let diffuse_out = scale * texture_power(&brought.next, &brought.open);
        let one_sided = self.parameters.one_sided;
        let received = received(&sums, |value| {
            let back = value % 2 == 1;
            let (texel, surface) = (value / 2, SurfaceId(self.texels.surface_of[value / 2]));
            let first = self.texels.lattices[surface.index()].first as usize;
            let is_dark = back && one_sided;
            if is_dark { Rgb::BLACK } else { self.reflectances.at(surface, texel - first) }
        });
        let (diffuse_in, mirror_in) = match self.field.manifest().ledger.last() {
            Some(before) => (before.unshot_diffuse, before.unshot_mirror),
            None => emitted_power(self.scene, scale),
        };
        let powers = (diffuse_in, mirror_in, diffuse_out);
        let ledger = account(cycle, &units, tally, &received, powers);
        if ledger.residual().abs() > LEDGER_TOLERANCE {
            return Err(BakeError::Ledger { cycle, residual: ledger.residual() });
        }

        let (total, half) = self.totals_with(&brought)?;
        let error = estimate(&self.errors_of(&brought.open, &total, &half));
        self.field.write_textures(cycle + 1, &total, &brought.next, &half)?;
        self.count_seconds();
        let manifest = self.field.manifest_mut();
        manifest.ledger.push(ledger);
        manifest.grids[cycle as usize] = grids;
        manifest.error = error;
        count_run(&mut manifest.statistics, tally);
        manifest.cycle = cycle + 1;
        manifest.done.fill(0);
        manifest.has_sums = false;
        let unshot = unshot_fractions(&manifest.ledger).last().copied().unwrap_or(0.0);
        let enough = match self.parameters.cycles {
            Some(cycles) => cycle + 1 >= cycles,
            None => unshot < self.parameters.unshot_fraction || cycle + 1 >= MOST_CYCLES,
        };
        if enough {
            manifest.phase = Phase::WritingTotals;
        }
        self.field.commit()?;
        self.committed = Instant::now();
        Ok(())
    }

    /// Writes the total radiance maps, then ends the bake.
    fn totals(&mut self) -> Result<Walk, BakeError> {
        self.spare = Spare::default();
        let total = self.texture(ChunkKind::TotalTexture)?;
        let lit = totals::lit_sides(self.texels, &total);
        let cycle = self.field.manifest().cycle;
        if !self.all_done() {
            self.field.begin_folder(names::TOTAL)?;
        }
        let workers: Vec<Mutex<totals::Scratch>> =
            (0..self.options.threads.max(1)).map(|_| Mutex::default()).collect();
        let stored = self.shared().has_mirrors() && self.parameters.totals_from_store();
        let pages = stored.then(|| self.pages(Phase::WritingTotals));
        self.begin_step();
        while !self.all_done() {
            let shared = self.shared();
            let wanted = Wanted {
                pages: pages.as_ref(),
                gathers: false,
                shared: &shared,
                marks: &self.marks,
            };
            let place = (names::TOTAL, cycle);
            let (done, walk) = self.walk(place, &wanted, |direction, worker| {
                let mut scratch = lock(&workers[worker]);
                let arrived = match &pages {
                    Some(pages) => Some(pages.get(direction, ChunkKind::Arrived)?),
                    None => None,
                };
                let mirrors = match (&arrived, self.paths()) {
                    (Some(page), _) => Mirrors::Stored(page),
                    (None, Some(paths)) => Mirrors::Traced(paths),
                    (None, None) => Mirrors::None,
                };
                let maps = (total.as_slice(), lit.as_slice());
                let id = DirectionId(direction);
                let bytes =
                    totals::total_map(&shared, id, maps, (mirrors, &self.marks), &mut scratch);
                Ok(vec![(ChunkKind::Total, bytes)])
            })?;
            done.iter().for_each(|d| self.field.manifest_mut().mark_done(*d));
            // With the directions they belong to, so that a resumed bake counts none twice and misses none.
            for worker in &workers {
                let mut scratch = lock(worker);
                let statistics = &mut self.field.manifest_mut().statistics;
                statistics.fragments += std::mem::take(&mut scratch.fragments);
                statistics.entries += std::mem::take(&mut scratch.entries);
                self.profile.add(&scratch.watch.take());
            }
            self.count_pages(pages.as_ref());
            self.count_seconds();
            self.field.commit()?;
            self.committed = Instant::now();
            if let Walk::Stopped = walk {
                return Ok(Walk::Stopped);
            }
        }
        let digest = self.field.digest()?;
        self.count_seconds();
        let manifest = self.field.manifest_mut();
        manifest.phase = Phase::Finished;
        manifest.digest = digest;
        // Once for the field, and once more so that no commit needs the unshot maps.
        self.field.commit()?;
        self.field.commit()?;
        self.report(false, self.parameters.directions);
        Ok(Walk::Done)
    }
}

/// Area of each texel, with the pieces of others that belong to it, in the fitted scene's units squared.
fn home_areas(scene: &Scene, texels: &Texels, outlines: &Outlines) -> Vec<f32> {
    let mut areas = areas(scene, texels);
    outlines.homes.move_areas(texels, &mut areas);
    areas
}

/// Unshot power after each cycle as a fraction of what the scene emits.
fn unshot_fractions(ledger: &[CycleLedger]) -> Vec<f64> {
    let emitted = ledger.first().map_or(0.0, |l| l.emitted);
    let fraction = |l: &CycleLedger| if emitted > 0.0 { l.unshot() / emitted } else { 0.0 };
    ledger.iter().map(fraction).collect()
}

/// Power that diffuse surfaces and mirrors emit, W: `pi` times radiance times area, front sides only.
fn emitted_power(scene: &Scene, scale: f64) -> (f64, f64) {
    let (mut diffuse, mut mirrors) = (0.0, 0.0);
    for id in scene.surface_ids() {
        let material = scene.material_of(id);
        let area = f64::from(scene.surface(id).area()) * scale;
        let power = std::f64::consts::PI * f64::from(material.emitted.mean()) * area;
        *(if material.reflectance.is_mirror() { &mut mirrors } else { &mut diffuse }) += power;
    }
    (diffuse, mirrors)
}

fn lock<T>(worker: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    worker.lock().unwrap_or_else(PoisonError::into_inner)
}

/// All light of some sums.
fn light(sums: &[Fixed]) -> i128 {
    sums.iter().map(|sum| i128::from(channels(sum))).sum()
}

/// Adds some sums to others, `times` over.
fn add_sums(to: &mut [Fixed], sums: &[Fixed], times: i64) {
    for (to, own) in to.iter_mut().zip(sums) {
        (0..4).for_each(|k| to[k] += times * own[k]);
    }
}

/// Adds the workers' sums to the first's, empties them, and adds their tallies.
fn gather_sums(workers: &[Mutex<Scratch>], tally: &mut Tally) {
    let Some((first, others)) = workers.split_first() else { return };
    let mut first = lock(first);
    for other in others {
        let mut other = lock(other);
        let totals = first.sums.iter_mut().flatten();
        for (total, own) in totals.zip(other.sums.iter_mut().flatten()) {
            for (t, o) in total.iter_mut().zip(own.iter_mut()) {
                *t += std::mem::take(o);
            }
        }
        tally.add(&std::mem::take(&mut other.tally));
    }
    tally.add(&std::mem::take(&mut first.tally));
}
