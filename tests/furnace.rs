//! A furnace: in a closed box whose every wall emits `Le` and reflects `rho`, the radiance is the same
//! everywhere and in every direction, `Le (1 + rho + rho^2 + ...)`: after c bounces the sum to `rho^c`,
//! in the end `Le / (1 - rho)`. A mirror in the box changes nothing. Whatever the bake gets wrong
//! about who sees whom, how much of it, or where light goes, shows here as a stain.

mod common;

use common::{Baked, camera, parameters, picture, scene};
use vlf::look::render::method::Method;
use vlf::{Parameters, Rgb};

#[test]
fn every_texel_of_a_diffuse_furnace_is_exact_after_every_cycle() {
    let furnace = scene("furnace");
    let (le, rho) = (1.0f64, 0.5f64);
    for tile in [8, 16, 64] {
        for cycles in [1, 2, 3] {
            let parameters = Parameters { tile, ..parameters(129, 64, cycles) };
            let field = Baked::new(&furnace, &parameters).open();
            let exact: f64 = le * (0..=cycles).map(|k| rho.powi(k as i32)).sum::<f64>();
            let mut worst = 0.0f64;
            // Fronts look into the box, backs out of it.
            for sides in field.total.chunks_exact(2) {
                for c in sides[0].0 {
                    worst = worst.max((f64::from(c) - exact).abs());
                }
                assert_eq!(sides[1], Rgb::BLACK, "light outside the furnace");
            }
            assert!(worst < 1e-4, "tile {tile}, cycle {cycles}: off by {worst:e} from {exact}");
        }
    }
}

#[test]
fn pictures_of_a_furnace_with_mirrors_are_two_everywhere() {
    let furnace = scene("furnace_mirror");
    let parameters = Parameters { cycles: None, ..parameters(513, 64, 1) };
    let field = Baked::new(&furnace, &parameters).open();
    let camera = camera("furnace_mirror", 64, 64);
    for method in [Method::Trace, Method::Field] {
        let picture = picture(&field, &camera, method, 4);
        let off = |p: &Rgb| p.0.map(|c| (c - 2.0).abs() / 2.0).into_iter().fold(0.0, f32::max);
        let worst = picture.pixels.iter().map(off).fold(0.0, f32::max);
        let over = picture.pixels.iter().filter(|p| off(p) > 0.01).count();
        let cycles = field.manifest.cycle;
        assert!(
            worst < 0.01,
            "{method:?}, {cycles} cycles: off by up to {:.2} %; {over} of {} pixels over 1 %",
            100.0 * worst,
            picture.pixels.len()
        );
    }
}
