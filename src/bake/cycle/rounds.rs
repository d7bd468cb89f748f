//! Rounds: a cycle's lines a part at a time, until they are enough, and what they have brought.

use super::{Bake, Brought, add_sums, lock};
use crate::bake::BakeError;
use crate::bake::estimate::{Choice, Errors, Totals, by_surface, grids_of_half, lacking};
use crate::bake::layers::SPLIT;
use crate::bake::ledger::open_areas;
use crate::bake::step::Scratch;
use crate::bake::transfer::diffuse::next_textures;
use crate::bake::transfer::{self, Fixed};
use crate::field::FieldError;
use crate::format::container::ChunkKind;
use crate::radiance::Rgb;
use std::borrow::Cow;
use std::iter::successors;
use std::ops::Range;
use std::sync::Mutex;

/// Rounds of a cycle after which it may have lines enough.
const ROUNDS: u32 = 8;

impl Bake<'_> {
    /// The PSFs of each direction in the round under way: all of a cycle, unless an error is aimed at.
    pub(super) fn round(&self, cycle: u32) -> Range<u32> {
        let before = self.field.manifest().grids.get(cycle as usize).copied().unwrap_or(0);
        let most = self.parameters.grids(cycle).perturbations;
        match self.parameters.target_error > 0.0 {
            true => before..(before + most.div_ceil(ROUNDS)).min(most),
            false => before..most,
        }
    }

    /// Whether a cycle has all its lines. Where the round under way has ended and these are not enough,
    /// the next one begins.
    pub(super) fn is_over(
        &mut self,
        own: &Mutex<Scratch>,
        few_send: bool,
    ) -> Result<bool, BakeError> {
        if !self.all_done() {
            return Ok(false);
        }
        let cycle = self.field.manifest().cycle;
        let round = self.round(cycle);
        if round.end == self.parameters.grids(cycle).perturbations {
            return Ok(true);
        }
        let sums = &mut lock(own).sums;
        let [half, all] = sums;
        add_sums(all, half, 1);
        let brought = {
            let [half, all] = self.levelled([half, all], round.end, few_send);
            // The least of the filter: more of it takes longer than it tells.
            self.brought([&half, &all], round.end, few_send, self.least_filter())
        };
        add_sums(all, half, -1);
        let (total, half) = self.totals_with(&brought)?;
        let errors = self.errors_of(&brought.open, &total, &half);
        let lacking = lacking(&errors, self.parameters.target_error, cycle);
        if lacking.is_empty() {
            return Ok(true);
        }
        // A scene of which every lit part still lacks lines goes on as it is; and where cells are split, lines
        // that meet some surfaces only would not be those of all.
        let some_have = self.supplied.any() || lacking.len() < errors.len();
        if some_have && (few_send || !self.parameters.supersample) {
            self.supplied.add(&lacking, (self.texels, round.end), sums);
        }
        self.end_step(self.work_of(cycle, round.clone()));
        let manifest = self.field.manifest_mut();
        manifest.done.fill(0);
        manifest.grids[cycle as usize] = round.end;
        self.begin_step();
        Ok(false)
    }

    /// What the lines of a cycle have brought: from the sums of half of them and of all, each direction
    /// standing for so many PSFs. Each side of a surface is filtered as often as its error is lowest by, up to
    /// `most` times.
    pub(super) fn brought(
        &self,
        [half, all]: [&[Fixed]; 2],
        grids: u32,
        few_send: bool,
        most: u32,
    ) -> Brought {
        let thinned = self.parameters.grids(self.field.manifest().cycle).thinned;
        // A whole texel meets lines in proportion to its projected area: pi sr in all.
        let lines = std::f64::consts::PI / (self.share(thinned) * self.ray());
        let repeats = f64::from(grids);
        // Of few senders, only the lines of the unperturbed PSFs are counted.
        let values = 2 * self.texels.len();
        let counted = lines * if few_send { 1.0 } else { repeats };
        let is_cut = |texel| self.texels.cuts.is_cut(texel);
        let open = open_areas(&self.areas, &all[..values], counted, is_cut);
        let next = |sums: &[Fixed], repeats: f64, passes: u32| {
            let struck = |value: usize| match few_send {
                true => repeats * lines * open[value],
                false => transfer::lines(&sums[value]),
            };
            let how = (passes, self.parameters.one_sided);
            let lines = (&struck as &dyn Fn(usize) -> f64, lines * repeats);
            next_textures(
                (self.scene, &self.reflectances),
                self.texels,
                (sums, self.quantum),
                lines,
                how,
            )
        };
        let halved = grids_of_half(self.directions, thinned, grids);
        let both =
            |passes| self.pool.join(|| next(all, repeats, passes), || next(half, halved, passes));
        let least = self.least_filter();
        let (mut all, mut half) = both(least);
        let doubled = successors(Some(2 * least), |passes| Some(2 * passes));
        let more = doubled.take_while(|passes| (1..most).contains(passes));
        let mut choice = Choice::new(self.texels, &open, Totals { all: &all, half: &half });
        let last = (most > least).then_some(most);
        for passes in more.chain(last) {
            let (more, more_half) = both(passes);
            let maps = Totals { all: &more, half: &more_half };
            choice.take(self.texels, (&open, maps), [least, passes], [&mut all, &mut half]);
        }
        Brought { next: all, half, open }
    }

    /// Passes of the filter that every surface has in every cycle.
    pub(super) fn least_filter(&self) -> u32 {
        self.parameters.filter.min(1)
    }

    /// Area that a ray stands for, in the fitted scene's units squared.
    pub(super) fn ray(&self) -> f64 {
        let parts = if self.parameters.supersample { SPLIT } else { 1 };
        f64::from(2.0 / (parts * self.parameters.resolution) as f32).powi(2)
    }

    /// Solid angle of a share of the lines of a cycle, sr.
    pub(super) fn share(&self, thinned: u32) -> f64 {
        self.directions.share() * 4f64.powi(thinned as i32)
    }

    pub(super) fn errors_of(&self, open: &[f64], all: &[Rgb], half: &[Rgb]) -> Vec<Errors> {
        let maps = Totals { all, half };
        self.pool.install(|| by_surface(self.scene, self.texels, open, maps))
    }

    /// The sums of half of the lines of a cycle and of all, every surface's of as many grids.
    pub(super) fn levelled<'b>(
        &self,
        sums: [&'b [Fixed]; 2],
        grids: u32,
        few_send: bool,
    ) -> [Cow<'b, [Fixed]>; 2] {
        if !self.supplied.any() {
            return sums.map(Cow::Borrowed);
        }
        let thinned = self.parameters.grids(self.field.manifest().cycle).thinned;
        // Of few senders, only the lines of the unperturbed PSFs are counted.
        let level = |sums: &[Fixed], of: &dyn Fn(u32) -> f64| {
            let mut levelled = sums.to_vec();
            self.supplied.level(self.texels, &mut levelled, (grids, !few_send), of);
            Cow::Owned(levelled)
        };
        let [half, all] = sums;
        let halved = |grids| grids_of_half(self.directions, thinned, grids);
        [level(half, &halved), level(all, &f64::from)]
    }

    /// The total texture maps, of all lines and of half of them, with what a cycle has brought.
    pub(super) fn totals_with(
        &self,
        brought: &Brought,
    ) -> Result<(Vec<Rgb>, Vec<Rgb>), FieldError> {
        let mut total = self.texture(ChunkKind::TotalTexture)?;
        let mut half = self.texture(ChunkKind::HalfTexture)?;
        total.iter_mut().zip(&brought.next).for_each(|(t, n)| *t += *n);
        half.iter_mut().zip(&brought.half).for_each(|(t, n)| *t += *n);
        Ok((total, half))
    }
}
