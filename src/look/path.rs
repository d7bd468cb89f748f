//! A walk that is written down: views at given times, and a smooth camera through them.
//!
//! In: the JSON file `{"views":[{"time":s,"eye":[x,y,z],"target":[x,y,z],"up":[x,y,z],"vfov_deg":d},...]}`, times in
//! seconds, places in the scene's own units. Out: the camera at any time. Eye and target follow cubic
//! curves through the views (Catmull and Rom 1974, with their times unevenly spaced), `up` and the angle
//! straight lines; before the first view and after the last the camera stands still.

use crate::format::text::inert;
use crate::scene::camera::{Camera, CameraError};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// Most views of a path.
const MOST_VIEWS: usize = 100_000;

/// Most bytes of a path's file.
const MOST_BYTES: u64 = 1 << 26;

/// Latest time, in seconds: a path of a day.
const LATEST: f64 = 86_400.0;

/// A view that the camera comes by.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TimedView {
    /// When, in seconds.
    pub time: f64,
    /// Where the eye is, in the scene's own units.
    pub eye: DVec3,
    /// What it looks at.
    pub target: DVec3,
    /// Which way is up in the picture; need not be perpendicular to the view.
    pub up: DVec3,
    /// Vertical field of view in degrees, in (0, 180).
    pub vfov_deg: f64,
}

/// A camera that moves: one view or more, at times that rise.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CameraPath {
    views: Vec<TimedView>,
}

/// What the file holds before it is checked.
#[derive(Deserialize)]
struct Unchecked {
    views: Vec<TimedView>,
}

/// Why a path was refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PathError {
    /// The file could not be read.
    #[error("{}: cannot be read: {source}; give the file of a camera's path", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Not JSON, or not a path's.
    #[error(
        "not a camera's path: {}; write {{\"views\":[{{\"time\":s,\"eye\":[x,y,z],\"target\":[x,y,z],\
         \"up\":[x,y,z],\"vfov_deg\":d}},...]}}",
        inert(&.0.to_string(), 200)
    )]
    Json(#[from] serde_json::Error),
    /// None, or too many.
    #[error("a path of {0} views; it may have 1 to {MOST_VIEWS}")]
    Count(usize),
    /// A time that cannot be, or is not after that of the view before.
    #[error(
        "view {view} of the path (the first is 0) has the time {time}; times must rise from view to view, \
         between 0 and {LATEST} seconds"
    )]
    Time {
        /// Which view.
        view: usize,
        /// Its time in seconds.
        time: f64,
    },
    /// A view that no camera can have.
    #[error("view {view} of the path (the first is 0): {source}")]
    View {
        /// Which view.
        view: usize,
        /// What is wrong with it.
        source: CameraError,
    },
    /// Any of the others, in a file.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong with its contents.
        source: Box<PathError>,
    },
}

impl CameraPath {
    /// A path through some views, checked.
    ///
    /// # Errors
    /// [`PathError::Count`], [`PathError::Time`] or [`PathError::View`], whichever is found first.
    pub fn new(views: Vec<TimedView>) -> Result<CameraPath, PathError> {
        if views.is_empty() || views.len() > MOST_VIEWS {
            return Err(PathError::Count(views.len()));
        }
        for (view, v) in views.iter().enumerate() {
            let follows = view == 0 || v.time > views[view - 1].time;
            if !(0.0..=LATEST).contains(&v.time) || !follows {
                return Err(PathError::Time { view, time: v.time });
            }
            v.camera((1, 1)).check().map_err(|source| PathError::View { view, source })?;
        }
        Ok(CameraPath { views })
    }

    /// Reads a path from JSON and checks it. Fields that a path does not have are left alone.
    ///
    /// # Errors
    /// [`PathError::Json`], or as [`CameraPath::new`].
    pub fn from_json(text: &str) -> Result<CameraPath, PathError> {
        CameraPath::new(serde_json::from_str::<Unchecked>(text)?.views)
    }

    /// Reads a path's file; see [`CameraPath::from_json`].
    ///
    /// # Errors
    /// [`PathError::Read`] or [`PathError::File`].
    pub fn open(path: &Path) -> Result<CameraPath, PathError> {
        let mut text = String::new();
        // A longer file is cut and then no JSON; devices that never end are cut as well.
        std::fs::File::open(path)
            .and_then(|file| file.take(MOST_BYTES).read_to_string(&mut text))
            .map_err(|source| PathError::Read { path: path.to_owned(), source })?;
        CameraPath::from_json(&text)
            .map_err(|e| PathError::File { path: path.to_owned(), source: Box::new(e) })
    }

    /// Its views.
    pub fn views(&self) -> &[TimedView] {
        &self.views
    }

    /// The time of the first view, in seconds.
    pub fn start(&self) -> f64 {
        self.views[0].time
    }

    /// The time of the last view, in seconds.
    pub fn end(&self) -> f64 {
        self.views[self.views.len() - 1].time
    }

    /// The camera at a time in seconds, for a picture of `size` pixels, width and height.
    pub fn at(&self, time: f64, size: (u32, u32)) -> Camera {
        let views = &self.views;
        let after = views.partition_point(|v| v.time <= time);
        if after == 0 || after == views.len() {
            return views[after.saturating_sub(1)].camera(size);
        }
        let (from, to) = (&views[after - 1], &views[after]);
        let span = to.time - from.time;
        let s = (time - from.time) / span;
        let curve = |place: fn(&TimedView) -> DVec3| {
            let slopes = [self.slope(after - 1, place) * span, self.slope(after, place) * span];
            hermite([place(from), place(to)], slopes, s)
        };
        TimedView {
            time,
            eye: curve(|v| v.eye),
            target: curve(|v| v.target),
            up: from.up.normalize().lerp(to.up.normalize(), s),
            vfov_deg: from.vfov_deg + (to.vfov_deg - from.vfov_deg) * s,
        }
        .camera(size)
    }

    /// How fast a place moves at a view, in own units a second: that of the parabola through the views
    /// before and after, and rest at both ends of the path.
    fn slope(&self, at: usize, place: fn(&TimedView) -> DVec3) -> DVec3 {
        if at == 0 || at + 1 == self.views.len() {
            return DVec3::ZERO;
        }
        let [a, b, c] = [at - 1, at, at + 1].map(|i| &self.views[i]);
        let [before, after] = [b.time - a.time, c.time - b.time];
        let [came, goes] = [(place(b) - place(a)) / before, (place(c) - place(b)) / after];
        (came * after + goes * before) / (before + after)
    }
}

/// The cubic with given values and slopes at 0 and 1.
fn hermite([p, q]: [DVec3; 2], [v, w]: [DVec3; 2], s: f64) -> DVec3 {
    let (s2, s3) = (s * s, s * s * s);
    p * (2.0 * s3 - 3.0 * s2 + 1.0)
        + v * (s3 - 2.0 * s2 + s)
        + q * (3.0 * s2 - 2.0 * s3)
        + w * (s3 - s2)
}

impl TimedView {
    /// The camera that has it, for a picture of `size` pixels, width and height.
    pub fn camera(&self, size: (u32, u32)) -> Camera {
        let TimedView { eye, target, up, vfov_deg, .. } = *self;
        Camera { eye, target, up, vfov_deg, width: size.0, height: size.1 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view(time: f64, x: f64) -> TimedView {
        let eye = DVec3::new(x, 0.0, 0.0);
        TimedView { time, eye, target: eye - DVec3::Z, up: DVec3::Y, vfov_deg: 60.0 }
    }

    #[test]
    fn the_camera_comes_by_every_view_and_stands_at_both_ends() {
        let views = vec![view(1.0, 0.0), view(2.0, 3.0), view(2.5, -1.0), view(9.0, 2.0)];
        let path = CameraPath::new(views.clone()).unwrap();
        for v in &views {
            assert_eq!(path.at(v.time, (4, 3)), v.camera((4, 3)));
        }
        assert_eq!(path.at(0.0, (4, 3)).eye, views[0].eye);
        assert_eq!(path.at(f64::INFINITY, (4, 3)).eye, views[3].eye);
    }

    #[test]
    fn no_jumps_in_place_or_speed_and_even_motion_stays_even() {
        let views = vec![view(0.0, 0.0), view(0.5, 3.0), view(2.0, -1.0), view(2.1, 2.0)];
        let path = CameraPath::new(views).unwrap();
        let x = |t: f64| path.at(t, (4, 3)).eye.x;
        let speed = |t: f64| (x(t + 1e-6) - x(t)) / 1e-6;
        for t in [0.0, 0.5, 2.0, 2.1] {
            assert!((x(t - 1e-9) - x(t + 1e-9)).abs() < 1e-6, "a jump at {t}");
            assert!((speed(t - 2e-6) - speed(t + 1e-6)).abs() < 5e-3, "a jerk at {t}");
        }
        // Views at uneven times on an even motion: between inner views it is that motion.
        let times = [0.0, 1.0, 1.5, 4.0, 5.0];
        let even = CameraPath::new(times.map(|t| view(t, 2.0 * t)).to_vec()).unwrap();
        for t in [1.1, 1.4, 2.0, 3.9] {
            assert!((even.at(t, (4, 3)).eye.x - 2.0 * t).abs() < 1e-12);
        }
    }

    #[test]
    fn a_bad_path_is_refused_with_the_view_that_is_wrong() {
        let good = r#"{"views":[
            {"time":0,"eye":[0,0,5],"target":[0,0,0],"up":[0,1,0],"vfov_deg":60,"more":1},
            {"time":1,"eye":[0,0,4],"target":[0,0,0],"up":[0,1,0],"vfov_deg":70}]}"#;
        let path = CameraPath::from_json(good).unwrap();
        assert_eq!((path.start(), path.end(), path.views().len()), (0.0, 1.0, 2));
        assert_eq!(CameraPath::from_json(&serde_json::to_string(&path).unwrap()).unwrap(), path);
        for (from, to, message) in [
            ("\"time\":1", "\"time\":0", "view 1 of the path"),
            ("\"time\":1", "\"time\":1e9", "view 1 of the path"),
            ("\"time\":0", "\"time\":-1", "view 0 of the path"),
            ("[0,0,4]", "[0,0,0]", "view 1 of the path (the first is 0): camera field `target`"),
            ("\"vfov_deg\":60", "\"vfov_deg\":180", "`vfov_deg` is 180"),
            ("\"views\"", "\"sights\"", "missing field `views`"),
            ("\"time\":1,", "", "missing field `time`"),
            ("]}", "}", "not a camera's path"),
        ] {
            let error = CameraPath::from_json(&good.replace(from, to)).unwrap_err().to_string();
            assert!(error.contains(message), "{to}: {error}");
        }
        let error = CameraPath::from_json(r#"{"views":[]}"#).unwrap_err().to_string();
        assert!(error.contains("0 views"), "{error}");
    }
}
