//! Mirrors obey the law of reflection: what is seen in one is the scene behind the glass, what it
//! lights it lights from the mirrored lamp, and a chain of mirrors weakens light by the product of
//! their reflectances and by nothing else.

mod common;

use common::{Baked, both_ways, camera, mean_radiance, obj, parameters, picture, scene, scene_of};
use glam::DVec3;
use vlf::Visible;
use vlf::look::render::method::Method;
use vlf::look::render::raytrace::Raytrace;
use vlf::paths::{MAX_DEPTH, Paths};
use vlf::{Camera, Parameters, Rgb, Scene};

/// A room without its wall at z = -1, a tilted box in it and a lamp at the ceiling, as faces of quads.
/// `mirrored` is its reflection in the plane z = -1.
fn room(mirrored: bool) -> String {
    let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
    let corner = DVec3::NEG_ONE;
    let mut quads = vec![
        ("floor", corner, 2.0 * z, 2.0 * x),
        ("white", corner + 2.0 * y, 2.0 * x, 2.0 * z),
        ("red", corner, 2.0 * y, 2.0 * z),
        ("green", corner + 2.0 * x, 2.0 * z, 2.0 * y),
        ("white", corner + 2.0 * z, 2.0 * y, 2.0 * x),
        ("lamp", DVec3::new(-0.4, 0.98, -0.3), 0.8 * x, 0.8 * z),
    ];
    let (a, c) = (DVec3::new(0.45, 0.0, 0.2), DVec3::new(-0.2, 0.0, 0.45));
    let (foot, b) = (DVec3::new(-0.5, -0.95, -0.35), 0.7 * y);
    let sides = [
        (foot, b, a),
        (foot, c, b),
        (foot, a, c),
        (foot + a, b, c),
        (foot + c, a, b),
        (foot + b, c, a),
    ];
    // Outside is away from the box's middle.
    let middle = foot + 0.5 * (a + b + c);
    quads.extend(sides.map(|(o, p, q)| {
        let outward = p.cross(q).dot(o + 0.5 * (p + q) - middle) > 0.0;
        if outward { ("blue", o, p, q) } else { ("blue", o, q, p) }
    }));
    let mut text = String::new();
    for (material, o, p, q) in quads {
        let mut loop_ = [o, o + p, o + p + q, o + q];
        if mirrored {
            loop_ = loop_.map(|v| DVec3::new(v.x, v.y, -2.0 - v.z));
            loop_.reverse();
        }
        for v in loop_ {
            text += &format!("v {} {} {}\n", v.x, v.y, v.z);
        }
        text += &format!("usemtl {material}\nf -4 -3 -2 -1\n");
    }
    text
}

const MIRROR: &str = "v -1 -1 -1\nv 1 -1 -1\nv 1 1 -1\nv -1 1 -1\nusemtl mirror\nf -4 -3 -2 -1\n";

fn materials(ks: f64) -> String {
    let diffuse = [
        ("floor", "0.6 0.5 0.4"),
        ("white", "0.7 0.7 0.7"),
        ("red", "0.6 0.1 0.1"),
        ("green", "0.1 0.5 0.1"),
        ("blue", "0.2 0.3 0.7"),
    ];
    let mut text: String =
        diffuse.map(|(n, kd)| format!("newmtl {n}\nKd {kd}\nillum 1\n")).concat();
    text += "newmtl lamp\nKd 0 0 0\nKe 10 9 8\nillum 1\n";
    text + &format!("newmtl mirror\nKd 0 0 0\nKs {ks} {ks} {ks}\nillum 3\n")
}

fn eye() -> Camera {
    Camera {
        eye: DVec3::new(0.55, 0.35, 0.8),
        target: DVec3::new(-0.15, -0.2, -1.0),
        up: DVec3::Y,
        vfov_deg: 60.0,
        width: 120,
        height: 90,
    }
}

fn mirrored(camera: &Camera) -> Camera {
    let flip = |v: DVec3| DVec3::new(v.x, v.y, -2.0 - v.z);
    Camera { eye: flip(camera.eye), target: flip(camera.target), ..*camera }
}

/// The scene with one surface fewer, its last.
fn without_the_mirror(scene: &Scene) -> Scene {
    let mut scene = scene.clone();
    let last = vlf::SurfaceId(scene.surfaces.len() as u32 - 1);
    assert!(scene.material_of(last).reflectance.is_mirror());
    scene.surfaces.pop();
    scene
}

#[test]
fn a_mirror_shows_what_the_mirrored_eye_sees_through_its_frame() {
    let ks = 0.8;
    let room = scene_of(&(room(false) + MIRROR), &materials(ks));
    let baked = Baked::new(&room, &parameters(129, 64, 3));
    let field = baked.open();
    let camera = eye();
    let picture = picture(&field, &camera, Method::Trace, 1);

    let behind = without_the_mirror(&field.scene);
    let visible = Visible::new(&behind);
    let trace = Raytrace {
        paths: Paths { scene: &behind, visible: &visible, max_depth: MAX_DEPTH },
        texels: &field.texels,
        values: &field.total,
    };
    let options = vlf::look::render::Options { samples: 1, ..Default::default() };
    let other = vlf::look::render::render(
        &behind,
        &visible,
        &mirrored(&camera),
        options,
        &|direction, hit| trace.radiance(direction, hit),
        &|_| {},
    );

    let all = Visible::new(&field.scene);
    let mirror = field.scene.surfaces.len() as u32 - 1;
    let (mut shown, mut seen, mut close, mut pixels) = (0.0, 0.0, 0, 0);
    for y in 0..90 {
        for x in 0..120 {
            let (origin, direction) =
                camera.view(&field.scene.fit).ray(x as f64 + 0.5, y as f64 + 0.5);
            if all.nearest(origin, direction, 0.0).unwrap().surface.0 != mirror {
                continue;
            }
            let a = picture.pixels[y * 120 + x].mean();
            // The mirrored eye's picture is the other way round.
            let b = ks as f32 * other.pixels[y * 120 + 119 - x].mean();
            pixels += 1;
            close += u32::from((a - b).abs() <= 0.05 * b);
            (shown, seen) = (shown + f64::from(a), seen + f64::from(b));
        }
    }
    assert!(pixels > 4000, "the mirror fills only {pixels} pixels");
    assert!((shown / seen - 1.0).abs() < 0.02, "mean {:+.2} %", 100.0 * (shown / seen - 1.0));
    assert!(f64::from(close) > 0.99 * f64::from(pixels), "{close} of {pixels} pixels within 5 %");
}

/// Light, too: a room with a perfect mirror for a wall is lit as the same room with its reflection
/// in the wall's place.
#[test]
fn a_perfect_mirror_lights_as_the_room_behind_it_would() {
    let glass = scene_of(&(room(false) + MIRROR), &materials(1.0));
    let doubled = scene_of(&(room(false) + &room(true)), &materials(1.0));
    // The same cells in the scene's units, as the doubled scene is larger.
    let n = (64.0 * doubled.fit.radius / 3f64.sqrt() / 16.0).round() as u32 * 16;
    let open = Baked::new(&doubled, &parameters(513, n, 9));
    let open = open.open();
    // By stored maps light takes a cycle more by way of the mirror: only after many do the two come
    // together.
    for (way, parameters) in both_ways(&parameters(513, 64, 9)) {
        let glass = Baked::new(&glass, &parameters).open();
        for material in ["floor", "white", "red", "green", "blue"] {
            let (a, b) = (mean_radiance(&glass, material), mean_radiance(&open, material));
            let off = (a / b - 1.0).abs();
            assert!(off < 0.02, "{way}, {material}: {a:.4} by the mirror, {b:.4} doubled");
        }
    }
}

/// A tube of four mirrors between a lamp and a receiver: the receiver sees the lamp and, by every number
/// of reflections, its images, each weaker by `Ks` a reflection. Their form factors are known.
#[test]
fn light_through_a_tube_of_mirrors_falls_by_their_reflectance() {
    // 1 x 1 x 2; the receiver at y = 0 looks up, the lamp at y = 2 down, the walls inward.
    let tube = "\
v 0 0 0\nv 1 0 0\nv 1 0 1\nv 0 0 1\nv 0 2 0\nv 1 2 0\nv 1 2 1\nv 0 2 1
usemtl receiver\nf 4 3 2 1
usemtl lamp\nf 5 6 7 8
usemtl mirror\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8
";
    for ks in [0.6, 1.0] {
        let mtl = format!(
            "newmtl receiver\nKd 0.5 0.5 0.5\nillum 1\nnewmtl lamp\nKd 0 0 0\nKe 1 1 1\nillum 1\n\
             newmtl mirror\nKd 0 0 0\nKs {ks} {ks} {ks}\nillum 3\n"
        );
        let scene = scene_of(tube, &mtl);
        // By reciprocity the lamp's images are as many squares at height 2, displaced by (i, j).
        let images = if ks == 1.0 { 1.0 } else { tube_factor(ks) };
        for (way, parameters) in both_ways(&parameters(513, 64, 1)) {
            let parameters = Parameters { cycles: None, ..parameters };
            let field = Baked::new(&scene, &parameters).open();
            // What the receiver reflects comes back by the black lamp's plane not at all.
            let found = mean_radiance(&field, "receiver") / 0.5;
            let off = 100.0 * (found / images - 1.0);
            assert!(
                off.abs() < 1.0,
                "{way}, Ks {ks}: {found:.5} of the lamp arrives, not {images:.5}: {off:+.2} %"
            );
        }
    }
}

/// Mean over the receiver of the sum over images of `ks^(|i| + |j|)` times the point's form factor to
/// the square at (i, j), by the midpoint rule.
fn tube_factor(ks: f64) -> f64 {
    let (height, steps, most) = (2.0f64, 24, 24i32);
    // Form factor from a point below a corner to a rectangle a x b (odd in each).
    let corner = |a: f64, b: f64| {
        let (a, b) = (a / height, b / height);
        let (p, q) = ((1.0 + a * a).sqrt(), (1.0 + b * b).sqrt());
        (a / p * (b / p).atan() + b / q * (a / q).atan()) / (2.0 * std::f64::consts::PI)
    };
    let mut sum = 0.0;
    for k in 0..steps * steps {
        let x = (f64::from(k % steps) + 0.5) / f64::from(steps);
        let z = (f64::from(k / steps) + 0.5) / f64::from(steps);
        for i in -most..=most {
            for j in -most..=most {
                let (x0, z0) = (f64::from(i) - x, f64::from(j) - z);
                let factor =
                    corner(x0 + 1.0, z0 + 1.0) - corner(x0, z0 + 1.0) - corner(x0 + 1.0, z0)
                        + corner(x0, z0);
                sum += ks.powi(i.abs() + j.abs()) * factor;
            }
        }
    }
    sum / f64::from(steps * steps)
}

/// The lamp stands to the right (x > 0) of the ring. The inside of the ring's far half throws its light
/// back into the ring, in a cusp; the same ring in grey lights the plane a little and evenly. Outside, in
/// the ring's shadow, the mirror puts nothing.
#[test]
fn a_mirror_ring_gathers_light_in_a_cusp_and_a_grey_one_does_not() {
    let text = std::fs::read_to_string(obj("ring_caustic")).unwrap().replace("mtllib", "# ");
    let mtl = std::fs::read_to_string(obj("ring_caustic").with_extension("mtl")).unwrap();
    let grey = mtl
        .replace("Kd 0 0 0\nKs 0.9 0.72 0.4", "Kd 0.7 0.7 0.7\nKs 0 0 0")
        .replace("illum 3", "illum 1")
        .replace("Ns 100000\n", "");
    assert_ne!(mtl, grey);
    let light = |mtl: &str, parameters: &Parameters| {
        let field = Baked::new(&scene_of(&text, mtl), parameters).open();
        let (id, lattice) = (vlf::SurfaceId(0), field.texels.lattices[0]);
        let plane = field.scene.surface(id);
        assert_eq!(field.scene.material_of(id).name, "plane");
        // Mean over the left and the right half of the ring's inside.
        let mut halves = [(0.0, 0); 2];
        for texel in 0..lattice.width * lattice.height {
            let at = glam::Vec2::new(
                (texel % lattice.width) as f32 + 0.5,
                (texel / lattice.width) as f32 + 0.5,
            );
            let at = at / lattice.density;
            let p = field.scene.fit.to_own(plane.origin + plane.u * at.x + plane.v * at.y);
            if p.x.hypot(p.z) < 0.9 {
                let half = &mut halves[usize::from(p.x > 0.0)];
                let value: Rgb = field.total[2 * (lattice.first + texel) as usize];
                *half = (half.0 + f64::from(value.mean()), half.1 + 1);
            }
        }
        halves.map(|(sum, count)| sum / f64::from(count))
    };
    for (way, parameters) in both_ways(&parameters(513, 64, 2)) {
        let (mirror, grey) = (light(&mtl, &parameters), light(&grey, &parameters));
        println!("{way}, left, right: mirror {mirror:?}, grey {grey:?}");
        // Left is the far half.
        let gained = [mirror[0] - grey[0], mirror[1] - grey[1]];
        assert!(gained[0] > 0.1 * grey[0], "{way}: mirror {mirror:?}, grey {grey:?}");
        assert!(gained[0] > 2.0 * gained[1].max(0.0), "{way}: mirror {mirror:?}, grey {grey:?}");
    }
}

/// Two ways to look into two mirrors that face each other: following the ray, and what has arrived.
#[test]
fn a_corridor_of_mirrors_is_as_bright_by_either_method() {
    let (scene, camera) = (scene("mirror_corridor"), camera("mirror_corridor", 80, 80));
    for (way, parameters) in both_ways(&parameters(129, 64, 6)) {
        let baked = Baked::new(&scene, &parameters);
        let field = baked.open();
        let mean = |method| {
            let picture = picture(&field, &camera, method, 4);
            picture.pixels.iter().map(|v| f64::from(v.mean())).sum::<f64>() / 6400.0
        };
        let (a, b) = (mean(Method::Trace), mean(Method::Field));
        assert!((a / b - 1.0).abs() < 0.1, "{way}: trace {a:.4}, field {b:.4}");
    }
}
