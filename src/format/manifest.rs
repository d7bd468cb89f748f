//! The manifest: what a field is, how far its bake has come, and its energy ledger.
//!
//! One record, encoded with bincode 2 (little-endian, fixed-width integers, fields in the order they
//! stand here) inside a checksummed chunk. `format-spec/` lists the bytes.

#![deny(
    clippy::arithmetic_side_effects,
    clippy::cast_possible_truncation,
    clippy::indexing_slicing
)]

use super::container::{self, ChunkId, ChunkKind, FieldId, FileKind, Header, NO_DIRECTION};
use super::limits::{self, Limits};
use super::{Fault, FormatError};
use serde::{Deserialize, Serialize};

/// What decides the bits of a field, besides the scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Parameters {
    /// Lines, l.
    pub directions: u32,
    /// Cells along an edge of a PSF, N.
    pub resolution: u32,
    /// Cells along an edge of a tile, m.
    pub tile: u32,
    /// Cycles to run; `None` is `auto`.
    pub cycles: Option<u32>,
    /// With `auto`: stop when this fraction of the emitted power is still unshot.
    pub unshot_fraction: f64,
    /// PSFs each line stands for in each cycle, its own included; see `thinned` for later cycles.
    pub perturbations: Vec<u32>,
    /// In cycles later than `perturbations` names, only the lines of a lattice with steps `2^thinned`
    /// times as long; with 0, the last of `perturbations` counts for all of them.
    pub thinned: u32,
    /// Edge of a texel in cells.
    pub texel_cells: f64,
    /// Where light has edges, texels are finer, up to so many times as many in all; 1: nowhere.
    pub refined: f64,
    /// Whether light along the rays of cells that a surface's border passes through is exchanged by 2 x 2
    /// rays in the place of one.
    pub supersample: bool,
    /// The most passes of the binomial filter over the first cycle's Next Texture Maps; later ones have one,
    /// unless this is 0.
    pub filter: u32,
    /// Whether surfaces have a front only.
    pub one_sided: bool,
    /// How light goes from texels to cells and from cells to texels.
    pub transfer: Transfer,
    /// How mirrors send light on.
    pub specular: Specular,
    /// Whether mirrors' total maps are found along true paths after the last cycle.
    pub resample: bool,
    /// The noise of lines is brought down to where pictures have about this relMSE, as far as
    /// `perturbations` allow, which are then the most PSFs a line may stand for; 0: they are what it
    /// stands for.
    pub target_error: f64,
}

/// How light goes from texels to cells and from cells to texels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Transfer {
    /// From and to the texel that a cell's middle ray meets.
    Sample,
    /// From and to all texels that the cell overlaps, by the area of the overlap (section 4.2).
    Clip,
}

/// How mirrors send light on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Specular {
    /// From their unshot maps: what arrived in one cycle, interpolated, leaves in the next (section 4.3).
    Maps,
    /// By following the true path back to a diffuse surface, in the same cycle; nothing is stored.
    Trace,
}

impl Default for Parameters {
    /// Those of `vlf bake` without options, but for one grid a direction.
    fn default() -> Parameters {
        Parameters {
            directions: 2049,
            resolution: 128,
            tile: 16,
            cycles: None,
            unshot_fraction: 1e-3,
            perturbations: vec![1],
            thinned: 0,
            texel_cells: 1.0,
            refined: 1.0,
            supersample: false,
            filter: 0,
            one_sided: false,
            transfer: Transfer::Sample,
            specular: Specular::Trace,
            resample: true,
            target_error: 0.0,
        }
    }
}

impl Parameters {
    /// Edge of a texel of the diffuse texture maps, in the fitted scene's units.
    #[allow(clippy::cast_possible_truncation, reason = "0.1 to 100")]
    pub fn texel_edge(&self) -> f32 {
        2.0 / self.resolution as f32 * self.texel_cells as f32
    }

    /// Whether mirrors' maps are written while light is propagated.
    pub fn stores_mirrors(&self) -> bool {
        self.specular == Specular::Maps
    }

    /// The PSFs of a cycle. Where mirrors' maps are written, each needs those of all lines.
    pub fn grids(&self, cycle: u32) -> Grids {
        let counts = &self.perturbations;
        let thins = self.thinned > 0 && !self.stores_mirrors();
        match counts.get(cycle as usize).or(counts.last().filter(|_| !thins)) {
            Some(&perturbations) => Grids { perturbations, thinned: 0 },
            None => Grids { perturbations: 1, thinned: self.thinned },
        }
    }

    /// Whether mirrors' total maps are what was stored of them.
    pub fn totals_from_store(&self) -> bool {
        self.stores_mirrors() && !self.resample
    }
}

/// The most that steps of the lattice can be doubled for late cycles.
pub const MOST_THINNED: u32 = 9;

/// The PSFs of one cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grids {
    /// PSFs that each of its lines stands for, its own included.
    pub perturbations: u32,
    /// Its lines are those of a lattice with steps `2^thinned` times as long.
    pub thinned: u32,
}

impl Grids {
    /// PSFs for each line of the full lattice.
    pub fn per_line(self) -> f64 {
        f64::from(self.perturbations) / f64::from(4u32.pow(self.thinned.min(MOST_THINNED)))
    }
}

/// Where a bake stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Phase {
    /// Cycle `cycle` of the propagation is under way.
    Propagating,
    /// The total radiance maps are being written.
    WritingTotals,
    /// All is there.
    Finished,
}

/// The energy ledger of one cycle, in W (mean of the channels, the scene's own units of length).
///
/// `emitted + carried_in = absorbed + left + unshot + holes + sampling + quantised`, up to
/// [`CycleLedger::residual`]; `unshot` is the sum of the diffuse surfaces' and the mirrors'.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CycleLedger {
    /// The cycle.
    pub cycle: u32,
    /// Emitted at the start of this cycle.
    pub emitted: f64,
    /// Unshot power that the cycle before left.
    pub carried_in: f64,
    /// Absorbed by surfaces.
    pub absorbed: f64,
    /// Left the scene along lines that meet nothing more.
    pub left: f64,
    /// Reflected by diffuse surfaces in this cycle and not yet shot.
    pub unshot_diffuse: f64,
    /// What mirrors will reflect of what arrived at them in this cycle.
    pub unshot_mirror: f64,
    /// Lost (positive) or gained by interpolating mirrors' radiance between directions and cells.
    pub holes: f64,
    /// Lost or gained because lines sample areas: what the lines carry less what the areas say.
    pub sampling: f64,
    /// Lost or gained by rounding stored radiance.
    pub quantised: f64,
}

impl CycleLedger {
    /// What came in.
    pub fn income(&self) -> f64 {
        self.emitted + self.carried_in
    }

    /// What is still to be shot.
    pub fn unshot(&self) -> f64 {
        self.unshot_diffuse + self.unshot_mirror
    }

    /// What the ledger does not account for, as a fraction of what came in.
    pub fn residual(&self) -> f64 {
        let out = self.absorbed + self.left + self.unshot();
        let lost = self.holes + self.sampling + self.quantised;
        if self.income() > 0.0 { (self.income() - out - lost) / self.income() } else { 0.0 }
    }
}

/// The squared error to expect of pictures (`--method trace`) of all that is lit, relative to squared
/// radiance as `vlf compare` has it; estimated, and as a rule right within a factor of two. A picture
/// that shows little of what is lit may be better or worse.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ErrorEstimate {
    /// Of the whole: relMSE.
    pub relmse: f64,
    /// What of it comes from the number of lines; the rest from texels' size.
    pub noise: f64,
    /// The surfaces that bring the most of it, at most [`limits::WORST`], worst first.
    pub worst: Vec<SurfaceError>,
}

/// The error of one surface, both sides.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SurfaceError {
    /// The surface.
    pub surface: u32,
    /// Its own relMSE.
    pub relmse: f64,
    /// What part of the whole error is on it, 0 to 1.
    pub part: f64,
}

/// Figures of a bake that `vlf info` shows; they do not count into the field's digest.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Statistics {
    /// Seconds of baking so far, over all runs.
    pub seconds: f64,
    /// Fragments rasterised.
    pub fragments: u64,
    /// Radiance lookups in unshot maps of mirrors.
    pub gathers: u64,
    /// Lookups that found no cell of the mirror in any of the three directions.
    pub holes: u64,
    /// Bytes of files written.
    pub bytes_written: u64,
    /// Entries of the total maps, one a surface, tile and direction.
    pub entries: u64,
    /// What the page cache did.
    pub cache: CacheFigures,
    /// Seconds between commits that reached the disk for certain; `None`: the system decided.
    pub sync: Option<f64>,
}

/// What the page cache did, over all runs of a bake.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CacheFigures {
    /// Pages that were there when a step asked for them.
    pub hits: u64,
    /// Pages that a step had to wait for.
    pub misses: u64,
    /// Pages given up for others.
    pub evictions: u64,
    /// Pages read again after they had been given up.
    pub redundant: u64,
    /// Bytes read.
    pub bytes: u64,
    /// Most bytes held at once.
    pub peak: u64,
    /// Seconds that steps waited for pages, summed over threads.
    pub wait: f64,
}

impl CacheFigures {
    /// Counts another run's figures in.
    pub fn add(&mut self, other: &CacheFigures) {
        self.hits = self.hits.saturating_add(other.hits);
        self.misses = self.misses.saturating_add(other.misses);
        self.evictions = self.evictions.saturating_add(other.evictions);
        self.redundant = self.redundant.saturating_add(other.redundant);
        self.bytes = self.bytes.saturating_add(other.bytes);
        self.peak = self.peak.max(other.peak);
        self.wait += other.wait;
    }
}

/// The commit record of a field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Revision of the algorithm; fields of another one are not continued.
    pub revision: u32,
    /// What decides the bits.
    pub parameters: Parameters,
    /// Hash of the scene's bytes.
    pub scene_hash: [u8; 16],
    /// Where the bake stands.
    pub phase: Phase,
    /// The cycle under way, or the number of cycles done.
    pub cycle: u32,
    /// Directions of the step under way that are done, one bit each, low bit first.
    pub done: Vec<u8>,
    /// Number of commits so far; names the manifest's own file and the file of the sums.
    pub sequence: u64,
    /// Whether a file of sums belongs to this commit.
    pub has_sums: bool,
    /// One ledger a finished cycle.
    pub ledger: Vec<CycleLedger>,
    /// PSFs that each line stood for, by cycle; of the cycle under way those before the round under way.
    pub grids: Vec<u32>,
    /// The error after the last finished cycle.
    pub error: ErrorEstimate,
    /// Figures.
    pub statistics: Statistics,
    /// Digest of the finished field, else zero.
    pub digest: [u8; 16],
}

#[allow(clippy::cast_possible_truncation, reason = "the limit fits into 32 bits")]
fn config() -> impl bincode::config::Config {
    bincode::config::standard()
        .with_little_endian()
        .with_fixed_int_encoding()
        .with_limit::<{ limits::RECORD as usize }>()
}

/// Encodes a small metadata record.
///
/// # Errors
/// When it is larger than the limit.
pub fn record_to_bytes<T: Serialize>(record: &T) -> Result<Vec<u8>, Fault> {
    bincode::serde::encode_to_vec(record, config()).map_err(|e| Fault::invalid(e.to_string()))
}

/// Decodes a small metadata record that takes exactly these bytes.
///
/// # Errors
/// When the bytes are not such a record, or surplus bytes follow it.
pub fn record_from_bytes<T: for<'a> Deserialize<'a>>(bytes: &[u8]) -> Result<T, Fault> {
    let (record, used) = bincode::serde::decode_from_slice(bytes, config())
        .map_err(|e| Fault::invalid(format!("record: {e}")))?;
    match bytes.len().saturating_sub(used) {
        0 => Ok(record),
        surplus => Err(Fault::Surplus(surplus as u64)),
    }
}

impl Manifest {
    /// The place of the record's chunk in its file.
    pub const ID: ChunkId = ChunkId { kind: ChunkKind::Record, cycle: 0, direction: NO_DIRECTION };

    /// Reads a manifest file and checks what it says against its first block.
    ///
    /// # Errors
    /// The first fault found.
    pub fn from_file(
        name: &str,
        file: &[u8],
        limits: &Limits,
    ) -> Result<(Header, Manifest), FormatError> {
        let directory = container::open(name, file, FileKind::Manifest, limits)?;
        let read = || {
            let entry = directory.find(ChunkKind::Record, NO_DIRECTION)?;
            let manifest: Manifest = record_from_bytes(&directory.chunk(file, entry)?)?;
            manifest.check(&directory.header)?;
            Ok(manifest)
        };
        let manifest = read().map_err(|f: Fault| f.in_file(name))?;
        Ok((directory.header, manifest))
    }

    /// The state of a field, from its two manifest files where they are there: the sound one of the
    /// higher sequence. Also says what is wrong with the other one, if anything is.
    ///
    /// # Errors
    /// When none is there or sound, one was made by a later version, or one is beyond the limits.
    pub fn newest(
        field: &str,
        files: [Option<(String, Vec<u8>)>; 2],
        limits: &Limits,
    ) -> Result<(Header, Manifest, Option<FormatError>), FormatError> {
        let mut best: Option<(Header, Manifest)> = None;
        let mut fault = None;
        for (name, bytes) in files.into_iter().flatten() {
            match Manifest::from_file(&name, &bytes, limits) {
                Ok((header, manifest)) => {
                    if best.as_ref().is_none_or(|(_, m)| m.sequence < manifest.sequence) {
                        best = Some((header, manifest));
                    }
                }
                Err(e) if e.fault.is_unsupported() || e.fault.is_limited() => return Err(e),
                Err(e) => fault = Some(e),
            }
        }
        match (best, fault) {
            (Some((header, manifest)), fault) => Ok((header, manifest, fault)),
            (None, Some(fault)) => {
                let what = format!("no valid commit record; nothing was changed ({fault})");
                Err(Fault::invalid(what).in_file(field))
            }
            (None, None) => Err(Fault::Foreign.in_file(field)),
        }
    }

    /// Checks the record against the first block of its file.
    ///
    /// # Errors
    /// The first contradiction found.
    pub fn check(&self, header: &Header) -> Result<(), Fault> {
        let p = &self.parameters;
        let same = p.directions == header.directions
            && p.resolution == header.resolution
            && p.tile == header.tile;
        if !same || self.done.len() != (p.directions as usize).div_ceil(8) {
            return Err(Fault::invalid("its parameters are not those of its first block"));
        }
        let counts = p.filter <= 64 && p.thinned <= MOST_THINNED;
        if !(0.1..=100.0).contains(&p.texel_cells)
            || p.perturbations.is_empty()
            || !counts
            || !(1.0..=64.0).contains(&p.refined)
        {
            return Err(Fault::invalid("its parameters are out of range"));
        }
        if !(0.0..=1.0).contains(&p.target_error) || self.error.worst.len() > limits::WORST {
            return Err(Fault::invalid("its error or the one aimed at is out of range"));
        }
        if p.specular == Specular::Trace && !p.resample {
            return Err(Fault::invalid("its mirrors' maps are neither stored nor traced"));
        }
        Ok(())
    }

    /// Whether a direction of the step under way is done.
    pub fn is_done(&self, direction: u32) -> bool {
        let byte = self.done.get(direction as usize / 8);
        byte.is_some_and(|byte| byte >> (direction % 8) & 1 == 1)
    }

    /// Marks a direction of the step under way as done.
    pub fn mark_done(&mut self, direction: u32) {
        if let Some(byte) = self.done.get_mut(direction as usize / 8) {
            *byte |= 1 << (direction % 8);
        }
    }

    /// Directions of the step under way that are done.
    pub fn done_count(&self) -> u32 {
        self.done.iter().map(|b| b.count_ones()).sum()
    }
}

/// Header for a file of a field.
pub fn header(
    kind: FileKind,
    field: FieldId,
    parameters: &Parameters,
    surfaces: u32,
    exponent: i32,
    (generation, direction): (u32, u32),
) -> Header {
    Header {
        kind,
        field,
        directions: parameters.directions,
        resolution: parameters.resolution,
        tile: parameters.tile,
        exponent,
        surfaces,
        generation,
        direction,
        required_to_write: 0,
        optional: 0,
    }
}
