//! `--bench`: how long the frames of a written walk take. No window.

use crate::pace::Pass;
use crate::paint::{Job, Look, Method, Shot, Spare, paint};
use crate::source::Source;
use serde_json::{Value, json};
use std::sync::atomic::AtomicBool;
use std::time::Duration;
use vlf::look::path::CameraPath;
use vlf::look::tone::Curve;

/// Frames a second of the walk.
const RATE: f64 = 30.0;

/// The most frames that are taken; those of longer walks are farther apart.
const MOST: f64 = 3000.0;

/// Frame times of a walk, in milliseconds.
#[derive(Debug, PartialEq)]
pub struct Report {
    pub method: Method,
    pub size: (u32, u32),
    pub frames: usize,
    /// The first frame, which has to fetch what the others find.
    pub first: f64,
    pub median: f64,
    pub p95: f64,
    pub p99: f64,
    pub worst: f64,
}

/// Takes the frames of a walk one after the other, one sample a pixel, tone-mapped, at full resolution.
pub fn run(source: &Source, path: &CameraPath, size: (u32, u32), method: Method) -> Report {
    let (start, length) = (path.start(), path.end() - path.start());
    let count = (length * RATE).ceil().clamp(1.0, MOST) as usize + 1;
    let look = Look { exposure: Some(0.0), curve: Curve::Shoulder };
    let mut spare = Spare::default();
    let times = (0..count).filter_map(|i| {
        let time = start + length * i as f64 / (count - 1) as f64;
        let pass = Pass { coarse: 1, samples: 1 };
        let job = Job::Take(Shot { camera: path.at(time, size), pass, method }, look);
        paint(source, &job, &AtomicBool::new(false), &mut spare).map(|frame| frame.time)
    });
    summary(times.collect(), size, method)
}

/// The figures of a list of times, the first of which counts apart.
fn summary(times: Vec<Duration>, size: (u32, u32), method: Method) -> Report {
    let mut times: Vec<f64> = times.iter().map(|t| t.as_secs_f64() * 1e3).collect();
    let frames = times.len();
    let first = times.first().copied().unwrap_or(0.0);
    if frames > 1 {
        times.remove(0);
    }
    times.sort_by(f64::total_cmp);
    // The smallest time that such a part of the frames does not exceed.
    let part = |part: f64| {
        let at = (part * times.len() as f64).ceil() as usize;
        times.get(at.max(1) - 1).copied().unwrap_or(0.0)
    };
    let [median, p95, p99, worst] = [0.5, 0.95, 0.99, 1.0].map(part);
    Report { method, size, frames, first, median, p95, p99, worst }
}

impl Report {
    /// As JSON; times in milliseconds.
    pub fn to_json(&self) -> Value {
        json!({
            "method": self.method.name(),
            "size": [self.size.0, self.size.1],
            "frames": self.frames,
            "threads": rayon::current_num_threads(),
            "first_ms": self.first,
            "median_ms": self.median,
            "p95_ms": self.p95,
            "p99_ms": self.p99,
            "worst_ms": self.worst,
        })
    }

    /// In a line.
    pub fn to_text(&self) -> String {
        let Report { first, median, p95, p99, worst, frames, size, .. } = self;
        format!(
            "{}, {} x {}, {frames} frames: median {median:.1} ms, 95 % {p95:.1}, 99 % {p99:.1}, \
             worst {worst:.1}; the first {first:.1}",
            self.method.name(),
            size.0,
            size.1
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_figures_are_of_all_frames_but_the_first() {
        let times = [900].into_iter().chain((1..=100).rev()).map(Duration::from_millis).collect();
        let report = summary(times, (4, 3), Method::Trace);
        let figures = [report.first, report.median, report.p95, report.p99, report.worst];
        assert_eq!(figures, [900.0, 50.0, 95.0, 99.0, 100.0]);
        assert_eq!(report.frames, 101);
        let one = summary(vec![Duration::from_millis(7)], (4, 3), Method::Trace);
        assert_eq!([one.first, one.median, one.worst], [7.0, 7.0, 7.0]);
    }
}
