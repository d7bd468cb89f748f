//! One picture: what to take, and the taking.

use crate::pace::Pass;
use crate::source::Source;
use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};
use vlf::look::image::{Bitmap, Canvas, Picture};
use vlf::look::render::Options;
use vlf::look::render::method::{self, draw_tolerant, mark, take_tolerant};
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

/// Canvases of frames of before, to be drawn on again when nobody shows those any more.
#[derive(Default)]
pub struct Spare(VecDeque<(Arc<Taken>, Arc<Bitmap>)>);

/// Frames that may be shown, drawn or sent at a time.
const KEPT: usize = 3;

impl Spare {
    fn canvas(&mut self) -> Canvas {
        let free = |(taken, bitmap): &(Arc<Taken>, Arc<Bitmap>)| {
            Arc::strong_count(taken) == 1 && Arc::strong_count(bitmap) == 1
        };
        let found = self.0.iter().position(free).and_then(|at| self.0.remove(at));
        let own = found.and_then(|(taken, bitmap)| {
            Some(Canvas {
                picture: Arc::into_inner(taken)?.picture,
                bitmap: Arc::into_inner(bitmap)?,
            })
        });
        own.unwrap_or_default()
    }

    fn keep(&mut self, taken: &Arc<Taken>, bitmap: &Arc<Bitmap>) {
        self.0.push_back((taken.clone(), bitmap.clone()));
        if self.0.len() > KEPT {
            self.0.pop_front();
        }
    }
}

/// Does a job; `None` when `stop` was set before it was done.
pub fn paint(source: &Source, job: &Job, stop: &AtomicBool, spare: &mut Spare) -> Option<Frame> {
    let start = Instant::now();
    let (taken, bitmap, look) = match job {
        Job::Take(shot, look) => {
            let (taken, bitmap, ev) = take(source, shot, look, stop, spare.canvas())?;
            (Arc::new(taken), bitmap, Look { exposure: Some(ev), ..*look })
        }
        Job::Develop(taken, look) => {
            let ev = look.exposure.unwrap_or_else(|| tone::auto_exposure(&taken.picture));
            let bitmap = tone::develop_with(&taken.picture, ev, look.curve);
            (taken.clone(), bitmap, Look { exposure: Some(ev), ..*look })
        }
    };
    let bitmap = Arc::new(bitmap);
    spare.keep(&taken, &bitmap);
    Some(Frame { taken, bitmap, look, time: start.elapsed() })
}

/// Takes a picture, with what is shown of it and at which exposure. Pixels that need a damaged map are magenta.
fn take(
    source: &Source,
    shot: &Shot,
    look: &Look,
    stop: &AtomicBool,
    mut canvas: Canvas,
) -> Option<(Taken, Bitmap, f32)> {
    let Source { field, visible, .. } = source;
    let camera = shot.taken_by();
    let options = Options { samples: shot.pass.samples, ..Options::default() };
    let (first, second) = match shot.method {
        Method::Field => (method::Method::Field, None),
        Method::Trace => (method::Method::Trace, None),
        Method::Difference => (method::Method::Field, Some(method::Method::Trace)),
    };
    // Whoever waits for the next picture does not wait for the rest of this one. Unwinding is how a
    // renderer that reports its progress is left in the middle; nothing is half done by then.
    let go_on = |_| {
        if stop.load(Ordering::Relaxed) {
            resume_unwind(Box::new(Stopped));
        }
    };
    // The first picture would wait for each of its maps.
    let needs = first == method::Method::Field && field.is_finished();
    let fetches = needs && !source.begun.swap(true, Ordering::Relaxed);
    let drawn = || {
        thread::scope(|scope| {
            if fetches {
                scope.spawn(|| field.fetch(visible, &shot.camera));
            }
            let how = (first, options);
            match (look.exposure, second) {
                // All is known for what is shown to be drawn along.
                (Some(ev), None) => {
                    let onto = (&mut canvas, ev, look.curve);
                    draw_tolerant(field, visible, &camera, how, &go_on, onto);
                    ev
                }
                (ev, second) => {
                    let (mut picture, missing) =
                        take_tolerant(field, visible, &camera, how, &go_on);
                    if let Some(second) = second {
                        let how = (second, options);
                        let (other, _) = take_tolerant(field, visible, &camera, how, &go_on);
                        subtract(&mut picture, &other);
                    }
                    mark(&mut picture, &missing, ev);
                    let ev = ev.unwrap_or_else(|| tone::auto_exposure(&picture));
                    let bitmap = tone::develop_with(&picture, ev, look.curve);
                    canvas = Canvas { picture, bitmap };
                    ev
                }
            }
        })
    };
    let ev = match catch_unwind(AssertUnwindSafe(drawn)) {
        Ok(ev) => ev,
        Err(reason) if reason.is::<Stopped>() => return None,
        Err(reason) => resume_unwind(reason),
    };
    let Canvas { picture, bitmap } = canvas;
    Some((Taken { shot: *shot, picture, damaged: field.damaged().len() }, bitmap, ev))
}

/// How far a picture is from another, channel by channel, in its place.
fn subtract(picture: &mut Picture, other: &Picture) {
    for (pixel, other) in picture.pixels.iter_mut().zip(&other.pixels) {
        *pixel = Rgb([0, 1, 2].map(|c| (pixel.0[c] - other.0[c]).abs()));
    }
}

/// Why a picture was left unfinished.
struct Stopped;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{opening, pack};
    use glam::DVec3;
    use std::collections::HashSet;

    /// One frame after the other, each of which is shown until the next: what is shown is what the picture develops to,
    /// however it was drawn, and the frames take turns on the same memory.
    #[test]
    fn frames_are_developed_while_they_are_drawn_and_use_their_memory_again() {
        let (_folder, pack) = pack();
        let source = opening(&pack).open().unwrap();
        let mut spare = Spare::default();
        for method in [Method::Field, Method::Trace, Method::Difference] {
            for samples in [1, 4] {
                let (mut places, mut shown) = (HashSet::new(), None);
                for step in 0..8 {
                    let camera = Camera { width: 61 - step, height: 43, ..source.start };
                    let shot = Shot { camera, pass: Pass { coarse: 1, samples }, method };
                    let look = Look { exposure: Some(0.5), curve: Curve::Reinhard };
                    let job = Job::Take(shot, look);
                    let frame = paint(&source, &job, &AtomicBool::new(false), &mut spare).unwrap();
                    let developed = tone::develop_with(&frame.taken.picture, 0.5, Curve::Reinhard);
                    assert!(*frame.bitmap == developed, "{method:?}, {samples}");
                    places.insert(frame.taken.picture.pixels.as_ptr() as usize);
                    // Until here the frame before was shown.
                    shown.replace(frame);
                }
                // What is drawn along is drawn on what is at hand.
                let most = if method == Method::Difference { 8 } else { KEPT };
                assert!(places.len() <= most, "{method:?}, {samples}: {}", places.len());
            }
        }
    }

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
