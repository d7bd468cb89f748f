//! Pictures of many samples that cost many only at edges.
//!
//! In: what fills each pixel (see [`super::filled`]), and who looks. Out: a picture. A pixel that one surface fills,
//! of which [`super::Look::plain`] says that it has no finer detail, is the mean of four samples, unless these disagree. They
//! are looked up in packets, and no ray is sent for them.

use super::filled::MIXED;
use super::{Looker, Moments};
use crate::level::level;
use crate::look::image::Picture;
use crate::look::packet::{EDGE, LANES, Lanes, NONE, Packet};
use crate::radiance::Rgb;
use crate::scene::camera::View;
use crate::visible::Visible;
use fearless_simd::dispatch;
use rayon::prelude::*;

/// Where the quarters of a pixel have their middles, from that of the pixel.
pub(super) const QUARTERS: [[f64; 2]; 4] =
    [[-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25], [0.25, 0.25]];

/// A plain pixel's mean that may be off by more than this part of itself is uncertain.
const UNCERTAIN: f64 = 0.01;

/// Takes four samples, in packets, of pixels that one surface fills, and as many as `pixel` does only where these
/// disagree or the surface is not plain. `tell` is told rows that are finished.
pub(super) fn around_edges<'a>(
    (visible, view, filled): (&Visible, &View, &[u32]),
    looker: &(dyn Fn(usize) -> Looker<'a> + Sync),
    picture: &mut Picture,
    pixel: &(impl Fn(&mut Looker<'a>, usize, usize) -> Rgb + Sync),
    tell: &(impl Fn(usize) + Sync),
) {
    let width = picture.width as usize;
    let views = QUARTERS.map(|[x, y]| view.moved(x, y));
    let strips = picture.pixels.par_chunks_mut((width * EDGE).max(1));
    let strips = strips.zip(filled.par_chunks((width * EDGE).max(1))).enumerate();
    let begin = || (looker(rayon::current_thread_index().unwrap_or(0)), Quarters::default());
    strips.for_each_init(begin, |(look, quarters), (strip, (out, filled))| {
        for column in (0..width).step_by(EDGE) {
            let mut surfaces = [MIXED; LANES];
            for (surfaces, row) in surfaces.chunks_mut(EDGE).zip(filled.chunks(width)) {
                let here = &row[column..width.min(column + EDGE)];
                surfaces[..here.len()].copy_from_slice(here);
            }
            let first = [column, strip * EDGE];
            let plain = quarters.look(look, (&views, visible), first, &surfaces);
            for (k, surface) in surfaces.iter().enumerate() {
                let (x, y) = (column + k % EDGE, k / EDGE);
                if x >= width || y * width + x >= out.len() {
                    continue;
                }
                let mut all = || pixel(look, x, strip * EDGE + y);
                out[y * width + x] = match (*surface, plain >> k & 1) {
                    (NONE, _) => Rgb::BLACK,
                    (_, 0) => all(),
                    (_, _) => quarters.mean(k, all),
                };
            }
            tell(0);
        }
        tell(out.len() / width);
    });
}

/// What is seen through the quarters of a square of pixels.
#[derive(Default)]
struct Quarters {
    packets: [Packet; 4],
    seen: [Lanes<Rgb>; 4],
}

impl Quarters {
    /// Looks at the square's plain pixels, which are returned as [`super::Look::plain`] does.
    fn look(
        &mut self,
        look: &mut Looker<'_>,
        (views, visible): (&[View; 4], &Visible),
        first: [usize; 2],
        surfaces: &Lanes<u32>,
    ) -> u32 {
        let Quarters { packets, seen } = self;
        let level = level();
        let mut met = surfaces.map(|surface| if surface == MIXED { NONE } else { surface });
        if met == [NONE; LANES] {
            return 0;
        }
        for (packet, view) in packets.iter_mut().zip(views) {
            dispatch!(level, simd => packet.send(simd, view, first, (met, visible)));
        }
        let mut plain = look.plain(packets);
        for (k, met) in met.iter_mut().enumerate() {
            plain &= !(u32::from(*met == NONE) << k);
            *met = if plain >> k & 1 == 1 { *met } else { NONE };
        }
        if plain == 0 {
            return 0;
        }
        for (packet, seen) in packets.iter_mut().zip(seen) {
            packet.surfaces = met;
            look.packet(packet, seen);
        }
        plain
    }

    /// A pixel; as far as its quarters disagree, what is seen of `all` of it.
    fn mean(&self, k: usize, all: impl FnOnce() -> Rgb) -> Rgb {
        let (mut moments, mut sum) = (Moments::default(), Rgb::BLACK);
        for seen in &self.seen {
            moments.add(f64::from(seen[k].mean()));
            sum += seen[k];
        }
        match moments.doubt(UNCERTAIN) as f32 {
            doubt if doubt > 0.0 => sum * (0.25 * (1.0 - doubt)) + all() * doubt,
            _ => sum * 0.25,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::look::render::{Look, Options, render_with};
    use crate::scene::Scene;
    use crate::scene::camera::Camera;
    use crate::scene::test_scenes::{quad, room};
    use crate::visible::Hit;
    use glam::{DVec3, Vec3};
    use std::sync::atomic::{AtomicU64, Ordering};

    /// Sees each surface in a colour of its own, a little darker to the left, and counts how often it is asked.
    struct Counted<'a> {
        plain: bool,
        asked: &'a AtomicU64,
    }

    impl Look for Counted<'_> {
        fn radiance(&mut self, dir: Vec3, hit: &Hit) -> Rgb {
            self.asked.fetch_add(1, Ordering::Relaxed);
            Rgb([0.1 * hit.surface.0 as f32, 1.0, 0.5]) + Rgb::splat(0.2 * dir.x)
        }

        fn plain(&self, _: &[Packet; 4]) -> u32 {
            if self.plain { u32::MAX } else { 0 }
        }
    }

    /// A picture of 16 samples, and how many were taken.
    fn taken(scene: &Scene, camera: &Camera, plain: bool) -> (Picture, u64) {
        let (visible, asked) = (Visible::new(scene), AtomicU64::new(0));
        let looker = |_| -> Looker<'_> { Box::new(Counted { plain, asked: &asked }) };
        let picture = render_with(scene, &visible, camera, Options::default(), &looker, &|_| ());
        (picture, asked.into_inner())
    }

    fn camera() -> Camera {
        let (eye, target) = (DVec3::new(0.01, 0.02, 0.4), DVec3::new(0.05, -0.02, -0.5));
        Camera { eye, target, up: DVec3::Y, vfov_deg: 70.0, width: 61, height: 43 }
    }

    #[test]
    fn pixels_without_edges_cost_four_samples() {
        let scene = room();
        let (few, asked) = taken(&scene, &camera(), true);
        let (many, asked_of_all) = taken(&scene, &camera(), false);
        let pixels = few.pixels.len() as u64;
        assert!(asked_of_all >= 16 * pixels);
        // Eight edges of the room are in view, none longer than the picture's diagonal.
        let at_edges = 8 * (61 + 43);
        assert!(asked <= 4 * pixels + 16 * 16 * at_edges && asked < asked_of_all / 2, "{asked}");
        let apart = |(a, b): (&Rgb, &Rgb)| (a.mean() - b.mean()).abs();
        let worst = few.pixels.iter().zip(&many.pixels).map(apart).fold(0.0, f32::max);
        assert!(worst < 1e-3, "{worst}");
    }

    #[test]
    fn a_leg_thinner_than_a_pixel_is_as_all_samples_have_it() {
        let bare = room();
        let mut scene = room();
        // A twentieth of a pixel wide, aslant.
        scene.surfaces.push(quad(
            0,
            Vec3::new(0.1, -0.5, -0.3),
            Vec3::X * 7e-4,
            Vec3::new(0.0, 1.0, 0.1),
        ));
        let ((without, _), (few, _), (many, _)) = (
            taken(&bare, &camera(), true),
            taken(&scene, &camera(), true),
            taken(&scene, &camera(), false),
        );
        let mut shows_leg = 0;
        for ((without, few), many) in without.pixels.iter().zip(&few.pixels).zip(&many.pixels) {
            assert!((few.mean() - many.mean()).abs() < 1e-3);
            if few != without {
                shows_leg += 1;
                assert_eq!(few, many);
            }
        }
        assert!(shows_leg >= 30, "{shows_leg}");
    }
}
