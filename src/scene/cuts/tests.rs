use super::*;
use crate::ids::Side;
use crate::radiance::Rgb;
use crate::scene::texels::{Texels, sample};
use glam::{DMat3, DVec3};
use proptest::prelude::*;
use std::path::Path;

/// A scene of polygons, each a list of corners, turned by a rotation.
fn scene_of(polygons: &[Vec<DVec3>], turn: DMat3) -> Scene {
    let mut obj = "mtllib m\nusemtl lamp\n".to_owned();
    for polygon in polygons {
        for corner in polygon {
            let p = turn * *corner;
            obj += &format!("v {} {} {}\n", p.x, p.y, p.z);
        }
        obj += "f";
        (1..=polygon.len()).rev().for_each(|k| obj += &format!(" -{k}"));
        obj += "\n";
    }
    let mtl = "newmtl lamp\nKd 0.5 0.5 0.5\nKe 1 1 1\n";
    Scene::from_text(Path::new("cut.obj"), &obj, &mut |_| Ok(mtl.into())).unwrap().0
}

fn corners<const N: usize>(points: [(f64, f64, f64); N]) -> Vec<DVec3> {
    points.map(DVec3::from).to_vec()
}

/// A floor of 8 x 8 texels.
fn floor() -> Vec<DVec3> {
    corners([(-4.0, 0.0, 4.0), (4.0, 0.0, 4.0), (4.0, 0.0, -4.0), (-4.0, 0.0, -4.0)])
}

/// An upright wall on the floor from one point to another.
fn wall(from: (f64, f64), to: (f64, f64)) -> Vec<DVec3> {
    corners([(from.0, 0.0, from.1), (from.0, 2.0, from.1), (to.0, 2.0, to.1), (to.0, 0.0, to.1)])
}

fn texels_of(scene: &Scene) -> Texels {
    let texels = Texels::new(scene, (1.0 / scene.fit.radius) as f32);
    assert_eq!((texels.lattices[0].width, texels.lattices[0].height), (8, 8));
    texels
}

/// A floor with a wall across it, and one that hangs above.
#[test]
fn a_wall_cuts_the_texels_it_stands_on_and_a_hanging_one_none() {
    let hanging =
        corners([(-2.5, 1.0, 4.0), (-2.5, 2.0, 4.0), (-2.5, 2.0, -4.0), (-2.5, 1.0, -4.0)]);
    let scene = scene_of(&[floor(), wall((0.5, 2.7), (0.5, -4.0)), hanging], DMat3::IDENTITY);
    let texels = texels_of(&scene);
    let texel = |x: f64, z: f64| {
        let point = scene.fit.to_unit(DVec3::new(x, 0.0, z));
        let texel = texels.at(SurfaceId(0), &scene.surfaces[0], point);
        assert_eq!(texels.cuts.is_met(texel), texels.cuts.is_cut(texel));
        texels.cuts.is_cut(texel)
    };
    for z in [-3.5, -2.5, -1.5, -0.5, 0.5, 1.5, 2.5] {
        for x in [-3.5, -2.5, -1.5, -0.5, 1.5, 2.5, 3.5] {
            assert!(!texel(x, z), "({x}, {z}) is cut");
        }
        assert!(texel(0.5, z), "(0.5, {z}) is not cut");
    }
    assert!(!texel(0.5, 3.5), "beyond the wall's end");
}

/// What stands around a surface meets it and does not divide it, whatever the surface's outline.
#[test]
fn walls_around_a_surface_do_not_divide_it() {
    let triangle = corners([(-4.0, 0.0, 4.0), (4.0, 0.0, 4.0), (4.0, 0.0, -4.0)]);
    let around = [
        wall((-4.0, 4.0), (4.0, 4.0)),
        wall((4.0, 4.0), (4.0, -4.0)),
        wall((4.0, -4.0), (-4.0, 4.0)),
    ];
    let [a, b, c] = around;
    let scene = scene_of(&[triangle, a, b, c], DMat3::IDENTITY);
    let texels = Texels::new(&scene, (1.0 / scene.fit.radius) as f32);
    let of_triangle =
        || (0..texels.lattices[1].first).filter(|t| texels.surface_of[*t as usize] == 0);
    assert!(of_triangle().any(|t| texels.cuts.is_met(t)));
    assert!(!of_triangle().any(|t| texels.cuts.is_cut(t)));
}

proptest! {
    /// Two rooms on one floor, light and dark, with a wall between them, or two thinner apart than a
    /// texel: a lookup finds nothing but its own room's light, however the wall and the scene are turned.
    #[test]
    fn no_light_shows_behind_a_wall(
        offset in prop_oneof![Just(0.0), Just(0.5), Just(1.0), -3.0..3.0f64],
        slope in prop_oneof![Just(0.0), -0.9..0.9f64],
        thickness in prop_oneof![Just(0.0), 0.001..0.9f64],
        turn in (-3.0..3.0f64, -3.0..3.0f64, -3.0..3.0f64),
        places in prop::collection::vec((-3.99..3.99f64, -3.99..3.99f64), 200),
    ) {
        let turn = DMat3::from_euler(glam::EulerRot::XYZ, turn.0, turn.1, turn.2);
        let x_at = |z: f64| offset + slope * z;
        let stands = |shift: f64| wall((x_at(5.0) + shift, 5.0), (x_at(-5.0) + shift, -5.0));
        let scene = scene_of(&[floor(), stands(0.0), stands(thickness)], turn);
        let texels = texels_of(&scene);
        let (surface, lattice) = (&scene.surfaces[0], texels.lattices[0]);
        let line = |x: f64, z: f64| x - x_at(z);
        let mut values = vec![Rgb::BLACK; 2 * texels.len()];
        let own = |p: DVec3| surface.coordinates(scene.fit.to_unit(turn * p)) * lattice.density;
        let (o, i, k) = (own(DVec3::ZERO), own(DVec3::X), own(DVec3::Z));
        for texel in 0..64u32 {
            let site = texels.cuts.site(&lattice, texel) - o;
            let (x, z) = (site.dot(i - o), site.dot(k - o));
            let light = if line(f64::from(x), f64::from(z)) > 0.5 * thickness { 1.0 } else { 0.0 };
            values[2 * texel as usize] = Rgb::splat(light);
        }
        for (x, z) in places {
            let away = line(x, z);
            let between = away > -1e-3 && away < thickness + 1e-3;
            // Beyond the last texel middle on its side there may be nothing to look at.
            let edge = (own(DVec3::new(x, 0.0, z)) - 4.0).abs().max_element() > 3.0;
            if between || edge {
                continue;
            }
            let point = scene.fit.to_unit(turn * DVec3::new(x, 0.0, z));
            let seen = sample(&texels, &values, SurfaceId(0), surface, Side::Front, point);
            let expected = if away > 0.0 { 1.0 } else { 0.0 };
            prop_assert!((seen.0[0] - expected).abs() < 1e-6, "{seen:?} at {x}, {z}: {away}");
        }
    }
}
