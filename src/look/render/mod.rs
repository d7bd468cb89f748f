//! Pictures: rays through the pixels, and the mean of the radiance they find.
//!
//! In: the scene, its [`Visible`], a camera, and a function from a direction and a hit to radiance
//! (section 6 of the paper has two). Out: a [`Picture`]. Each pixel is the plain mean over stratified
//! points of its square, a box filter; more of them where they disagree, fewer where one surface fills it and they
//! cannot. Same bits for every run and any number of threads.

use crate::look::image::Picture;
use crate::look::packet::{EDGE, LANES, Lanes, Packet};
use crate::look::tone::Tone;
use crate::radiance::Rgb;
use crate::scene::Scene;
use crate::scene::camera::{Camera, View};
use crate::visible::{Hit, Visible};
use filled::filled;
use glam::Vec3;
use plain::{QUARTERS, around_edges};
use primary::{BAND, Band, Primary};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

pub mod primary;

mod filled;

mod plain;

pub mod raytrace;

pub mod method;

/// The most samples a pixel may have.
pub const MOST_SAMPLES: u32 = 4096;

/// How a picture is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// Samples a pixel, `1..=4096`; a number outside is taken as the nearest inside. Powers of two
    /// are stratified best. Pixels whose samples disagree take more, and those without an edge no more than
    /// four, as long as these agree. One sample looks through the pixel's middle.
    pub samples: u32,
    /// What of the directions around the eye the picture shows.
    pub projection: Projection,
}

/// How directions become places in a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Projection {
    /// Of a pinhole camera.
    #[default]
    Perspective,
    /// All around the eye, see [`Camera::panorama`].
    Equirectangular,
}

impl Default for Options {
    fn default() -> Options {
        Options { samples: 16, projection: Projection::default() }
    }
}

/// Radiance that arrives along a unit direction (pointing away from the eye) from a hit, W sr^-1 m^-2.
pub type Radiance<'a> = dyn Fn(Vec3, &Hit) -> Rgb + Sync + 'a;

/// The same for one thread, which may remember what it has seen.
pub trait Look {
    /// As [`Radiance`].
    fn radiance(&mut self, dir: Vec3, hit: &Hit) -> Rgb;

    /// The same of the rays of a packet; black where nothing is met.
    fn packet(&mut self, packet: &Packet, out: &mut Lanes<Rgb>) {
        for (k, out) in out.iter_mut().enumerate() {
            *out = packet.hit(k).map_or(Rgb::BLACK, |hit| self.radiance(packet.dir(k), &hit));
        }
    }

    /// Of which pixels four samples tell the mean, unless they disagree, as a bit each, the first one's the lowest:
    /// where nothing has edges but what the eye sees first, and no detail is smaller than a pixel. The packets' rays
    /// go through the middles of the quarters of the same pixels, each of which one surface fills.
    fn plain(&self, _quarters: &[Packet; 4]) -> u32 {
        0
    }
}

impl Look for &Radiance<'_> {
    fn radiance(&mut self, dir: Vec3, hit: &Hit) -> Rgb {
        self(dir, hit)
    }
}

/// Who looks for one thread.
pub type Looker<'a> = Box<dyn Look + 'a>;

/// Parts of a picture that is drawn in packets, at least; four a thread, so that none waits long for another.
const PARTS: usize = 16;

/// Pixels after which `progress` is told within a row: rows of many samples take long.
const TOLD_EVERY: usize = 32;

/// A pixel whose samples disagree, as where a lamp's edge runs through it, takes up to this many times
/// as many.
const REFINED: u32 = 16;

/// A pixel's mean that may be off by more than this part of itself is uncertain.
const UNCERTAIN: f64 = 0.05;

/// Of what is uncertain, squared, where doubt begins: between the two, more samples count in part. A picture is then a
/// continuous function of what is looked at; a threshold would let a field's last bits decide whole samples.
const DOUBT: f64 = 0.5;

/// Sums from which the error of a mean is judged.
#[derive(Default)]
struct Moments {
    count: f64,
    sum: f64,
    squares: f64,
}

impl Moments {
    fn add(&mut self, value: f64) {
        self.count += 1.0;
        self.sum += value;
        self.squares += value * value;
    }

    /// How much more samples are to count, from 0 where the standard error of the mean is small to 1 where it
    /// is a part `uncertain` of the mean or more. The samples are stratified, so the true error is less.
    fn doubt(&self, uncertain: f64) -> f64 {
        let variance = (self.squares - self.sum * self.sum / self.count).max(0.0);
        let bound = (uncertain * self.sum).powi(2);
        // Not where both are 0, or one is no number.
        if variance > DOUBT * bound {
            ((variance - DOUBT * bound) / (bound - DOUBT * bound)).min(1.0)
        } else {
            0.0
        }
    }
}

/// Takes a picture, on all threads of the rayon pool it is called in. Pixels that look past the scene
/// are black. `progress` is told the finished part, up to 1, again and again and from any thread.
pub fn render(
    scene: &Scene,
    visible: &Visible,
    camera: &Camera,
    options: Options,
    radiance: &Radiance<'_>,
    progress: &(dyn Fn(f32) + Sync),
) -> Picture {
    let looker = |_| -> Looker { Box::new(radiance) };
    render_with(scene, visible, camera, options, &looker, progress)
}

/// The same with those who look made by `looker` for numbered parts of the picture, so that they can go on with
/// what they saw of the same part of a picture before. Where pixels have many samples a thread's share is a part.
pub fn render_with<'a>(
    scene: &Scene,
    visible: &Visible,
    camera: &Camera,
    options: Options,
    looker: &(dyn Fn(usize) -> Looker<'a> + Sync),
    progress: &(dyn Fn(f32) + Sync),
) -> Picture {
    let mut picture = Picture::black(camera.width, camera.height);
    draw(scene, visible, camera, options, looker, progress, (&mut picture, None));
    picture
}

/// What is to be shown, and where.
type Shown<'a> = Option<(Tone, &'a mut [[u8; 3]])>;

/// Draws every pixel of a picture of the camera's size.
fn draw<'a>(
    scene: &Scene,
    visible: &Visible,
    camera: &Camera,
    options: Options,
    looker: &(dyn Fn(usize) -> Looker<'a> + Sync),
    progress: &(dyn Fn(f32) + Sync),
    (picture, shown): (&mut Picture, Shown<'_>),
) {
    let height = camera.height as usize;
    let view = camera.view(&scene.fit);
    let all_around = camera.panorama(&scene.fit);
    let ray = |x: f64, y: f64| match options.projection {
        Projection::Perspective => view.ray(x, y),
        Projection::Equirectangular => all_around.ray(x, y),
    };
    let samples = options.samples.clamp(1, MOST_SAMPLES);
    let places = places(samples * if samples > 1 { REFINED } else { 1 });
    let pixel = |look: &mut Looker<'a>, x: usize, y: usize| -> Rgb {
        let seed = hash(x as u32 ^ hash(y as u32));
        // Sums of many samples in f64: the mean of equal values is that value.
        let mut sum = [0.0f64; 3];
        let mut moments = Moments::default();
        // The mean of the samples so far, and the pixel, which follows it as far as it was in doubt.
        let (mut mean, mut value) = ([0.0f64; 3], [0.0f64; 3]);
        let mut follows = 1.0;
        let (mut taken, mut wanted) = (0, samples as usize);
        while taken < wanted {
            for place in &places[taken..wanted] {
                let [dx, dy] = if samples == 1 { [0.5; 2] } else { shuffled(*place, seed) };
                let (origin, dir) = ray(x as f64 + dx, y as f64 + dy);
                let hit = visible.nearest(origin, dir, 0.0);
                let found = hit.map_or(Rgb::BLACK, |hit| look.radiance(dir, &hit));
                (0..3).for_each(|c| sum[c] += f64::from(found.0[c]));
                moments.add(f64::from(found.mean()));
            }
            taken = wanted;
            let before = mean;
            mean = sum.map(|s| s / taken as f64);
            (0..3).for_each(|c| value[c] += follows * (mean[c] - before[c]));
            follows *= moments.doubt(UNCERTAIN);
            if samples > 1 && follows > 0.0 {
                wanted = (2 * wanted).min(places.len());
            }
        }
        Rgb(value.map(|v| v as f32))
    };
    let rows_done = AtomicUsize::new(0);
    let tell = |rows: usize| {
        let done = rows_done.fetch_add(rows, Ordering::Relaxed) + rows;
        progress(done as f32 / height as f32);
    };
    if samples == 1 && options.projection == Projection::Perspective {
        return in_packets(visible, &view, looker, (picture, shown), &tell);
    }
    if samples as usize >= QUARTERS.len() && options.projection == Projection::Perspective {
        let filled = filled(scene, visible, &view, (camera.width, camera.height));
        let places = (visible, &view, &filled[..]);
        around_edges(places, looker, picture, &pixel, &tell);
    } else {
        all_alike(looker, picture, &pixel, &tell);
    }
    if let Some((tone, shown)) = shown {
        tone.develop(&picture.pixels, shown);
    }
}

/// Takes all samples of all pixels. `tell` is told rows that are finished.
fn all_alike<'a>(
    looker: &(dyn Fn(usize) -> Looker<'a> + Sync),
    picture: &mut Picture,
    pixel: &(impl Fn(&mut Looker<'a>, usize, usize) -> Rgb + Sync),
    tell: &(impl Fn(usize) + Sync),
) {
    let width = picture.width as usize;
    let rows = picture.pixels.par_chunks_mut(width.max(1)).enumerate();
    rows.for_each_init(
        || looker(rayon::current_thread_index().unwrap_or(0)),
        |look, (y, row)| {
            for (x, out) in row.iter_mut().enumerate() {
                *out = pixel(look, x, y);
                if x % TOLD_EVERY == TOLD_EVERY - 1 {
                    tell(0);
                }
            }
            tell(1);
        },
    );
}

/// Draws the middles of all pixels in packets, and what is shown of them while they are in a core's own cache. `tell` is
/// told rows that are finished.
fn in_packets<'a>(
    visible: &Visible,
    view: &View,
    looker: &(dyn Fn(usize) -> Looker<'a> + Sync),
    (picture, shown): (&mut Picture, Shown<'_>),
    tell: &(impl Fn(usize) + Sync),
) {
    let primary = Primary::new(visible, view, (picture.width, picture.height));
    let (width, height) = (picture.width as usize, picture.height as usize);
    let bands = height.div_ceil(BAND).div_ceil(PARTS.max(4 * rayon::current_num_threads()));
    let (tone, shown) = shown.unzip();
    let (band, part) = ((width * BAND).max(1), (width * BAND * bands).max(1));
    let mut shown = shown.unwrap_or_default().chunks_mut(part);
    let both = |out| (out, shown.next().unwrap_or_default());
    let parts: Vec<_> = picture.pixels.chunks_mut(part).map(both).collect();
    let parts = parts.into_par_iter().enumerate();
    parts.for_each_init(Band::default, |into, (part, (out, shown))| {
        let (mut look, mut seen) = (looker(part), [Rgb::BLACK; LANES]);
        let mut shown = shown.chunks_mut(band);
        for (k, out) in out.chunks_mut(band).enumerate() {
            primary.draw(part * bands + k, into, |[column, row], packet| {
                look.packet(packet, &mut seen);
                let rows = out[row * width..].chunks_mut(width);
                for (row, seen) in rows.zip(seen.chunks(EDGE)) {
                    let here = &mut row[column..width.min(column + EDGE)];
                    here.copy_from_slice(&seen[..here.len()]);
                }
            });
            if let (Some(tone), Some(shown)) = (tone, shown.next()) {
                tone.show(out, shown);
            }
            tell(out.len() / width);
        }
    });
}

/// The first `n` points of Sobol's (0, 2)-sequence, as 32-bit fractions of the unit square: every
/// power of two of them has one point in each strip, square and rectangle of that area.
fn places(n: u32) -> Vec<[u32; 2]> {
    let second = |mut i: u32| {
        let (mut v, mut sum) = (1u32 << 31, 0);
        while i != 0 {
            if i & 1 == 1 {
                sum ^= v;
            }
            v ^= v >> 1;
            i >>= 1;
        }
        sum
    };
    (0..n).map(|i| [i.reverse_bits(), second(i)]).collect()
}

/// A point of the sequence in [0, 1)^2, shuffled for one pixel without losing its strata (Owen's
/// scrambling, by Laine and Karras' hash as corrected by Vegdahl 2021): neighbouring pixels that
/// shared their points would show the same error side by side.
fn shuffled(place: [u32; 2], seed: u32) -> [f64; 2] {
    let scramble = |bits: u32, seed: u32| {
        let mut x = bits.reverse_bits();
        x ^= x.wrapping_mul(0x3d20_adea);
        x = x.wrapping_add(seed);
        x = x.wrapping_mul((seed >> 16) | 1);
        x ^= x.wrapping_mul(0x0552_6c56);
        x ^= x.wrapping_mul(0x53a2_2864);
        f64::from(x.reverse_bits()) / 4_294_967_296.0
    };
    [scramble(place[0], seed), scramble(place[1], hash(seed))]
}

/// A well mixed 32-bit hash (Wellons' "lowbias32").
fn hash(mut x: u32) -> u32 {
    x = x.wrapping_add(0x9e37_79b9);
    x = (x ^ (x >> 16)).wrapping_mul(0x7feb_352d);
    x = (x ^ (x >> 15)).wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::test_scenes::room;
    use glam::DVec3;

    fn camera(width: u32, height: u32) -> Camera {
        Camera {
            eye: DVec3::new(0.0, 0.0, 0.4),
            target: DVec3::new(0.05, -0.02, -0.5),
            up: DVec3::Y,
            vfov_deg: 70.0,
            width,
            height,
        }
    }

    /// Each wall in a colour of its own, shaded by the angle.
    fn shade(dir: Vec3, hit: &Hit) -> Rgb {
        Rgb([hit.surface.0 as f32 * 0.1, dir.z.abs(), hit.distance])
    }

    #[test]
    fn the_points_are_stratified_before_and_after_the_shuffle() {
        for n in [1u32, 4, 16, 64] {
            let points = places(n);
            let side = f64::from(n).sqrt().round();
            for seed in [0, 1, 0xdead_beef] {
                let mut squares = vec![0; n as usize];
                let mut columns = vec![0; n as usize];
                for p in &points {
                    let [x, y] = shuffled(*p, seed);
                    assert!((0.0..1.0).contains(&x) && (0.0..1.0).contains(&y));
                    squares[((y * side).floor() * side + (x * side).floor()) as usize] += 1;
                    columns[(x * f64::from(n)) as usize] += 1;
                }
                assert!(squares.iter().chain(&columns).all(|c| *c == 1), "{n} points, seed {seed}");
            }
        }
    }

    #[test]
    fn the_same_bits_on_one_thread_and_on_two() {
        let (scene, camera) = (room(), camera(61, 37));
        let visible = Visible::new(&scene);
        let take = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let options = Options { samples: 9, ..Options::default() };
            pool.install(|| render(&scene, &visible, &camera, options, &shade, &|_| ()))
        };
        let one = take(1);
        assert!(one == take(2) && one == take(2));
        assert!(one.pixels.iter().all(|p| p.0[2] > 0.0));
    }

    #[test]
    fn a_pixel_is_the_mean_over_its_square() {
        // An edge between a white and a black wall: the mean over the picture is the white share,
        // however few the pixels.
        let scene = room();
        let visible = Visible::new(&scene);
        let white = |_: Vec3, hit: &Hit| Rgb::splat(if hit.surface.0 == 4 { 1.0 } else { 0.0 });
        let mean = |camera: Camera, samples| {
            let p = render(
                &scene,
                &visible,
                &camera,
                Options { samples, ..Options::default() },
                &white,
                &|_| (),
            );
            p.pixels.iter().map(|p| f64::from(p.0[0])).sum::<f64>() / p.pixels.len() as f64
        };
        let fine = mean(camera(400, 300), 4);
        assert!((mean(camera(8, 6), 256) - fine).abs() < 2e-3);
        assert!((mean(camera(40, 30), 16) - fine).abs() < 2e-3);
    }

    /// No pixel jumps when what is looked at changes a little, as from a field to its pack: not even where
    /// its samples begin to disagree enough for more to be taken.
    #[test]
    fn a_pixel_is_a_continuous_function_of_what_it_sees() {
        let scene = room();
        let visible = Visible::new(&scene);
        let options = Options { samples: 4, ..Options::default() };
        let picture = |dark: f32| {
            let shade =
                |_: Vec3, hit: &Hit| Rgb::splat(if hit.surface.0 == 4 { 1.0 } else { dark });
            render(&scene, &visible, &camera(40, 30), options, &shade, &|_| ())
        };
        let mut before = picture(0.3);
        for step in 1..=300 {
            let after = picture(0.3 + 0.002 * step as f32);
            let jumps =
                before.pixels.iter().zip(&after.pixels).map(|(a, b)| (a.0[0] - b.0[0]).abs());
            let jump = jumps.fold(0.0, f32::max);
            assert!(jump < 0.006, "{jump} when the dark walls are {}", 0.3 + 0.002 * step as f32);
            before = after;
        }
    }

    #[test]
    fn progress_ends_at_one_and_misses_are_black() {
        let scene = room();
        let visible = Visible::new(&scene);
        let last = std::sync::Mutex::new(0.0f32);
        let away = Camera { eye: DVec3::Z * 2.0, target: DVec3::Z * 3.0, ..camera(5, 4) };
        let told = |p: f32| {
            let mut last = last.lock().unwrap();
            *last = last.max(p);
        };
        let picture = render(
            &scene,
            &visible,
            &away,
            Options { samples: 1, ..Options::default() },
            &shade,
            &told,
        );
        assert!(picture.pixels.iter().all(|p| p.is_black()));
        assert_eq!(*last.lock().unwrap(), 1.0);
    }
}
