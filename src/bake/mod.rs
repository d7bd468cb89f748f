//! Act one, made: light is propagated through the field (section 4).
//!
//! In: a [`Scene`] and [`Parameters`]. Out: a field directory. The stages, in the data's order:
//! [`homes`] (which texel a point belongs to), [`layers`] (every surface on every ray), [`exchange`] (who sees whom),
//! [`links`] (what of that is kept), [`transfer`] (what travels), [`marks`] and [`reach`] (where no light can come),
//! [`refine`] (how fine texels are), [`step`] (one direction in one cycle), [`cycle`] (the loops), [`ledger`] (where the energy went),
//! [`estimate`] (how wrong it is),
//! [`totals`] (the last sweep), [`mend`] (what of it went bad since).

pub mod profile;

pub mod homes;

pub mod window;

pub mod layers;

pub mod exchange;

pub mod perturb;

pub mod marks;

pub mod links;

pub mod reach;

pub mod transfer;

pub mod ledger;

pub mod estimate;

pub mod step;

pub mod totals;

pub mod mend;

pub mod ahead;

pub mod memory;

pub mod cycle;

pub mod quality;

pub mod refine;

use crate::directions::Directions;
use crate::field::storage::Storage;
use crate::field::storage::disk::Disk;
use crate::field::{Field, FieldError, Terms};
use crate::format::limits::Limits;
use crate::format::manifest::{MOST_THINNED, Parameters, Phase, Specular, Statistics};
use crate::format::tiles::exponent_for;
use crate::radiance::Rgb;
use crate::scene::Scene;
use crate::scene::texels::Texels;
use profile::Profile;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

/// What can go wrong with a bake.
#[derive(Clone, Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BakeError {
    /// A parameter that makes no sense.
    #[error("{0}")]
    Parameter(String),
    /// Of the field's files.
    #[error(transparent)]
    Field(#[from] FieldError),
    /// The memory granted is too small.
    #[error("needs at least {needs} of memory for this scene and N = {resolution}, not {granted}")]
    Memory {
        /// The least that works, in words.
        needs: String,
        /// What was granted, in words.
        granted: String,
        /// N.
        resolution: u32,
    },
    /// The disk is too small.
    #[error("the field would take about {needs} of disk, {free} is free; use --force to try")]
    Space {
        /// What it would take, in words.
        needs: String,
        /// What is there, in words.
        free: String,
    },
    /// Total maps of a finished field are damaged, and not all that they were made of is kept.
    #[error(
        "{fault}; {count} of the total maps are damaged and cannot be made again, since what arrived \
         at the mirrors is kept only until a bake is finished. Bake the scene anew, under another name"
    )]
    Gone {
        /// The first of them.
        fault: FieldError,
        /// How many.
        count: usize,
    },
    /// The energy ledger does not close: light was lost or made by a fault of the program.
    #[error(
        "cycle {cycle}: the energy ledger does not close: {residual:.1e} of the income is not \
         accounted for. This is a fault of the program; the field is kept as it was before the cycle"
    )]
    Ledger {
        /// The cycle.
        cycle: u32,
        /// Unaccounted fraction of the income.
        residual: f64,
    },
    /// Radiance that is negative or not finite.
    #[error("cycle {cycle}: non-finite or negative radiance on surface {surface}; not committed")]
    Radiance {
        /// The cycle.
        cycle: u32,
        /// The surface.
        surface: u32,
    },
}

/// What a bake may use, and who watches it. None of it changes a bit of the field.
pub struct Options<'a> {
    /// Bytes of memory granted.
    pub memory: u64,
    /// Threads, at least 1.
    pub threads: usize,
    /// Set from elsewhere to stop between directions.
    pub stop: &'a AtomicBool,
    /// Told how far the bake has come.
    pub progress: &'a (dyn Fn(&Progress) + Sync),
    /// The order in which directions are taken; any order gives the same field. `None`: by id.
    pub order: Option<Vec<u32>>,
    /// Seconds between commits of a cycle under way.
    pub commit_every: f64,
    /// On what terms the field is written.
    pub terms: Terms,
    /// Whether to begin though the disk seems to be too small.
    pub force: bool,
}

/// How far a bake has come.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// The phase.
    pub phase: Phase,
    /// Cycles finished.
    pub cycle: u32,
    /// Directions done in the step under way.
    pub done: u32,
    /// Directions in all.
    pub directions: u32,
    /// Whether the bake is still finding out where light can come.
    pub preparing: bool,
    /// Unshot power as a fraction of the emitted, when the last cycle ended.
    pub unshot: f64,
    /// PSFs rasterised in this run, or what takes as long.
    pub work: f64,
    /// The same that are left, as far as can be seen.
    pub work_left: f64,
    /// Where the time of this run went, up to the last commit.
    pub profile: Profile,
}

/// How a bake ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The field is finished.
    Finished,
    /// It was stopped between directions; the same call goes on with it.
    Stopped,
}

/// Largest fraction of a cycle's income that the ledger may leave unaccounted.
pub const LEDGER_TOLERANCE: f64 = 1e-3;

/// Most cycles that `auto` runs.
pub const MOST_CYCLES: u32 = 200;

/// Bakes a scene into a field at `path`, or goes on with the unfinished bake of the same scene and
/// parameters that is there. What was done is committed at least every `commit_every` seconds. Total
/// maps that are there already are read, and made again where they are damaged.
///
/// # Errors
/// Parameters out of range, too little memory, a field that is another's or damaged, a system that
/// refuses, or a ledger that does not close. What was committed stays and can be gone on with.
pub fn bake(
    scene: &Scene,
    parameters: &Parameters,
    path: &Path,
    options: &Options,
) -> Result<Outcome, BakeError> {
    bake_in(Arc::new(Disk::new(path)), scene, parameters, options)
}

/// The same in any storage.
///
/// # Errors
/// As [`bake`].
pub fn bake_in(
    storage: Arc<dyn Storage>,
    scene: &Scene,
    parameters: &Parameters,
    options: &Options,
) -> Result<Outcome, BakeError> {
    let directions = checked(scene, parameters)?;
    let Some(scene) = refine::refined(scene, parameters, options)? else {
        return Ok(Outcome::Stopped);
    };
    let scene = &*scene;
    check_texels(scene, parameters)?;
    let texels = texels(scene, parameters);
    let most = scene.materials.iter().map(|m| m.emitted.max()).fold(0.0, f32::max);
    let exponent = exponent_for(most);
    let (need, disk) = needs(scene, &texels, &directions, parameters, exponent, options)?;
    let there = storage.list("").is_ok_and(|names| !names.is_empty());
    let free = storage.free().unwrap_or(u64::MAX);
    if !there && free < disk && !options.force {
        return Err(BakeError::Space { needs: words(disk), free: words(free) });
    }
    let mut field = Field::create_or_resume(storage, scene, parameters, exponent, options.terms)?;
    if let Some(notice) = field.notice() {
        tracing::warn!("{}: {notice}", field.path().display());
    }
    if field.manifest().phase != Phase::Propagating {
        let outlines = layers::Outlines::new(scene, &texels);
        let quantum = transfer::Quantum::new(most);
        let (texels, directions) = (&texels, &directions);
        let outlines = &outlines;
        let shared =
            step::Shared { scene, texels, outlines, directions, parameters, quantum, exponent };
        let budget = options.memory.saturating_sub(need.fixed[1]);
        if mend::mend(&shared, &mut field, budget, options)? == Outcome::Stopped {
            return Ok(Outcome::Stopped);
        }
    }
    if field.manifest().phase == Phase::Finished {
        if let Err(error) = field.settle() {
            tracing::warn!("the field is finished, but not tidied up: {error}");
        }
        return Ok(Outcome::Finished);
    }
    field.collect()?;
    let bake = cycle::Bake::new(scene, &texels, &directions, field, (most, need), options)?;
    bake.run(Instant::now())
}

/// The lines of a bake, if it can be made with these parameters.
///
/// # Errors
/// Parameters out of range.
pub fn checked(scene: &Scene, parameters: &Parameters) -> Result<Directions, BakeError> {
    check(parameters)?;
    let directions = Directions::with_lines(parameters.directions)
        .ok_or_else(|| BakeError::Parameter(no_lattice(parameters.directions)))?;
    check_texels(scene, parameters)?;
    Ok(directions)
}

fn check_texels(scene: &Scene, parameters: &Parameters) -> Result<(), BakeError> {
    let count = Texels::count(scene, parameters.texel_edge());
    if count > Limits::PUBLISHED.texels {
        let most = Limits::PUBLISHED.texels;
        return Err(BakeError::Parameter(format!(
            "the scene would have {count} texels and may have {most}: lower --resolution or --refine, or raise --texel"
        )));
    }
    Ok(())
}

/// What a bake needs of memory, and about what it needs of the disk at its peak; refused when the
/// memory granted is less.
fn needs(
    scene: &Scene,
    texels: &Texels,
    directions: &Directions,
    parameters: &Parameters,
    exponent: i32,
    options: &Options,
) -> Result<(memory::Need, u64), BakeError> {
    let outlines = layers::Outlines::new(scene, texels);
    let quantum = transfer::Quantum::new(1.0);
    let shared = step::Shared {
        scene,
        texels,
        outlines: &outlines,
        directions,
        parameters,
        quantum,
        exponent,
    };
    let extent = memory::Extent::probe(&shared);
    let need = memory::Need::new(&shared, &extent, options.threads.max(1) as u64);
    if options.memory < need.smallest() {
        // In whole units, so that what is said can be granted.
        let unit = if need.smallest() > 1 << 20 { 1 << 20 } else { 1 << 10 };
        return Err(BakeError::Memory {
            needs: words(need.smallest().next_multiple_of(unit)),
            granted: words(options.memory),
            resolution: parameters.resolution,
        });
    }
    // Half of it: most sides are lit on one side at most, and the probe is of the largest directions.
    let lines = directions.len() as u64;
    let disk = lines * (extent.total_map / 2 + 4 * extent.mirror_map) + 96 * texels.len() as u64;
    Ok((need, disk))
}

/// Bytes in words.
fn words(bytes: u64) -> String {
    bytesize::ByteSize::b(bytes).display().iec().to_string()
}

/// The texels of a scene at a bake's resolution.
pub fn texels(scene: &Scene, parameters: &Parameters) -> Texels {
    Texels::new(scene, parameters.texel_edge())
}

/// Texture maps before the first cycle: what the surfaces emit, two values a texel.
pub fn emission(scene: &Scene, texels: &Texels) -> Vec<Rgb> {
    let mut values = vec![Rgb::BLACK; 2 * texels.len()];
    for texel in 0..texels.diffuse as usize {
        let id = crate::ids::SurfaceId(texels.surface_of[texel]);
        values[2 * texel] = scene.material_of(id).emitted;
    }
    values
}

fn no_lattice(lines: u32) -> String {
    format!(
        "--directions {lines}: there is no lattice of that many lines; \
         choose 9, 33, 129, 513, 2049, 8193, 32769, 131073 or 524289"
    )
}

fn check(p: &Parameters) -> Result<(), BakeError> {
    let bad = |what: String| Err(BakeError::Parameter(what));
    if p.resolution == 0 || p.resolution > Limits::PUBLISHED.resolution {
        return bad(format!(
            "--resolution {}: 1 to {}",
            p.resolution,
            Limits::PUBLISHED.resolution
        ));
    }
    if p.tile == 0 || p.tile > Limits::PUBLISHED.tile || !p.resolution.is_multiple_of(p.tile) {
        let most = Limits::PUBLISHED.tile;
        return bad(format!(
            "--tile {}: must divide the resolution {} and be at most {most}",
            p.tile, p.resolution
        ));
    }
    if p.perturbations.is_empty() || p.perturbations.iter().any(|n| *n == 0 || *n > 4096) {
        return bad("--perturb: 1 to 4096 for each cycle".to_owned());
    }
    if p.thinned > MOST_THINNED {
        return bad(format!("--perturb: a last fraction is 1/4 to 1/4^{MOST_THINNED}"));
    }
    if p.specular == Specular::Trace && !p.resample {
        return bad(
            "--resample off: with --specular trace nothing is stored to take maps from".into()
        );
    }
    if !(0.0..=1.0).contains(&p.target_error) {
        return bad(format!("--target-error {}: 0 to 1", p.target_error));
    }
    if !(1.0..=64.0).contains(&p.refined) {
        return bad(format!("--refine {}: 1 to 64", p.refined));
    }
    if p.filter > 64 {
        return bad(format!("--filter {}: 0 to 64", p.filter));
    }
    if p.cycles.is_some_and(|c| c == 0 || c > MOST_CYCLES) {
        return bad(format!("--cycles: 1 to {MOST_CYCLES}, or auto"));
    }
    if !(0.1..=100.0).contains(&p.texel_cells)
        || p.unshot_fraction.is_nan()
        || p.unshot_fraction <= 0.0
    {
        return bad("texel edge or unshot fraction out of range".to_owned());
    }
    Ok(())
}

/// Adds what a run took to a bake's figures.
fn count_run(statistics: &mut Statistics, tally: &ledger::Tally) {
    statistics.fragments += tally.fragments;
    statistics.gathers += tally.gathers;
    statistics.holes += tally.holes;
}
