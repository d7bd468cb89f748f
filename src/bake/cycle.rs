//! The loops: cycles over directions, and what is committed between them.
//!
//! A step reads generation c and writes generation c + 1; sums over directions are whole numbers. So
//! the state of a bake is the committed generation, the sums so far and the set of directions they
//! hold, and any interruption costs at most the time since the last commit.

use super::cuts::cut_texels;
use super::layers::{Layers, Outlines};
use super::ledger::{Tally, Units, account, open_areas, received, texture_power};
use super::reach::{CutViews, Reach, Sealed};
use super::step::{Cycle, FROM_OUTSIDE, Made, Scratch, Shared, shoot};
use super::totals;
use super::transfer::diffuse::{diffuse_factor, next_textures};
use super::transfer::{Fixed, Quantum};
use super::{BakeError, LEDGER_TOLERANCE, MOST_CYCLES, Options, Outcome, Progress, count_run};
use crate::directions::Directions;
use crate::field::pages::Pages;
use crate::field::writer::{self, Maps};
use crate::field::{Field, FieldError, Textures};
use crate::format::bytes::{Reader, Writer};
use crate::format::container::{ChunkKind, FileKind};
use crate::format::manifest::{CycleLedger, Parameters, Phase};
use crate::format::names;
use crate::ids::DirectionId;
use crate::radiance::Rgb;
use crate::scene::Scene;
use crate::scene::areas::areas;
use crate::scene::texels::Texels;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// Seconds of work handed out between two looks at the clock.
const BATCH_SECONDS: f64 = 0.5;

/// A bake under way.
pub struct Bake<'a> {
    scene: &'a Scene,
    texels: &'a Texels,
    directions: &'a Directions,
    outlines: Outlines,
    areas: Vec<f32>,
    parameters: Parameters,
    field: Field,
    quantum: Quantum,
    budget: u64,
    options: &'a Options<'a>,
    pool: rayon::ThreadPool,
    committed: Instant,
    counted: Instant,
    sealed: Sealed,
}

/// What ended a loop over directions.
enum Walk {
    Done,
    Stopped,
}

impl<'a> Bake<'a> {
    /// Takes up a field that is not finished. `most` is the brightest emitted radiance, `budget` the
    /// bytes that the page cache may hold.
    ///
    /// # Errors
    /// When threads cannot be started.
    pub fn new(
        scene: &'a Scene,
        texels: &'a Texels,
        directions: &'a Directions,
        field: Field,
        most: f32,
        budget: u64,
        options: &'a Options<'a>,
    ) -> Result<Bake<'a>, BakeError> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(options.threads.max(1))
            .build()
            .map_err(|e| BakeError::Parameter(format!("--threads: {e}")))?;
        let mut bake = Bake {
            scene,
            texels,
            directions,
            outlines: Outlines::new(scene, texels),
            areas: areas(scene, texels),
            parameters: field.manifest().parameters.clone(),
            field,
            quantum: Quantum::new(most),
            budget,
            options,
            pool,
            committed: Instant::now(),
            counted: Instant::now(),
            sealed: Sealed::default(),
        };
        bake.sealed = bake.reach();
        Ok(bake)
    }

    /// The texture values that no light can come to, from two sweeps over the lines.
    fn reach(&self) -> Sealed {
        let shared = self.shared();
        let values = 2 * self.texels.len();
        let cut = cut_texels(self.scene, self.texels);
        let reach = self.sweep(
            || Reach::new(values),
            |reach, id, layers| reach.sweep(&shared, &cut, id, layers),
            |all, one| all.merge(&one),
        );
        let mut sealed = reach.sealed(&shared, &cut);
        let views = self.sweep(
            || CutViews::new(values),
            |views, id, layers| views.sweep(&shared, (&cut, &sealed), id, layers),
            |all, one| all.merge(&one),
        );
        views.seal(&mut sealed);
        sealed
    }

    /// Lets every thread look along directions until none is left, then merges what they found.
    fn sweep<T: Send>(
        &self,
        new: impl Fn() -> T + Sync,
        look: impl Fn(&mut T, DirectionId, &mut Layers) + Sync,
        merge: impl Fn(&mut T, T),
    ) -> T {
        let next = AtomicUsize::new(0);
        let found = self.pool.broadcast(|_| {
            let (mut own, mut layers) = (new(), Layers::default());
            loop {
                let direction = next.fetch_add(1, Ordering::Relaxed);
                if direction >= self.directions.len() {
                    return own;
                }
                look(&mut own, DirectionId(direction as u32), &mut layers);
            }
        });
        let mut all = new();
        found.into_iter().for_each(|own| merge(&mut all, own));
        all
    }

    /// Runs to the end, or until asked to stop.
    ///
    /// # Errors
    /// Of any step; what was committed stays.
    pub fn run(mut self, started: Instant) -> Result<Outcome, BakeError> {
        self.counted = started;
        while self.field.manifest().phase == Phase::Propagating {
            if let Walk::Stopped = self.cycle()? {
                return Ok(Outcome::Stopped);
            }
        }
        if let Walk::Stopped = self.totals()? {
            return Ok(Outcome::Stopped);
        }
        Ok(Outcome::Finished)
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

    /// The texture maps that the cycle under way shoots from.
    fn textures(&self) -> Result<Textures, FieldError> {
        match self.field.manifest().cycle {
            0 => {
                let total = super::emission(self.scene, self.texels);
                Ok(Textures { current: total.clone(), total })
            }
            cycle => self.field.read_textures(cycle, 2 * self.texels.len()),
        }
    }

    fn pages(&self) -> Pages<'_> {
        let surfaces = self.scene.surfaces.len() as u32;
        let exponent = self.field.header_of(FileKind::Tiles, (0, 0)).exponent;
        let cycle = self.field.manifest().cycle;
        let what = (surfaces, exponent);
        Pages::new(self.field.path(), cycle, &self.parameters, what, self.budget)
    }

    /// Goes on with the cycle under way, to its end and commit.
    fn cycle(&mut self) -> Result<Walk, BakeError> {
        let cycle = self.field.manifest().cycle;
        let textures = self.textures()?;
        let shot = textures.current.iter().map(|v| self.quantum.fixed(*v));
        let current: Vec<Fixed> = shot.chain([FROM_OUTSIDE]).collect();
        let mut sums = vec![[0i64; 4]; 2 * self.texels.len()];
        let mut tally = Tally::default();
        if self.field.manifest().has_sums {
            (sums, tally) = self.read_sums()?;
        }
        let perturbations = self.perturbations(cycle);
        let has_mirrors = self.shared().has_mirrors();
        let folder = names::generation(cycle + 1);
        if has_mirrors && !self.all_done() {
            self.field.begin_folder(&folder)?;
        }
        let workers: Vec<Mutex<Scratch>> = (0..self.options.threads.max(1))
            .map(|_| Mutex::new(Scratch::new(self.texels)))
            .collect();
        loop {
            let pages = (has_mirrors && cycle > 0).then(|| self.pages());
            let shared = self.shared();
            let what = Cycle {
                number: cycle,
                current: &current,
                pages: pages.as_ref(),
                perturbations,
                sealed: &self.sealed,
            };
            let place = (folder.as_str(), cycle + 1);
            let (done, walk) = self.walk(Phase::Propagating, place, |direction, worker| {
                let mut scratch = lock(&workers[worker]);
                let made = shoot(&shared, &what, DirectionId(direction), &mut scratch)?;
                let maps = |made: Made| {
                    vec![(ChunkKind::Unshot, made.unshot), (ChunkKind::Arrived, made.arrived)]
                };
                Ok(made.map(maps).unwrap_or_default())
            })?;
            drop(pages);
            gather_sums(&workers, &mut sums, &mut tally);
            done.iter().for_each(|d| self.field.manifest_mut().mark_done(*d));
            match walk {
                Walk::Done if self.all_done() => break,
                _ => self.checkpoint(&sums, &tally)?,
            }
            if let Walk::Stopped = walk {
                return Ok(Walk::Stopped);
            }
        }
        self.end_cycle(cycle, textures, &sums, &tally, perturbations)?;
        Ok(Walk::Done)
    }

    fn perturbations(&self, cycle: u32) -> u32 {
        let counts = &self.parameters.perturbations;
        counts[(cycle as usize).min(counts.len() - 1)]
    }

    fn all_done(&self) -> bool {
        self.field.manifest().done_count() == self.parameters.directions
    }

    /// Takes directions that are not done until all are, the commit is due, or a stop is asked for; the
    /// maps that steps make are written to the folder of a generation. Returns those that were done.
    fn walk(
        &self,
        phase: Phase,
        place: (&str, u32),
        step: impl Fn(u32, usize) -> Result<Maps, FieldError> + Sync,
    ) -> Result<(Vec<u32>, Walk), BakeError> {
        writer::behind(&self.field, place, |queue| {
            self.walk_with(phase, |direction, worker| {
                let maps = step(direction, worker)?;
                if !maps.is_empty() {
                    queue.put(direction, maps);
                }
                Ok(())
            })
        })?
    }

    fn walk_with(
        &self,
        phase: Phase,
        step: impl Fn(u32, usize) -> Result<(), FieldError> + Sync,
    ) -> Result<(Vec<u32>, Walk), BakeError> {
        let manifest = self.field.manifest();
        let natural = 0..self.parameters.directions;
        let order = self.options.order.clone().unwrap_or_else(|| natural.collect());
        let todo: Vec<u32> = order.into_iter().filter(|d| !manifest.is_done(*d)).collect();
        let stop = || self.options.stop.load(Ordering::Relaxed);
        let mut done = Vec::new();
        let mut at = 0;
        let mut batch = self.options.threads.max(1);
        while at < todo.len() && !stop() {
            let due = self.committed.elapsed().as_secs_f64() > self.options.commit_every;
            if due && !done.is_empty() {
                return Ok((done, Walk::Done));
            }
            let began = Instant::now();
            let part = &todo[at..(at + batch).min(todo.len())];
            let next = AtomicUsize::new(0);
            let results = self.pool.broadcast(|context| {
                let mut finished = Vec::new();
                while let Some(direction) = part.get(next.fetch_add(1, Ordering::Relaxed)) {
                    if stop() {
                        break;
                    }
                    step(*direction, context.index())?;
                    finished.push(*direction);
                }
                Ok::<_, FieldError>(finished)
            });
            for result in results {
                done.extend(result?);
            }
            at += part.len();
            let seconds = began.elapsed().as_secs_f64().max(1e-4);
            let fitting = (part.len() as f64 * BATCH_SECONDS / seconds) as usize;
            batch = fitting.clamp(self.options.threads.max(1), 4 * batch.max(1));
            self.report(phase, manifest.done_count() + done.len() as u32);
        }
        Ok((done, if stop() { Walk::Stopped } else { Walk::Done }))
    }

    fn report(&self, phase: Phase, done: u32) {
        let manifest = self.field.manifest();
        let unshot = unshot_fractions(&manifest.ledger);
        let expected_cycles = self.parameters.cycles.or_else(|| {
            let fall = match unshot[..] {
                [.., a, b] if b > 0.0 && b < a => b / a,
                _ => return None,
            };
            let more = (self.parameters.unshot_fraction / unshot.last()?).ln() / fall.ln();
            Some(manifest.cycle + more.max(0.0).ceil() as u32)
        });
        (self.options.progress)(&Progress {
            phase,
            cycle: manifest.cycle,
            done,
            directions: self.parameters.directions,
            unshot: unshot.last().copied().unwrap_or(1.0),
            expected_cycles,
            perturbations: self.perturbations(manifest.cycle),
        });
    }

    /// Adds the time since the last call to the field's own.
    fn count_seconds(&mut self) {
        let seconds = self.counted.elapsed().as_secs_f64();
        self.counted = Instant::now();
        self.field.manifest_mut().statistics.seconds += seconds;
    }

    /// Commits the sums of a cycle under way.
    fn checkpoint(&mut self, sums: &[Fixed], tally: &Tally) -> Result<(), BakeError> {
        let mut w = Writer(Vec::with_capacity(32 * sums.len() + 256));
        tally.write(&mut w);
        sums.iter().flatten().for_each(|v| w.i64(*v));
        self.field.write_sums(&w.0)?;
        self.count_seconds();
        self.field.commit()?;
        self.committed = Instant::now();
        Ok(())
    }

    fn read_sums(&self) -> Result<(Vec<Fixed>, Tally), BakeError> {
        let bytes = self.field.read_sums()?;
        let mut r = Reader::new(&bytes);
        let tally = Tally::read(&mut r)?;
        let mut sums = vec![[0i64; 4]; 2 * self.texels.len()];
        for sum in sums.iter_mut().flatten() {
            *sum = r.i64()?;
        }
        r.end()?;
        Ok((sums, tally))
    }

    /// Makes the next generation's texture maps, closes the ledger and commits.
    fn end_cycle(
        &mut self,
        cycle: u32,
        textures: Textures,
        sums: &[Fixed],
        tally: &Tally,
        perturbations: u32,
    ) -> Result<(), BakeError> {
        let units = Units {
            quantum: self.quantum,
            share: self.directions.share(),
            cell: f64::from(2.0 / self.parameters.resolution as f32).powi(2)
                * self.scene.fit.radius.powi(2),
            perturbations,
        };
        // A whole texel meets lines in proportion to its projected area: pi sr in all.
        let cell = f64::from(2.0 / self.parameters.resolution as f32).powi(2);
        let lines = std::f64::consts::PI / (units.share * cell) * f64::from(perturbations);
        let how = (self.parameters.filter, self.parameters.one_sided);
        let next = next_textures(self.scene, self.texels, sums, (self.quantum, lines), how);
        if let Some(at) = next.iter().position(|v| !v.is_physical()) {
            let surface = self.texels.surface_of[at / 2];
            return Err(BakeError::Radiance { cycle, surface });
        }

        let scale = self.scene.fit.radius.powi(2);
        let mut open = open_areas(&self.areas, sums, lines);
        open.iter_mut().for_each(|a| *a *= scale);
        let diffuse_out = texture_power(&next, &open);
        let one_sided = self.parameters.one_sided;
        let factors: Vec<Rgb> =
            self.scene.surface_ids().map(|id| diffuse_factor(self.scene, id)).collect();
        let received = received(sums, |value| {
            let back = value % 2 == 1;
            let surface = self.texels.surface_of[value / 2] as usize;
            if back && one_sided { Rgb::BLACK } else { factors[surface] }
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

        let mut total = textures.total;
        total.iter_mut().zip(&next).for_each(|(t, n)| *t += *n);
        self.field.write_textures(cycle + 1, &Textures { total, current: next })?;
        if self.shared().has_mirrors() {
            self.field.publish_folder(&names::generation(cycle + 1))?;
        }
        self.count_seconds();
        let manifest = self.field.manifest_mut();
        manifest.ledger.push(ledger);
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
        self.field.remove_sums()?;
        self.field.remove_maps(cycle)?;
        self.field.remove_textures(cycle)?;
        Ok(())
    }

    /// Writes the total radiance maps, then ends the bake.
    fn totals(&mut self) -> Result<Walk, BakeError> {
        let textures = self.textures()?;
        let lit = totals::lit_sides(self.texels, &textures.total);
        let has_mirrors = self.shared().has_mirrors();
        if !self.all_done() {
            self.field.begin_folder(names::TOTAL)?;
        }
        let workers: Vec<Mutex<totals::Scratch>> =
            (0..self.options.threads.max(1)).map(|_| Mutex::default()).collect();
        while !self.all_done() {
            let cycle = self.field.manifest().cycle;
            let pages = has_mirrors.then(|| self.pages());
            let shared = self.shared();
            let place = (names::TOTAL, cycle);
            let (done, walk) = self.walk(Phase::WritingTotals, place, |direction, worker| {
                let mut scratch = lock(&workers[worker]);
                let read = |p: &Pages| p.read(direction, ChunkKind::Arrived);
                let arrived = pages.as_ref().map(read).transpose()?;
                let maps = (textures.total.as_slice(), lit.as_slice());
                let id = DirectionId(direction);
                let bytes = totals::total_map(&shared, id, maps, arrived.as_ref(), &mut scratch)?;
                Ok(vec![(ChunkKind::Total, bytes)])
            })?;
            drop(pages);
            done.iter().for_each(|d| self.field.manifest_mut().mark_done(*d));
            // With the directions they belong to, so that a resumed bake counts none twice and misses none.
            let fragments = |w: &Mutex<totals::Scratch>| std::mem::take(&mut lock(w).fragments);
            let fragments: u64 = workers.iter().map(fragments).sum();
            self.field.manifest_mut().statistics.fragments += fragments;
            self.count_seconds();
            self.field.commit()?;
            self.committed = Instant::now();
            if let Walk::Stopped = walk {
                return Ok(Walk::Stopped);
            }
        }
        self.field.publish_folder(names::TOTAL)?;
        let digest = self.field.digest()?;
        self.count_seconds();
        let cycle = self.field.manifest().cycle;
        let manifest = self.field.manifest_mut();
        manifest.phase = Phase::Finished;
        manifest.digest = digest;
        self.field.commit()?;
        if has_mirrors {
            self.field.remove_maps(cycle)?;
        }
        Ok(Walk::Done)
    }
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
    worker.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

/// Adds the workers' sums to the bake's and empties them.
fn gather_sums(workers: &[Mutex<Scratch>], sums: &mut [Fixed], tally: &mut Tally) {
    for worker in workers {
        let mut scratch = lock(worker);
        for (total, own) in sums.iter_mut().zip(&mut scratch.sums) {
            for (t, o) in total.iter_mut().zip(own.iter_mut()) {
                *t += std::mem::take(o);
            }
        }
        tally.add(&std::mem::take(&mut scratch.tally));
    }
}
