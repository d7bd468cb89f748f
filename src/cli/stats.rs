//! Where a bake's time went, as `vlf bake --stats` says it.

use serde_json::{Value, json};
use std::fmt::Write;
use vlf::bake::profile::{Profile, Stage};

/// What a run spent, and how long it took on how many threads.
#[derive(Clone, Copy, Debug, Default)]
pub struct Spent {
    pub profile: Profile,
    pub seconds: f64,
    pub threads: usize,
}

impl Spent {
    /// Seconds of all threads that no stage had: waiting for the disk and for one another, and preparing.
    fn rest(&self) -> f64 {
        let stages: f64 = Stage::ALL.iter().map(|s| self.profile.seconds(*s)).sum();
        (self.seconds * self.threads as f64 - stages).max(0.0)
    }

    /// As a table.
    pub fn text(&self) -> String {
        let all = (self.seconds * self.threads as f64).max(f64::MIN_POSITIVE);
        let mut out = format!(
            "  seconds of {} threads by stage, {:.1} in all; {} pairs of fragments exchanged light",
            self.threads, all, self.profile.pairs
        );
        let mut line = |name: &str, seconds: f64, handled: Option<(u64, &str)>| {
            // Writing to a string cannot fail.
            let _ = write!(out, "\n    {name:<14}{seconds:>9.2}{:>7.1} %", 100.0 * seconds / all);
            if let Some((count, what)) = handled.filter(|(count, _)| *count > 0) {
                let each = 1e9 * seconds / count as f64;
                let _ = write!(out, "{count:>16} {what}, {each:.2} ns each");
            }
        };
        for stage in Stage::ALL {
            line(stage.name(), self.profile.seconds(stage), self.profile.handled(stage));
        }
        line("else, waiting", self.rest(), None);
        out
    }

    /// As an object.
    pub fn json(&self) -> Value {
        let Profile { fragments, pairs, touches, paths, map_bytes, .. } = self.profile;
        let stages: serde_json::Map<String, Value> = Stage::ALL
            .iter()
            .map(|s| (s.name().replace(' ', "_"), self.profile.seconds(*s).into()))
            .chain([("else".to_owned(), self.rest().into())])
            .collect();
        json!({
            "seconds": self.seconds,
            "threads": self.threads,
            "stages": stages,
            "fragments": fragments,
            "pairs": pairs,
            "texel_touches": touches,
            "mirror_paths": paths,
            "map_bytes": map_bytes,
        })
    }
}
