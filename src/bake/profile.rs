//! Where a bake's time goes: seconds of all threads by stage, and what the stages handled.

use std::time::Instant;

/// What a thread is at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Polygons to layers of fragments, sorted along each ray (section 4.1).
    Rasterise,
    /// Finding in each cell which fragments exchange light, and following what mirrors send (section 4.3).
    Exchange,
    /// Texels to texels (section 4.2).
    Transfer,
    /// Making maps of what arrives at mirrors.
    MirrorMaps,
    /// Making total radiance maps, but for their layers.
    TotalMaps,
    /// Texture maps and the account between cycles; all threads at once, told as the time of one.
    Textures,
}

impl Stage {
    /// All of them, in order.
    pub const ALL: [Stage; 6] = [
        Stage::Rasterise,
        Stage::Exchange,
        Stage::Transfer,
        Stage::MirrorMaps,
        Stage::TotalMaps,
        Stage::Textures,
    ];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Stage::Rasterise => "rasterise",
            Stage::Exchange => "exchange",
            Stage::Transfer => "transfer",
            Stage::MirrorMaps => "mirror maps",
            Stage::TotalMaps => "total maps",
            Stage::Textures => "texture maps",
        }
    }
}

/// What a run spent and handled.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Profile {
    seconds: [f64; Stage::ALL.len()],
    /// Fragments of all layers.
    pub fragments: u64,
    /// Pairs of diffuse fragments that exchanged light.
    pub pairs: u64,
    /// Texels read or added to for these pairs.
    pub touches: u64,
    /// Ends of mirrors' paths that were looked for.
    pub paths: u64,
    /// Bytes of maps that were made.
    pub map_bytes: u64,
}

impl Profile {
    /// Seconds of all threads in a stage.
    pub fn seconds(&self, stage: Stage) -> f64 {
        self.seconds[stage as usize]
    }

    /// How many of the things that a stage's time goes by it handled, and their name, where there are any.
    pub fn handled(&self, stage: Stage) -> Option<(u64, &'static str)> {
        match stage {
            Stage::Rasterise => Some((self.fragments, "fragments")),
            Stage::Exchange => Some((self.paths, "paths of mirrors")),
            Stage::Transfer => Some((self.touches, "texels touched")),
            Stage::TotalMaps => Some((self.map_bytes, "bytes of maps")),
            Stage::MirrorMaps | Stage::Textures => None,
        }
    }

    /// Adds what a stage took.
    pub fn spend(&mut self, stage: Stage, seconds: f64) {
        self.seconds[stage as usize] += seconds;
    }

    /// Adds another's.
    pub fn add(&mut self, other: &Profile) {
        let Profile { seconds, fragments, pairs, touches, paths, map_bytes } = other;
        self.seconds.iter_mut().zip(seconds).for_each(|(sum, s)| *sum += s);
        self.fragments += fragments;
        self.pairs += pairs;
        self.touches += touches;
        self.paths += paths;
        self.map_bytes += map_bytes;
    }
}

/// A thread's watch.
#[derive(Debug)]
pub struct Watch {
    last: Instant,
    /// What was spent and handled so far.
    pub profile: Profile,
}

impl Default for Watch {
    fn default() -> Watch {
        Watch { last: Instant::now(), profile: Profile::default() }
    }
}

impl Watch {
    /// From now on time counts.
    pub fn start(&mut self) {
        self.last = Instant::now();
    }

    /// The time since the start or the last lap was a stage's.
    pub fn lap(&mut self, stage: Stage) {
        let now = Instant::now();
        self.profile.spend(stage, (now - self.last).as_secs_f64());
        self.last = now;
    }

    /// What was spent and handled since this was asked last.
    pub fn take(&mut self) -> Profile {
        std::mem::take(&mut self.profile)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn laps_are_counted_for_their_stage_and_add_up() {
        let mut watch = Watch::default();
        let began = Instant::now();
        watch.start();
        std::thread::sleep(Duration::from_millis(20));
        watch.lap(Stage::Rasterise);
        watch.lap(Stage::Transfer);
        let profile = watch.take();
        let [layers, transfer] = [Stage::Rasterise, Stage::Transfer].map(|s| profile.seconds(s));
        assert!(layers >= 0.02 && layers + transfer <= began.elapsed().as_secs_f64());
        assert_eq!(watch.take(), Profile::default());
        let mut both = profile;
        both.add(&profile);
        assert_eq!(both.seconds(Stage::Rasterise), 2.0 * layers);
    }
}
