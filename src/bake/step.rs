//! One step: everything that a direction does in a cycle.
//!
//! In: the scene, the texture maps and unshot maps of this generation. Out: sums for the diffuse
//! receivers (added to the worker's own), and the direction's tile maps of the next generation. A pure
//! function of its inputs, so that a step may be done again, in any order, by any thread.

mod mirrored;

use super::estimate::half_of;
use super::exchange;
use super::layers::{Fragment, Layers, Outlines, SPLIT, Through, projections};
use super::ledger::{Tally, channels};
use super::links::{Kept, Links};
use super::marks::{self, Marks};
use super::perturb;
use super::profile::{Stage, Watch};
use super::transfer::clip::{Clip, Ground, Projection};
use super::transfer::specular::MirrorSender;
use super::transfer::{self, Current, Fixed, Quantum};
use crate::directions::Directions;
use crate::field::FieldError;
use crate::field::pages::Pages;
use crate::format::container::ChunkKind;
use crate::format::manifest::{Grids, Parameters, Transfer};
use crate::format::tiles::{CoveredCell, TileMapWriter};
use crate::ids::{Cell, DirectionId, Sense, SmallCell, SurfaceId};
use crate::paths::Paths;
use crate::psf::Psf;
use crate::radiance::Rgb;
use crate::scene::Scene;
use crate::scene::texels::Texels;
use mirrored::keep_mirrors;
use std::hint::black_box;
use std::mem::take;
use std::ops::Range;

/// What all steps of a bake share.
pub struct Shared<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Its texels.
    pub texels: &'a Texels,
    /// Its polygons.
    pub outlines: &'a Outlines,
    /// The lines.
    pub directions: &'a Directions,
    /// What decides the bits.
    pub parameters: &'a Parameters,
    /// How radiance is counted.
    pub quantum: Quantum,
    /// Power of two by which stored radiance is scaled.
    pub exponent: i32,
}

impl Shared<'_> {
    /// Whether any surface is a mirror.
    pub fn has_mirrors(&self) -> bool {
        (self.texels.diffuse as usize) < self.texels.len()
    }

    /// Whether the links between texture values may be kept: not those of split cells, nor what maps of
    /// mirrors show.
    pub fn is_linked(&self) -> bool {
        !self.parameters.supersample && !self.stores_mirrors()
    }

    /// Whether the scene has mirrors whose maps are written while light is propagated.
    pub fn stores_mirrors(&self) -> bool {
        self.has_mirrors() && self.parameters.stores_mirrors()
    }
}

/// The senders of a cycle in which few send.
#[derive(Clone, Copy)]
pub struct Few<'a> {
    /// Which surfaces send.
    pub senders: &'a [bool],
    /// Paths that meet none but senders, where mirrors are some of them. What these do not show, no
    /// mirror shows: other surfaces are dark, and can only stand in the way.
    pub paths: Option<Paths<'a>>,
}

/// What all steps of a cycle share.
pub struct Cycle<'a> {
    /// Its number.
    pub number: u32,
    /// What texture values shoot.
    pub current: Current<'a>,
    /// Unshot maps of mirrors; none in the first cycle and in scenes without mirrors.
    pub pages: Option<&'a Pages>,
    /// Where mirrors' light is found by following its path; `None`: in their unshot maps.
    pub paths: Option<Paths<'a>>,
    /// Which of the PSFs that each line stands for.
    pub grids: Range<u32>,
    /// Its lines are those of a lattice with steps `2^thinned` times as long.
    pub thinned: u32,
    /// The surfaces that send, when these are few: perturbed PSFs have only the lines that meet one of
    /// them, and the lines are counted in the unperturbed ones alone.
    pub few: Option<Few<'a>>,
    /// The surfaces that lack lines, when others have enough: perturbed PSFs have only the lines that meet one
    /// of them. `None`: all.
    pub lacking: Option<&'a [bool]>,
    /// What earlier cycles found of PSFs, and what later ones are to know of this one's.
    pub kept: Option<Again<'a>>,
    /// Which texture values no light can come to, and what else is special about texels.
    pub marks: &'a Marks,
}

/// What is found once for several cycles.
#[derive(Clone, Copy)]
pub struct Again<'a> {
    /// What was kept.
    pub links: &'a Kept,
    /// The PSFs that the next cycle has, if there is one: links of others are not kept.
    pub next: Option<Grids>,
}

impl Cycle<'_> {
    /// The value that stands for the space outside the scene.
    fn outside(&self) -> usize {
        self.current.outside()
    }
}

/// A worker's own memory, reused from step to step.
pub struct Scratch {
    layers: Layers,
    /// Sums over the lines of each half, two a texel, and one for the space outside, which is taken
    /// into the tally tile by tile; see [`half_of`].
    pub sums: [Vec<Fixed>; 2],
    /// Sums for the ledger.
    pub tally: Tally,
    senders: Vec<Option<MirrorSender>>,
    used_senders: Vec<usize>,
    pairs: Vec<[u32; 2]>,
    /// For clipping: the cell of each pair, and where cells fall.
    cells: Vec<SmallCell>,
    projections: Vec<Projection>,
    clip: Clip,
    line: Vec<Fragment>,
    /// The links of the PSF under way, while they are to be kept.
    links: Option<Links>,
    /// Memory for the next PSF's.
    spare_links: Links,
    arrived: Vec<[Rgb; 2]>,
    tile: Vec<CoveredCell>,
    flow: Flow,
    failure: Option<FieldError>,
    /// Where the worker's time goes.
    pub watch: Watch,
}

/// Sums over the lines of one PSF, channel by channel, each weighted by its shares.
#[derive(Default)]
struct Flow {
    /// Left diffuse surfaces.
    shot: Fixed,
    /// Left mirrors.
    shot_mirror: Fixed,
    /// Arrived at mirrors.
    to_mirror: Fixed,
    /// Arrived at mirrors, times their reflectance.
    mirrored: Fixed,
}

/// The tile maps a step made: unshot radiance, and all that has arrived so far.
pub struct Made {
    /// Bytes of the unshot map.
    pub unshot: Vec<u8>,
    /// Bytes of the map of all that arrived.
    pub arrived: Vec<u8>,
}

/// So many sums of nothing, in memory that has been written to. Where a page is first read and then written to,
/// the system maps it twice, and stops all other threads for that.
fn written(count: usize) -> Vec<Fixed> {
    const A_PAGE: usize = 4096 / size_of::<Fixed>();
    let mut sums = vec![[0; 4]; count];
    sums.iter_mut().step_by(A_PAGE).for_each(|sum| sum[0] = black_box(0));
    sums
}

/// The gap before a line leaves the scene, in the fitted scene's units.
const FAR: f32 = 1.0;

impl Scratch {
    /// Bytes for each mirror, apart from excerpts.
    pub const A_MIRROR: u64 = 2 * size_of::<Option<MirrorSender>>() as u64;

    /// For a scene's texels.
    pub fn new(texels: &Texels) -> Scratch {
        let mirrors = texels.len() - texels.diffuse as usize;
        Scratch {
            layers: Layers::default(),
            sums: [0, 1].map(|_| written(2 * texels.len() + 1)),
            pairs: Vec::new(),
            cells: Vec::new(),
            projections: Vec::new(),
            clip: Clip::default(),
            line: Vec::new(),
            links: None,
            spare_links: Links::default(),
            tally: Tally::default(),
            senders: (0..2 * mirrors).map(|_| None).collect(),
            used_senders: Vec::new(),
            arrived: Vec::new(),
            tile: Vec::new(),
            flow: Flow::default(),
            failure: None,
            watch: Watch::default(),
        }
    }

    /// Adds the flow of a PSF of so many fragments to the tally and lets go of its senders.
    fn settle(&mut self, fragments: u64, is_stored: bool) {
        let flow = take(&mut self.flow);
        let sum = |lines: &Fixed| i128::from(channels(lines));
        self.tally.shot_diffuse += sum(&flow.shot);
        self.tally.shot_mirror += sum(&flow.shot_mirror);
        self.tally.to_mirror += sum(&flow.to_mirror);
        self.tally.mirrored += sum(&flow.mirrored);
        if is_stored {
            self.tally.mirrored_true += sum(&flow.mirrored);
        }
        self.tally.fragments += fragments;
        for used in self.used_senders.drain(..) {
            self.senders[used] = None;
        }
    }
}

/// Shoots a cycle's light along a direction and its perturbations. Returns the direction's maps of the
/// next generation, if the scene has mirrors.
///
/// # Errors
/// When a page cannot be read.
pub fn shoot(
    shared: &Shared,
    cycle: &Cycle,
    id: DirectionId,
    scratch: &mut Scratch,
) -> Result<Option<Made>, FieldError> {
    let mut made = None;
    scratch.watch.start();
    if !shared.directions.is_in_coarser(id, cycle.thinned) {
        return Ok(made);
    }
    let colour = shared.directions.colour(id, cycle.thinned);
    let double = shared.directions.shares(id) == 2;
    let stores_mirrors = shared.stores_mirrors();
    for number in cycle.grids.clone() {
        let psf = perturb::psf(shared.directions, id, number, shared.parameters.resolution);
        let few = cycle.few.filter(|_| number > 0);
        let lacking = cycle.lacking.filter(|_| number > 0);
        let line = Line { shared, cycle, psf: &psf, half: half_of(colour, number), few };
        let is_whole = few.is_none() && lacking.is_none();
        let stores = number == 0 && stores_mirrors;
        let splits = shared.parameters.supersample && is_whole && !stores;
        let kept = cycle.kept.filter(|_| is_whole && shared.is_linked());
        if line.clips() {
            projections(shared.outlines, &psf, &mut scratch.projections);
        }
        if let Some(links) = kept.and_then(|kept| kept.links.get(id, number)) {
            match double {
                true => line.again::<2>(&links, scratch),
                false => line.again::<3>(&links, scratch),
            }
            scratch.settle(links.fragments, false);
            scratch.watch.lap(Stage::Transfer);
            continue;
        }
        if is_whole {
            scratch.layers.rasterise(shared.outlines, &psf);
        } else {
            line.rasterise_through(lacking, scratch);
        }
        if splits {
            scratch.layers.find_split(shared.outlines);
        }
        scratch.watch.profile.fragments += scratch.layers.len() as u64;
        scratch.watch.lap(Stage::Rasterise);
        let what = match (is_whole, stores) {
            (false, _) => Lines::Window { counts: few.is_none() },
            (true, true) => Lines::Mapped(id),
            (true, false) => Lines::Grid { splits },
        };
        let kept = kept.filter(|kept| kept.is_wanted(shared.directions, id, number));
        scratch.links = kept.map(|_| take(&mut scratch.spare_links));
        // A ray of a split cell stands for a part of the cell.
        made = match (double, shared.parameters.supersample) {
            (true, false) => line.pass::<2>(what, scratch)?,
            (false, false) => line.pass::<3>(what, scratch)?,
            (true, true) => line.pass::<{ 2 * PARTS }>(what, scratch)?,
            (false, true) => line.pass::<{ 3 * PARTS }>(what, scratch)?,
        }
        .or(made);
        if let (Some(mut links), Some(kept)) = (scratch.links.take(), kept) {
            links.fragments = scratch.layers.len() as u64;
            kept.links.put(id, number, &links);
            links.clear();
            scratch.spare_links = links;
        }
        if splits {
            scratch.settle(scratch.layers.len() as u64, false);
            let psf = psf.parted(SPLIT);
            let line = Line { psf: &psf, ..line };
            if line.clips() {
                projections(shared.outlines, &psf, &mut scratch.projections);
            }
            scratch.layers.rasterise_split(shared.outlines, &psf);
            scratch.watch.profile.fragments += scratch.layers.len() as u64;
            scratch.watch.lap(Stage::Rasterise);
            match double {
                true => line.through_window::<2, 1>(scratch),
                false => line.through_window::<3, 1>(scratch),
            }
        }
        scratch.settle(scratch.layers.len() as u64, stores);
        if let Some(error) = scratch.failure.take() {
            return Err(error);
        }
    }
    Ok(made)
}

impl Again<'_> {
    /// Whether the next cycle has a PSF, and there is room for its links.
    fn is_wanted(&self, directions: &Directions, id: DirectionId, number: u32) -> bool {
        let has =
            |next: Grids| number < next.perturbations && directions.is_in_coarser(id, next.thinned);
        self.next.is_some_and(has) && self.links.has_room()
    }
}

/// The lines of one PSF.
#[derive(Clone, Copy)]
struct Line<'a> {
    shared: &'a Shared<'a>,
    cycle: &'a Cycle<'a>,
    psf: &'a Psf,
    /// Which half of all lines they belong to.
    half: usize,
    /// The senders, where only lines of few are wanted.
    few: Option<Few<'a>>,
}

/// Which lines of a PSF there are to pass along.
#[derive(Clone, Copy)]
enum Lines {
    /// Those of the window.
    Window { counts: bool },
    /// All, and the maps of the mirrors on them.
    Mapped(DirectionId),
    /// All, but those of split cells.
    Grid { splits: bool },
}

/// Rays of a split cell.
const PARTS: i64 = (SPLIT * SPLIT) as i64;

/// Lines whose window is transferred at once.
const BLOCK: usize = 256;

impl Line<'_> {
    /// Rasterises only the lines that meet surfaces of which one may send and one lacks lines.
    fn rasterise_through(&self, lacking: Option<&[bool]>, scratch: &mut Scratch) {
        let Shared { scene, outlines, .. } = *self.shared;
        let is_mirror = |s: SurfaceId| scene.material_of(s).reflectance.is_mirror();
        let sends = |few: &Few, surface, point| {
            let sends = |sense| self.may_send(few, (surface, point, FAR), sense);
            !is_mirror(surface) || [Sense::Along, Sense::Against].into_iter().any(sends)
        };
        let few = self.few;
        let through = Through {
            senders: few.map(|few| few.senders),
            sends: |surface, point| few.is_none_or(|few| sends(&few, surface, point)),
            receivers: lacking,
        };
        scratch.layers.rasterise_through(outlines, self.psf, &through);
    }

    /// Passes light along lines, each for so many shares.
    fn pass<const SHARES: i64>(
        &self,
        lines: Lines,
        scratch: &mut Scratch,
    ) -> Result<Option<Made>, FieldError> {
        match lines {
            Lines::Window { counts: false } => self.through_window::<SHARES, 0>(scratch),
            Lines::Window { counts: true } => self.through_window::<SHARES, 1>(scratch),
            Lines::Grid { splits } => self.without_maps::<SHARES, 1>(splits, scratch),
            Lines::Mapped(id) => return self.with_maps::<SHARES, 1>(id, scratch).map(Some),
        }
        Ok(None)
    }

    /// The lines of a window.
    fn through_window<const SHARES: i64, const COUNTS: i64>(&self, scratch: &mut Scratch) {
        let count = scratch.layers.window().len();
        for first in (0..count).step_by(BLOCK) {
            for slot in first..(first + BLOCK).min(count) {
                let cell = scratch.layers.window()[slot];
                self.cell::<SHARES, COUNTS>(cell, slot, scratch);
            }
            self.transfer::<SHARES, COUNTS>(scratch);
        }
    }

    fn without_maps<const SHARES: i64, const COUNTS: i64>(
        &self,
        splits: bool,
        scratch: &mut Scratch,
    ) {
        // Tile by tile here too: neighbouring lines find their texels in the cache.
        let Parameters { resolution, tile: m, .. } = *self.shared.parameters;
        let n = resolution / m;
        for tile in 0..n * n {
            for inside in 0..m * m {
                let cell = Cell { i: tile % n * m + inside % m, j: tile / n * m + inside / m };
                if splits && scratch.layers.is_split(cell) {
                    continue;
                }
                let slot = (cell.j * resolution + cell.i) as usize;
                self.cell::<SHARES, COUNTS>(cell, slot, scratch);
            }
            self.transfer::<SHARES, COUNTS>(scratch);
        }
    }

    /// Tile by tile, as the paper's loops go, writing what arrives at mirrors.
    fn with_maps<const SHARES: i64, const COUNTS: i64>(
        &self,
        id: DirectionId,
        scratch: &mut Scratch,
    ) -> Result<Made, FieldError> {
        let Parameters { resolution, tile: m, .. } = *self.shared.parameters;
        let exponent = self.shared.exponent;
        let before = self.cycle.pages.map(|p| p.get(id.0, ChunkKind::Arrived)).transpose()?;
        let mut unshot = TileMapWriter::new(resolution, m, exponent);
        let mut arrived = TileMapWriter::new(resolution, m, exponent);
        let n = resolution / m;
        for tile in 0..n * n {
            let (s, t) = (tile % n, tile / n);
            scratch.tile.clear();
            for inside in 0..m * m {
                let cell = Cell { i: s * m + inside % m, j: t * m + inside / m };
                let slot = (cell.j * resolution + cell.i) as usize;
                self.cell::<SHARES, COUNTS>(cell, slot, scratch);
                keep_mirrors(self.shared.texels, scratch, cell, inside);
            }
            self.transfer::<SHARES, COUNTS>(scratch);
            unshot.tile(&mut scratch.tile);
            if let Some(before) = &before {
                for kept in &mut scratch.tile {
                    let cell = Cell { i: s * m + kept.cell % m, j: t * m + kept.cell / m };
                    let Some(entry) = before.map().entry(cell, kept.surface) else { continue };
                    for sense in [Sense::Along, Sense::Against] {
                        kept.radiance[sense.slot()] +=
                            entry.radiance(cell, sense).unwrap_or_default();
                    }
                }
            }
            arrived.tile(&mut scratch.tile);
            scratch.watch.lap(Stage::MirrorMaps);
        }
        let made = Made { unshot: unshot.finish(), arrived: arrived.finish() };
        self.tally_stored::<SHARES, COUNTS>(&made.unshot, scratch);
        scratch.watch.profile.map_bytes += (made.unshot.len() + made.arrived.len()) as u64;
        scratch.watch.lap(Stage::MirrorMaps);
        Ok(made)
    }

    /// Exchanges light along the line of one cell, whose fragments have a place in the layers. Pairs
    /// without a mirror are put down and wait for [`Line::transfer`].
    fn cell<const SHARES: i64, const COUNTS: i64>(
        &self,
        cell: Cell,
        slot: usize,
        scratch: &mut Scratch,
    ) {
        let marks = self.cycle.marks;
        let fragments = scratch.layers.slot(slot);
        let Shared { outlines, texels, .. } = *self.shared;
        exchange::order_contacts(fragments, &outlines.contacts, &texels.surface_of);
        let marked = |fragments: &[Fragment]| {
            fragments.iter().fold(0, |all, fragment| all | marks.of(fragment.texel()))
        };
        if marked(fragments) & marks::CUT != 0 {
            self.bring_home(cell, fragments);
        }
        let (Some(first), Some(last)) = (fragments.first(), fragments.last()) else { return };
        let has_mirrors = marked(fragments) & marks::MIRROR != 0;
        let is_diffuse = |f: &Fragment| !has_mirrors || f.texel() < texels.diffuse;
        let outside = self.cycle.outside();
        let mut put = |near: usize, far: usize| {
            // A pair in the dark only counts lines.
            if COUNTS > 0 || self.is_lit(near) || self.is_lit(far) {
                scratch.pairs.push([near as u32, far as u32]);
            }
        };
        if is_diffuse(first) && !marks.is_sealed(first.value_against()) {
            put(outside, first.value_against());
        }
        for pair in fragments.windows(2) {
            let (near, far) = (pair[0], pair[1]);
            if is_diffuse(&near) && is_diffuse(&far) && is_open(near, far, marks) {
                put(near.value_along(), far.value_against());
            }
        }
        if is_diffuse(last) && !marks.is_sealed(last.value_along()) {
            put(last.value_along(), outside);
        }
        if self.clips() {
            scratch.cells.resize(scratch.pairs.len(), cell.into());
        }
        if has_mirrors {
            scratch.arrived.clear();
            scratch.arrived.resize(fragments.len(), [Rgb::BLACK; 2]);
            scratch.line.clear();
            scratch.line.extend_from_slice(fragments);
            self.exchange_with_mirrors::<SHARES, COUNTS>(cell, scratch);
        }
    }

    fn clips(&self) -> bool {
        self.shared.parameters.transfer == Transfer::Clip
    }

    fn ground<'a>(&'a self, projections: &'a [Projection]) -> Ground<'a> {
        Ground { projections, surface_of: &self.shared.texels.surface_of, marks: self.cycle.marks }
    }

    /// Whether a texture value sends anything.
    fn is_lit(&self, value: usize) -> bool {
        !self.cycle.current.radiance(value).is_black()
    }

    /// Gives the fragments of a cell that lie in cut texels the texels that they belong to.
    fn bring_home(&self, cell: Cell, fragments: &mut [Fragment]) {
        let Shared { scene, texels, outlines, .. } = *self.shared;
        for fragment in fragments {
            if self.cycle.marks.of(fragment.texel()) & marks::CUT != 0 {
                let (x, y) = (cell.i as f32 + 0.5, cell.j as f32 + 0.5);
                let point = self.psf.unproject(x, y, fragment.depth());
                let home = outlines.homes.of(scene, texels, fragment.texel(), point);
                *fragment = fragment.with_texel(home);
            }
        }
    }

    /// Texture map to texture map, for the pairs put down. Apart from finding the pairs, so that the
    /// processor can wait for many texels at once.
    fn transfer<const SHARES: i64, const COUNTS: i64>(&self, scratch: &mut Scratch) {
        scratch.watch.lap(Stage::Exchange);
        let (mut pairs, mut cells) = (take(&mut scratch.pairs), take(&mut scratch.cells));
        self.trade::<SHARES, COUNTS>(&pairs, &cells, scratch);
        if let Some(links) = &mut scratch.links {
            links.pairs.extend_from_slice(&pairs);
            links.cells.extend_from_slice(&cells);
        }
        pairs.clear();
        cells.clear();
        (scratch.pairs, scratch.cells) = (pairs, cells);
        scratch.watch.lap(Stage::Transfer);
    }

    /// Each of a pair receives what the other shoots. `cells` are those of the pairs where they are
    /// clipped.
    fn trade<const SHARES: i64, const COUNTS: i64>(
        &self,
        pairs: &[[u32; 2]],
        cells: &[SmallCell],
        scratch: &mut Scratch,
    ) {
        let Scratch { sums, flow, tally, clip, projections, watch, .. } = scratch;
        let sums = &mut sums[self.half];
        let current = self.cycle.current;
        watch.profile.pairs += pairs.len() as u64;
        let shot = if self.clips() {
            let ground = self.ground(projections);
            let shot = clip.exchange::<SHARES, COUNTS>((cells, pairs), &ground, current, sums);
            watch.profile.touches += 2 * clip.tap_count() as u64;
            shot
        } else {
            watch.profile.touches += 4 * pairs.len() as u64;
            transfer::exchange::<SHARES, COUNTS>(pairs, current, sums)
        };
        transfer::add_to(&mut flow.shot, &shot);
        self.leave(sums, tally);
    }

    /// Takes what has left the scene into the tally: over a cycle it is more than one fixed number holds.
    fn leave(&self, sums: &mut [Fixed], tally: &mut Tally) {
        let left = take(&mut sums[self.cycle.outside()]);
        tally.left += i128::from(channels(&left));
    }

    /// Passes light along all lines of a PSF whose links are known.
    fn again<const SHARES: i64>(&self, links: &Links, scratch: &mut Scratch) {
        if self.clips() {
            for (pairs, cells) in links.pairs.chunks(BLOCK).zip(links.cells.chunks(BLOCK)) {
                self.trade::<SHARES, 1>(pairs, cells, scratch);
            }
        } else {
            for pairs in links.pairs.chunks(BLOCK * BLOCK) {
                self.trade::<SHARES, 1>(pairs, &[], scratch);
            }
        }
        self.mirrored_again::<SHARES>(links, scratch);
    }
}

/// Whether light can pass between two neighbours on a line.
fn is_open(near: Fragment, far: Fragment, marks: &Marks) -> bool {
    !marks.is_sealed(near.value_along())
        && !marks.is_sealed(far.value_against())
        && exchange::see_each_other(near, far)
}
