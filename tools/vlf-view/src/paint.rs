//! One picture: what to take, and the taking.

use crate::pace::Pass;
use crate::source::Source;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};
use vlf::look::image::{Bitmap, Picture};
use vlf::look::render::Options;
use vlf::look::render::method::{self, mark, take_tolerant};
use vlf::look::tone::{self, Curve};
use vlf::{Camera, Rgb};

/// How pictures are taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Method {
    /// Everything from the light field.
    Field,
    /// Diffuse surfaces from the texture maps, mirrors by rays.
    Trace,
    /// How far the two are apart, channel by channel.
    Difference,
}

impl Method {
    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Method::Field => "field",
            Method::Trace => "trace",
            Method::Difference => "difference",
        }
    }
}

/// How radiance is shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// Stops; `None` takes them from the picture.
    pub exposure: Option<f32>,
    /// The tone curve.
    pub curve: Curve,
}

/// A picture to be taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shot {
    /// What it shows, of the size in which it is shown.
    pub camera: Camera,
    /// How fine it is.
    pub pass: Pass,
    /// How it is taken.
    pub method: Method,
}

/// What there is to do for the next frame.
#[derive(Clone, Debug)]
pub enum Job {
    /// Take a picture.
    Take(Shot, Look),
    /// Show a picture in another way.
    Develop(Arc<Taken>, Look),
}

/// A picture that was taken.
#[derive(Debug)]
pub struct Taken {
    /// What was asked for.
    pub shot: Shot,
    /// Radiance, of the size of [`Shot::taken_by`].
    pub picture: Picture,
    /// Maps that were needed so far and are damaged or missing.
    pub damaged: usize,
}

/// A picture, ready to be shown.
#[derive(Clone, Debug)]
pub struct Frame {
    /// The picture.
    pub taken: Arc<Taken>,
    /// What is shown of it.
    pub bitmap: Arc<Bitmap>,
    /// How it is shown.
    pub look: Look,
    /// Until it was ready.
    pub time: Duration,
}

impl Shot {
    /// The camera that takes it: with pixels `coarse` times as large about the same middle, as many as
    /// cover the picture.
    pub fn taken_by(&self) -> Camera {
        let coarse = self.pass.coarse;
        let Camera { width, height, vfov_deg, .. } = self.camera;
        let (columns, rows) = (width.div_ceil(coarse), height.div_ceil(coarse));
        if coarse == 1 {
            return self.camera;
        }
        let larger = f64::from(rows * coarse) / f64::from(height);
        let tangent = (0.5 * vfov_deg.to_radians()).tan() * larger;
        let vfov_deg = 2.0 * tangent.atan().to_degrees();
        Camera { width: columns, height: rows, vfov_deg, ..self.camera }
    }

    /// How far the shown picture's corner is inside the taken one's, in shown pixels.
    pub fn margin(&self) -> [f32; 2] {
        let Camera { width, height, .. } = self.camera;
        [width, height].map(|n| (n.div_ceil(self.pass.coarse) * self.pass.coarse - n) as f32 * 0.5)
    }
}

/// Does a job; `None` when `stop` was set before it was done.
pub fn paint(source: &Source, job: &Job, stop: &AtomicBool) -> Option<Frame> {
    let start = Instant::now();
    let (taken, look) = match job {
        Job::Take(shot, look) => (Arc::new(take(source, shot, look, stop)?), *look),
        Job::Develop(taken, look) => (taken.clone(), *look),
    };
    let ev = look.exposure.unwrap_or_else(|| tone::auto_exposure(&taken.picture));
    let bitmap = Arc::new(tone::develop_with(&taken.picture, ev, look.curve));
    let look = Look { exposure: Some(ev), ..look };
    Some(Frame { taken, bitmap, look, time: start.elapsed() })
}

/// Takes a picture. Pixels that need a damaged map are magenta.
fn take(source: &Source, shot: &Shot, look: &Look, stop: &AtomicBool) -> Option<Taken> {
    let camera = shot.taken_by();
    let by = |method| {
        let how = (method, Options { samples: shot.pass.samples, ..Options::default() });
        // Whoever waits for the next picture does not wait for the rest of this one. Unwinding is how a
        // renderer that reports its progress is left in the middle; nothing is half done by then.
        let go_on = |_| {
            if stop.load(Ordering::Relaxed) {
                resume_unwind(Box::new(Stopped));
            }
        };
        // The first picture would wait for each of its maps.
        let needs = method == method::Method::Field && source.field.is_finished();
        let fetches = needs && !source.begun.swap(true, Ordering::Relaxed);
        let pictured = || {
            thread::scope(|scope| {
                if fetches {
                    scope.spawn(|| source.field.fetch(&source.visible, &shot.camera));
                }
                take_tolerant(&source.field, &source.visible, &camera, how, &go_on)
            })
        };
        match catch_unwind(AssertUnwindSafe(pictured)) {
            Ok(pictured) => Some(pictured),
            Err(reason) if reason.is::<Stopped>() => None,
            Err(reason) => resume_unwind(reason),
        }
    };
    let (mut picture, missing) = match shot.method {
        Method::Field => by(method::Method::Field)?,
        Method::Trace => by(method::Method::Trace)?,
        Method::Difference => {
            let (mut field, missing) = by(method::Method::Field)?;
            let (trace, _) = by(method::Method::Trace)?;
            let apart = |a: &Rgb, b: &Rgb| Rgb([0, 1, 2].map(|c| (a.0[c] - b.0[c]).abs()));
            for (pixel, other) in field.pixels.iter_mut().zip(&trace.pixels) {
                *pixel = apart(pixel, other);
            }
            (field, missing)
        }
    };
    mark(&mut picture, &missing, look.exposure);
    let damaged = source.field.damaged().len();
    Some(Taken { shot: *shot, picture, damaged })
}

/// Why a picture was left unfinished.
struct Stopped;

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn a_coarse_picture_shows_what_the_fine_one_does() {
        let camera = Camera {
            eye: DVec3::ZERO,
            target: -DVec3::Z,
            up: DVec3::Y,
            vfov_deg: 70.0,
            width: 101,
            height: 67,
        };
        let fit = vlf::scene::Fit { centre: DVec3::ZERO, radius: 1.0 };
        for coarse in [2, 3, 16] {
            let shot = Shot { camera, pass: Pass { coarse, samples: 1 }, method: Method::Trace };
            let by = shot.taken_by();
            let margin = shot.margin().map(f64::from);
            for place in [[0.0, 0.0], [50.5, 33.5], [101.0, 67.0]] {
                let (_, fine) = camera.view(&fit).ray(place[0], place[1]);
                let there = [0, 1].map(|i| (place[i] + margin[i]) / f64::from(coarse));
                let (_, rough) = by.view(&fit).ray(there[0], there[1]);
                assert!(fine.distance(rough) < 1e-6, "{coarse}: {fine} is not {rough}");
            }
        }
    }
}
