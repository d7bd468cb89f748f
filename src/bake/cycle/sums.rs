//! The sums of a cycle under way, to disk and back.

use super::Bake;
use super::supplied::Supplied;
use crate::bake::BakeError;
use crate::bake::ledger::Tally;
use crate::bake::transfer::Fixed;
use crate::field::FieldError;
use crate::field::files::BLOCK;
use crate::format::Fault;
use crate::format::bytes::{Reader, Writer};
use std::time::Instant;

impl Bake<'_> {
    /// Commits the sums of a cycle under way.
    pub(super) fn checkpoint(
        &mut self,
        sums: &[Vec<Fixed>; 2],
        tally: &Tally,
    ) -> Result<(), BakeError> {
        let values = 2 * self.texels.len();
        let mut head = Writer::default();
        tally.write(&mut head);
        self.supplied.write(self.scene.surfaces.len() as u32, &mut head);
        let length = (head.0.len() + 2 * values * size_of::<Fixed>()) as u64;
        let parts = sums.iter().flat_map(|s| s[..values].chunks(BLOCK / size_of::<Fixed>()));
        let blocks = parts.map(|part| {
            let mut w = Writer(Vec::with_capacity(size_of_val(part)));
            part.iter().flatten().for_each(|v| w.i64(*v));
            w.0
        });
        self.field.write_sums(length, std::iter::once(head.0).chain(blocks))?;
        self.count_seconds();
        self.field.commit()?;
        self.committed = Instant::now();
        Ok(())
    }

    /// Reads the committed sums; returns the tally that belongs to them, and which surfaces had lines enough.
    pub(super) fn read_sums(
        &self,
        sums: &mut [Vec<Fixed>; 2],
    ) -> Result<(Tally, Supplied), FieldError> {
        // Numbers of each half, four a value.
        let each = 8 * self.texels.len();
        let count = 2 * each;
        let surfaces = self.scene.surfaces.len() as u32;
        let (mut head, mut rest, mut at) = (None, Vec::new(), 0);
        self.field.read_sums(|block| {
            rest.extend_from_slice(block);
            let mut r = Reader::new(&rest);
            if head.is_none() {
                if (rest.len() as u64) < Supplied::head(surfaces) {
                    return Ok(());
                }
                head = Some((Tally::read(&mut r)?, Supplied::read(&mut r, surfaces)?));
            }
            while r.left() >= 8 && at < count {
                sums[at / each][at % each / 4][at % 4] = r.i64()?;
                at += 1;
            }
            let used = rest.len() - r.left();
            rest.drain(..used);
            Ok(())
        })?;
        match head {
            Some((tally, mut supplied)) if at == count && rest.is_empty() => {
                supplied.keep(sums);
                Ok((tally, supplied))
            }
            _ => Err(Fault::invalid("sums of another length").in_file("sums").into()),
        }
    }
}
