//! Surfaces that have lines enough in a cycle, while others go on.
//!
//! Some surfaces need more lines than others for the same error. Where an error is aimed at, a round of
//! a cycle ends with a look at each surface; those that have come to what is aimed at are *supplied*:
//! their sums stay as they are, and the lines of later rounds are only those that meet a surface that
//! still *lacks* lines. At the end all sums are taken to as many grids.

use crate::bake::ledger::{Tally, channels};
use crate::bake::transfer::Fixed;
use crate::format::Fault;
use crate::format::bytes::{Reader, Writer};
use crate::ids::SurfaceId;
use crate::scene::texels::Texels;

/// Which surfaces have lines enough, and what lines brought since the first had.
#[derive(Clone, Debug, Default)]
pub struct Supplied {
    /// Grids after which each surface had enough; 0: it lacks lines. None where all do.
    grids: Vec<u32>,
    /// Sums of supplied surfaces, of each half of the lines, as they stay. Others' mean nothing.
    sums: [Vec<Fixed>; 2],
    /// Sums over the lines of rounds that were not for all surfaces. What arrived at supplied ones has left.
    pub partial: Tally,
}

impl Supplied {
    /// Whether any surface has lines enough.
    pub fn any(&self) -> bool {
        !self.grids.is_empty()
    }

    /// Grids of the rounds that were for all surfaces, of `grids` in all.
    pub fn whole(&self, grids: u32) -> u32 {
        self.grids.iter().copied().filter(|g| *g > 0).min().unwrap_or(grids)
    }

    /// The surfaces that lack lines; `None`: all of them.
    pub fn lacking(&self) -> Option<Vec<bool>> {
        self.any().then(|| self.grids.iter().map(|g| *g == 0).collect())
    }

    /// Takes the surfaces that have lines enough after so many grids of a cycle, all but those that are
    /// `lacking`, and the sums of half of the lines each.
    pub fn add(
        &mut self,
        lacking: &[SurfaceId],
        (texels, grids): (&Texels, u32),
        sums: &[Vec<Fixed>; 2],
    ) {
        let mut lacks = vec![false; texels.lattices.len()];
        lacking.iter().for_each(|surface| lacks[surface.index()] = true);
        if !self.any() {
            self.grids = vec![0; lacks.len()];
            self.sums = sums.clone();
        }
        for (index, lacks) in lacks.into_iter().enumerate() {
            if self.grids[index] == 0 && !lacks {
                self.grids[index] = grids;
                let values = texels.lattices[index].values();
                for (own, sums) in self.sums.iter_mut().zip(sums) {
                    own[values.clone()].copy_from_slice(&sums[values.clone()]);
                }
            }
        }
    }

    /// Gives supplied surfaces back the sums that they had, and counts what came since as having left.
    pub fn restore(&mut self, texels: &Texels, sums: &mut [Vec<Fixed>; 2]) {
        for index in (0..self.grids.len()).filter(|index| self.grids[*index] > 0) {
            let values = texels.lattices[index].values();
            for (own, sums) in self.sums.iter().zip(sums.iter_mut()) {
                for (own, sum) in own[values.clone()].iter().zip(&mut sums[values.clone()]) {
                    self.partial.left += i128::from(channels(sum) - channels(own));
                    *sum = *own;
                }
            }
        }
    }

    /// Takes the sums of supplied surfaces to `grids` grids; `of` says what part of a cycle's lines so many
    /// of its grids have, and `counted` whether the numbers of lines are of all grids.
    pub fn level(
        &self,
        texels: &Texels,
        sums: &mut [Fixed],
        (grids, counted): (u32, bool),
        of: &dyn Fn(u32) -> f64,
    ) {
        let all = of(grids);
        for (index, own) in self.grids.iter().enumerate().filter(|(_, own)| **own > 0) {
            let times = all / of(*own);
            let channels = if counted { 4 } else { 3 };
            for sum in &mut sums[texels.lattices[index].values()] {
                for v in &mut sum[..channels] {
                    *v = (*v as f64 * times).round() as i64;
                }
            }
        }
    }

    /// The tally of a cycle of `grids` grids whose levelled sums have `levelled` of light and were `raw`
    /// before: as if all rounds had been for all surfaces. What was lost or doubled on the way shows in it
    /// as it did.
    pub fn tally(&self, whole: &Tally, grids: u32, (raw, levelled): (i128, i128)) -> Tally {
        if !self.any() {
            return *whole;
        }
        let mut all = *whole;
        all.add(&self.partial);
        let went = |t: &Tally| t.left + t.to_mirror;
        let astray = all.shot_diffuse + all.shot_mirror - raw - went(&all);
        let times = f64::from(grids) / f64::from(self.whole(grids));
        let level = |sum: i128| (sum as f64 * times).round() as i128;
        let mut tally = Tally {
            left: level(whole.left),
            to_mirror: level(whole.to_mirror),
            mirrored: level(whole.mirrored),
            shot_mirror: level(whole.shot_mirror),
            ..all
        };
        tally.shot_diffuse = levelled + went(&tally) + astray - tally.shot_mirror;
        tally
    }

    /// Bytes of a checkpoint before its sums, for a scene of so many surfaces: a tally of the rounds that were
    /// for all surfaces, and this.
    pub fn head(surfaces: u32) -> u64 {
        2 * Tally::BYTES + 4 * u64::from(surfaces)
    }

    /// Appends it to the bytes of a checkpoint, but for the sums.
    pub fn write(&self, surfaces: u32, w: &mut Writer) {
        self.partial.write(w);
        (0..surfaces as usize).for_each(|s| w.u32(self.grids.get(s).copied().unwrap_or(0)));
    }

    /// Reads what [`Supplied::write`] wrote.
    ///
    /// # Errors
    /// When the bytes end, or a number is out of range.
    pub fn read(r: &mut Reader, surfaces: u32) -> Result<Supplied, Fault> {
        let partial = Tally::read(r)?;
        let mut grids = (0..surfaces).map(|_| r.u32()).collect::<Result<Vec<_>, _>>()?;
        if grids.iter().all(|g| *g == 0) {
            grids.clear();
        }
        Ok(Supplied { grids, partial, ..Supplied::default() })
    }

    /// The part of all texels whose surfaces lack lines.
    pub fn lacking_part(&self, texels: &Texels) -> f64 {
        let supplied = texels.lattices.iter().zip(&self.grids).filter(|(_, grids)| **grids > 0);
        let supplied: usize = supplied.map(|(lattice, _)| lattice.len()).sum();
        1.0 - supplied as f64 / texels.len() as f64
    }

    /// Keeps the sums that were read with it.
    pub fn keep(&mut self, sums: &[Vec<Fixed>; 2]) {
        if self.any() {
            self.sums = sums.clone();
        }
    }
}
