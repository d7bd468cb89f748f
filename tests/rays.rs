//! A ray serves both ways: whoever P sees along it sees P along it, `X(r, P) = Q` exactly when
//! `X(r, Q) = P` (section 4.1). So it must not matter from which end a ray is looked at: the PSF of
//! the opposite direction, its grid mirrored so that the rays are the same, must pair the same sides
//! of the same surfaces, contacts of boxes with floors and walls with walls included. If it does not,
//! one of the two gets light that the other never sent.

mod common;

use common::{SCENES, parameters, scene};
use std::collections::BTreeMap;
use vlf::bake::exchange::{order_contacts, see_each_other};
use vlf::bake::layers::{Layers, Outlines};
use vlf::bake::perturb;
use vlf::{DirectionId, Directions, Psf, Scene};

/// A side of a surface: its number and whether it is the front. Before the first and behind the
/// last surface is the space outside, one at each end.
type Side = (u32, bool);
const BEFORE: Side = (u32::MAX, false);
const BEHIND: Side = (u32::MAX, true);

/// For each ray, what every side on it sees, seen from the end that the PSF begins at.
fn exchange(scene: &Scene, psf: &Psf) -> Vec<BTreeMap<Side, Side>> {
    let texels = vlf::bake::texels(scene, &parameters(9, psf.resolution, 1));
    let mut layers = Layers::default();
    let outlines = Outlines::new(scene, &texels);
    layers.rasterise(&outlines, psf);
    let n = psf.resolution;
    let mut rays = Vec::new();
    for cell in 0..n * n {
        let fragments = layers.cell(cell % n, cell / n);
        order_contacts(fragments, &outlines.contacts, &texels.surface_of);
        let mut sees = BTreeMap::new();
        let mut pair = |a: Side, b: Side| {
            sees.insert(a, b);
            sees.insert(b, a);
        };
        let surface = |k: usize| texels.surface_of[fragments[k].texel() as usize];
        let along = |k: usize| (surface(k), fragments[k].faces_along());
        let against = |k: usize| (surface(k), !fragments[k].faces_along());
        if !fragments.is_empty() {
            pair(BEFORE, against(0));
            pair(along(fragments.len() - 1), BEHIND);
        }
        for k in 1..fragments.len() {
            if see_each_other(fragments[k - 1], fragments[k]) {
                pair(along(k - 1), against(k));
            }
        }
        rays.push(sees);
    }
    rays
}

/// The PSF of the opposite direction over the same rays, columns in reverse.
fn reversed(psf: &Psf) -> Psf {
    let shift = glam::Vec2::new(-psf.shift.x, psf.shift.y);
    Psf { right: -psf.right, direction: -psf.direction, shift, ..*psf }
}

#[test]
fn whoever_sees_is_seen_from_either_end_of_every_ray() {
    let directions = Directions::with_lines(129).unwrap();
    let n = 64;
    for name in SCENES {
        let scene = scene(name);
        let (mut pairs, mut edges, mut wrong) = (0, 0, Vec::new());
        for k in 0..12u32 {
            // Grids turned and moved a little: no ray runs along an edge on purpose.
            let psf = perturb::psf(&directions, DirectionId(k * 11 % 129), k + 1, n);
            let there = exchange(&scene, &psf);
            let back = exchange(&scene, &reversed(&psf));
            for (at, sees) in there.iter().enumerate() {
                let (i, j) = (at % n as usize, at / n as usize);
                let seen = &back[j * n as usize + n as usize - 1 - i];
                let swapped: BTreeMap<Side, Side> = seen
                    .iter()
                    .map(|(a, b)| [*a, *b])
                    .map(|sides| {
                        sides.map(|s| match s {
                            BEFORE => BEHIND,
                            BEHIND => BEFORE,
                            s => s,
                        })
                    })
                    .map(|[a, b]| (a, b))
                    .collect();
                let met = |m: &BTreeMap<Side, Side>| -> Vec<u32> {
                    m.keys()
                        .map(|s| s.0)
                        .collect::<std::collections::BTreeSet<_>>()
                        .into_iter()
                        .collect()
                };
                for (a, b) in sees {
                    assert_eq!(sees[b], *a, "{name}: {a:?} sees {b:?}, which looks elsewhere");
                }
                pairs += sees.len() / 2;
                // A ray on the very edge of a surface may meet it from one end and not the other.
                if met(sees) != met(&swapped) {
                    edges += 1;
                } else if *sees != swapped {
                    wrong.push((k, i, j, sees.clone(), swapped));
                }
            }
        }
        assert!(pairs > 1000, "{name}: only {pairs} pairs");
        assert!(
            wrong.is_empty(),
            "{name}: {} rays of {pairs} pairs differ: {:?}",
            wrong.len(),
            wrong[0]
        );
        assert!(edges * 10_000 <= pairs, "{name}: {edges} rays on edges, of {pairs} pairs");
    }
}

/// A box on the floor has a bottom that touches the floor, and below the floor is nothing. From above
/// a ray comes out of the solid box into the contact, from below it comes from nowhere: the order of
/// contacts used to be guessed from what lay before them only, so that the floor under the box saw
/// the floor's underside from one end and the inside of the box from the other.
#[test]
fn a_closed_box_touches_a_bare_floor_from_either_end() {
    let scene = common::scene_of(common::BOX_ON_A_FLOOR, common::WHITE_AND_LAMP);
    let directions = Directions::with_lines(129).unwrap();
    let bottom = |sees: &BTreeMap<Side, Side>| {
        let down = |s: &Side| s.0 < u32::MAX && s.1 && scene.surfaces[s.0 as usize].normal.y < -0.9;
        sees.keys().filter(|s| down(s)).count()
    };
    for k in 0..129 {
        let psf = perturb::psf(&directions, DirectionId(k), 3, 32);
        for sees in exchange(&scene, &psf).iter().chain(&exchange(&scene, &reversed(&psf))) {
            assert_eq!(bottom(sees), 0, "the box's bottom looks at something: {sees:?}");
        }
    }
}
