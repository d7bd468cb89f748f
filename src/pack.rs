//! Act two: a finished field becomes one file (section 8: "the Unshot Radiance Maps can be deleted").
//!
//! In: a field directory whose bake has finished. Out: one self-contained `.vlf`: record, scene, Total
//! Texture Map, then the total radiance map of every direction in order. Every chunk is verified and
//! every map checked on the way, so that what is packed is sound. The same field gives the same bytes.

use crate::field::files::read_chunk;
use crate::field::storage::Storage;
use crate::field::storage::disk::Disk;
use crate::field::{FieldError, read_manifest};
use crate::format::container::{
    ChunkId, ChunkKind, Codec, ContainerWriter, Directory, FIRST_BLOCK, FileKind, Header,
    NO_DIRECTION, encode,
};
use crate::format::limits::Limits;
use crate::format::manifest::{Manifest, Phase, Statistics, record_to_bytes};
use crate::format::names;
use crate::format::tiles::Layout;
use rayon::prelude::*;
use serde::Serialize;
use std::fs;
use std::io::{self, BufWriter, Read};
use std::path::{Path, PathBuf};

/// Directions encoded at a time.
const BLOCK: u32 = 64;

/// What can go wrong with packing.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PackError {
    /// Of the field.
    #[error(transparent)]
    Field(#[from] FieldError),
    /// The bake has not come to its end.
    #[error("{}: the bake is not finished; run the same `vlf bake` again, then pack", .0.display())]
    Unfinished(PathBuf),
    /// Something that is not a pack has the output's name.
    #[error("{}: exists and is not a packed field; nothing was changed. Choose another name", .0.display())]
    Foreign(PathBuf),
    /// The system refused to write.
    #[error("{}: cannot be written: {source}", path.display())]
    Io {
        /// The pack.
        path: PathBuf,
        /// The system's answer.
        source: io::Error,
    },
}

/// What packing did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct PackReport {
    /// Bytes of scene and texture maps before and after.
    pub scene: (u64, u64),
    /// Bytes of total radiance maps before and after.
    pub maps: (u64, u64),
    /// Bytes of the pack.
    pub bytes: u64,
    /// Stored values (three f16 each).
    pub values: u64,
    /// Directions.
    pub directions: u32,
}

/// Packs the finished field at `field` into the file `out`, each chunk stored with `codec`. `progress`
/// is told the finished part in [0, 1]. The file appears whole or not at all.
///
/// # Errors
/// An unfinished or damaged field, something else in the pack's place, or a system that refuses.
pub fn pack(
    field: &Path,
    out: &Path,
    codec: Codec,
    progress: &(dyn Fn(f32) + Sync),
) -> Result<PackReport, PackError> {
    pack_from(&Disk::new(field), out, codec, progress)
}

/// The same from any storage, within its limits.
///
/// # Errors
/// As [`pack`].
pub fn pack_from(
    storage: &dyn Storage,
    out: &Path,
    codec: Codec,
    progress: &(dyn Fn(f32) + Sync),
) -> Result<PackReport, PackError> {
    let field = storage.place();
    let (header, mut manifest) = read_manifest(storage)?;
    if manifest.phase != Phase::Finished {
        return Err(PackError::Unfinished(field.to_owned()));
    }
    may_replace(out, &storage.limits())?;
    let failed = |source| PackError::Io { path: out.to_owned(), source };
    let folder = match out.parent() {
        Some(p) if p != Path::new("") => p,
        _ => Path::new("."),
    };
    let mut builder = tempfile::Builder::new();
    builder.prefix(".vlf-pack-");
    // Without this the file would be its owner's alone; the process's umask still applies.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let temporary = builder.tempfile_in(folder).map_err(failed)?;

    let mut report =
        PackReport { directions: manifest.parameters.directions, ..PackReport::default() };
    let pack_header = Header { kind: FileKind::Pack, ..header.clone() };
    let chunks = 3 + report.directions as usize;
    let mut writer =
        ContainerWriter::new(BufWriter::new(temporary), pack_header, chunks).map_err(failed)?;

    // The record, without what differs from run to run.
    let Statistics { fragments, gathers, holes, entries, .. } = manifest.statistics;
    manifest.statistics =
        Statistics { fragments, gathers, holes, entries, ..Statistics::default() };
    (manifest.sequence, manifest.has_sums) = (0, false);
    let record =
        record_to_bytes(&manifest).map_err(|f| FieldError::from(f.in_file(field.display())))?;
    let cycle = manifest.cycle;
    let id = |kind, direction| ChunkId { kind, cycle, direction };
    let scene =
        read_chunk(storage, names::SCENE, FileKind::Scene, (ChunkKind::Scene, NO_DIRECTION))?;
    let textures = read_chunk(
        storage,
        &names::textures(cycle),
        FileKind::Textures,
        (ChunkKind::TotalTexture, NO_DIRECTION),
    )?;
    for (kind, bytes) in [
        (ChunkKind::Record, &record),
        (ChunkKind::Scene, &scene),
        (ChunkKind::TotalTexture, &textures),
    ] {
        let stored = encode(codec, bytes).map_err(failed)?;
        report.scene.0 += bytes.len() as u64;
        report.scene.1 += stored.len() as u64;
        let raw = bytes.len() as u64;
        writer.stored_chunk(id(kind, NO_DIRECTION), codec, raw, &stored).map_err(failed)?;
    }

    for from in (0..report.directions).step_by(BLOCK as usize) {
        let block: Vec<u32> = (from..(from + BLOCK).min(report.directions)).collect();
        let encoded: Vec<Result<_, PackError>> = block
            .par_iter()
            .map(|d| {
                let (raw, values) = checked_map(storage, &header, &manifest, *d)?;
                let stored = encode(codec, &raw).map_err(failed)?.into_owned();
                Ok((*d, raw.len() as u64, stored, values))
            })
            .collect();
        for map in encoded {
            let (d, raw, stored, values) = map?;
            report.maps.0 += raw;
            report.maps.1 += stored.len() as u64;
            report.values += values;
            let id = id(ChunkKind::Total, d);
            writer.stored_chunk(id, codec, raw, &stored).map_err(failed)?;
        }
        progress((from + block.len() as u32) as f32 / report.directions as f32);
    }
    let out_file = writer.finish().map_err(failed)?;
    let temporary = out_file.into_inner().map_err(|e| failed(e.into_error()))?;
    temporary.as_file().sync_all().map_err(failed)?;
    report.bytes = temporary.as_file().metadata().map_err(failed)?.len();
    temporary.persist(out).map_err(|e| failed(e.error))?;
    Ok(report)
}

/// The total radiance map of a direction, checked, and how many values it stores.
fn checked_map(
    storage: &dyn Storage,
    header: &Header,
    manifest: &Manifest,
    direction: u32,
) -> Result<(Vec<u8>, u64), PackError> {
    let name = names::tile_file(names::TOTAL, direction);
    let bytes = read_chunk(storage, &name, FileKind::Tiles, (ChunkKind::Total, direction))?;
    let p = &manifest.parameters;
    let layout = Layout::check(&bytes, p.resolution, p.tile, header.surfaces, header.exponent)
        .map_err(|f| FieldError::from(f.in_file(&name)))?;
    let values = crate::format::tiles::TileMap::new(&bytes, &layout).value_count() as u64;
    Ok((bytes, values))
}

/// Refuses to replace anything but an earlier pack.
fn may_replace(out: &Path, limits: &Limits) -> Result<(), PackError> {
    match fs::symlink_metadata(out) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(source) => Err(PackError::Io { path: out.to_owned(), source }),
        Ok(data) => {
            let is_pack = data.is_file() && {
                let mut head = Vec::new();
                let read = fs::File::open(out)
                    .and_then(|f| f.take(FIRST_BLOCK as u64).read_to_end(&mut head));
                read.map_err(|source| PackError::Io { path: out.to_owned(), source })?;
                Directory::length(&head, data.len(), limits).is_ok_and(|_| {
                    // A pack's directory begins right behind the first block, which says its kind.
                    head.get(40..44) == Some(&(FileKind::Pack as u32).to_le_bytes())
                })
            };
            if is_pack { Ok(()) } else { Err(PackError::Foreign(out.to_owned())) }
        }
    }
}
