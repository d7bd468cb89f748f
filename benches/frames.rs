//! Times of a frame of the walkthrough and of its parts, over a few views of a packed field, beside the
//! time that a ray for each pixel takes; see the README beside this file.
//!
//!     cargo bench --bench frames -- PACK.vlf CAMERA.json

use glam::DVec3;
use rayon::prelude::*;
use std::path::Path;
use std::time::{Duration, Instant};
use vlf::look::render::Options;
use vlf::look::render::method::{Method, take};
use vlf::look::render::primary::{BAND, Band, Primary};
use vlf::scene::camera::View;
use vlf::{Camera, LightField, Visible};

/// Views, each a step to the side of the one before.
const VIEWS: u32 = 24;

/// Length of a step, in radii of the scene.
const STEP: f64 = 0.01;

/// A name, and what is done for a view.
type Work<'a> = (&'a str, &'a dyn Fn(&Camera));

fn main() {
    let words: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let [pack, camera] = words.as_slice() else {
        eprintln!("say what to look at: cargo bench --bench frames -- PACK.vlf CAMERA.json");
        return;
    };
    let field = LightField::open(Path::new(pack)).expect("a pack");
    let start = Camera::open(Path::new(camera)).expect("a camera");
    let visible = Visible::new(&field.scene);
    let right = (start.target - start.eye).cross(start.up).normalize() * field.scene.fit.radius;
    let moved = |by: DVec3| Camera { eye: start.eye + by, target: start.target + by, ..start };
    let views: Vec<Camera> = (0..VIEWS).map(|k| moved(right * (STEP * f64::from(k)))).collect();
    let size = (start.width, start.height);

    let one_by_one = |camera: &Camera| _ = rays(&visible, &camera.view(&field.scene.fit), size);
    let rasterised = |camera: &Camera| _ = raster(&visible, &camera.view(&field.scene.fit), size);
    let frame = |method| {
        let (field, visible) = (&field, &visible);
        move |camera: &Camera| {
            let options = (method, Options { samples: 1, ..Options::default() });
            _ = take(field, visible, camera, options, &|_| ()).expect("a sound pack");
        }
    };
    let all: [Work; 4] = [
        ("primary rays, one by one", &one_by_one),
        ("primary, rasterised", &rasterised),
        ("trace", &frame(Method::Trace)),
        ("field", &frame(Method::Field)),
    ];
    // Maps are decoded when they are first needed, pages touched; then in turn, so that a machine that
    // is busy for a while is so for all of them.
    let mut times: Vec<Vec<Duration>> = vec![Vec::new(); all.len()];
    for round in 0..3 {
        for camera in &views {
            for ((_, work), times) in all.iter().zip(&mut times) {
                let began = Instant::now();
                work(camera);
                if round > 0 {
                    times.push(began.elapsed());
                }
            }
        }
    }
    times.iter_mut().for_each(|t| t.sort());
    let median = |k: usize| times[k][times[k].len() / 2].as_secs_f64() * 1e3;
    let (threads, count) = (rayon::current_num_threads(), times[0].len());
    println!("{} x {}, {threads} threads, median of {count}", size.0, size.1);
    for (k, (name, _)) in all.iter().enumerate() {
        println!("{name:>26}: {:7.2} ms, {:.2} of the rays'", median(k), median(k) / median(0));
    }
}

/// Pixels whose rays, followed one by one, meet something.
fn rays(visible: &Visible, view: &View, size: (u32, u32)) -> usize {
    let meets = |x: u32, y: u32| {
        let (origin, dir) = view.ray(f64::from(x) + 0.5, f64::from(y) + 0.5);
        visible.nearest(origin, dir, 0.0).is_some()
    };
    let row = |y: u32| (0..size.0).filter(|x| meets(*x, y)).count();
    (0..size.1).into_par_iter().map(row).sum()
}

/// The same by rasterising.
fn raster(visible: &Visible, view: &View, size: (u32, u32)) -> usize {
    let primary = Primary::new(visible, view, size);
    let count = |into: &mut Band, band: usize| {
        let mut met = 0;
        primary.draw(band, into, |_, packet| met += packet.met());
        met
    };
    let bands = size.1.div_ceil(BAND as u32) as usize;
    (0..bands).into_par_iter().map_init(Band::default, count).sum()
}
