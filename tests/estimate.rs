//! The error that a field states is the error that it has.

mod common;

use common::{Baked, hidden, parameters, scene};
use std::path::Path;
use vlf::bake::quality::Quality;
use vlf::field::read_manifest;
use vlf::field::storage::disk::Disk;
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

#[test]
#[ignore = "scratch"]
fn scratch() {
    let var = |n: &str| std::env::var(n).unwrap();
    let truth = LightField::open(Path::new(&var("TRUTH"))).unwrap();
    for path in var("FIELDS").split(',') {
        let e = read_manifest(&Disk::new(Path::new(path))).unwrap().1.error;
        let t = true_error(&LightField::open(Path::new(path)).unwrap(), &truth);
        println!(
            "{path}: true {t:.2e} estimate {:.2e} (noise {:.2e}) ratio {:.2}",
            e.relmse,
            e.noise,
            e.relmse / t
        );
    }
}
