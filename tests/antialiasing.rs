//! Pictures of many samples take many only where they can differ, and are still what all samples give: the same
//! function of directions and hits is once taken by the methods, which say where it is plain, and once as one of
//! which nothing is known.

mod common;

use common::{Baked, camera, parameters, scene};
use vlf::Visible;
use vlf::look::compare::compare;
use vlf::look::render::method::{Method, look_along};
use vlf::look::render::{Options, render};

#[test]
fn few_samples_in_plain_pixels_are_as_good_as_all() {
    for name in ["office", "cornell_mirror", "gallery"] {
        let baked = Baked::new(&scene(name), &parameters(129, 64, 3));
        let (field, camera) = (baked.open(), camera(name, 240, 180));
        let visible = Visible::new(&field.scene);
        for method in [Method::Trace, Method::Field] {
            let options = Options::default();
            let few = vlf::take(&field, &visible, &camera, (method, options), &|_| ()).unwrap();
            let looked = |dir, hit: &_| look_along(&field, &visible, method, dir, hit).unwrap();
            let all = render(&field.scene, &visible, &camera, options, &looked, &|_| ());
            let apart = compare(&few, &all).unwrap();
            // Of 16 samples themselves it is ten times as much against 256 of them.
            assert!(apart.relmse < 4e-6, "{name}, {method:?}: {}", apart.relmse);
            assert!(few != all, "{name}, {method:?}: no pixel is plain");
        }
    }
}
