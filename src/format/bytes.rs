//! Little-endian numbers in and out of byte strings, without a panic on short input.

#![deny(
    clippy::arithmetic_side_effects,
    clippy::cast_possible_truncation,
    clippy::indexing_slicing
)]

use super::Fault;

/// Appends little-endian numbers to a byte string.
#[derive(Clone, Debug, Default)]
pub struct Writer(pub Vec<u8>);

impl Writer {
    /// A byte.
    pub fn u8(&mut self, v: u8) {
        self.0.push(v);
    }
    /// Two bytes.
    pub fn u16(&mut self, v: u16) {
        self.0.extend_from_slice(&v.to_le_bytes());
    }
    /// Four bytes.
    pub fn u32(&mut self, v: u32) {
        self.0.extend_from_slice(&v.to_le_bytes());
    }
    /// Eight bytes.
    pub fn u64(&mut self, v: u64) {
        self.0.extend_from_slice(&v.to_le_bytes());
    }
    /// A signed number of four bytes.
    pub fn i32(&mut self, v: i32) {
        self.0.extend_from_slice(&v.to_le_bytes());
    }
    /// A signed number of eight bytes.
    pub fn i64(&mut self, v: i64) {
        self.0.extend_from_slice(&v.to_le_bytes());
    }
    /// An IEEE binary32.
    pub fn f32(&mut self, v: f32) {
        self.u32(v.to_bits());
    }
    /// An IEEE binary64.
    pub fn f64(&mut self, v: f64) {
        self.u64(v.to_bits());
    }
    /// Length and UTF-8 bytes.
    #[allow(clippy::cast_possible_truncation, reason = "names are far shorter")]
    pub fn text(&mut self, v: &str) {
        self.u32(v.len() as u32);
        self.0.extend_from_slice(v.as_bytes());
    }
    /// Zero bytes up to a multiple of `align`.
    pub fn pad(&mut self, align: usize) {
        self.0.resize(self.0.len().next_multiple_of(align), 0);
    }
}

/// Reads little-endian numbers from a byte string.
#[derive(Clone, Debug)]
pub struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    /// Reads from the first byte on.
    pub fn new(bytes: &'a [u8]) -> Reader<'a> {
        Reader { bytes, at: 0 }
    }

    /// How many bytes have been read.
    pub fn offset(&self) -> usize {
        self.at
    }

    /// How many bytes are left.
    pub fn left(&self) -> usize {
        self.bytes.len().saturating_sub(self.at)
    }

    /// The next `n` bytes.
    ///
    /// # Errors
    /// When fewer are left.
    pub fn take(&mut self, n: usize) -> Result<&'a [u8], Fault> {
        let end = self.at.saturating_add(n);
        let taken = self.bytes.get(self.at..end).ok_or_else(|| {
            Fault::invalid(format!("{n} bytes wanted at {:#x}, {} left", self.at, self.left()))
        })?;
        self.at = end;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], Fault> {
        let mut out = [0; N];
        out.copy_from_slice(self.take(N)?);
        Ok(out)
    }

    /// A byte.
    ///
    /// # Errors
    /// At the end of the bytes, as for all that follow.
    pub fn u8(&mut self) -> Result<u8, Fault> {
        Ok(self.array::<1>()?[0])
    }
    /// Two bytes.
    ///
    /// # Errors
    /// At the end of the bytes.
    pub fn u16(&mut self) -> Result<u16, Fault> {
        Ok(u16::from_le_bytes(self.array()?))
    }
    /// Four bytes.
    ///
    /// # Errors
    /// At the end of the bytes.
    pub fn u32(&mut self) -> Result<u32, Fault> {
        Ok(u32::from_le_bytes(self.array()?))
    }
    /// Eight bytes.
    ///
    /// # Errors
    /// At the end of the bytes.
    pub fn u64(&mut self) -> Result<u64, Fault> {
        Ok(u64::from_le_bytes(self.array()?))
    }
    /// A signed number of four bytes.
    ///
    /// # Errors
    /// At the end of the bytes.
    pub fn i32(&mut self) -> Result<i32, Fault> {
        Ok(i32::from_le_bytes(self.array()?))
    }
    /// A signed number of eight bytes.
    ///
    /// # Errors
    /// At the end of the bytes.
    pub fn i64(&mut self) -> Result<i64, Fault> {
        Ok(i64::from_le_bytes(self.array()?))
    }
    /// An IEEE binary32.
    ///
    /// # Errors
    /// At the end of the bytes.
    pub fn f32(&mut self) -> Result<f32, Fault> {
        Ok(f32::from_bits(self.u32()?))
    }
    /// An IEEE binary64.
    ///
    /// # Errors
    /// At the end of the bytes.
    pub fn f64(&mut self) -> Result<f64, Fault> {
        Ok(f64::from_bits(self.u64()?))
    }
    /// Length and UTF-8 bytes, at most `limit` of them.
    ///
    /// # Errors
    /// At the end of the bytes, above the limit, or when they are not UTF-8.
    pub fn text(&mut self, limit: u32) -> Result<String, Fault> {
        let len = self.u32()?;
        if len > limit {
            return Err(Fault::Limit {
                what: "text length",
                value: len.into(),
                limit: limit.into(),
                flag: None,
            });
        }
        String::from_utf8(self.take(len as usize)?.to_vec())
            .map_err(|_| Fault::invalid("a text is not UTF-8"))
    }
    /// How many items of `size` bytes a count in the file names, checked against the bytes left.
    ///
    /// # Errors
    /// When the bytes left cannot hold that many.
    pub fn count(&mut self, size: usize) -> Result<usize, Fault> {
        let count = self.u32()?;
        if u64::from(count).saturating_mul(size as u64) > self.left() as u64 {
            return Err(Fault::invalid(format!(
                "{count} items do not fit into {} bytes",
                self.left()
            )));
        }
        Ok(count as usize)
    }
    /// Requires that all bytes have been read.
    ///
    /// # Errors
    /// When some are left.
    pub fn end(&self) -> Result<(), Fault> {
        match self.left() {
            0 => Ok(()),
            n => Err(Fault::Surplus(n as u64)),
        }
    }
}

pub use tables::{u16_at, u32_at, u64_at};

/// Lookups in tables that were checked as a whole, for the innermost loops.
#[allow(
    clippy::arithmetic_side_effects,
    clippy::indexing_slicing,
    reason = "the table holds the index"
)]
mod tables {
    /// The little-endian number at an index of a table that has been checked to hold it.
    #[inline]
    pub fn u32_at(table: &[u8], index: usize) -> u32 {
        let b = &table[4 * index..4 * index + 4];
        u32::from_le_bytes([b[0], b[1], b[2], b[3]])
    }

    /// The little-endian number at an index of a table that has been checked to hold it.
    #[inline]
    pub fn u64_at(table: &[u8], index: usize) -> u64 {
        let b = &table[8 * index..8 * index + 8];
        u64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]])
    }

    /// The little-endian number at an index of a table that has been checked to hold it.
    #[inline]
    pub fn u16_at(table: &[u8], index: usize) -> u16 {
        u16::from_le_bytes([table[2 * index], table[2 * index + 1]])
    }
}
