//! Bytes on disk: what files there are at each commit, and how large they are.

use super::Bytes;
use super::rehearsal::{Generation, Rehearsal, Steps};
use super::sample::Sample;
use crate::bake::BakeError;
use crate::bake::step::Shared;
use crate::field::FieldError;
use crate::format::container::{ALIGN, ENTRY, FIRST_BLOCK, length};
use crate::format::manifest::{Manifest, Statistics, record_to_bytes};

/// Sizes of a bake's files.
pub struct Files {
    directions: u64,
    scene: u64,
    textures: u64,
    sums: u64,
    /// One commit record.
    record: u64,
    /// All files of mirrors' maps by generation, the first one's at 0.
    generations: Vec<u64>,
    /// Mean bytes of the maps in them.
    pub maps: Vec<Generation>,
    /// All files of total maps.
    totals: u64,
    packed: [u64; 3],
}

/// What a commit needs besides what is always there.
#[derive(Clone, Copy, PartialEq)]
struct Commit {
    /// Cycles done.
    cycle: usize,
    sums: bool,
    /// Whether light is still being sent on.
    propagating: bool,
}

impl Files {
    /// Of the whole bake.
    ///
    /// # Errors
    /// When the commit record is too large.
    pub fn new(
        shared: &Shared,
        rehearsal: &Rehearsal,
        sample: &Sample,
    ) -> Result<Files, BakeError> {
        let directions = u64::from(shared.parameters.directions);
        let values = 2 * shared.texels.len() as u64;
        let mut manifest = rehearsal.manifest.clone();
        manifest.parameters = shared.parameters.clone();
        manifest.done = vec![0; (directions as usize).div_ceil(8)];
        let size = |manifest: &Manifest| {
            let bytes = record_to_bytes(manifest).map_err(|f| f.in_file("commit record"));
            Ok::<u64, FieldError>(bytes.map_err(FieldError::from)?.len() as u64)
        };
        let record = size(&manifest)?;
        manifest.statistics = Statistics::default();
        let packed_record = size(&manifest)?;
        let maps =
            |g: &Generation| directions * length([g.unshot as u64, g.arrived as u64].into_iter());
        let (_, scene) = rehearsal.scene;
        let textures = 12 * values;
        let pack = |scene: u64, textures: u64, maps: f64| {
            let head = FIRST_BLOCK as u64 + ENTRY as u64 * (3 + directions);
            let aligned =
                [packed_record, scene, textures].map(|b| b.next_multiple_of(ALIGN as u64));
            head + aligned.iter().sum::<u64>() + (maps * directions as f64) as u64
        };
        let zstd_textures = (textures as f64 * rehearsal.ratios[0]) as u64;
        Ok(Files {
            directions,
            scene: rehearsal.scene.0,
            textures: length([textures; 3].into_iter()),
            sums: length([64 * values].into_iter()),
            record: length([record].into_iter()),
            generations: sample.generations.iter().map(maps).collect(),
            maps: sample.generations.clone(),
            totals: (sample.file * directions as f64) as u64,
            packed: [
                pack(scene[0], textures, sample.packed[0]),
                pack(scene[1], zstd_textures, sample.packed[1]),
                pack(scene[1], zstd_textures, sample.packed[2]),
            ],
        })
    }

    /// How many directions have files of their own.
    pub fn directions(&self) -> u64 {
        self.directions
    }

    /// Bytes in the end and on the way there, with commits every so many seconds.
    pub fn bytes(&self, steps: &Steps, commit_every: f64) -> Bytes {
        let (peak, written) = self.on_the_way(steps, commit_every);
        let records = 2 * self.record;
        Bytes {
            scene: self.scene,
            textures: self.textures,
            totals: self.totals,
            records,
            finished: self.scene + self.textures + self.totals + records,
            peak,
            written,
            packed_raw: self.packed[0],
            packed_zstd: self.packed[1],
            packed: self.packed[2],
        }
    }

    /// Goes through the commits of a bake; returns the most bytes that were there at once and the bytes
    /// written. Files that neither of the last two commits needs are gone.
    fn on_the_way(&self, steps: &Steps, commit_every: f64) -> (u64, u64) {
        let seconds: Vec<f64> = steps.seconds().collect();
        let cycles = seconds.len().saturating_sub(1);
        let fixed = self.scene + 3 * self.record;
        let first = Commit { cycle: 0, sums: false, propagating: true };
        let mut last = [first; 2];
        let (mut peak, mut written) = (0, self.scene);
        for (step, seconds) in seconds.iter().enumerate() {
            let propagating = step < cycles;
            // Those within the step, then its end. At most one for every other direction.
            let commit_every = commit_every.max(2.0 * seconds / self.directions as f64);
            let within = if *seconds > 0.0 { (seconds / commit_every) as u64 } else { 0 };
            for k in 1..=within + 1 {
                let is_end = k == within + 1;
                let part = if is_end { 1.0 } else { k as f64 * commit_every / seconds };
                let being_made = if propagating {
                    let textures = if is_end { self.textures } else { self.sums };
                    (part * self.generation(step + 1) as f64) as u64 + textures
                } else {
                    (part * self.totals as f64) as u64
                };
                peak = peak.max(fixed + self.needed(&last, step) + being_made);
                written += self.record + if propagating && !is_end { self.sums } else { 0 };
                let commit = Commit {
                    cycle: step + usize::from(is_end && propagating),
                    sums: propagating && !is_end,
                    propagating: propagating && !(is_end && step + 1 == cycles),
                };
                last = [last[1], commit];
            }
            written +=
                if propagating { self.generation(step + 1) + self.textures } else { self.totals };
        }
        (peak, written)
    }

    fn generation(&self, generation: usize) -> u64 {
        let of = generation.checked_sub(1).and_then(|k| self.generations.get(k));
        of.copied().unwrap_or(0)
    }

    /// Bytes that two commits need, apart from the generation that `step` makes.
    fn needed(&self, commits: &[Commit; 2], step: usize) -> u64 {
        let sums = commits.iter().filter(|c| c.sums).count() as u64;
        let mut needed: Vec<(bool, usize)> = Vec::new();
        for commit in commits {
            needed.push((true, commit.cycle));
            needed.push((false, commit.cycle));
            if commit.propagating {
                needed.push((false, commit.cycle + 1));
            }
        }
        needed.sort_unstable();
        needed.dedup();
        let bytes = |(textures, cycle): &(bool, usize)| match (textures, *cycle) {
            (_, 0) => 0,
            (true, _) => self.textures,
            (false, generation) if generation == step + 1 => 0,
            (false, generation) => self.generation(generation),
        };
        sums * self.sums + needed.iter().map(bytes).sum::<u64>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILES: Files = Files {
        directions: 1000,
        scene: 1,
        textures: 10,
        sums: 100,
        record: 1,
        generations: Vec::new(),
        maps: Vec::new(),
        totals: 50_000,
        packed: [0; 3],
    };

    fn peak(generations: &[u64], seconds: &[f64], commit_every: f64) -> u64 {
        let files = Files { generations: generations.to_vec(), ..FILES };
        files.on_the_way(&Steps::of(seconds), commit_every).0
    }

    #[test]
    fn without_mirrors_only_textures_and_sums_come_and_go() {
        // Scene, records, the textures of two commits, total maps.
        assert_eq!(peak(&[], &[1.0, 1.0, 1.0, 1.0], 5.0), 1 + 3 + 20 + 50_000);
    }

    #[test]
    fn three_generations_are_there_when_cycles_are_short() {
        let generations = [1_000_000; 4];
        // At the end of a cycle: its own maps, those it gathers from, and those of the commit before.
        let most = 1 + 3 + 3_000_000 + 30;
        assert_eq!(peak(&generations, &[1.0, 1.0, 1.0, 1.0, 1.0], 5.0), most);
    }

    #[test]
    fn long_cycles_let_the_generation_before_go() {
        let generations = [1_000_000; 4];
        let long = peak(&generations, &[60.0, 60.0, 60.0, 60.0, 60.0], 5.0);
        assert!((2_000_000..2_500_000).contains(&long), "{long}");
    }
}
