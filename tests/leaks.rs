//! A house of two rooms with one floor, one ceiling and a thin wall between them; a lamp in the one.
//! No light comes into the other: neither through the wall, nor under it, where texels are larger than
//! the wall is thick. What is left are single lines that strike the very edge at which wall and floor
//! meet, where rounding decides what they see.

mod common;

use common::{Baked, parameters, scene_of};
use glam::{DMat3, DVec3, EulerRot};
use vlf::scene::texels::sample;
use vlf::{Parameters, Scene, Side, SurfaceId};

/// One line in some thousands that a texel meets, and what it brings.
const ROUNDING: f32 = 5e-4;

/// A house of 4 x 2 x 2 with its wall from `x` to `x + thickness`, turned.
fn house(x: f64, thickness: f64, turn: DMat3) -> Scene {
    let mut obj = String::new();
    let mut quad = |material: &str, corners: [[f64; 3]; 4]| {
        for corner in corners {
            let p = turn * DVec3::from(corner);
            obj += &format!("v {} {} {}\n", p.x, p.y, p.z);
        }
        obj += &format!("usemtl {material}\nf -4 -3 -2 -1\n");
    };
    let (a, b) = (-2.0, 2.0);
    quad("white", [[a, -1., 1.], [b, -1., 1.], [b, -1., -1.], [a, -1., -1.]]);
    quad("white", [[a, 1., -1.], [b, 1., -1.], [b, 1., 1.], [a, 1., 1.]]);
    quad("white", [[a, -1., -1.], [b, -1., -1.], [b, 1., -1.], [a, 1., -1.]]);
    quad("white", [[a, 1., 1.], [b, 1., 1.], [b, -1., 1.], [a, -1., 1.]]);
    quad("lamp", [[a, -1., -1.], [a, 1., -1.], [a, 1., 1.], [a, -1., 1.]]);
    quad("white", [[b, 1., -1.], [b, -1., -1.], [b, -1., 1.], [b, 1., 1.]]);
    quad("white", [[x, 1., -1.], [x, -1., -1.], [x, -1., 1.], [x, 1., 1.]]);
    let x = x + thickness;
    quad("white", [[x, -1., -1.], [x, 1., -1.], [x, 1., 1.], [x, -1., 1.]]);
    scene_of(&obj, "newmtl white\nKd 0.5 0.5 0.5\nnewmtl lamp\nKd 0.5 0.5 0.5\nKe 1 1 1\n")
}

/// Least and most radiance on floor and ceiling at either side of the wall.
fn rooms(x: f64, thickness: f64, turn: DMat3, parameters: &Parameters) -> [(f32, f32); 2] {
    let scene = house(x, thickness, turn);
    let field = Baked::new(&scene, parameters).open();
    let mut found = [(f32::MAX, 0.0f32); 2];
    for (at, y) in [(0, -1.0), (1, 1.0)] {
        let id = SurfaceId(at);
        for k in 0..4000 {
            let part = |step: f64| (f64::from(k) * step).fract() * 2.0 - 1.0;
            let (along, z) = (2.0 * part(0.618_033_988_75), part(0.754_877_666_25));
            let room = usize::from(along > x);
            if along > x - 1e-4 && along < x + thickness + 1e-4 {
                continue;
            }
            let point = scene.fit.to_unit(turn * DVec3::new(along, y, z));
            let surface = scene.surface(id);
            let seen = sample(&field.texels, &field.total, id, surface, Side::Front, point);
            let (least, most) = &mut found[room];
            (*least, *most) = (least.min(seen.max()), most.max(seen.max()));
        }
    }
    found
}

#[test]
fn a_dark_room_stays_dark_wherever_its_wall_stands() {
    let parameters = Parameters { perturbations: vec![2], ..parameters(513, 32, 4) };
    // Turned by nothing, by an angle that keeps texels along the wall, and by anything.
    for turn in [(0.0, 0.0, 0.0), (0.3, 0.0, 0.0), (0.5, -0.7, 1.1)] {
        let turn = DMat3::from_euler(EulerRot::XYZ, turn.0, turn.1, turn.2);
        // On a border between texels, and in the middle of one.
        for (x, thickness) in [(0.0, 0.03), (0.07, 0.004)] {
            let [lit, dark] = rooms(x, thickness, turn, &parameters);
            let what = format!("wall at {x}, {thickness} thick, {turn:?}");
            assert!(lit.0 > 0.05, "{what}: a light room with {lit:?}");
            assert!(dark.1 < ROUNDING * lit.1, "{what}: a dark room with {dark:?}");
        }
    }
}
