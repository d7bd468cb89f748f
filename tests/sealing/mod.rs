//! Makes the hashes of a file that has been tampered with fit again, so that what is behind them is
//! tried. By the specification alone: nothing here is the library's.

// Not every test that tampers needs all of it.
#![allow(dead_code)]

use std::ops::Range;
use twox_hash::XxHash3_64;

/// Bytes of the first block.
pub const FIRST_BLOCK: usize = 256;
/// Bytes of a directory entry.
pub const ENTRY: usize = 64;

/// The little-endian number of up to eight bytes.
pub fn number(bytes: &[u8]) -> u64 {
    bytes.iter().rev().fold(0, |n, b| n << 8 | u64::from(*b))
}

/// Number of chunks, as the first block says.
pub fn chunks(file: &[u8]) -> Option<usize> {
    number(file.get(88..96)?).try_into().ok()
}

/// Where the entry of a chunk is.
pub fn entry(chunk: usize) -> Range<usize> {
    FIRST_BLOCK + ENTRY * chunk..FIRST_BLOCK + ENTRY * (chunk + 1)
}

/// Where the stored bytes of a chunk are, as its entry says; `None` when that is not in the file.
pub fn stored(file: &[u8], chunk: usize) -> Option<Range<usize>> {
    let at = entry(chunk).start;
    let offset: usize = number(file.get(at + 16..at + 24)?).try_into().ok()?;
    let length: usize = number(file.get(at + 24..at + 32)?).try_into().ok()?;
    let range = offset..offset.checked_add(length)?;
    file.get(range.clone()).map(|_| range)
}

/// Makes the hash of a chunk fit its bytes and its place. `None` when they are not in the file.
pub fn seal_chunk(file: &mut [u8], chunk: usize) -> Option<()> {
    let bytes = stored(file, chunk)?;
    let entry = entry(chunk);
    let identity = [file.get(64..80)?, &file.get(entry.clone())?[..12]].concat();
    let seed = XxHash3_64::oneshot(&identity);
    let hash = XxHash3_64::oneshot_with_seed(seed, &file[bytes]);
    file[entry][40..48].copy_from_slice(&hash.to_le_bytes());
    Some(())
}

/// Makes the hashes of directory and first block fit. `None` when they are not in the file.
pub fn seal_head(file: &mut [u8]) -> Option<()> {
    let end = chunks(file)?.checked_mul(ENTRY)?.checked_add(FIRST_BLOCK)?;
    if let Some(table) = file.get(FIRST_BLOCK..end) {
        let directory = XxHash3_64::oneshot(table);
        file[96..104].copy_from_slice(&directory.to_le_bytes());
    }
    let block = XxHash3_64::oneshot(file.get(..248)?);
    file.get_mut(248..256)?.copy_from_slice(&block.to_le_bytes());
    Some(())
}

/// Makes all hashes fit that can, and the length that the file states.
pub fn seal(file: &mut [u8]) {
    if file.len() < FIRST_BLOCK {
        return;
    }
    let length = file.len() as u64;
    file[104..112].copy_from_slice(&length.to_le_bytes());
    let entries = (file.len() - FIRST_BLOCK) / ENTRY;
    for chunk in 0..chunks(file).unwrap_or(0).min(entries) {
        seal_chunk(file, chunk);
    }
    seal_head(file);
}

/// A chunk that is taken out of a pack to be put back otherwise.
#[derive(Clone)]
pub struct Chunk {
    /// Kind, cycle and direction, as in an entry.
    pub id: [u8; 12],
    /// How the bytes are stored.
    pub codec: u32,
    /// How many bytes they decode to.
    pub raw: u64,
    /// The stored bytes.
    pub bytes: Vec<u8>,
}

impl Chunk {
    /// Puts bytes in, raw or as the frame or frames that they are.
    pub fn put(&mut self, codec: u32, raw: usize, bytes: Vec<u8>) {
        (self.codec, self.raw, self.bytes) = (codec, raw as u64, bytes);
    }
}

/// Takes a pack apart, and puts what `edit` leaves together again with sound hashes.
pub fn rebuilt(pack: &[u8], edit: &dyn Fn(&mut Vec<Chunk>)) -> Vec<u8> {
    let mut parts: Vec<Chunk> = (0..chunks(pack).unwrap())
        .map(|k| {
            let own = &pack[entry(k)];
            Chunk {
                id: own[..12].try_into().unwrap(),
                codec: number(&own[12..16]) as u32,
                raw: number(&own[32..40]),
                bytes: pack[stored(pack, k).unwrap()].to_vec(),
            }
        })
        .collect();
    edit(&mut parts);
    let mut file = pack[..FIRST_BLOCK].to_vec();
    file[88..96].copy_from_slice(&(parts.len() as u64).to_le_bytes());
    file.resize(FIRST_BLOCK + ENTRY * parts.len(), 0);
    for (k, chunk) in parts.iter().enumerate() {
        let numbers = [file.len() as u64, chunk.bytes.len() as u64, chunk.raw];
        let numbers: Vec<u8> = numbers.iter().flat_map(|n| n.to_le_bytes()).collect();
        let own = [&chunk.id[..], &chunk.codec.to_le_bytes(), &numbers].concat();
        file[entry(k)][..40].copy_from_slice(&own);
        file.extend(&chunk.bytes);
        file.resize(file.len().next_multiple_of(64), 0);
    }
    seal(&mut file);
    file
}
