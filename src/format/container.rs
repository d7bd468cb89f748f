//! The container that every file is: first block, directory, chunks.
//!
//! ```text
//! 0      first block, 256 bytes, hashed by its last 8
//! 256    directory: one entry of 64 bytes a chunk, hashed in the first block
//! ...    chunks, each at a multiple of 64, in the directory's order, zero bytes between
//! ```
//!
//! A chunk's hash is seeded with its identity (field, kind, cycle, direction), so that a sound chunk
//! in the wrong place fails too. It covers the stored bytes and is checked before they are decoded.

#![deny(
    clippy::arithmetic_side_effects,
    clippy::cast_possible_truncation,
    clippy::indexing_slicing
)]

use super::bytes::{Reader, Writer};
use super::limits::{self, Limits};
use super::{Fault, FormatError, READS_MAJOR, room_for, tiles};
use crate::directions::paging;
use crate::ids::DirectionId;
use std::borrow::Cow;
use std::hash::Hasher;
use std::io::{self, Seek, SeekFrom, Write};
use std::ops::RangeInclusive;
use twox_hash::XxHash3_64;

/// Non-ASCII first, then CR LF, ^Z, LF: a text-mode transfer damages it in a way that is seen.
pub const MAGIC: [u8; 8] = [0x89, b'V', b'L', b'F', 0x0d, 0x0a, 0x1a, 0x0a];
/// Bytes of the first block.
pub const FIRST_BLOCK: usize = 256;
/// Bytes of a directory entry.
pub const ENTRY: usize = 64;
/// Chunks begin at multiples of this.
pub const ALIGN: usize = 64;
/// The `direction` of a chunk or file that belongs to none.
pub const NO_DIRECTION: u32 = u32::MAX;

const SENTINEL: u32 = 0x0102_0304;
const MINOR: u16 = 0;
const HASH_AT: usize = FIRST_BLOCK - 8;
/// Every zstd frame begins with these; skippable frames and those of old versions do not.
const FRAME_MAGIC: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

// So there is no padding before the first chunk.
const _: () = assert!(FIRST_BLOCK.is_multiple_of(ALIGN) && ENTRY.is_multiple_of(ALIGN));

/// What a file is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum FileKind {
    /// The commit record of a field.
    Manifest = 1,
    /// The resolved scene of a field.
    Scene = 2,
    /// Texture maps of a generation.
    Textures = 3,
    /// Sums of a cycle under way.
    Sums = 4,
    /// Tile maps of one direction and generation.
    Tiles = 5,
    /// A packed field.
    Pack = 6,
}

/// What a chunk holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u32)]
pub enum ChunkKind {
    /// A metadata record (bincode).
    Record = 1,
    /// The resolved scene.
    Scene = 2,
    /// Total texture map P^T.
    TotalTexture = 3,
    /// Current texture map P^C: unshot radiance of diffuse surfaces.
    CurrentTexture = 4,
    /// Sums of a cycle under way, from which P^N is made.
    Sums = 5,
    /// Unshot radiance maps L_U of mirrors, where the light arrived.
    Unshot = 6,
    /// Radiance that has arrived at mirrors over all cycles.
    Arrived = 7,
    /// Total radiance maps L_T.
    Total = 8,
    /// Total texture map from half of the lines.
    HalfTexture = 9,
}

/// How a chunk's bytes are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Codec {
    /// As they are.
    Raw = 0,
    /// One zstd frame.
    Zstd = 1,
    /// A tile map's planes ([`tiles::to_planes`]) in one zstd frame.
    Planes = 2,
}

fn chunk_kind(v: u32) -> Result<ChunkKind, Fault> {
    use ChunkKind::*;
    [Record, Scene, TotalTexture, CurrentTexture, Sums, Unshot, Arrived, Total, HalfTexture]
        .into_iter()
        .find(|k| *k as u32 == v)
        .ok_or_else(|| Fault::invalid(format!("unknown chunk kind {v}")))
}

fn file_kind(v: u32) -> Result<FileKind, Fault> {
    use FileKind::*;
    [Manifest, Scene, Textures, Sums, Tiles, Pack]
        .into_iter()
        .find(|k| *k as u32 == v)
        .ok_or_else(|| Fault::invalid(format!("unknown file kind {v}")))
}

/// Identity of the field a file belongs to.
pub type FieldId = [u8; 16];

/// The first block, checked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Header {
    /// What the file is.
    pub kind: FileKind,
    /// The field it belongs to.
    pub field: FieldId,
    /// Lines of the field, l.
    pub directions: u32,
    /// Cells along an edge of a PSF, N.
    pub resolution: u32,
    /// Cells along an edge of a tile, m.
    pub tile: u32,
    /// Stored radiance is multiplied by two to this power.
    pub exponent: i32,
    /// Surfaces of the scene.
    pub surfaces: u32,
    /// Generation the file belongs to.
    pub generation: u32,
    /// Direction the file belongs to, or [`NO_DIRECTION`].
    pub direction: u32,
    /// Features without which the file must not be changed, as it states them. This version has none,
    /// writes 0 and leaves files alone in which a bit is set: [`Header::check_writable`].
    pub required_to_write: u64,
    /// Optional features, as it states them; unknown ones mean nothing.
    pub optional: u64,
}

/// The optional feature of a pack whose tile maps have no entries of diffuse surfaces: their radiance is
/// the texture map's, where whoever finds no entry looks anyway.
pub const DIFFUSE_LEFT_OUT: u64 = 1;

/// A chunk's place in the order of things; its hash is bound to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ChunkId {
    /// What it holds.
    pub kind: ChunkKind,
    /// Cycle or generation.
    pub cycle: u32,
    /// Direction, or [`NO_DIRECTION`].
    pub direction: u32,
}

impl std::fmt::Display for ChunkId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.direction {
            NO_DIRECTION => write!(f, "{:?}", self.kind),
            direction => write!(f, "{:?} of direction {direction}", self.kind),
        }
    }
}

/// A directory entry, checked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChunkEntry {
    /// Which chunk.
    pub id: ChunkId,
    /// How it is stored.
    pub codec: Codec,
    /// Where its stored bytes begin in the file.
    pub offset: u64,
    /// How many they are.
    pub stored: u64,
    /// How many they are when decoded.
    pub raw: u64,
    /// Hash of the stored bytes, seeded with the identity.
    pub hash: u64,
}

/// First block and directory of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Directory {
    /// The first block.
    pub header: Header,
    /// The chunks, in the order they lie in the file.
    pub entries: Vec<ChunkEntry>,
}

/// Seed of the hash of a chunk at a place.
fn chunk_seed(field: &FieldId, id: ChunkId) -> u64 {
    let mut w = Writer::default();
    w.0.extend_from_slice(field);
    w.u32(id.kind as u32);
    w.u32(id.cycle);
    w.u32(id.direction);
    XxHash3_64::oneshot(&w.0)
}

/// Hash of stored bytes at a place.
fn chunk_hash(field: &FieldId, id: ChunkId, stored: &[u8]) -> u64 {
    // For `benches/cost-of-safety` only, which has to know what hashing costs.
    if cfg!(vlf_unhashed) {
        return 0;
    }
    XxHash3_64::oneshot_with_seed(chunk_seed(field, id), stored)
}

/// The same for bytes that come in blocks.
pub struct ChunkHasher(XxHash3_64);

impl ChunkHasher {
    /// For a chunk at a place.
    pub fn new(field: &FieldId, id: ChunkId) -> ChunkHasher {
        ChunkHasher(XxHash3_64::with_seed(chunk_seed(field, id)))
    }

    /// Takes the next block.
    pub fn write(&mut self, block: &[u8]) {
        if !cfg!(vlf_unhashed) {
            self.0.write(block);
        }
    }

    /// The hash of all blocks.
    pub fn finish(&self) -> u64 {
        if cfg!(vlf_unhashed) { 0 } else { self.0.finish() }
    }
}

/// Encodes bytes with a codec; for [`Codec::Planes`] they are a map's planes.
///
/// # Errors
/// When the compressor fails for want of memory.
pub fn encode<'a>(codec: Codec, raw: &'a [u8]) -> io::Result<Cow<'a, [u8]>> {
    Ok(match codec {
        Codec::Raw => Cow::Borrowed(raw),
        Codec::Zstd => Cow::Owned(zstd::bulk::compress(raw, 3)?),
        Codec::Planes => Cow::Owned(zstd::bulk::compress(raw, 3)?),
    })
}

/// Verifies a chunk's stored bytes against its entry and decodes them.
///
/// # Errors
/// A checksum or a length that does not fit, or a damaged frame.
pub fn decode<'a>(
    field: &FieldId,
    entry: &ChunkEntry,
    stored: &'a [u8],
) -> Result<Cow<'a, [u8]>, Fault> {
    if stored.len() as u64 != entry.stored || chunk_hash(field, entry.id, stored) != entry.hash {
        return Err(Fault::Checksum { what: entry.id.to_string(), offset: entry.offset });
    }
    unencoded(entry.codec, entry.raw, stored).map_err(|fault| match fault {
        Fault::Invalid(what) => Fault::invalid(format!("{}: {what}", entry.id)),
        other => other,
    })
}

/// Decodes what [`encode`] has made of a chunk of `raw` bytes (for [`Codec::Planes`]: of a map).
///
/// # Errors
/// A damaged frame, or another length.
pub fn unencoded(codec: Codec, raw: u64, stored: &[u8]) -> Result<Cow<'_, [u8]>, Fault> {
    match codec {
        Codec::Raw => Ok(Cow::Borrowed(stored)),
        Codec::Zstd => unpacked(stored, raw..=raw).map(Cow::Owned),
        // Planes are never longer than what they were made from.
        Codec::Planes => tiles::from_planes(&unpacked(stored, 0..=raw)?, raw).map(Cow::Owned),
    }
}

/// What the one frame holds that a chunk's stored bytes must be, if its length is one of `lengths`.
fn unpacked(stored: &[u8], lengths: RangeInclusive<u64>) -> Result<Vec<u8>, Fault> {
    if !stored.starts_with(&FRAME_MAGIC) {
        return Err(Fault::invalid("not a zstd frame"));
    }
    // The lengths are bounded by what the directory was checked against; the one frame must declare
    // its own, so that it cannot ask for more.
    let declared = zstd::zstd_safe::get_frame_content_size(stored).ok().flatten();
    let frame = zstd::zstd_safe::find_frame_compressed_size(stored).ok();
    let declared = declared.filter(|d| lengths.contains(d) && frame == Some(stored.len()));
    let declared = declared.ok_or_else(|| Fault::invalid("its frame has another size"))?;
    let bad = |e: io::Error| Fault::invalid(e.to_string());
    let mut raw: Vec<u8> = room_for(declared, || "a frame".into())?;
    let mut decompressor = zstd::bulk::Decompressor::new().map_err(bad)?;
    decompressor.decompress_to_buffer(stored, &mut raw).map_err(bad)?;
    match raw.len() as u64 == declared {
        true => Ok(raw),
        false => Err(Fault::invalid("decodes to another length")),
    }
}

/// Whether the specification lets files of a kind hold chunks of another.
fn may_hold(file: FileKind, chunk: ChunkKind) -> bool {
    use ChunkKind::*;
    match file {
        FileKind::Manifest => chunk == Record,
        FileKind::Scene => chunk == Scene,
        FileKind::Textures => matches!(chunk, TotalTexture | CurrentTexture | HalfTexture),
        FileKind::Sums => chunk == Sums,
        FileKind::Tiles => matches!(chunk, Unshot | Arrived | Total),
        FileKind::Pack => matches!(chunk, Record | Scene | TotalTexture | Total),
    }
}

/// Checks how many bytes a chunk has, decoded, in a file with this first block.
fn check_raw(kind: ChunkKind, raw: u64, header: &Header, limits: &Limits) -> Result<u64, Fault> {
    let Header { resolution, tile, surfaces, .. } = *header;
    match kind {
        ChunkKind::Record if raw <= limits::RECORD => Ok(raw),
        ChunkKind::Record => {
            let limit = limits::RECORD;
            Err(Fault::Limit { what: "chunk length", value: raw, limit, flag: None })
        }
        ChunkKind::Scene => limits.check_chunk(raw, u64::MAX),
        // Two values of three f32 a texel.
        ChunkKind::TotalTexture | ChunkKind::CurrentTexture | ChunkKind::HalfTexture => {
            limits.check_texel_chunk(raw, 0, 24)
        }
        // Ten numbers of sixteen bytes, and for each half two times four of eight a texel.
        ChunkKind::Sums => limits.check_texel_chunk(raw, 10 * 16, 128),
        ChunkKind::Unshot | ChunkKind::Arrived | ChunkKind::Total => {
            limits.check_chunk(raw, tiles::most_bytes(resolution, tile, surfaces))
        }
    }
}

/// The most bytes that `raw` bytes may take when they are stored.
fn most_stored(raw: u64) -> u64 {
    raw.saturating_add(raw / 256).saturating_add(64)
}

impl Header {
    /// Whether this version may change the file, or the field that it belongs to.
    ///
    /// # Errors
    /// The first feature that is required to write and is not known.
    pub fn check_writable(&self) -> Result<(), Fault> {
        match self.required_to_write {
            0 => Ok(()),
            bits => Err(Fault::ReadOnlyFeature(bits.trailing_zeros())),
        }
    }

    /// Whether the file is a pack whose tile maps have no entries of diffuse surfaces.
    pub fn leaves_diffuse_out(&self) -> bool {
        self.kind == FileKind::Pack && self.optional & DIFFUSE_LEFT_OUT != 0
    }

    /// Whether the file is the one of this field, generation and direction, and no sound file that
    /// belongs elsewhere.
    ///
    /// # Errors
    /// When it is another one.
    pub fn check_place(
        &self,
        field: &FieldId,
        (generation, direction): (u32, u32),
    ) -> Result<(), Fault> {
        if self.field != *field {
            return Err(Fault::invalid("belongs to another field"));
        }
        if (self.generation, self.direction) != (generation, direction) {
            return Err(Fault::invalid("belongs to another generation or direction"));
        }
        Ok(())
    }

    /// The first block's bytes.
    fn to_bytes(&self, chunks: u64, directory_hash: u64, file_len: u64) -> [u8; FIRST_BLOCK] {
        let mut w = Writer::default();
        w.0.extend_from_slice(&MAGIC);
        w.u32(SENTINEL);
        w.u16(READS_MAJOR);
        w.u16(MINOR);
        // Features required to read, and to write: none so far.
        w.u64(0);
        w.u64(0);
        w.u64(self.optional);
        w.u32(self.kind as u32);
        w.u32(self.directions);
        w.u32(self.resolution);
        w.u32(self.tile);
        w.i32(self.exponent);
        w.u32(self.surfaces);
        w.0.extend_from_slice(&self.field);
        w.u32(self.generation);
        w.u32(self.direction);
        w.u64(chunks);
        w.u64(directory_hash);
        w.u64(file_len);
        w.0.resize(HASH_AT, 0);
        let hash = XxHash3_64::oneshot(&w.0);
        w.u64(hash);
        let mut block = [0; FIRST_BLOCK];
        block.copy_from_slice(&w.0);
        block
    }

    /// Checks a first block against the length of its file. Returns it with the number of chunks and
    /// the directory's hash.
    fn parse(block: &[u8], file_len: u64, limits: &Limits) -> Result<(Header, u64, u64), Fault> {
        let is_magic = block.iter().zip(&MAGIC).all(|(byte, magic)| byte == magic);
        if !is_magic || block.is_empty() {
            // CR LF turned into LF, or LF into CR LF, right behind the letters.
            let mangled = block.len() > 4 && block.get(1..4) == MAGIC.get(1..4);
            return Err(if mangled { Fault::TextMode } else { Fault::Foreign });
        }
        let whole = block.get(..FIRST_BLOCK).and_then(|block| block.split_at_checked(HASH_AT));
        let Some((hashed, hash)) = whole else {
            return Err(Fault::Truncated { expected: FIRST_BLOCK as u64, actual: file_len });
        };
        let mut r = Reader::new(hashed);
        r.take(MAGIC.len())?;
        match r.u32()? {
            SENTINEL => {}
            v if v == SENTINEL.swap_bytes() => return Err(Fault::ByteOrder),
            _ => return Err(Fault::Checksum { what: "first block".into(), offset: 0 }),
        }
        let (major, minor) = (r.u16()?, r.u16()?);
        let stated = Reader::new(hash).u64()?;
        if major == READS_MAJOR && XxHash3_64::oneshot(hashed) != stated {
            return Err(Fault::Checksum { what: "first block".into(), offset: 0 });
        }
        if major != READS_MAJOR {
            return Err(Fault::Version { major, minor });
        }
        let required = r.u64()?;
        if required != 0 {
            return Err(Fault::Feature(required.trailing_zeros()));
        }
        let required_to_write = r.u64()?;
        let optional = r.u64()?;
        let kind = file_kind(r.u32()?)?;
        let directions = limits.check_directions(r.u32()?)?;
        let resolution = limits.check_resolution(r.u32()?)?;
        let tile = limits.check_tile(r.u32()?)?;
        let exponent = r.i32()?;
        let surfaces = limits.check_surfaces(r.u32()?)?;
        if tile == 0 || resolution == 0 || !resolution.is_multiple_of(tile) {
            return Err(Fault::invalid(format!("resolution {resolution} in tiles of {tile}")));
        }
        if !(-100..=100).contains(&exponent) {
            return Err(Fault::invalid(format!("radiance exponent {exponent}")));
        }
        let mut field = [0; 16];
        field.copy_from_slice(r.take(16)?);
        let (generation, direction) = (r.u32()?, r.u32()?);
        let (chunks, directory_hash, stated_len) = (r.u64()?, r.u64()?, r.u64()?);
        if r.take(r.left())?.iter().any(|b| *b != 0) {
            return Err(Fault::invalid("reserved bytes of the first block are not zero"));
        }
        match file_len.checked_sub(stated_len) {
            None => return Err(Fault::Truncated { expected: stated_len, actual: file_len }),
            Some(0) => {}
            Some(surplus) => return Err(Fault::Surplus(surplus)),
        }
        let header = Header {
            kind,
            field,
            directions,
            resolution,
            tile,
            exponent,
            surfaces,
            generation,
            direction,
            required_to_write,
            optional,
        };
        Ok((header, chunks, directory_hash))
    }
}

impl ChunkEntry {
    fn write(&self, w: &mut Writer) {
        w.u32(self.id.kind as u32);
        w.u32(self.id.cycle);
        w.u32(self.id.direction);
        w.u32(self.codec as u32);
        w.u64(self.offset);
        w.u64(self.stored);
        w.u64(self.raw);
        w.u64(self.hash);
        w.u64(0);
        w.u64(0);
    }

    fn parse(r: &mut Reader, header: &Header, limits: &Limits) -> Result<ChunkEntry, Fault> {
        let kind = chunk_kind(r.u32()?)?;
        let (cycle, direction) = (r.u32()?, r.u32()?);
        let codec = match r.u32()? {
            0 => Codec::Raw,
            1 => Codec::Zstd,
            2 if kind == ChunkKind::Total && header.kind == FileKind::Pack => Codec::Planes,
            c => return Err(Fault::invalid(format!("unknown codec {c}"))),
        };
        let (offset, stored, raw, hash) = (r.u64()?, r.u64()?, r.u64()?, r.u64()?);
        if r.u64()? != 0 || r.u64()? != 0 {
            return Err(Fault::invalid("reserved bytes of a directory entry are not zero"));
        }
        if !may_hold(header.kind, kind) {
            return Err(Fault::invalid(format!(
                "a chunk of kind {kind:?} in a {:?} file",
                header.kind
            )));
        }
        check_raw(kind, raw, header, limits)?;
        if (codec == Codec::Raw && raw != stored) || stored > most_stored(raw) {
            return Err(Fault::invalid(format!("{stored} bytes are stored for a chunk of {raw}")));
        }
        let id = ChunkId { kind, cycle, direction };
        Ok(ChunkEntry { id, codec, offset, stored, raw, hash })
    }

    /// Bytes of the padding behind it.
    #[allow(
        clippy::arithmetic_side_effects,
        clippy::cast_possible_truncation,
        reason = "a remainder of 64"
    )]
    pub fn padding(&self) -> usize {
        let end = self.offset.wrapping_add(self.stored);
        (end.wrapping_neg() % ALIGN as u64) as usize
    }

    /// Checks the padding behind it.
    ///
    /// # Errors
    /// When it is not zero.
    pub fn check_padding(&self, padding: &[u8]) -> Result<(), Fault> {
        if padding.iter().all(|b| *b == 0) {
            return Ok(());
        }
        Err(Fault::invalid(format!("{}: the padding behind it is not zero", self.id)))
    }

    /// Checks that the chunk is in its file and behind the one before it.
    /// `next` is whose turn it is among the maps of a pack.
    fn check_place(
        &self,
        header: &Header,
        before: Option<&ChunkEntry>,
        next: Option<DirectionId>,
    ) -> Result<(), Fault> {
        let ChunkId { kind, cycle, direction } = self.id;
        let wrong =
            |what| Err(Fault::invalid(format!("{kind:?} of direction {direction}: {what}")));
        let is_map = matches!(kind, ChunkKind::Unshot | ChunkKind::Arrived | ChunkKind::Total);
        if is_map != (direction != NO_DIRECTION) || (is_map && direction >= header.directions) {
            return wrong("it has no such direction");
        }
        let same_place = match header.kind {
            FileKind::Pack => before.is_none_or(|b| b.id.cycle == cycle),
            _ => (cycle, direction) == (header.generation, header.direction),
        };
        if !same_place {
            return wrong("its cycle or direction is not its file's");
        }
        // Not twice either.
        let is_in_order = match (header.kind, kind) {
            (FileKind::Pack, ChunkKind::Total) => next == Some(DirectionId(direction)),
            _ => before.is_none_or(|b| (b.id.kind, b.id.direction) < (kind, direction)),
        };
        if !is_in_order {
            return wrong("the chunks are not in order");
        }
        Ok(())
    }
}

impl Directory {
    /// Length of first block and directory, from the first block; what [`Directory::parse`] wants.
    ///
    /// # Errors
    /// A first block that is not sound, or a file too short for its directory.
    pub fn length(block: &[u8], file_len: u64, limits: &Limits) -> Result<usize, Fault> {
        let (header, chunks, _) = Header::parse(block, file_len, limits)?;
        let limit = match header.kind {
            FileKind::Pack => 3 + u64::from(header.directions),
            FileKind::Textures => 3,
            _ => 2,
        };
        if chunks > limit {
            return Err(Fault::Limit { what: "chunk count", value: chunks, limit, flag: None });
        }
        if header.kind == FileKind::Pack && chunks < limit {
            return Err(Fault::Missing(format!(
                "one chunk or more of {limit}, the pack's number,"
            )));
        }
        chunks
            .checked_mul(ENTRY as u64)
            .and_then(|d| d.checked_add(FIRST_BLOCK as u64))
            .filter(|end| *end <= file_len)
            .and_then(|end| usize::try_from(end).ok())
            .ok_or_else(|| Fault::invalid(format!("no room for a directory of {chunks} chunks")))
    }

    /// Checks first block and directory (`head` begins the file and holds both) against the length
    /// of the file: hashes, limits, and that the chunks lie in order, aligned, without a hole, to the
    /// very end.
    ///
    /// # Errors
    /// The first fault found.
    pub fn parse(head: &[u8], file_len: u64, limits: &Limits) -> Result<Directory, Fault> {
        let (header, chunks, hash) = Header::parse(head, file_len, limits)?;
        let end = Directory::length(head, file_len, limits)?;
        let table = head
            .get(FIRST_BLOCK..end)
            .ok_or(Fault::Truncated { expected: end as u64, actual: head.len() as u64 })?;
        if XxHash3_64::oneshot(table) != hash {
            let offset = FIRST_BLOCK as u64;
            return Err(Fault::Checksum { what: "directory".into(), offset });
        }
        let mut r = Reader::new(table);
        let mut entries: Vec<ChunkEntry> = room_for(chunks, || "directory".into())?;
        let mut at = end as u64;
        let order = match header.kind {
            FileKind::Pack => paging(header.directions).unwrap_or_default(),
            _ => Vec::new(),
        };
        let mut order = order.into_iter();
        for i in 0..chunks {
            let entry = ChunkEntry::parse(&mut r, &header, limits)?;
            let is_packed = entry.id.kind == ChunkKind::Total && header.kind == FileKind::Pack;
            let next = if is_packed { order.next() } else { None };
            entry.check_place(&header, entries.last(), next)?;
            if entry.offset != at.next_multiple_of(ALIGN as u64) {
                return Err(Fault::invalid(format!("chunk {i} is not where the one before ends")));
            }
            at = entry
                .offset
                .checked_add(entry.stored)
                .filter(|e| *e <= file_len)
                .ok_or_else(|| Fault::invalid(format!("chunk {i} reaches beyond the file")))?;
            entries.push(entry);
        }
        if at.next_multiple_of(ALIGN as u64) != file_len {
            return Err(Fault::invalid("the chunks do not end with the file"));
        }
        Ok(Directory { header, entries })
    }

    /// Refuses a file of another kind.
    ///
    /// # Errors
    /// When it is one.
    pub fn is_of(&self, kind: FileKind) -> Result<(), Fault> {
        match self.header.kind {
            found if found == kind => Ok(()),
            found => Err(Fault::invalid(format!("is a {found:?} file, not {kind:?}"))),
        }
    }

    /// The entry of a chunk.
    ///
    /// # Errors
    /// When the file has none of that kind and direction.
    pub fn find(&self, kind: ChunkKind, direction: u32) -> Result<&ChunkEntry, Fault> {
        self.entries
            .iter()
            .find(|e| e.id.kind == kind && e.id.direction == direction)
            .ok_or_else(|| Fault::Missing(ChunkId { kind, cycle: 0, direction }.to_string()))
    }

    /// Verifies and decodes a chunk of a file that is in memory or mapped, as a whole or up to the
    /// multiple of [`ALIGN`] at which the next chunk begins.
    ///
    /// # Errors
    /// As [`decode`], or when the padding behind the chunk is not zero.
    pub fn chunk<'a>(&self, file: &'a [u8], entry: &ChunkEntry) -> Result<Cow<'a, [u8]>, Fault> {
        let end = entry.offset.saturating_add(entry.stored);
        let next = end.checked_next_multiple_of(ALIGN as u64).unwrap_or(u64::MAX);
        let between = |from: u64, to: u64| file.get(from.try_into().ok()?..to.try_into().ok()?);
        let (stored, padding) = between(entry.offset, end)
            .zip(between(end, next))
            .ok_or(Fault::Truncated { expected: next, actual: file.len() as u64 })?;
        entry.check_padding(padding)?;
        decode(&self.header.field, entry, stored)
    }

    /// The same for a chunk whose stored bytes were read with the padding behind them.
    ///
    /// # Errors
    /// As [`Directory::chunk`].
    pub fn chunk_read(&self, mut framed: Vec<u8>, entry: &ChunkEntry) -> Result<Vec<u8>, Fault> {
        let stored = usize::try_from(entry.stored).unwrap_or(usize::MAX);
        entry.check_padding(&framed.split_off(stored.min(framed.len())))?;
        match decode(&self.header.field, entry, &framed)? {
            Cow::Borrowed(_) => Ok(framed),
            Cow::Owned(raw) => Ok(raw),
        }
    }
}

/// Writes a container chunk by chunk; the number of chunks is fixed at the start, so that the
/// directory can stand before them.
pub struct ContainerWriter<W: Write + Seek> {
    out: W,
    header: Header,
    chunks: usize,
    entries: Vec<ChunkEntry>,
    at: u64,
}

#[allow(
    clippy::arithmetic_side_effects,
    clippy::cast_possible_truncation,
    clippy::indexing_slicing,
    reason = "counts what it has written itself"
)]
impl<W: Write + Seek> ContainerWriter<W> {
    /// Leaves room for first block and directory.
    ///
    /// # Errors
    /// Of the output.
    pub fn new(mut out: W, header: Header, chunks: usize) -> io::Result<ContainerWriter<W>> {
        let at = FIRST_BLOCK + ENTRY * chunks;
        out.write_all(&vec![0; at])?;
        Ok(ContainerWriter { out, header, chunks, entries: Vec::new(), at: at as u64 })
    }

    /// Appends a chunk.
    ///
    /// # Errors
    /// Of the output or the compressor.
    ///
    /// # Panics
    /// When more chunks come than were announced.
    pub fn chunk(&mut self, id: ChunkId, codec: Codec, raw: &[u8]) -> io::Result<()> {
        let stored = encode(codec, raw)?;
        self.stored_chunk(id, codec, raw.len() as u64, &stored)
    }

    /// Appends a chunk whose bytes are encoded already; `raw` is their decoded length.
    ///
    /// # Errors
    /// Of the output.
    ///
    /// # Panics
    /// When more chunks come than were announced.
    pub fn stored_chunk(
        &mut self,
        id: ChunkId,
        codec: Codec,
        raw: u64,
        stored: &[u8],
    ) -> io::Result<()> {
        let offset = self.begin_chunk()?;
        self.out.write_all(stored)?;
        self.at += stored.len() as u64;
        let hash = chunk_hash(&self.header.field, id, stored);
        let stored = stored.len() as u64;
        self.entries.push(ChunkEntry { id, codec, offset, stored, raw, hash });
        Ok(())
    }

    /// Appends a chunk, stored as it is, whose bytes come in blocks.
    ///
    /// # Errors
    /// Of the output.
    ///
    /// # Panics
    /// When more chunks come than were announced.
    pub fn raw_chunk(
        &mut self,
        id: ChunkId,
        blocks: impl IntoIterator<Item = impl AsRef<[u8]>>,
    ) -> io::Result<()> {
        let offset = self.begin_chunk()?;
        let mut hasher = ChunkHasher::new(&self.header.field, id);
        for block in blocks {
            let block = block.as_ref();
            hasher.write(block);
            self.out.write_all(block)?;
            self.at += block.len() as u64;
        }
        let stored = self.at - offset;
        let hash = hasher.finish();
        self.entries.push(ChunkEntry { id, codec: Codec::Raw, offset, stored, raw: stored, hash });
        Ok(())
    }

    /// Bytes of the file, if no more chunks came.
    pub fn length(&self) -> u64 {
        self.at.next_multiple_of(ALIGN as u64)
    }

    /// Pads to where the next chunk begins.
    fn begin_chunk(&mut self) -> io::Result<u64> {
        assert!(self.entries.len() < self.chunks, "more chunks than announced");
        let offset = self.at.next_multiple_of(ALIGN as u64);
        self.out.write_all(&[0; ALIGN][..(offset - self.at) as usize])?;
        self.at = offset;
        Ok(offset)
    }

    /// Writes first block and directory and hands the output back, unsynced.
    ///
    /// # Errors
    /// Of the output.
    ///
    /// # Panics
    /// When fewer chunks came than were announced.
    pub fn finish(mut self) -> io::Result<W> {
        assert_eq!(self.entries.len(), self.chunks, "fewer chunks than announced");
        let end = self.at.next_multiple_of(ALIGN as u64);
        self.out.write_all(&[0; ALIGN][..(end - self.at) as usize])?;
        let mut table = Writer::default();
        self.entries.iter().for_each(|e| e.write(&mut table));
        let hash = XxHash3_64::oneshot(&table.0);
        let block = self.header.to_bytes(self.chunks as u64, hash, end);
        self.out.seek(SeekFrom::Start(0))?;
        self.out.write_all(&block)?;
        self.out.write_all(&table.0)?;
        self.out.flush()?;
        Ok(self.out)
    }
}

/// Bytes of a container whose chunks store so many.
#[allow(clippy::arithmetic_side_effects, reason = "of chunks that are in memory or on a disk")]
pub fn length(stored: impl ExactSizeIterator<Item = u64>) -> u64 {
    let pad = |at: u64| at.next_multiple_of(ALIGN as u64);
    let directory = (FIRST_BLOCK + ENTRY * stored.len()) as u64;
    pad(stored.fold(directory, |at, chunk| pad(at) + chunk))
}

/// A container built in memory.
///
/// # Errors
/// Of the compressor.
pub fn to_bytes(header: Header, chunks: &[(ChunkId, Codec, &[u8])]) -> io::Result<Vec<u8>> {
    let mut w = ContainerWriter::new(io::Cursor::new(Vec::new()), header, chunks.len())?;
    for (id, codec, raw) in chunks {
        w.chunk(*id, *codec, raw)?;
    }
    Ok(w.finish()?.into_inner())
}

/// Reads first block and directory of a file in memory; `name` is for the message.
///
/// # Errors
/// The first fault found, with the file's name; or another kind of file than `kind`.
pub fn open(
    name: &str,
    file: &[u8],
    kind: FileKind,
    limits: &Limits,
) -> Result<Directory, FormatError> {
    let directory = Directory::parse(file, file.len() as u64, limits);
    let directory = directory.map_err(|f| f.in_file(name))?;
    directory.is_of(kind).map_err(|f| f.in_file(name))?;
    Ok(directory)
}
