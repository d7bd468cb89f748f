//! Light does not care how a scene is written down: in which units, which way round, in how many polygons, or
//! which of two patches is called the lamp.

mod common;

use common::{Baked, Dice, hidden, moved, parameters, scene_of, text};
use glam::{DQuat, DVec3};
use std::collections::BTreeMap;
use std::f64::consts::TAU;
use vlf::{Parameters, Scene, SurfaceId};

/// What the bounds below are stated for.
fn small() -> Parameters {
    Parameters { perturbations: vec![8, 2, 1], ..parameters(513, 64, 3) }
}

/// Radiant exitance over pi, per material, fronts only, where light can come. A material and its `_twin` count as one.
fn light(scene: &Scene) -> BTreeMap<String, f64> {
    let field = Baked::new(scene, &small()).open();
    let areas = vlf::scene::areas::areas(&field.scene, &field.texels);
    let mut sums: BTreeMap<String, (f64, f64)> = BTreeMap::new();
    let hidden = hidden(&field);
    let seen = field.texels.surface_of.iter().enumerate().filter(|(texel, _)| !hidden[*texel]);
    for (texel, surface) in seen {
        let name = &field.scene.material_of(SurfaceId(*surface)).name;
        let name = name.trim_end_matches("_twin").to_owned();
        let (sum, area) = sums.entry(name).or_default();
        let a = f64::from(areas[texel]);
        *sum += a * f64::from(field.total[2 * texel].mean());
        *area += a;
    }
    sums.into_iter().map(|(name, (sum, area))| (name, sum / area)).collect()
}

/// Holds the mean radiance of each material against that of the scene as it stands.
fn same_light(what: &str, other: &Scene, bound: f64) {
    let (obj, mtl) = text("cornell");
    let (as_written, found) = (light(&scene_of(&obj, &mtl)), light(other));
    assert!(as_written.len() >= 4 && as_written.keys().eq(found.keys()), "{found:?}");
    let mut worst = 0.0f64;
    for (name, a) in &as_written {
        let off = found[name] / a - 1.0;
        println!("{what}: {name} {a:.5}, {:+.3} %", 100.0 * off);
        worst = worst.max(off.abs());
    }
    assert!(worst < bound, "{what}: a material is {:.2} % off", 100.0 * worst);
}

#[test]
fn halving_a_scene_changes_no_bit_of_its_light() {
    let (obj, mtl) = text("cornell");
    let half = scene_of(&moved(&obj, |v| 0.5 * v), &mtl);
    assert_eq!(light(&scene_of(&obj, &mtl)), light(&half));
}

#[test]
fn turning_a_scene_keeps_its_light_within_a_percent() {
    let mut dice = Dice(11);
    let mut roll = || 2.0 * dice.unit() - 1.0;
    let axis = DVec3::new(roll(), roll(), roll()).normalize();
    let turn = DQuat::from_axis_angle(axis, TAU * roll());
    let (obj, mtl) = text("cornell");
    same_light("turned", &scene_of(&moved(&obj, |v| turn * v), &mtl), 0.01);
}

/// Faces of four corners as two of three; the second of each pair in the material that `second` makes of its
/// own.
fn split(obj: &str, second: impl Fn(&str) -> String) -> String {
    let mut material = "";
    let mut out = String::new();
    for line in obj.lines() {
        material = line.strip_prefix("usemtl ").unwrap_or(material);
        let corners: Vec<&str> = line.split_whitespace().skip(1).collect();
        match (line.starts_with("f "), &corners[..]) {
            (true, [a, b, c, d]) => {
                let other = second(material);
                out +=
                    &format!("f {a} {b} {c}\nusemtl {other}\nf {a} {c} {d}\nusemtl {material}\n");
            }
            _ => out += &format!("{line}\n"),
        }
    }
    out
}

#[test]
fn triangles_that_merge_again_are_lit_as_their_quads() {
    let (obj, mtl) = text("cornell");
    let scene = scene_of(&split(&obj, str::to_owned), &mtl);
    assert_eq!(scene.surfaces.len(), scene_of(&obj, &mtl).surfaces.len());
    same_light("split and merged", &scene, 1e-3);
}

#[test]
fn triangles_that_stay_apart_are_lit_as_their_quads() {
    let (obj, mtl) = text("cornell");
    let twins: String = mtl
        .lines()
        .map(|l| if l.starts_with("newmtl ") { format!("{l}_twin\n") } else { format!("{l}\n") })
        .collect();
    let scene = scene_of(&split(&obj, |m| format!("{m}_twin")), &format!("{mtl}\n{twins}"));
    assert!(scene.surfaces.len() > scene_of(&obj, &mtl).surfaces.len());
    same_light("split", &scene, 0.01);
}

/// Two patches of areas A and B that see each other aslant. What B sends back of A's light, times B, is what A
/// sends back of B's, times A.
#[test]
fn a_lamp_and_a_receiver_may_change_places() {
    const PATCHES: &str = "\
v 0 0 0\nv 0 0 0.3\nv 0.3 0 0.3\nv 0.3 0 0\nusemtl a\nf 1 2 3 4
v 0.5 0.7 0.1\nv 0.7 0.55 0.1\nv 0.7 0.55 0.35\nv 0.5 0.7 0.35\nusemtl b\nf 5 6 7 8
";
    let (area_a, area_b) = (0.3 * 0.3, 0.25 * 0.25);
    let mtl = |lamp: &str, receiver: &str| {
        format!(
            "newmtl {lamp}\nKd 0 0 0\nKe 1 1 1\nillum 1\nnewmtl {receiver}\nKd 0.5 0.5 0.5\nillum 1\n"
        )
    };
    let parameters = Parameters { perturbations: vec![4], ..parameters(2049, 128, 1) };
    let back = |lamp, receiver| {
        let scene = scene_of(PATCHES, &mtl(lamp, receiver));
        let field = Baked::new(&scene, &parameters).open();
        common::mean_radiance(&field, receiver)
    };
    let (to_b, to_a) = (area_b * back("a", "b"), area_a * back("b", "a"));
    println!("to b {to_b:.6e}, to a {to_a:.6e}, {:+.3} %", 100.0 * (to_b / to_a - 1.0));
    assert!(to_a > 0.0);
    assert!((to_b / to_a - 1.0).abs() < 0.01, "{to_b} to b, {to_a} to a");
}

/// Late light is smooth and little: a quarter of the lines shows it as well.
#[test]
fn late_cycles_on_a_coarser_lattice_bring_the_same_light() {
    let (obj, mtl) = text("cornell");
    let scene = scene_of(&obj, &mtl);
    let total = |thinned| {
        let parameters =
            Parameters { perturbations: vec![2, 2, 1], thinned, ..parameters(513, 64, 6) };
        Baked::new(&scene, &parameters).open()
    };
    let (all, quarter) = (total(0), total(1));
    assert_ne!(all.total, quarter.total, "the lattice is not coarser");
    let hidden = hidden(&all);
    let (mut sum, mut off) = (0.0, 0.0);
    for texel in (0..hidden.len()).filter(|t| !hidden[*t]) {
        let (a, b) = (all.total[2 * texel].mean(), quarter.total[2 * texel].mean());
        sum += f64::from(a);
        off += f64::from((a - b).abs());
    }
    println!("mean {}, mean difference {:.3} %", sum / hidden.len() as f64, 100.0 * off / sum);
    assert!(off < 0.01 * sum, "{:.2} % off", 100.0 * off / sum);
}
