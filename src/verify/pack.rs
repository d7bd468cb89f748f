//! A packed field: one file, which must be whole in itself.

use super::{BLOCK, Checked, Finding, Place, Report, TextureBlocks, agrees, check_length};
use crate::directions::{Directions, paging};
use crate::field::files::{self, Opened};
use crate::field::{FieldError, hash};
use crate::format::Fault;
use crate::format::container::{
    ChunkEntry, ChunkId, ChunkKind, FileKind, Header, NO_DIRECTION, decode,
};
use crate::format::limits::Limits;
use crate::format::manifest::{Manifest, Phase, record_from_bytes};
use crate::format::tiles::{Layout, TileMap};
use crate::ids::DirectionId;
use crate::look::lightfield::{check_scene, texel_count};
use crate::psf::Psf;
use crate::scene::{Scene, stored};
use crate::textured;
use rayon::prelude::*;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

/// Checks all of a pack, on all threads of the rayon pool it is called in. `progress` is told the
/// finished part in [0, 1].
///
/// # Errors
/// When it cannot be read, or its first block or directory is not sound: then nothing says what is in it.
pub fn pack(
    path: &Path,
    limits: &Limits,
    progress: &(dyn Fn(f32) + Sync),
) -> Result<Report, FieldError> {
    let mut opened = files::open_at(path, FileKind::Pack, limits)?;
    let header = opened.directory.header.clone();
    let entries = opened.directory.entries.clone();
    let place = Place::file(&path.file_name().unwrap_or_default().to_string_lossy(), NO_DIRECTION);
    let mut checked = Checked { files: 1, bytes: opened.length, ..Checked::default() };

    // The record comes first: what it says decides what the others must be.
    let mut manifest = None;
    if let Some(entry) = entries.first().filter(|e| e.id.kind == ChunkKind::Record) {
        match opened.chunk(entry).map_err(|e| place.chunk(entry).error(e)) {
            Ok(bytes) => match record(&bytes, &header) {
                Ok(record) => manifest = Some(record),
                Err(fault) => checked.findings.push(place.chunk(entry).fault(fault)),
            },
            Err(finding) => checked.findings.push(finding),
        }
        checked.chunks += 1;
    }
    let mut report = Report::of(&header, manifest.as_ref());
    checked.findings.extend(structure(&place, &header, &entries, manifest.as_ref()));
    report.add(checked);

    let directions = Directions::with_lines(header.directions);
    let opened = Mutex::new(opened);
    let mut pack = Pack { place, header, manifest, opened, limits, scene: None, directions };
    let mut texels = None;
    let parts = entries.len().min(3);
    for entry in entries[..parts].iter().filter(|e| e.id.kind != ChunkKind::Record) {
        let result = match entry.id.kind {
            ChunkKind::Scene => pack.scene(entry).map(|(scene, count)| {
                (pack.scene, texels) = (Some(scene), count);
            }),
            ChunkKind::TotalTexture => pack.textures(entry, texels),
            _ => pack.map(entry),
        };
        let findings = result.err().into_iter().collect();
        report.add(Checked { chunks: 1, findings, ..Checked::default() });
    }
    let maps = &entries[parts..];
    for (number, block) in maps.chunks(BLOCK).enumerate() {
        let results: Vec<_> = block.par_iter().map(|entry| pack.map(entry)).collect();
        for result in results {
            let findings = result.err().into_iter().collect();
            report.add(Checked { chunks: 1, findings, ..Checked::default() });
        }
        progress((number * BLOCK + block.len()) as f32 / maps.len() as f32);
    }
    Ok(report)
}

/// A pack's record, checked.
fn record(bytes: &[u8], header: &Header) -> Result<Manifest, Fault> {
    let manifest: Manifest = record_from_bytes(bytes)?;
    manifest.check(header)?;
    agrees(&manifest, header)?;
    if manifest.phase != Phase::Finished || manifest.has_sums || manifest.sequence != 0 {
        return Err(Fault::invalid("is not that of a finished, packed field"));
    }
    Ok(manifest)
}

/// Finds the first chunk that is not where it must be.
fn structure(
    place: &Place,
    header: &Header,
    entries: &[ChunkEntry],
    manifest: Option<&Manifest>,
) -> Vec<Finding> {
    let mut findings = Vec::new();
    if (header.generation, header.direction) != (0, NO_DIRECTION) {
        findings.push(place.clone().damaged("its first block is of a generation or direction"));
    }
    let cycle = manifest.map(|m| m.cycle).or(entries.first().map(|e| e.id.cycle));
    let id = |kind, direction| ChunkId { kind, cycle: cycle.unwrap_or_default(), direction };
    let parts = [ChunkKind::Record, ChunkKind::Scene, ChunkKind::TotalTexture];
    let parts = parts.into_iter().map(|kind| id(kind, NO_DIRECTION));
    let maps = paging(header.directions).unwrap_or_default();
    let maps = maps.into_iter().map(|direction| id(ChunkKind::Total, direction.0));
    if let Some((entry, _)) = entries.iter().zip(parts.chain(maps)).find(|(e, id)| e.id != *id) {
        findings.push(place.chunk(entry).damaged("is where another chunk should be"));
    }
    let expected = 3 + u64::from(header.directions);
    if entries.len() as u64 != expected {
        let what = format!("holds {} chunks, not {expected}", entries.len());
        findings.push(place.clone().damaged(what));
    }
    findings
}

struct Pack<'a> {
    place: Place,
    header: Header,
    manifest: Option<Manifest>,
    opened: Mutex<Opened>,
    limits: &'a Limits,
    scene: Option<Scene>,
    directions: Option<Directions>,
}

impl Pack<'_> {
    fn opened(&self) -> std::sync::MutexGuard<'_, Opened> {
        self.opened.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A chunk, read while others wait, then verified and handed over beside them.
    fn decoded<T>(
        &self,
        entry: &ChunkEntry,
        take: impl FnOnce(&[u8]) -> Result<T, Fault>,
    ) -> Result<T, Finding> {
        let stored = self.opened().stored(entry).map_err(|e| self.place.chunk(entry).error(e))?;
        decode(&self.header.field, entry, &stored)
            .and_then(|bytes| take(&bytes))
            .map_err(|fault| self.place.chunk(entry).fault(fault))
    }

    /// The scene, checked, and how many texels it has, where the record says how large they are.
    fn scene(&self, entry: &ChunkEntry) -> Result<(Scene, Option<u64>), Finding> {
        self.decoded(entry, |bytes| {
            let scene = stored::from_bytes(bytes, self.limits)?;
            check_scene(&scene, self.header.surfaces)?;
            let Some(manifest) = &self.manifest else { return Ok((scene, None)) };
            if hash(bytes) != manifest.scene_hash {
                return Err(Fault::invalid("is another scene than the record's"));
            }
            let count = texel_count(&scene, manifest, self.limits)?;
            Ok((scene, Some(count)))
        })
    }

    fn textures(&self, entry: &ChunkEntry, texels: Option<u64>) -> Result<(), Finding> {
        check_length(entry, texels.map(|t| 24 * t))
            .map_err(|fault| self.place.chunk(entry).fault(fault))?;
        self.decoded(entry, |bytes| {
            let mut blocks = TextureBlocks::default();
            bytes.chunks(files::BLOCK).try_for_each(|block| blocks.take(block))
        })
    }

    fn map(&self, entry: &ChunkEntry) -> Result<(), Finding> {
        let Header { resolution, tile, surfaces, exponent, .. } = self.header;
        self.decoded(entry, |bytes| {
            let layout = Layout::check_packed(bytes, (resolution, tile), surfaces, exponent)?;
            let Some((scene, directions)) = self.scene.as_ref().zip(self.directions.as_ref())
            else {
                return Ok(());
            };
            let map = TileMap::new(bytes, &layout);
            let is_diffuse = |s| !scene.material_of(s).reflectance.is_mirror();
            let line = directions.vector(DirectionId(entry.id.direction));
            if self.header.leaves_diffuse_out() && map.slots().any(|s| is_diffuse(s.surface)) {
                return Err(Fault::invalid("tile map: has a diffuse surface that was left out"));
            }
            textured::check(&map, &Psf::new(line, resolution), scene)
        })
    }
}
