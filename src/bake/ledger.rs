//! The energy ledger: what each cycle took in and where it went.
//!
//! Lines are counted in whole numbers, so that the account of a cycle closes to the last unit unless a
//! transfer is lost, doubled or overflows; that is what [`CycleLedger::residual`] shows. Against
//! that stand the areas: what the texture maps hold. The difference is the error of sampling areas
//! by lines, and is named.

use super::transfer::{self, Fixed, Quantum};
use crate::format::Fault;
use crate::format::bytes::{Reader, Writer};
use crate::format::manifest::CycleLedger;
use crate::radiance::Rgb;
use std::f64::consts::PI;

/// Sums over the lines of a cycle; radiance in fixed point, its three channels added up, each line
/// weighted by its shares.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Left diffuse surfaces.
    pub shot_diffuse: i128,
    /// Left mirrors.
    pub shot_mirror: i128,
    /// Left the scene.
    pub left: i128,
    /// Arrived at mirrors.
    pub to_mirror: i128,
    /// Arrived at mirrors, times their reflectance.
    pub mirrored: i128,
    /// The same along the lines of the unperturbed PSFs, for which it is stored.
    pub mirrored_true: i128,
    /// The same as it was stored.
    pub stored: i128,
    /// Fragments.
    pub fragments: u64,
    /// Lookups of mirrors' unshot radiance.
    pub gathers: u64,
    /// Of these, those that found nothing.
    pub holes: u64,
}

impl Tally {
    const NUMBERS: usize = 10;

    /// Bytes in a checkpoint.
    pub const BYTES: u64 = 16 * Tally::NUMBERS as u64;

    fn numbers(&self) -> [i128; Tally::NUMBERS] {
        [
            self.shot_diffuse,
            self.shot_mirror,
            self.left,
            self.to_mirror,
            self.mirrored,
            self.mirrored_true,
            self.stored,
            self.fragments.into(),
            self.gathers.into(),
            self.holes.into(),
        ]
    }

    fn from_numbers(n: [i128; Tally::NUMBERS]) -> Tally {
        let [shot_diffuse, shot_mirror, left, to_mirror, mirrored, mirrored_true, stored, ..] = n;
        let count = |k: usize| n[k] as u64;
        Tally {
            shot_diffuse,
            shot_mirror,
            left,
            to_mirror,
            mirrored,
            mirrored_true,
            stored,
            fragments: count(7),
            gathers: count(8),
            holes: count(9),
        }
    }

    /// Adds another tally.
    pub fn add(&mut self, other: &Tally) {
        let mut sum = self.numbers();
        sum.iter_mut().zip(other.numbers()).for_each(|(a, b)| *a += b);
        *self = Tally::from_numbers(sum);
    }

    /// Appends the tally to the bytes of a checkpoint.
    pub fn write(&self, w: &mut Writer) {
        for n in self.numbers() {
            w.u64(n as u64);
            w.u64((n >> 64) as u64);
        }
    }

    /// Reads what [`Tally::write`] wrote.
    ///
    /// # Errors
    /// When the bytes end, a number is negative, or a count takes more than 64 bits.
    pub fn read(r: &mut Reader) -> Result<Tally, Fault> {
        let mut n = [0i128; Tally::NUMBERS];
        for v in &mut n {
            let (low, high) = (r.u64()?, r.u64()?);
            *v = i128::from(low) | (i128::from(high as i64) << 64);
        }
        let counts = &n[Tally::NUMBERS - 3..];
        if n.iter().any(|v| *v < 0) || counts.iter().any(|v| u64::try_from(*v).is_err()) {
            return Err(Fault::invalid("sums: a total is out of range"));
        }
        Ok(Tally::from_numbers(n))
    }
}

/// The channels of a line's radiance, added up.
pub fn channels(line: &Fixed) -> i64 {
    line[0] + line[1] + line[2]
}

/// What turns sums over lines into power.
#[derive(Clone, Copy, Debug)]
pub struct Units {
    /// Radiance of one fixed unit.
    pub quantum: Quantum,
    /// Solid angle of one share, sr.
    pub share: f64,
    /// Area that a ray stands for, in the scene's own units squared.
    pub cell: f64,
    /// PSFs each direction stood for.
    pub perturbations: u32,
    /// Whether mirrors sent on in this cycle what arrived at them in it, and keep nothing.
    pub relays: bool,
}

impl Units {
    /// Power of a sum over lines, W, mean of the channels.
    fn power(&self, sum: i128) -> f64 {
        sum as f64 * self.quantum.unit() * self.share * self.cell
            / 3.0
            / f64::from(self.perturbations)
    }

    /// Power of a sum over lines of the unperturbed PSFs only.
    fn power_true(&self, sum: i128) -> f64 {
        self.power(sum) * f64::from(self.perturbations)
    }
}

/// Power that texture maps hold, W, mean of the channels: `pi` times radiance times area. `areas` has
/// one area for each of the two values of a texel, in the scene's own units squared.
pub fn texture_power(values: &[Rgb], areas: &[f64]) -> f64 {
    PI * values.iter().zip(areas).map(|(v, a)| f64::from(v.mean()) * a).sum::<f64>()
}

/// The area of each texture value that looks at anything: a texel's area inside its surface, less what
/// lies in contact with another surface, where no light comes or goes. That shows in the lines that
/// struck it, of which a texel of unit area would have `lines`. Numbers of lines scatter, the more the
/// finer the texels; so geometry decides where many came, and where some came unless a border of such a
/// contact may divide the texel, `is_cut`.
pub fn open_areas(
    areas: &[f32],
    sums: &[Fixed],
    lines: f64,
    is_cut: impl Fn(u32) -> bool,
) -> Vec<f64> {
    const MANY: f64 = 0.75;
    const SOME: f64 = 0.25;
    let open = |(value, sum): (usize, &Fixed)| {
        let area = f64::from(areas[value / 2]);
        let struck = transfer::lines(sum) / lines;
        let enough = if is_cut(value as u32 / 2) { MANY } else { SOME };
        if struck < enough * area { struck } else { area }
    };
    sums.iter().enumerate().map(open).collect()
}

/// What a cycle's diffuse receivers took: the sums over lines, and the part that they reflect.
#[derive(Clone, Copy, Debug, Default)]
pub struct Received {
    /// Arrived.
    pub arrived: i128,
    /// Arrived, times reflectance.
    pub reflected: f64,
}

/// Adds up the sums of a cycle; `factor` is the reflectance of a texture value.
pub fn received(sums: &[Fixed], factor: impl Fn(usize) -> Rgb) -> Received {
    let mut total = Received::default();
    for (value, sum) in sums.iter().enumerate() {
        total.arrived += i128::from(channels(sum));
        let rho = factor(value).0;
        total.reflected += (0..3).map(|c| sum[c] as f64 * f64::from(rho[c])).sum::<f64>();
    }
    total
}

/// Power of the unshot maps that a cycle leaves: what mirrors will send on. W.
pub fn stored_power(units: &Units, tally: &Tally) -> f64 {
    units.power_true(tally.stored)
}

/// The account of a cycle. `diffuse_in` and `mirror_in` are the unshot power that it began with in
/// texture maps and unshot maps, `diffuse_out` that of the new texture maps, all in W.
pub fn account(
    cycle: u32,
    units: &Units,
    tally: &Tally,
    received: &Received,
    (diffuse_in, mirror_in, diffuse_out): (f64, f64, f64),
) -> CycleLedger {
    let p = |sum| units.power(sum);
    let reflected = p(received.reflected as i128);
    let stored = stored_power(units, tally);
    let true_lines = units.power_true(tally.mirrored_true);
    // What leaves mirrors along some lines against what arrived at them along others.
    let relayed = if units.relays { p(tally.mirrored) } else { 0.0 };
    let income = diffuse_in + mirror_in;
    CycleLedger {
        cycle,
        emitted: if cycle == 0 { income } else { 0.0 },
        carried_in: if cycle == 0 { 0.0 } else { income },
        absorbed: p(received.arrived) - reflected + p(tally.to_mirror) - p(tally.mirrored),
        left: p(tally.left),
        unshot_diffuse: diffuse_out,
        unshot_mirror: stored,
        holes: mirror_in + relayed - p(tally.shot_mirror),
        sampling: diffuse_in - p(tally.shot_diffuse) + reflected - diffuse_out + p(tally.mirrored)
            - relayed
            - true_lines,
        quantised: true_lines - stored,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tally() -> Tally {
        Tally {
            shot_diffuse: 1 << 100,
            shot_mirror: 7,
            left: 19,
            to_mirror: i128::MAX / 4,
            mirrored: 5,
            mirrored_true: 1 << 90,
            stored: 3,
            fragments: 11,
            gathers: 13,
            holes: 17,
        }
    }

    #[test]
    fn a_tally_survives_a_checkpoint_and_adds_up() {
        let mut w = Writer(Vec::new());
        tally().write(&mut w);
        let mut r = Reader::new(&w.0);
        assert_eq!(Tally::read(&mut r).unwrap(), tally());
        r.end().unwrap();
        assert!(Tally::read(&mut Reader::new(&w.0[1..])).is_err());
        let mut sum = tally();
        sum.add(&tally());
        assert_eq!((sum.shot_diffuse, sum.mirrored_true), (1 << 101, 1 << 91));
        assert_eq!((sum.fragments, sum.gathers, sum.holes), (22, 26, 34));
    }

    /// 12 units leave a diffuse surface: 6 arrive at one of reflectance 1/2, 4 at a mirror of 3/4, 2
    /// leave. A unit that is lost on the way shows as the residual.
    #[test]
    fn the_account_closes_and_shows_a_loss() {
        let quantum = Quantum::new(1.0);
        let units = Units { quantum, share: 1.0, cell: 3.0, perturbations: 1, relays: false };
        let watt = quantum.unit();
        let mut tally = Tally { shot_diffuse: 12, to_mirror: 4, mirrored: 3, ..Tally::default() };
        tally.left = 2;
        (tally.mirrored_true, tally.stored) = (3, 3);
        let received = Received { arrived: 6, reflected: 3.0 };
        let powers = (12.0 * watt, 0.0, 3.0 * watt);
        let l = account(0, &units, &tally, &received, powers);
        assert!(l.residual().abs() < 1e-12);
        assert_eq!([l.absorbed, l.left, l.unshot()].map(|p| (p / watt).round()), [4.0, 2.0, 6.0]);
        assert_eq!((l.sampling, l.holes, l.quantised), (0.0, 0.0, 0.0));
        tally.left = 1;
        let l = account(0, &units, &tally, &received, powers);
        assert!((l.residual() - 1.0 / 12.0).abs() < 1e-12);
    }

    #[test]
    fn only_cut_texels_that_few_lines_struck_are_taken_to_be_covered_in_part() {
        // 10 lines a unit of area; sides with 0, 5, 8 and 12 lines.
        let sums: Vec<Fixed> = [0, 5, 8, 12].map(|n| [0, 0, 0, n * transfer::LINE]).to_vec();
        assert_eq!(open_areas(&[1.0, 1.0], &sums, 10.0, |_| true), [0.0, 0.5, 1.0, 1.0]);
        assert_eq!(open_areas(&[1.0, 1.0], &sums, 10.0, |_| false), [0.0, 1.0, 1.0, 1.0]);
    }
}
