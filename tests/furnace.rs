//! A furnace: in a closed box whose every wall emits `Le` and reflects `rho`, the radiance is the same
//! everywhere and in every direction, `Le (1 + rho + rho^2 + ...)`: after c bounces the sum to `rho^c`,
//! in the end `Le / (1 - rho)`. A mirror in the box changes nothing. Whatever the bake gets wrong
//! about who sees whom, how much of it, or where light goes, shows here as a stain.

mod common;

use common::{Baked, camera, obj, parameters, picture, scene, scene_of};
use vlf::look::render::method::Method;
use vlf::{Parameters, Rgb, Scene, Transfer};

/// Neither may leave a stain.
const TRANSFERS: [Transfer; 2] = [Transfer::Sample, Transfer::Clip];

#[test]
fn every_texel_of_a_diffuse_furnace_is_exact_after_every_cycle() {
    let furnace = scene("furnace");
    let (le, rho) = (1.0f64, 0.5f64);
    for tile in [8, 16, 64] {
        for (cycles, transfer) in [1, 2, 3].into_iter().flat_map(|c| TRANSFERS.map(|t| (c, t))) {
            let parameters = Parameters { tile, transfer, ..parameters(129, 64, cycles) };
            let baked = Baked::new(&furnace, &parameters);
            let field = baked.open();
            let exact: f64 = le * (0..=cycles).map(|k| rho.powi(k as i32)).sum::<f64>();
            let mut worst = 0.0f64;
            // Fronts look into the box, backs out of it.
            for sides in field.total.chunks_exact(2) {
                for c in sides[0].0 {
                    worst = worst.max((f64::from(c) - exact).abs());
                }
                assert_eq!(sides[1], Rgb::BLACK, "light outside the furnace");
            }
            assert!(
                worst < 1e-4,
                "tile {tile}, cycle {cycles}, {transfer:?}: off by {worst:e} from {exact}"
            );
        }
    }
}

/// The floor under the block of `furnace_mirror` must not show: the block's faces emit to the outside
/// only, so its inside is no furnace.
#[test]
fn pictures_of_a_furnace_with_mirrors_are_two_everywhere() {
    two_everywhere(&scene("furnace_mirror"));
}

/// The same with a bottom to the block, which touches the floor: no light passes between the two, and
/// lines that meet only in the contact must not count.
#[test]
fn a_closed_block_that_stands_in_a_furnace_leaves_no_stain() {
    let folder = obj("furnace_mirror");
    let bottom =
        "v -0.5 -1 -0.3\nv 0 -1 -0.3\nv 0 -1 0.2\nv -0.5 -1 0.2\nusemtl block\nf -4 -3 -2 -1\n";
    let text = std::fs::read_to_string(&folder).unwrap().replace("mtllib", "# ") + bottom;
    let mtl = std::fs::read_to_string(folder.with_extension("mtl")).unwrap();
    two_everywhere(&scene_of(&text, &mtl));
}

fn two_everywhere(furnace: &Scene) {
    let camera = camera("furnace_mirror", 64, 64);
    let mut failures = Vec::new();
    let both = |transfer| [Method::Trace, Method::Field].map(|method| (transfer, method));
    for (transfer, method) in TRANSFERS.into_iter().flat_map(both) {
        let parameters = Parameters { cycles: None, transfer, ..parameters(129, 64, 1) };
        let baked = Baked::new(furnace, &parameters);
        let field = baked.open();
        let picture = picture(&field, &camera, method, 4);
        let off = |p: &Rgb| p.0.map(|c| (c - 2.0).abs() / 2.0).into_iter().fold(0.0, f32::max);
        let worst = picture.pixels.iter().map(off).fold(0.0, f32::max);
        let over = picture.pixels.iter().filter(|p| off(p) > 0.01).count();
        if worst >= 0.01 {
            failures.push(format!(
                "{transfer:?}, {method:?}, {} cycles: off by up to {:.2} %; {over} of {} pixels over 1 %",
                field.manifest.cycle,
                100.0 * worst,
                picture.pixels.len()
            ));
        }
    }
    assert!(failures.is_empty(), "{failures:#?}");
}
