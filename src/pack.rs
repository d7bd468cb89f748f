//! Act two: a finished field becomes one file (section 8: "the Unshot Radiance Maps can be deleted").
//!
//! In: a field directory whose bake has finished. Out: one self-contained `.vlf`: record, scene, Total
//! Texture Map, then the total radiance map of every direction, coarse lattices first. Every chunk is verified and every map
//! checked on the way, so that what is packed is sound; each packed map is decoded again, as a reader
//! would, and held against the true one. The same field gives the same bytes.

mod reduce;

mod report;

pub use reduce::{Deviation, Place};
pub use report::{PackReport, Section};

use crate::directions::{Directions, paging};
use crate::field::files::read_chunk;
use crate::field::storage::Storage;
use crate::field::storage::disk::Disk;
use crate::field::{FieldError, read_manifest};
use crate::format::container::{
    self, ChunkId, ChunkKind, Codec, ContainerWriter, DIFFUSE_LEFT_OUT, Directory, FIRST_BLOCK,
    FileKind, Header, NO_DIRECTION, encode,
};
use crate::format::limits::Limits;
use crate::format::manifest::{Manifest, Phase, Statistics, record_to_bytes};
use crate::format::tiles::{Layout, TileMap, to_planes};
use crate::format::{Fault, names};
use crate::ids::{DirectionId, SurfaceId};
use crate::psf::Psf;
use crate::scene::stored;
use crate::scene::texels::{self, Texels};
use crate::textured::Texture;
use bytesize::ByteSize;
use rayon::prelude::*;
use reduce::Reduced;
use serde::Serialize;
use std::borrow::Cow;
use std::fs;
use std::io::{self, BufWriter, Read};
use std::path::{Path, PathBuf};
use tempfile::NamedTempFile;

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
    /// The memory is not enough.
    #[error("a map and its copies take {}; {} are granted (--memory)", ByteSize::b(*needed).display().iec(), ByteSize::b(*granted).display().iec())]
    Memory {
        /// Bytes of the largest map and its copies.
        needed: u64,
        /// Bytes that were granted.
        granted: u64,
    },
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

/// How a field is packed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// How total maps are stored. [`Codec::Raw`] ones are left as they are, to be looked up without
    /// decoding; scene and texture maps take zstd with any other.
    pub codec: Codec,
    /// How far a cell's value may be off: its worst channel against its brightest, at most
    /// [`MOST_ERROR`]. 0 loses nothing.
    pub max_error: f32,
    /// What becomes of diffuse surfaces' total maps.
    pub diffuse: Diffuse,
    /// Bytes that maps may take in memory.
    pub memory: u64,
}

/// [`Options::max_error`] of `vlf-pack` unless it is told another.
pub const USUAL_ERROR: f32 = 0.002;

/// The largest [`Options::max_error`].
pub const MOST_ERROR: f32 = 0.25;

impl Options {
    /// All maps to the last bit, within 256 MiB.
    pub fn exact(codec: Codec) -> Options {
        Options { codec, max_error: 0.0, diffuse: Diffuse::Maps, memory: 256 << 20 }
    }
}

/// What becomes of diffuse surfaces' total maps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Diffuse {
    /// They are kept.
    Maps,
    /// They are left out, being a resampling of the Total Texture Map; lookup goes there.
    Texture,
}

/// Packs the finished field at `field` into the file `out`, to the last bit, each chunk stored with
/// `codec`. `progress` is told the finished part in [0, 1]. The file appears whole or not at all.
///
/// # Errors
/// An unfinished or damaged field, something else in the pack's place, or a system that refuses.
pub fn pack(
    field: &Path,
    out: &Path,
    codec: Codec,
    progress: &(dyn Fn(f32) + Sync),
) -> Result<PackReport, PackError> {
    pack_from(&Disk::new(field), out, &Options::exact(codec), progress)
}

/// The same from any storage, within its limits, with all options.
///
/// # Errors
/// As [`pack`], and when the memory is not enough for one map.
pub fn pack_from(
    storage: &dyn Storage,
    out: &Path,
    options: &Options,
    progress: &(dyn Fn(f32) + Sync),
) -> Result<PackReport, PackError> {
    let field = storage.place();
    let (header, manifest) = read_manifest(storage)?;
    if manifest.phase != Phase::Finished {
        return Err(PackError::Unfinished(field.to_owned()));
    }
    may_replace(out, &storage.limits())?;
    let size = maps_at_a_time(storage, &manifest, options.memory)?;
    let failed = |source| PackError::Io { path: out.to_owned(), source };
    let temporary = beside(out).map_err(failed)?;

    let optional = match options.diffuse {
        Diffuse::Maps => 0,
        Diffuse::Texture => DIFFUSE_LEFT_OUT,
    };
    let pack_header = Header { kind: FileKind::Pack, optional, ..header.clone() };
    let directions = manifest.parameters.directions;
    let mut writer =
        ContainerWriter::new(BufWriter::new(temporary), pack_header, 3 + directions as usize)
            .map_err(failed)?;
    let mut report = PackReport { directions, max_error: options.max_error, ..Default::default() };

    let cycle = manifest.cycle;
    let read = |name: &str, file, kind| read_chunk(storage, name, file, (kind, NO_DIRECTION));
    let scene_bytes = read(names::SCENE, FileKind::Scene, ChunkKind::Scene)?;
    let textures = names::textures(cycle);
    let total_bytes = read(&textures, FileKind::Textures, ChunkKind::TotalTexture)?;
    let record = record_to_bytes(&stripped(&manifest)).map_err(|f| in_file(f, field.display()))?;
    let codec = match options.codec {
        Codec::Planes => Codec::Zstd,
        codec => codec,
    };
    for (kind, bytes, section) in [
        (ChunkKind::Record, &record, &mut report.record),
        (ChunkKind::Scene, &scene_bytes, &mut report.scene),
        (ChunkKind::TotalTexture, &total_bytes, &mut report.textures),
    ] {
        let stored = encode(codec, bytes).map_err(failed)?;
        section.add(bytes.len(), stored.len());
        let id = ChunkId { kind, cycle, direction: NO_DIRECTION };
        writer.stored_chunk(id, codec, bytes.len() as u64, &stored).map_err(failed)?;
    }

    let scene = stored::from_bytes(&scene_bytes, &storage.limits())
        .map_err(|f| in_file(f, names::SCENE))?;
    // Counted before they are laid: a file may ask for any number.
    let edge = manifest.parameters.texel_edge();
    if 24 * Texels::count(&scene, edge) != total_bytes.len() as u64 {
        return Err(in_file(Fault::invalid("is not the texture map of the scene"), &textures));
    }
    let texels = Texels::new(&scene, edge);
    let total =
        texels::from_bytes(&total_bytes, 2 * texels.len()).map_err(|f| in_file(f, &textures))?;
    drop((scene_bytes, total_bytes));
    let texture = Texture { scene: &scene, texels: &texels, total: &total };
    let lattice = Directions::with_lines(directions);
    let lattice = lattice.ok_or_else(|| {
        in_file(Fault::invalid(format!("{directions} directions")), field.display())
    })?;
    let packer = Packer { storage, header, texture, lattice, options };
    let order = paging(directions).unwrap_or_default();
    for (number, block) in order.chunks(size).enumerate() {
        let packed: Vec<Result<_, PackError>> = block.par_iter().map(|d| packer.map(d.0)).collect();
        for map in packed {
            let map = map?;
            let id = ChunkId { kind: ChunkKind::Total, cycle, direction: map.direction };
            writer.stored_chunk(id, options.codec, map.raw, &map.stored).map_err(failed)?;
            report.add(&map);
        }
        progress((number * size + block.len()) as f32 / directions as f32);
    }
    let out_file = writer.finish().map_err(failed)?;
    let temporary = out_file.into_inner().map_err(|e| failed(e.into_error()))?;
    temporary.as_file().sync_all().map_err(failed)?;
    report.bytes = temporary.as_file().metadata().map_err(failed)?.len();
    temporary.persist(out).map_err(|e| failed(e.error))?;
    Ok(report)
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

fn in_file(fault: Fault, file: impl std::fmt::Display) -> PackError {
    FieldError::from(fault.in_file(file)).into()
}

/// A record without what differs from run to run.
fn stripped(manifest: &Manifest) -> Manifest {
    let Statistics { fragments, gathers, holes, entries, .. } = manifest.statistics;
    let statistics = Statistics { fragments, gathers, holes, entries, ..Statistics::default() };
    Manifest { statistics, sequence: 0, has_sums: false, ..manifest.clone() }
}

/// A file that is to take the place of `out`.
fn beside(out: &Path) -> io::Result<NamedTempFile> {
    let folder = out.parent().filter(|p| *p != Path::new("")).unwrap_or(Path::new("."));
    let mut builder = tempfile::Builder::new();
    builder.prefix(".vlf-pack-");
    // Without this the file would be its owner's alone; the process's umask still applies.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder.tempfile_in(folder)
}

/// Bytes that a map takes while it is packed, for each of its own: as it was, as it is kept, its tables,
/// its planes, stored, decoded, and with every value in place.
const COPIES: u64 = 8;

/// How many maps the memory is enough for at once.
fn maps_at_a_time(
    storage: &dyn Storage,
    manifest: &Manifest,
    memory: u64,
) -> Result<usize, PackError> {
    let mut largest = 0;
    for direction in 0..manifest.parameters.directions {
        let name = names::tile_file(names::TOTAL, direction);
        let length = storage.open(&name).and_then(|file| file.length());
        let path = storage.place().join(&name);
        largest = largest.max(length.map_err(FieldError::io("read", &path))?);
    }
    let needed = COPIES * largest;
    match memory.checked_div(needed) {
        Some(0) => Err(PackError::Memory { needed, granted: memory }),
        count => Ok(count.map_or(1, |count| count.min(MOST_MAPS)) as usize),
    }
}

/// Maps packed at a time, whatever the memory.
const MOST_MAPS: u64 = 256;

/// What a total map takes in a pack as `vlf-pack` makes it unless it is told otherwise: bytes that are
/// stored, and values among them. Surfaces for which `keep` is false are left out.
///
/// # Errors
/// When memory does not suffice.
pub fn usual_size(
    map: &TileMap,
    (psf, exponent): (&Psf, i32),
    texture: &Texture,
    keep: impl Fn(SurfaceId) -> bool,
) -> Result<(u64, u64), FieldError> {
    let reduced = reduce::reduced(map, (psf, exponent), texture, keep, USUAL_ERROR);
    let tiles = (map.resolution(), map.tile_edge());
    let surfaces = texture.scene.surfaces.len() as u32;
    let layout = Layout::check_packed(&reduced.map, tiles, surfaces, exponent);
    let layout = layout.map_err(|fault| fault.in_file("total map"))?;
    let kept = TileMap::new(&reduced.map, &layout);
    let planes = to_planes(&kept);
    let failed = FieldError::io("encode", Path::new("total map"));
    let stored = encode(Codec::Planes, &planes).map_err(failed)?;
    Ok((stored.len() as u64, kept.value_count() as u64))
}

/// What the maps of a field are packed with.
struct Packer<'a> {
    storage: &'a dyn Storage,
    header: Header,
    texture: Texture<'a>,
    lattice: Directions,
    options: &'a Options,
}

/// A packed map.
struct Packed {
    direction: u32,
    /// Bytes of the map in the field, and of the one that is stored.
    from: u64,
    raw: u64,
    stored: Vec<u8>,
    values: u64,
    deviation: Deviation,
}

impl Packer<'_> {
    fn keeps(&self, surface: SurfaceId) -> bool {
        let scene = self.texture.scene;
        self.options.diffuse == Diffuse::Maps || scene.material_of(surface).reflectance.is_mirror()
    }

    /// A direction's map, reduced, stored, and decoded again to see what became of it.
    fn map(&self, direction: u32) -> Result<Packed, PackError> {
        let name = names::tile_file(names::TOTAL, direction);
        let failed = |f: Fault| in_file(f, &name);
        let file = FileKind::Tiles;
        let bytes = read_chunk(self.storage, &name, file, (ChunkKind::Total, direction))?;
        let Header { resolution, tile, surfaces, exponent, .. } = self.header;
        let layout = Layout::check(&bytes, resolution, tile, surfaces, exponent).map_err(failed)?;
        let map = TileMap::new(&bytes, &layout);
        let psf = Psf::new(self.lattice.vector(DirectionId(direction)), resolution);
        let keep = |surface| self.keeps(surface);
        let Options { codec, max_error, diffuse, .. } = *self.options;
        // What is to stay as it is may still be the texture map's to the bit; only planes say so then.
        let stays = codec == Codec::Raw || (codec == Codec::Zstd && max_error == 0.0);
        let reduced = match (stays, diffuse) {
            (true, Diffuse::Maps) => Reduced { map: Cow::Borrowed(&*bytes), left: Vec::new() },
            (true, Diffuse::Texture) => {
                Reduced { map: reduce::kept(&map, keep).into(), left: Vec::new() }
            }
            (false, _) => reduce::reduced(&map, (&psf, exponent), &self.texture, keep, max_error),
        };
        let raw = &*reduced.map;
        let check = Layout::check_packed(raw, (resolution, tile), surfaces, exponent);
        let layout = check.map_err(failed)?;
        let packed = TileMap::new(raw, &layout);
        let stored = match codec {
            Codec::Planes => encode(codec, &to_planes(&packed)).map(Cow::into_owned),
            codec => encode(codec, raw).map(Cow::into_owned),
        };
        let stored =
            stored.map_err(|source| PackError::Io { path: PathBuf::from(&name), source })?;
        let is_same = container::unencoded(codec, raw.len() as u64, &stored).map(|d| *d == *raw);
        // What is decoded is the map that was packed, and a reader fills textured slots as `left` was
        // made: this is what it will find.
        let deviation = { is_same.map_err(failed)? }
            .then(|| Deviation::of(direction, (&map, &packed), &reduced.left, keep))
            .flatten()
            .filter(|deviation| deviation.worst <= max_error);
        let deviation = deviation
            .ok_or_else(|| failed(Fault::invalid("is not what it was when it is decoded again")))?;
        let (from, values) = (bytes.len() as u64, packed.value_count() as u64);
        Ok(Packed { direction, from, raw: raw.len() as u64, stored, values, deviation })
    }
}
