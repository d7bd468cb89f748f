//! The error that a field states is the error that it has.

mod common;

use common::{Baked, hidden, parameters, scene};
use std::process::Command;
use vlf::scene::texels;
use vlf::{LightField, Parameters, Side, SurfaceId};

/// relMSE of one field's diffuse radiance against another's, at the middles of the other's texels where
/// light can come; epsilon as in comparisons of pictures.
fn true_error(field: &LightField, truth: &LightField) -> f64 {
    let hidden = hidden(truth);
    let areas = vlf::scene::areas::areas(&truth.scene, &truth.texels);
    let (mut light, mut area) = (0.0, 0.0);
    let mut squares: Vec<(f64, [f64; 3], [f64; 3])> = Vec::new();
    for texel in (0..truth.texels.diffuse as usize).filter(|t| !hidden[*t]) {
        let id = SurfaceId(truth.texels.surface_of[texel]);
        let (surface, lattice) = (truth.scene.surface(id), truth.texels.lattices[id.index()]);
        let inside = texel as u32 - lattice.first;
        let place = |k: u32, density: f32| (k as f32 + 0.5) / density;
        let point = surface.origin
            + surface.u * place(inside % lattice.width, lattice.density.x)
            + surface.v * place(inside / lattice.width, lattice.density.y);
        let of = |f: &LightField| {
            texels::sample(&f.texels, &f.total, id, f.scene.surface(id), Side::Front, point)
        };
        let (a, b) = (of(field).0.map(f64::from), of(truth).0.map(f64::from));
        light += f64::from(areas[texel]) * b.iter().sum::<f64>() / 3.0;
        area += f64::from(areas[texel]);
        squares.push((f64::from(areas[texel]), a, b));
    }
    let epsilon = 0.01 * (light / area).powi(2);
    let of = |(area, a, b): &(f64, [f64; 3], [f64; 3])| {
        let relative = |c: usize| (a[c] - b[c]).powi(2) / (b[c] * b[c] + epsilon) / 3.0;
        area * (0..3).map(relative).sum::<f64>()
    };
    squares.iter().map(of).sum::<f64>() / area
}

fn cornell(perturbations: Vec<u32>, target_error: f64) -> Baked {
    let parameters = Parameters { perturbations, target_error, ..parameters(513, 48, 4) };
    Baked::new(&scene("cornell"), &parameters)
}

/// Against a field of many more lines and smaller texels.
#[test]
fn the_estimate_falls_with_lines_and_is_right_within_a_factor_of_two() {
    let many = Parameters { perturbations: vec![32, 16, 8], ..parameters(513, 144, 4) };
    let truth = Baked::new(&scene("cornell"), &many).open();
    let mut before = f64::INFINITY;
    for perturbations in [vec![1], vec![4, 2], vec![16, 8]] {
        let baked = cornell(perturbations.clone(), 0.0);
        let manifest = baked.manifest();
        let (error, truly) = (manifest.error, true_error(&baked.open(), &truth));
        let times = error.relmse / truly;
        assert!((0.5..2.0).contains(&times), "{perturbations:?}: {times} times {truly}");
        assert!(error.relmse < 0.7 * before, "{perturbations:?}: {} after {before}", error.relmse);
        assert!(error.noise > 0.0 && error.noise <= error.relmse);
        let parts: f64 = error.worst.iter().map(|s| s.part).sum();
        assert!((parts - 1.0).abs() < 1e-9, "all surfaces together: {parts}");
        assert!(error.worst.is_sorted_by(|a, b| a.part >= b.part));
        before = error.relmse;
    }
}

#[test]
fn a_cycle_ends_when_its_noise_is_small_enough_and_the_field_says_so() {
    let bound = vec![64, 16];
    let (rough, fine) = (cornell(bound.clone(), 3e-2), cornell(bound.clone(), 3e-3));
    let spent = |baked: &Baked| baked.manifest().grids;
    assert!(spent(&rough)[0] < spent(&fine)[0], "{:?}, {:?}", spent(&rough), spent(&fine));
    assert!(spent(&fine)[0] < 64, "{:?}", spent(&fine));
    let error = rough.manifest().error;
    assert!(error.noise < 3e-2, "{error:?}");
    // What no number of lines reaches takes all that are granted.
    assert_eq!(spent(&cornell(vec![4, 2], 1e-9)), [4, 2, 2, 2]);

    let vlf =
        Command::new(env!("CARGO_BIN_EXE_vlf")).arg("info").arg(&rough.path).output().unwrap();
    let said = String::from_utf8(vlf.stdout).unwrap();
    let grids: Vec<String> = spent(&rough).iter().map(u32::to_string).collect();
    let aimed = format!("aims at relMSE 3.0e-2; grids spent: {}", grids.join(", "));
    for words in
        [&aimed, "at most 64, 16", "estimated relMSE", "% of it on surface", "specular trace"]
    {
        assert!(said.contains(words), "{words}: {said}");
    }
}
