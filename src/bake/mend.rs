//! Total radiance maps that went bad on the disk, made again.
//!
//! A total map is made of what is kept: the Total Texture Map, and what arrives at mirrors along true
//! paths. Where that is taken from what was stored of it instead, it can be done until the bake is
//! finished. The same bits come out, so the field's digest says whether it is whole again.

use super::profile::Profile;
use super::reach;
use super::step::Shared;
use super::totals::{Mirrors, Scratch, lit_sides, total_map};
use super::{BakeError, Options, Outcome, Progress};
use crate::field::pages::Pages;
use crate::field::{Field, FieldError, files};
use crate::format::container::{ChunkKind, FileKind, NO_DIRECTION};
use crate::format::manifest::Phase;
use crate::format::tiles::Layout;
use crate::format::{Fault, names};
use crate::ids::DirectionId;
use crate::paths::{MAX_DEPTH, Paths};
use crate::visible::Visible;
use rayon::prelude::*;
use std::io::ErrorKind;
use std::sync::atomic::{AtomicU32, Ordering};

/// A total map that is missing or damaged, and how.
type Damaged = (u32, FieldError);

/// Reads every total map that a field's commit names and makes those again that are missing or
/// damaged; `budget` is for pages of what arrived at mirrors. [`Outcome::Stopped`]: not all was looked
/// at.
///
/// # Errors
/// [`BakeError::Gone`] when the field is finished and its mirrors' maps are what was stored of them; damaged texture maps, or a system
/// that refuses.
pub fn mend(
    shared: &Shared,
    field: &mut Field,
    budget: u64,
    options: &Options,
) -> Result<Outcome, BakeError> {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(options.threads.max(1))
        .build()
        .map_err(|e| BakeError::Parameter(format!("--threads: {e}")))?;
    let damaged = pool.install(|| damaged(shared, field, options))?;
    if options.stop.load(Ordering::Relaxed) {
        return Ok(Outcome::Stopped);
    }
    let Some((_, fault)) = damaged.first() else { return Ok(Outcome::Finished) };
    let finished = field.manifest().phase == Phase::Finished;
    if finished && from_store(shared) {
        return Err(BakeError::Gone { fault: fault.clone(), count: damaged.len() });
    }
    tracing::warn!("{fault}; total maps made again: {}", damaged.len());
    pool.install(|| make(shared, field, budget, (&damaged, options)))?;
    if finished {
        if field.digest()? != field.manifest().digest {
            let what =
                "its total maps were made again, but they are not those it was finished with";
            return Err(
                FieldError::from(Fault::invalid(what).in_file(field.path().display())).into()
            );
        }
        field.commit()?;
    }
    Ok(Outcome::Finished)
}

/// Whether mirrors' total maps are what was stored of them while light was propagated.
fn from_store(shared: &Shared) -> bool {
    shared.has_mirrors() && shared.parameters.totals_from_store()
}

/// The total maps that are not sound, of those that are committed.
fn damaged(shared: &Shared, field: &Field, options: &Options) -> Result<Vec<Damaged>, FieldError> {
    let manifest = field.manifest();
    let directions = manifest.parameters.directions;
    let seen = AtomicU32::new(0);
    let look = |direction: u32| {
        if options.stop.load(Ordering::Relaxed) || !manifest.is_done(direction) {
            return Ok(None);
        }
        let fault = check(shared, field, direction).err();
        let done = seen.fetch_add(1, Ordering::Relaxed) + 1;
        (options.progress)(&Progress {
            phase: manifest.phase,
            cycle: manifest.cycle,
            done,
            directions,
            preparing: true,
            unshot: 0.0,
            work: done.into(),
            work_left: (manifest.done_count() - done).into(),
            profile: Profile::default(),
        });
        match fault {
            Some(fault) if is_damage(&fault) => Ok(Some((direction, fault))),
            Some(fault) => Err(fault),
            None => Ok(None),
        }
    };
    let found: Result<Vec<_>, _> = (0..directions).into_par_iter().map(look).collect();
    Ok(found?.into_iter().flatten().collect())
}

/// Reads and checks a total map.
fn check(shared: &Shared, field: &Field, direction: u32) -> Result<(), FieldError> {
    let header = field.header_of(FileKind::Tiles, (field.manifest().cycle, direction));
    let name = names::tile_file(names::TOTAL, direction);
    let mut file = files::open(field.storage(), &name, header.kind)?.belongs(&header)?;
    let entry = file.find(ChunkKind::Total, direction)?;
    let bytes = file.chunk(&entry)?;
    let surfaces = shared.scene.surfaces.len() as u32;
    Layout::check(&bytes, header.resolution, header.tile, surfaces, header.exponent)
        .map_err(|f| f.in_file(file.path.display()))?;
    Ok(())
}

/// Whether making the file again would help.
fn is_damage(error: &FieldError) -> bool {
    match error {
        FieldError::Format(e) => !e.fault.is_unsupported(),
        FieldError::Io { source, .. } => {
            matches!(source.kind(), ErrorKind::NotFound | ErrorKind::UnexpectedEof)
        }
        _ => false,
    }
}

/// Makes total maps and writes them in the place of the damaged ones.
fn make(
    shared: &Shared,
    field: &Field,
    budget: u64,
    (damaged, options): (&[Damaged], &Options),
) -> Result<(), FieldError> {
    let cycle = field.manifest().cycle;
    let total = field.read_texture(cycle, ChunkKind::TotalTexture, 2 * shared.texels.len())?;
    let lit = lit_sides(shared.texels, &total);
    let pages = from_store(shared).then(|| {
        let header = field.header_of(FileKind::Tiles, (cycle, NO_DIRECTION));
        Pages::new(field.shared_storage(), header, budget, options.threads)
    });
    let lines: Vec<DirectionId> = shared.directions.ids().collect();
    let marks = reach::marks(shared, &lines, || true);
    let visible = (shared.has_mirrors() && pages.is_none()).then(|| Visible::new(shared.scene));
    let scene = shared.scene;
    let paths = visible.as_ref().map(|visible| Paths { scene, visible, max_depth: MAX_DEPTH });
    field.begin_folder(names::TOTAL)?;
    damaged.par_iter().try_for_each_init(Scratch::default, |scratch, (direction, _)| {
        let arrived = match &pages {
            Some(pages) => Some(pages.get(*direction, ChunkKind::Arrived)?),
            None => None,
        };
        let mirrors = match (&arrived, paths) {
            (Some(page), _) => Mirrors::Stored(page),
            (None, Some(paths)) => Mirrors::Traced(paths),
            (None, None) => Mirrors::None,
        };
        let maps = (total.as_slice(), lit.as_slice());
        let bytes = total_map(shared, DirectionId(*direction), maps, (mirrors, &marks), scratch);
        field.write_tiles(names::TOTAL, (cycle, *direction), &[(ChunkKind::Total, bytes)])
    })
}
