//! One step: everything that a direction does in a cycle.
//!
//! In: the scene, the texture maps and unshot maps of this generation. Out: sums for the diffuse
//! receivers (added to the worker's own), and the direction's tile maps of the next generation. A pure
//! function of its inputs, so that a step may be done again, in any order, by any thread.

use super::exchange;
use super::layers::{Fragment, Layers, Outlines};
use super::ledger::{Tally, channels};
use super::perturb;
use super::transfer::specular::{MirrorSender, sense_vector};
use super::transfer::{Fixed, Quantum, add};
use crate::directions::Directions;
use crate::field::FieldError;
use crate::field::pages::Pages;
use crate::format::container::ChunkKind;
use crate::format::manifest::Parameters;
use crate::format::tiles::{CoveredCell, TileMapWriter};
use crate::ids::{Cell, DirectionId, Sense, SurfaceId};
use crate::psf::Psf;
use crate::radiance::Rgb;
use crate::scene::Scene;
use crate::scene::texels::Texels;

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
}

/// What all steps of a cycle share.
pub struct Cycle<'a> {
    /// Its number.
    pub number: u32,
    /// Current texture maps in fixed point, two values a texel.
    pub current: &'a [Fixed],
    /// Unshot maps of mirrors; none in the first cycle and in scenes without mirrors.
    pub pages: Option<&'a Pages<'a>>,
    /// PSFs each direction stands for.
    pub perturbations: u32,
}

/// A worker's own memory, reused from step to step.
pub struct Scratch {
    layers: Layers,
    /// Sums over lines, two a texel.
    pub sums: Vec<Fixed>,
    /// Sums for the ledger.
    pub tally: Tally,
    senders: Vec<Option<MirrorSender>>,
    used_senders: Vec<usize>,
    arrived: Vec<[Rgb; 2]>,
    tile: Vec<CoveredCell>,
}

/// The tile maps a step made: unshot radiance, and all that has arrived so far.
pub struct Made {
    /// Bytes of the unshot map.
    pub unshot: Vec<u8>,
    /// Bytes of the map of all that arrived.
    pub arrived: Vec<u8>,
}

/// Nothing comes along a line from outside the scene; but it counts as a line.
const FROM_OUTSIDE: Fixed = [0, 0, 0, 1];

impl Scratch {
    /// For a scene's texels.
    pub fn new(texels: &Texels) -> Scratch {
        let mirrors = texels.len() - texels.diffuse as usize;
        Scratch {
            layers: Layers::default(),
            sums: vec![[0; 4]; 2 * texels.len()],
            tally: Tally::default(),
            senders: (0..2 * mirrors).map(|_| None).collect(),
            used_senders: Vec::new(),
            arrived: Vec::new(),
            tile: Vec::new(),
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
    for number in 0..cycle.perturbations {
        let psf = perturb::psf(shared.directions, id, number, shared.parameters.resolution);
        scratch.layers.rasterise(shared.outlines, &psf);
        scratch.tally.fragments += scratch.layers.len() as u64;
        let shares = shared.directions.shares(id).into();
        let mut line = Line { shared, cycle, psf: &psf, shares, is_true: number == 0 };
        if number == 0 && shared.has_mirrors() {
            made = Some(line.with_maps(id, scratch)?);
        } else {
            line.without_maps(scratch)?;
        }
        for used in scratch.used_senders.drain(..) {
            scratch.senders[used] = None;
        }
    }
    Ok(made)
}

/// The lines of one PSF.
struct Line<'a> {
    shared: &'a Shared<'a>,
    cycle: &'a Cycle<'a>,
    psf: &'a Psf,
    shares: i64,
    is_true: bool,
}

impl Line<'_> {
    fn without_maps(&mut self, scratch: &mut Scratch) -> Result<(), FieldError> {
        for j in 0..self.psf.resolution {
            for i in 0..self.psf.resolution {
                self.cell(Cell { i, j }, scratch)?;
            }
        }
        Ok(())
    }

    /// Tile by tile, as the paper's loops go, writing what arrives at mirrors.
    fn with_maps(&mut self, id: DirectionId, scratch: &mut Scratch) -> Result<Made, FieldError> {
        let Parameters { resolution, tile: m, .. } = *self.shared.parameters;
        let exponent = self.shared.exponent;
        let before = self.cycle.pages.map(|p| p.read(id.0, ChunkKind::Arrived)).transpose()?;
        let mut unshot = TileMapWriter::new(resolution, m, exponent);
        let mut arrived = TileMapWriter::new(resolution, m, exponent);
        let n = resolution / m;
        for tile in 0..n * n {
            let (s, t) = (tile % n, tile / n);
            scratch.tile.clear();
            for inside in 0..m * m {
                let cell = Cell { i: s * m + inside % m, j: t * m + inside / m };
                self.cell(cell, scratch)?;
                keep_mirrors(self.shared.texels, scratch, cell, inside);
            }
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
        }
        let made = Made { unshot: unshot.finish(), arrived: arrived.finish() };
        self.tally_stored(&made.unshot, scratch);
        Ok(made)
    }

    /// Exchanges light along the line of one cell.
    fn cell(&mut self, cell: Cell, scratch: &mut Scratch) -> Result<(), FieldError> {
        let Scratch { layers, sums, tally, senders, used_senders, arrived, .. } = scratch;
        let fragments = layers.cell(cell.i, cell.j);
        arrived.clear();
        arrived.resize(fragments.len(), [Rgb::BLACK; 2]);
        let mut failure = None;
        exchange::pairs(fragments, |near, far| {
            tally.pairs += 1;
            let mut sent = |fragment: Option<(usize, Fragment)>, sense| match fragment {
                None => Ok(FROM_OUTSIDE),
                Some((_, f)) if f.texel() < self.shared.texels.diffuse => {
                    let value = match sense {
                        Sense::Along => f.value_along(),
                        Sense::Against => f.value_against(),
                    };
                    let line = self.cycle.current[value];
                    tally.shot_diffuse += i128::from(channels(&line) * self.shares);
                    Ok(line)
                }
                Some((_, f)) => self.mirror(cell, f, sense, (senders, used_senders), tally),
            };
            let (along, against) = (sent(near, Sense::Along), sent(far, Sense::Against));
            let (along, against) = match (along, against) {
                (Ok(along), Ok(against)) => (along, against),
                (Err(e), _) | (_, Err(e)) => {
                    failure.get_or_insert(e);
                    return;
                }
            };
            // What goes along arrives at the far one's side that faces against the direction.
            for (receiver, line, sense) in
                [(far, along, Sense::Against), (near, against, Sense::Along)]
            {
                match receiver {
                    None => tally.left += i128::from(channels(&line) * self.shares),
                    Some((_, f)) if f.texel() < self.shared.texels.diffuse => {
                        let value = match sense {
                            Sense::Along => f.value_along(),
                            Sense::Against => f.value_against(),
                        };
                        add(&mut sums[value], &line, self.shares);
                    }
                    Some((k, f)) => {
                        self.arrive(f, &line, tally);
                        arrived[k][sense.slot()] = self.shared.quantum.radiance(line);
                    }
                }
            }
        });
        failure.map_or(Ok(()), Err)
    }

    /// What a mirror sends from its fragment in a cell.
    fn mirror(
        &self,
        cell: Cell,
        fragment: Fragment,
        sense: Sense,
        (senders, used): (&mut [Option<MirrorSender>], &mut Vec<usize>),
        tally: &mut Tally,
    ) -> Result<Fixed, FieldError> {
        let Shared { scene, texels, directions, .. } = self.shared;
        let mirror = fragment.texel() - texels.diffuse;
        let slot = 2 * mirror as usize + sense.slot();
        let sender = match &mut senders[slot] {
            Some(sender) => sender,
            empty => {
                let surface = SurfaceId(texels.surface_of[fragment.texel() as usize]);
                let outgoing = sense_vector(self.psf.direction, sense);
                let emits = self.cycle.number == 0;
                used.push(slot);
                let what = (surface, outgoing, emits);
                let pages = self.cycle.pages;
                empty.insert(MirrorSender::new(
                    scene,
                    directions,
                    pages,
                    what,
                    self.psf.resolution,
                )?)
            }
        };
        tally.gathers += 1;
        let (x, y) = (cell.i as f32 + 0.5, cell.j as f32 + 0.5);
        let radiance = sender.radiance(self.psf.unproject(x, y, fragment.depth()));
        if radiance.is_none() {
            tally.holes += 1;
        }
        let line = self.shared.quantum.fixed(radiance.unwrap_or_default());
        tally.shot_mirror += i128::from(channels(&line) * self.shares);
        Ok(line)
    }

    /// Accounts for light that arrives at a mirror.
    fn arrive(&self, fragment: Fragment, line: &Fixed, tally: &mut Tally) {
        let surface = SurfaceId(self.shared.texels.surface_of[fragment.texel() as usize]);
        let rho = self.shared.scene.material_of(surface).reflectance.factor().0;
        let reflected: i64 = (0..3).map(|c| (line[c] as f64 * f64::from(rho[c])) as i64).sum();
        tally.to_mirror += i128::from(channels(line) * self.shares);
        tally.mirrored += i128::from(reflected * self.shares);
        if self.is_true {
            tally.mirrored_true += i128::from(reflected * self.shares);
        }
    }

    /// Accounts for the unshot radiance as it was stored.
    fn tally_stored(&self, unshot: &[u8], scratch: &mut Scratch) {
        let Parameters { resolution, tile, .. } = *self.shared.parameters;
        let surfaces = self.shared.scene.surfaces.len() as u32;
        let check = crate::format::tiles::Layout::check;
        let Ok(layout) = check(unshot, resolution, tile, surfaces, self.shared.exponent) else {
            return;
        };
        let map = crate::format::tiles::TileMap::new(unshot, &layout);
        map.for_each(|surface, _, both| {
            let rho = self.shared.scene.material_of(surface).reflectance.factor();
            for radiance in both {
                let line = self.shared.quantum.fixed(radiance * rho);
                scratch.tally.stored += i128::from(channels(&line) * self.shares);
            }
        });
    }
}

/// Keeps what arrived at the mirrors of a cell for the tile's map.
fn keep_mirrors(texels: &Texels, scratch: &mut Scratch, cell: Cell, inside: u32) {
    let fragments = scratch.layers.cell(cell.i, cell.j);
    for (fragment, radiance) in fragments.iter().zip(&scratch.arrived) {
        if fragment.texel() >= texels.diffuse {
            let surface = SurfaceId(texels.surface_of[fragment.texel() as usize]);
            scratch.tile.push(CoveredCell { surface, cell: inside, radiance: *radiance });
        }
    }
}
