//! The error that a field states is the error that it has.

mod common;

use common::{Baked, camera, parameters, picture, scene};
use std::process::Command;
use vlf::format::manifest::CycleLedger;
use vlf::look::compare::compare;
use vlf::{Method, Parameters, Picture};

/// A picture of the room, edges of surfaces the same in all.
fn view(baked: &Baked) -> Picture {
    picture(&baked.open(), &camera("cornell", 128, 128), Method::Trace, 4)
}

fn cornell(perturbations: Vec<u32>, target_error: f64) -> Baked {
    let parameters = Parameters { perturbations, target_error, ..parameters(513, 48, 4) };
    Baked::new(&scene("cornell"), &parameters)
}

/// Against pictures of a field of many more lines and smaller texels.
#[test]
fn the_estimate_falls_with_lines_and_is_right_within_a_factor_of_two() {
    let many = Parameters { perturbations: vec![32, 8, 4], ..parameters(513, 96, 4) };
    let truth = view(&Baked::new(&scene("cornell"), &many));
    let mut before = f64::INFINITY;
    for perturbations in [vec![1], vec![4, 2], vec![16, 8]] {
        let baked = cornell(perturbations.clone(), 0.0);
        let error = baked.manifest().error;
        let truly = compare(&view(&baked), &truth).unwrap().relmse;
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

/// What a bake that aims at an error spends, beside one that spends as many lines on every surface.
#[test]
fn lines_are_spent_where_they_are_lacking() {
    let bake = |resolution, perturbations, target_error| {
        let fine = Parameters { texel_cells: 0.5, filter: 1, ..parameters(513, resolution, 4) };
        Baked::new(&scene("cornell"), &Parameters { perturbations, target_error, ..fine })
    };
    let truth = view(&bake(96, vec![96, 16, 8], 0.0));
    let aimed = bake(48, vec![64, 16], 1e-3);
    let grids = aimed.manifest().grids;
    let (aimed, evenly) = (&aimed, &bake(48, grids.clone(), 0.0));
    let fragments = |baked: &Baked| baked.manifest().statistics.fragments as f64;
    let spent = fragments(aimed) / fragments(evenly);
    assert!(spent < 0.95, "{grids:?}: {spent} of all lines");
    let ledger = aimed.manifest().ledger;
    let closes = |l: &CycleLedger| {
        l.residual().abs() < 1e-9 && l.sampling.abs() < 0.01 * l.emitted.max(l.carried_in)
    };
    assert!(ledger.iter().all(closes), "{ledger:?}");
    let wrong = |baked: &Baked| compare(&view(baked), &truth).unwrap().relmse;
    let (own, least) = (wrong(aimed), wrong(evenly));
    assert!(own < 1.5 * least, "{own} with {spent} of the lines, {least} with all of them");
    let stated = aimed.manifest().error.relmse;
    assert!((0.5..2.0).contains(&(stated / own)), "states {stated}, has {own}");
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
