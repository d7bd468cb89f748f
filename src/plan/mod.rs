//! What a bake will take, before it is begun: bytes on disk and in memory, seconds, cycles.
//!
//! In: what the bake would be given. Out: a [`Plan`]. Two things are done. `rehearsal` is the same
//! bake with fewer lines, in memory, on the same threads: it shows the number of cycles, the seconds
//! that a direction takes in each, which sides are lit, and how much of the mirrors' maps is. What the
//! few lines cannot show, because the axes have too large a part in them, comes from `sample`: total
//! maps of some of the real lines. `memory` and `disk` follow from the two by counting.
//! Nothing is written anywhere.

mod disk;

mod links;

mod memory;

mod rehearsal;

mod sample;

use crate::bake::memory::{Extent, Need};
use crate::bake::step::Shared;
use crate::bake::{self, BakeError, Options};
use crate::format::manifest::Parameters;
use crate::format::tiles::exponent_for;
use crate::scene::Scene;
use rehearsal::Rehearsal;
use sample::Sample;
use serde::Serialize;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

/// What a bake will take.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Plan {
    /// Lines, l.
    pub directions: u32,
    /// Cells along an edge of a PSF, N.
    pub resolution: u32,
    /// Surfaces of the scene, and how many of them are mirrors.
    pub surfaces: u32,
    /// Mirrors among the surfaces.
    pub mirrors: u32,
    /// Texels of the texture maps.
    pub texels: u64,
    /// Cycles that light is sent on for.
    pub cycles: u32,
    /// Bytes on disk.
    pub disk: Bytes,
    /// Bytes in memory.
    pub memory: Memory,
    /// Seconds on this machine, if it is as busy then as it was now and the disk keeps up.
    pub time: Time,
    /// How it was found out.
    pub effort: Effort,
}

/// Bytes on disk.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Bytes {
    /// The scene's file of the finished field.
    pub scene: u64,
    /// Its texture maps.
    pub textures: u64,
    /// Its total radiance maps.
    pub totals: u64,
    /// Its commit records.
    pub records: u64,
    /// The finished field.
    pub finished: u64,
    /// Most while it is being baked.
    pub peak: u64,
    /// Of all files that the bake writes, most of which it removes again.
    pub written: u64,
    /// The field packed as `vlf-pack` does it unless it is told otherwise.
    pub packed: u64,
    /// The field packed without compression.
    pub packed_raw: u64,
    /// The field packed with zstd.
    pub packed_zstd: u64,
}

/// Bytes in memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Memory {
    /// What the bake would be granted.
    pub granted: u64,
    /// The smallest grant that is not refused.
    pub smallest: u64,
    /// The grant with which every page is read once; more changes nothing.
    pub useful: u64,
    /// What the process will hold with the grant, or with the smallest if less was granted.
    pub peak: u64,
}

/// Seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Time {
    /// Threads they are for.
    pub threads: u32,
    /// From start to end.
    pub seconds: f64,
    /// Of them before the first cycle.
    pub beginning: f64,
    /// Of them for all cycles.
    pub cycles: f64,
    /// Of them for total radiance maps, and to the end.
    pub totals: f64,
    /// Seconds of processors, over all threads; known on Linux only.
    pub processor: Option<f64>,
}

/// What a plan took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Effort {
    /// Lines of the rehearsal.
    pub rehearsed: u32,
    /// Directions whose total maps were made.
    pub sampled: u32,
    /// Seconds.
    pub seconds: f64,
}

/// Work that a rehearsal may always take, see [`Rehearsal::work`]: a second or two.
const WORK: u64 = 25_000_000;

/// Part of the bake's work that it may take in any case.
const PART: u64 = 25;

/// Says what [`bake`](bake::bake) would take with the same arguments. A grant of memory that is too
/// small is no error here. Of the options, `stop`, `progress` and `order` play no part.
///
/// # Errors
/// Parameters out of range, and what can go wrong in the rehearsal.
pub fn plan(scene: &Scene, parameters: &Parameters, options: &Options) -> Result<Plan, BakeError> {
    let began = Instant::now();
    let directions = bake::checked(scene, parameters)?;
    // Nobody stops a plan.
    let going_on = &AtomicBool::new(false);
    let unstopped = Options { stop: going_on, order: None, ..*options };
    let refined = bake::refine::refined(scene, parameters, &unstopped)?;
    let scene = refined.as_deref().unwrap_or(scene);
    let texels = bake::texels(scene, parameters);
    let outlines = bake::layers::Outlines::new(scene, &texels);
    let most = scene.materials.iter().map(|m| m.emitted.max()).fold(0.0, f32::max);
    let shared = Shared {
        scene,
        texels: &texels,
        outlines: &outlines,
        directions: &directions,
        parameters,
        quantum: bake::transfer::Quantum::new(most),
        exponent: exponent_for(most),
    };
    let threads = options.threads.max(1) as u64;
    let need = Need::new(&shared, &Extent::probe(&shared), threads);
    let granted = options.memory.max(need.smallest());
    // What the bake leaves to its pages while light is sent on, and with the useful grant.
    let pages = granted - need.fixed[0];

    let rehearsal = rehearse(&shared, pages, options)?;
    let sample = Sample::new(&shared, &rehearsal, options.threads)?;

    let files = disk::Files::new(&shared, &rehearsal, &sample)?;
    let all_pages = memory::all_pages(&files, threads);
    let held = all_pages.min(pages);
    let steps = rehearsal.steps(&shared, &sample, held);
    let disk = files.bytes(&steps, options.commit_every);
    let all_links = memory::links(&shared, &sample, rehearsal.cycles());
    let links = all_links.min(need.spare(granted));
    let peak = memory::peak(&shared, &sample, threads, (held, links));
    // Links that are being found take room beside those that are kept.
    let finding = if all_links > 0 { need.links } else { 0 };
    let useful = need.smallest().max(need.fixed[0] + all_pages) + finding + all_links;
    Ok(Plan {
        directions: parameters.directions,
        resolution: parameters.resolution,
        surfaces: scene.surfaces.len() as u32,
        mirrors: texels.len() as u32 - texels.diffuse,
        texels: texels.len() as u64,
        cycles: rehearsal.cycles(),
        disk,
        memory: Memory { granted: options.memory, smallest: need.smallest(), useful, peak },
        time: steps.time(threads as u32),
        effort: Effort {
            rehearsed: rehearsal.lines,
            sampled: sample.count,
            seconds: began.elapsed().as_secs_f64(),
        },
    })
}

/// Rehearses with as many lines as are cheap, and at least a few.
fn rehearse(shared: &Shared, pages: u64, options: &Options) -> Result<Rehearsal, BakeError> {
    let all = shared.parameters.directions;
    let mut lines = all.min(33);
    loop {
        let rehearsal = Rehearsal::new(shared, lines, pages, options)?;
        // Each lattice has four times the directions of the one before, but for one line.
        let (work, more) = (rehearsal.work(), 4 * (lines - 1) + 1);
        let whole = work.saturating_mul(u64::from(all / lines));
        if lines == all || work.saturating_mul(u64::from(more / lines)) > WORK.max(whole / PART) {
            return Ok(rehearsal);
        }
        lines = more;
    }
}
