//! What a bake holds in memory, and how much of the grant is left for the page cache.
//!
//! Everything that grows with the scene or the resolution is counted: texture maps and sums, each
//! worker's scratch, maps that wait to be written, pages. What does not (code, stacks, what the
//! allocator keeps) is [`CONSTANT`] and not part of the grant.

use super::MOST_CYCLES;
use super::ahead::gathered_from;
use super::layers::{Layers, SPLIT};
use super::links::Shown;
use super::marks::Marks;
use super::step::{Scratch, Shared};
use super::transfer::clip::Clip;
use crate::field::writer::{WAITING, WRITERS};
use crate::format::limits::WORST;
use crate::format::manifest::{Parameters, Transfer};
use crate::ids::DirectionId;
use crate::psf::Psf;
use crate::scene::Scene;
use crate::scene::reflectances::Reflectances;

/// Bytes beyond the grant that a process of this program takes.
pub const CONSTANT: u64 = 48 << 20;

/// Bytes for each corner of a polygon in the hierarchies that paths are followed through. Measured.
const A_CORNER: u64 = 512;

/// Bytes of a surface of the scene with its polygons.
const A_SURFACE: u64 = 400;

/// Bytes for each texture value that the allocator keeps of maps let go, to hand them out again: the GNU C
/// library keeps about as much as the largest block so far, up to [`MOST_KEPT`]. Measured.
const KEPT: u64 = 20;

/// The most that it keeps.
const MOST_KEPT: u64 = 64 << 20;

/// The most bytes that the links between two neighbours on a line take while they are found: what a mirror
/// shows each way, in a list that grows.
const A_LINK: u64 = 2 * 2 * size_of::<Shown>() as u64;

/// Bytes in which disks give room.
const A_BLOCK: u64 = 4096;

/// Bytes of a commit record without its bit a direction and its ledgers.
const RECORD: u64 = 1024 + 20 * WORST as u64;

/// Bytes of a cycle's ledger and its number of grids in a commit record.
const A_LEDGER: u64 = 84;

/// Directions that are looked at before a bake begins.
const LOOKS: u32 = 24;

/// What one direction takes; of several, the most.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Extent {
    /// Fragments of its PSF, or of the parts of its split cells, if these have more.
    pub fragments: u64,
    /// Parts of its split cells.
    pub parts: u64,
    /// Bytes of its total radiance map.
    pub total_map: u64,
    /// Bytes of its map of what arrived at mirrors.
    pub mirror_map: u64,
    /// Bytes of the excerpts that its mirrors gather from.
    pub excerpts: u64,
    /// Maps that its mirrors gather from.
    pub gathered: u64,
}

impl Extent {
    /// The larger of the two, figure by figure.
    pub fn most(self, other: Extent) -> Extent {
        Extent {
            fragments: self.fragments.max(other.fragments),
            parts: self.parts.max(other.parts),
            total_map: self.total_map.max(other.total_map),
            mirror_map: self.mirror_map.max(other.mirror_map),
            excerpts: self.excerpts.max(other.excerpts),
            gathered: self.gathered.max(other.gathered),
        }
    }

    /// Of the layers of a direction, every covered side taken to be lit.
    pub fn of(shared: &Shared, id: DirectionId, layers: &mut Layers) -> Extent {
        let p = shared.parameters;
        let (m, n) = (p.tile, p.resolution / p.tile);
        let diffuse = shared.texels.diffuse;
        let mut last = vec![u32::MAX; shared.scene.surfaces.len()];
        // Entries and fragments, of all surfaces and of mirrors.
        let (mut entries, mut fragments) = ([0u64; 2], [0u64; 2]);
        for tile in 0..n * n {
            for inside in 0..m * m {
                let (i, j) = (tile % n * m + inside % m, tile / n * m + inside / m);
                for fragment in layers.cell(i, j) {
                    let mirror = u64::from(fragment.texel() >= diffuse);
                    fragments = [fragments[0] + 1, fragments[1] + mirror];
                    let surface = shared.texels.surface_of[fragment.texel() as usize] as usize;
                    if last[surface] != tile {
                        last[surface] = tile;
                        entries = [entries[0] + 1, entries[1] + mirror];
                    }
                }
            }
        }
        let words = u64::from(m * m).div_ceil(64);
        let map = |k: usize| {
            48 + 4 * u64::from(n * n + 1) + entries[k] * (14 + 8 * words) + 12 * fragments[k]
        };
        let (mirrors, along) =
            (diffuse as usize..shared.texels.len(), shared.directions.vector(id));
        let psf = Psf::new(along, p.resolution);
        // Rectangles of cells around each mirror, three directions and two senses of 12 bytes a cell.
        let around = mirrors.clone().map(|texel| {
            let surface = &shared.scene.surfaces[shared.texels.surface_of[texel] as usize];
            let (u, v) = (surface.u * surface.extent.x, surface.v * surface.extent.y);
            let (a, b) = (psf.project(u) - psf.project(-u), psf.project(v) - psf.project(-v));
            let wide = |a: f32, b: f32| u64::from((0.5 * (a.abs() + b.abs())) as u32 + 3);
            72 * wide(a.x, b.x) * wide(a.y, b.y)
        });
        Extent {
            fragments: fragments[0],
            parts: 0,
            total_map: map(0),
            mirror_map: if mirrors.is_empty() { 0 } else { map(1) },
            excerpts: around.sum(),
            gathered: 0,
        }
    }

    /// The most of some directions all around, with a margin for the others.
    pub fn probe(shared: &Shared) -> Extent {
        let curve = shared.directions.curve();
        let step = (curve.len() / LOOKS as usize).max(1);
        let mut layers = Layers::default();
        let marks = Marks::new(shared.texels);
        let mut most = Extent::default();
        for id in curve.into_iter().step_by(step) {
            let psf = Psf::new(shared.directions.vector(id), shared.parameters.resolution);
            layers.rasterise(shared.outlines, &psf);
            let gathered = gathered_from(shared, &marks, id).len() as u64;
            most = most.most(Extent { gathered, ..Extent::of(shared, id, &mut layers) });
            if shared.parameters.supersample {
                layers.find_split(shared.outlines);
                layers.rasterise_split(shared.outlines, &psf.parted(SPLIT));
                let (parts, fragments) = (layers.window().len() as u64, layers.len() as u64);
                most = most.most(Extent { parts, fragments, ..Extent::default() });
            }
        }
        let more = |v: u64| v + v / 4;
        Extent {
            fragments: more(most.fragments),
            parts: more(most.parts),
            total_map: more(most.total_map),
            mirror_map: more(most.mirror_map),
            excerpts: more(most.excerpts),
            gathered: most.gathered,
        }
    }
}

/// Corners of all polygons.
fn corners(scene: &Scene) -> u64 {
    let polygons = scene.surfaces.iter().flat_map(|s| &s.polygons);
    polygons.map(|p| p.vertices.len() as u64).sum()
}

/// Bytes of all texture values while light is propagated: what is shot, every worker's sums of both halves,
/// and when a cycle or a round of it ends the total and next maps of all lines and of half of them, and two
/// areas; with rounds, the sums of surfaces that have lines enough, and both halves' taken to as many. A cycle that has ended holds the sums of one worker and nothing that is shot.
pub fn texture_bytes(values: u64, threads: u64, parameters: &Parameters) -> u64 {
    let (shot, sums) = (16, 2 * 32);
    // Maps that are filtered more often are tried beside those chosen.
    let tried = if parameters.filter > 1 { 2 * 12 } else { 0 };
    let maps = 4 * 12 + 2 * 8 + tried;
    let rounds = if parameters.target_error > 0.0 { 2 * sums } else { 0 };
    let while_shot = if rounds > 0 { rounds + maps } else { 0 };
    let each = (shot + sums * threads + while_shot).max(sums + rounds + maps);
    values * each + (KEPT * values).min(MOST_KEPT)
}

/// Bytes of what lasts as long as the bake: texels' surfaces, cuts, areas and reflectances, which values are
/// sealed, outlines, the scene with its images, and the hierarchies of paths through it, of all surfaces and of few.
pub fn lasting_bytes(shared: &Shared) -> u64 {
    let values = 2 * shared.texels.len() as u64;
    let images: u64 = shared.scene.images.iter().map(|image| image.bytes()).sum();
    let scene = A_SURFACE * shared.scene.surfaces.len() as u64 + images;
    let reflectances = Reflectances::bytes(shared.scene, shared.texels);
    let follows = shared.has_mirrors() && !shared.parameters.totals_from_store();
    let hierarchies = if follows { A_CORNER * corners(shared.scene) } else { 0 };
    let areas = 4 * values / 2;
    let texels = shared.texels.bytes() + areas + reflectances + values / 8;
    texels + shared.outlines.bytes() + scene + hierarchies
}

/// Bytes that a bake needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Need {
    /// Whatever the page cache holds, while light is propagated and while total maps are written.
    pub fixed: [u64; 2],
    /// The least that the page cache must hold.
    pub least_pages: u64,
    /// Links of PSFs that are being found; if there is as much to spare.
    pub links: u64,
    /// All pages of a generation: with more, the cache has nothing left to do.
    pub all_pages: u64,
    /// Bytes of the disk that must be free when a direction is begun, while light is propagated and
    /// while total maps are written: for its maps, those that are under way, and a commit of them all.
    pub room: [u64; 2],
}

impl Need {
    /// Of a bake on so many threads whose directions take at most `extent`.
    pub fn new(shared: &Shared, extent: &Extent, threads: u64) -> Need {
        let values = 2 * shared.texels.len() as u64;
        let cells = u64::from(shared.parameters.resolution).pow(2);
        let surfaces = shared.scene.surfaces.len() as u64;
        let lasting = lasting_bytes(shared);
        let mirrors = values / 2 - u64::from(shared.texels.diffuse);
        let layers = 4 * cells + 16 * extent.parts + 12 * extent.fragments + 256 * surfaces;
        let stores = shared.stores_mirrors();
        let extent =
            if stores { *extent } else { Extent { mirror_map: 0, excerpts: 0, ..*extent } };
        // A map that is being made takes twice its bytes, and once more when it is finished.
        let clips = shared.parameters.transfer == Transfer::Clip;
        let clip = if clips { Clip::BYTES + Clip::A_SURFACE * surfaces } else { 0 };
        let scratch =
            layers + clip + 6 * extent.mirror_map + extent.excerpts + mirrors * Scratch::A_MIRROR;
        let waiting = (WAITING + WRITERS) as u64;
        let propagating = texture_bytes(values, threads, shared.parameters)
            + threads * scratch
            + waiting * 2 * extent.mirror_map;
        // Images are averaged before anything is propagated.
        let propagating = lasting + propagating.max(Reflectances::passing_bytes(shared.scene));
        let totals = lasting
            + values * 12
            + threads * (layers + 3 * extent.total_map)
            + waiting * extent.total_map;
        let directions = shared.directions.len() as u64;
        let under_way = |map: u64| (threads + waiting) * map.next_multiple_of(A_BLOCK);
        let cycles = u64::from(shared.parameters.cycles.unwrap_or(MOST_CYCLES));
        let record = (RECORD + directions / 8 + A_LEDGER * cycles).next_multiple_of(A_BLOCK);
        // Sums take more than the texture maps that come in their place at the end of a cycle.
        let sums = (values * 64 + 2 * A_BLOCK).next_multiple_of(A_BLOCK);
        Need {
            fixed: [propagating, totals],
            links: threads * A_LINK * (extent.fragments + cells),
            least_pages: 2 * threads * extent.mirror_map,
            all_pages: (directions + 2 * threads) * extent.mirror_map,
            room: [
                under_way(2 * extent.mirror_map) + sums + record,
                under_way(extent.total_map) + record,
            ],
        }
    }

    /// What a grant leaves for links while light is propagated.
    pub fn spare(&self, granted: u64) -> u64 {
        let taken = self.fixed[0].max(self.fixed[1]) + self.all_pages + self.links;
        granted.saturating_sub(taken)
    }

    /// The smallest grant that works.
    pub fn smallest(&self) -> u64 {
        self.fixed[0].max(self.fixed[1]) + self.least_pages
    }
}
