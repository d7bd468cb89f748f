//! How far a bake has come, in PSFs rasterised, and how far it has to go.

use super::{Bake, unshot_fractions};
use crate::bake::{MOST_CYCLES, Progress};
use crate::format::manifest::{Grids, Phase};
use std::ops::Range;

/// What a direction takes before the first cycle, in PSFs of the propagation.
pub const PREPARING: f64 = 0.75;

/// What a direction's total map takes, in PSFs of the propagation.
const TOTALS: f64 = 2.0;

/// What a PSF takes whose links were kept, in such that are rasterised whole.
const AGAIN: f64 = 0.2;

/// What a windowed PSF takes, in whole ones.
const WINDOWED: f64 = 0.25;

impl Bake<'_> {
    /// What some PSFs of a direction take in a cycle, in such that are rasterised whole.
    pub(super) fn work_of(&self, cycle: u32, grids: Range<u32>) -> f64 {
        let own = u32::from(grids.start == 0);
        let turned = f64::from(grids.len() as u32 - own);
        // The lines' own PSFs are those of the first cycle.
        let is_again = cycle >= self.known_from;
        let own = f64::from(own) * if is_again { AGAIN } else { 1.0 };
        let turned = turned * if self.few_senders(cycle).is_some() { WINDOWED } else { 1.0 };
        // Lines of later rounds are those of surfaces that lack some.
        let under_way = cycle == self.field.manifest().cycle && grids.start > 0;
        let turned = turned * if under_way { self.lacking } else { 1.0 };
        let part = Grids { perturbations: 1, ..self.parameters.grids(cycle) }.per_line();
        (own + turned) * part
    }

    /// Tells how far the bake has come: `done` directions of the step under way.
    pub(super) fn report(&self, preparing: bool, done: u32) {
        let manifest = self.field.manifest();
        let unshot = unshot_fractions(&manifest.ledger);
        let lines = f64::from(self.parameters.directions);
        let inside = f64::from(done) / lines;
        let cycle = manifest.cycle;
        let grids = |cycles: Range<u32>| -> f64 {
            cycles.map(|c| lines * self.work_of(c, 0..self.parameters.grids(c).perturbations)).sum()
        };
        let (own, later) = match manifest.phase {
            Phase::Propagating => {
                let end = self.expected_cycles(&unshot).max(cycle + 1);
                let round = self.round(cycle);
                let most = self.parameters.grids(cycle).perturbations;
                let rest = lines * self.work_of(cycle, round.end..most);
                let later = rest + grids(cycle + 1..end) + TOTALS * lines;
                (lines * self.work_of(cycle, round), later)
            }
            _ => (TOTALS * lines, 0.0),
        };
        // Before the step begins, all of it that is not done yet is left as well.
        let (step, left) = if preparing {
            let done = f64::from(manifest.done_count()) / lines;
            (PREPARING * lines, own * (1.0 - done) + later)
        } else {
            (own, later)
        };
        let before = f64::from(self.done_before) / lines;
        (self.options.progress)(&Progress {
            phase: manifest.phase,
            cycle,
            done,
            directions: self.parameters.directions,
            preparing,
            unshot: unshot.last().copied().unwrap_or(1.0),
            work: self.work + step * (inside - before),
            work_left: step * (1.0 - inside) + left,
            profile: self.profile,
        });
    }

    /// Cycles in all, from the fall of the unshot power so far.
    pub(super) fn expected_cycles(&self, unshot: &[f64]) -> u32 {
        if let Some(cycles) = self.parameters.cycles {
            return cycles;
        }
        // Before the first cycle: as if half of the light were absorbed.
        let (before, last) = match unshot {
            [] => (1.0, 0.5),
            [only] => (1.0, *only),
            [.., before, last] => (*before, *last),
        };
        let fall = (last / before).clamp(1e-3, 0.999);
        let now = unshot.last().copied().unwrap_or(1.0).max(f64::MIN_POSITIVE);
        let more = (self.parameters.unshot_fraction / now).ln() / fall.ln();
        (unshot.len() as u32 + more.max(0.0).ceil() as u32).min(MOST_CYCLES)
    }

    /// Begins a step, of which some directions may be done: only what this run does counts as its work.
    pub(super) fn begin_step(&mut self) {
        self.done_before = self.field.manifest().done_count();
    }

    /// Ends a step of so many PSFs a direction.
    pub(super) fn end_step(&mut self, grids: f64) {
        self.work += grids * f64::from(self.parameters.directions - self.done_before);
        self.done_before = 0;
    }
}
