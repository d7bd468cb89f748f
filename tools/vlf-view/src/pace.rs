//! How fine the next picture is. While the walker moves, frames are as fine as the frame rate allows;
//! at rest they are refined until they are what `vlf render` makes.

use std::time::Duration;

/// The time that a frame may take while the walker moves.
const MOVING_FRAME: f64 = 1.0 / 30.0;

/// How coarse frames can be.
const COARSE: [u32; 8] = [1, 2, 3, 4, 6, 8, 12, 16];

/// Samples of the passes at rest, once each pixel has one; the last is what `vlf render` takes.
const SAMPLES: [u32; 3] = [1, 4, 16];

/// A finer frame must promise to take at most this part of the time, lest the size swing.
const RESERVE: f64 = 0.8;

/// How fine a picture is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pass {
    /// Each of its pixels fills a square of so many pixels a side.
    pub coarse: u32,
    /// Samples in each of them.
    pub samples: u32,
}

impl Pass {
    /// Whether there is none finer.
    pub fn is_last(self) -> bool {
        self == Pass { coarse: 1, samples: SAMPLES[SAMPLES.len() - 1] }
    }
}

/// Chooses how fine the next picture is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// How coarse a frame keeps up with motion.
    moving: u32,
    /// No frame of a moving walker is finer.
    finest: u32,
    /// The pass shown last of the view as it is; `None` when it has changed since.
    shown: Option<Pass>,
    /// Seconds that a frame of one sample a pixel takes.
    full: Option<f64>,
}

impl Pace {
    pub fn new() -> Pace {
        Pace { moving: 4, finest: 1, shown: None, full: None }
    }

    /// The view has changed: refinement begins again.
    pub fn changed(&mut self) {
        self.shown = None;
    }

    /// Frames may take another time than before.
    pub fn another_method(&mut self) {
        *self = Pace { finest: self.finest, ..Pace::new() };
    }

    /// Frames of a moving walker are as coarse as this or coarser, as a slow link asks for.
    pub fn no_finer(&mut self, coarse: u32) {
        self.finest = coarse.clamp(1, COARSE[COARSE.len() - 1]);
    }

    /// The next pass, or `None` when the finest is already shown.
    pub fn next(&self, moving: bool) -> Option<Pass> {
        let coarse = self.moving.max(self.finest);
        match self.shown {
            _ if moving => Some(Pass { coarse, samples: 1 }),
            None => Some(Pass { coarse, samples: 1 }),
            Some(Pass { coarse: 1, samples }) => {
                let more = SAMPLES.iter().find(|s| **s > samples);
                more.map(|samples| Pass { coarse: 1, samples: *samples })
            }
            Some(Pass { coarse, .. }) => {
                // In steps, so that there is soon something better to see; at once if that is soon, too.
                let full = self.full.unwrap_or(1.0);
                let coarse = if full < 4.0 * MOVING_FRAME { 1 } else { (coarse / 2).max(1) };
                Some(Pass { coarse, samples: 1 })
            }
        }
    }

    /// Takes note of a picture that is shown, and of the time it took.
    pub fn took(&mut self, pass: Pass, time: Duration) {
        self.shown = Some(pass);
        if pass.samples > 1 {
            return;
        }
        let full = time.as_secs_f64() * f64::from(pass.coarse * pass.coarse);
        // Half old, half new: one slow frame says little.
        let full = self.full.map_or(full, |before| 0.5 * (before + full));
        self.full = Some(full);
        let promised = |coarse: u32| full / f64::from(coarse * coarse);
        let fits = |coarse: &&u32| {
            let reserve = if **coarse < self.moving { RESERVE } else { 1.0 };
            promised(**coarse) <= MOVING_FRAME * reserve
        };
        self.moving = *COARSE.iter().find(fits).unwrap_or(&COARSE[COARSE.len() - 1]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames of `full` seconds at full resolution, so many in a row.
    fn moved(pace: &mut Pace, full: f64, frames: u32) -> Vec<u32> {
        (0..frames)
            .map(|_| {
                let pass = pace.next(true).unwrap();
                let time = full / f64::from(pass.coarse * pass.coarse);
                pace.took(pass, Duration::from_secs_f64(time));
                pass.coarse
            })
            .collect()
    }

    #[test]
    fn at_rest_the_picture_is_refined_to_what_render_makes_and_then_stands() {
        let mut pace = Pace::new();
        let mut seen = Vec::new();
        while let Some(pass) = pace.next(false) {
            pace.took(pass, Duration::from_secs(1));
            seen.push((pass.coarse, pass.samples));
        }
        assert_eq!(seen, [(4, 1), (2, 1), (1, 1), (1, 4), (1, 16)]);
        assert_eq!(SAMPLES[2], vlf::look::render::Options::default().samples);
        pace.changed();
        assert!(pace.next(false).is_some_and(|pass| pass.samples == 1));
    }

    #[test]
    fn moving_frames_hold_the_rate_and_do_not_swing() {
        let mut pace = Pace::new();
        for (full, expected) in [(1.0, 6), (0.1, 2), (0.02, 1), (30.0, 16), (0.25, 4)] {
            moved(&mut pace, full, 20);
            let seen = moved(&mut pace, full, 10);
            assert!(seen.iter().all(|c| *c == expected), "{full} s: {seen:?}");
        }
        pace.no_finer(4);
        assert_eq!(moved(&mut pace, 0.001, 1), [4]);
    }
}
