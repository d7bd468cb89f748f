//! Bytes in memory: what the bake holds at once in each of its phases, with the lines' own numbers
//! where [`Need`](crate::bake::memory::Need) must take the worst.

use super::disk::Files;
use super::sample::Sample;
use crate::bake::memory::{lasting_bytes, texture_bytes};
use crate::bake::step::{Scratch, Shared};
use crate::ids::DirectionId;
use crate::psf::Psf;
use crate::scene::reflectances::Reflectances;

/// Of a process that holds nothing yet: its own data, threads' stacks, the allocator's. Measured.
const EMPTY: u64 = 5 << 18;

/// What the allocator keeps for the threads that read mirrors' maps and those that write them. Measured.
const KEPT: u64 = 5 << 18;

/// Bytes of a span, while a PSF is rasterised.
const SPAN: u64 = 24;

/// Directions whose spans are counted.
const LOOKS: usize = 16;

/// Bytes of pages when each is read once: all unshot maps of the generation that has most, and the
/// maps of what arrived that are in use or wait to be.
pub fn all_pages(files: &Files, threads: u64) -> u64 {
    let of = |g: &super::rehearsal::Generation| {
        files.directions() as f64 * g.unshot + (3 * threads + 4) as f64 * g.arrived
    };
    files.maps.iter().map(of).fold(0.0, f64::max) as u64
}

/// How many PSFs' links are kept, if there is room: those that a cycle and the one after it have. Those of the first
/// are taken to be its own lines only, as where few surfaces send.
fn kept(shared: &Shared, cycles: u32) -> u64 {
    let Shared { directions, parameters, .. } = *shared;
    let is_kept = |id: DirectionId, number: u32| {
        (1..cycles).any(|cycle| {
            let (before, next) = (parameters.grids(cycle - 1), parameters.grids(cycle));
            let whole = if cycle == 1 { 1 } else { before.perturbations };
            let has = |thinned| directions.is_in_coarser(id, thinned);
            number < whole.min(next.perturbations) && has(before.thinned) && has(next.thinned)
        })
    };
    let most = parameters.grids(1).perturbations;
    let of = |id| (0..most).filter(|number| is_kept(id, *number)).count() as u64;
    directions.ids().map(of).sum()
}

/// Bytes of links that a bake of so many cycles keeps, where there is room.
pub fn links(shared: &Shared, sample: &Sample, cycles: u32) -> u64 {
    let all = || kept(shared, cycles) as f64 * sample.links;
    if shared.is_linked() { all() as u64 } else { 0 }
}

/// Most bytes that the process will hold, with so many of pages and links.
pub fn peak(shared: &Shared, sample: &Sample, threads: u64, (pages, links): (u64, u64)) -> u64 {
    let texels = shared.texels.len() as u64;
    let values = 2 * texels;
    let cells = u64::from(shared.parameters.resolution).pow(2);
    let surfaces = &shared.scene.surfaces;
    let corners: u64 =
        surfaces.iter().flat_map(|s| &s.polygons).map(|p| p.vertices.len() as u64).sum();
    let lasting = EMPTY + lasting_bytes(shared) + 40 * shared.directions.len() as u64;
    let layers = 4 * cells
        + 8 * sample.most.fragments
        + SPAN * spans(shared)
        + 84 * surfaces.len() as u64
        + 12 * corners;

    // Sets that exchange light: one a thread, then all of them with their roots.
    let reach = threads * (layers + 17 * values) + 17 * values + texels;
    let (unshot, arrived) =
        sample.generations.last().map_or((0, 0), |g| (g.unshot as u64, g.arrived as u64));
    let mirrors = texels - u64::from(shared.texels.diffuse);
    let scratch = layers + 2 * (unshot + arrived) + mirrors * Scratch::A_MIRROR;
    let (excerpts, kept) =
        if shared.stores_mirrors() { (sample.most.excerpts, KEPT) } else { (0, 0) };
    let propagating = texture_bytes(values, threads, shared.parameters)
        + threads * (scratch + excerpts)
        + pages
        + links
        + kept;
    let totals = 12 * values + threads * (layers + 2 * sample.largest);
    let averaging = Reflectances::passing_bytes(shared.scene);
    lasting + reach.max(propagating).max(totals).max(averaging)
}

/// Most spans of any of some directions: rows that polygons reach over.
fn spans(shared: &Shared) -> u64 {
    let resolution = shared.parameters.resolution;
    let count = shared.directions.len();
    let polygons = || shared.scene.surfaces.iter().flat_map(|s| &s.polygons);
    let of = |id: DirectionId| {
        let psf = Psf::new(shared.directions.vector(id), resolution);
        let rows = |vertices: &[glam::Vec3]| {
            let y = vertices.iter().map(|v| psf.project(*v).y);
            let (low, high) = y.fold((f32::MAX, f32::MIN), |(l, h), y| (l.min(y), h.max(y)));
            f64::from(high - low)
        };
        polygons().map(|p| rows(&p.vertices)).sum::<f64>() as u64
    };
    let chosen = (0..count.min(LOOKS)).map(|k| DirectionId((k * count / count.min(LOOKS)) as u32));
    chosen.map(of).max().unwrap_or(0)
}
