//! Perturbation (section 5): more directions for diffuse receivers than the field stores.
//!
//! In: a direction and the number of the perturbation. Out: a PSF turned inside the direction's own
//! solid angle, its grid moved inside a cell. Perturbation 0 is the true PSF. The offsets are the
//! additive recurrence in four dimensions (Roberts 2018, "The unreasonable effectiveness of
//! quasirandom sequences"): deterministic, even for any count. All directions turn by the same
//! offset, so that each perturbation is the whole lattice moved.

use crate::directions::Directions;
use crate::ids::DirectionId;
use crate::psf::Psf;
use glam::{DVec2, DVec4, Vec2};

/// Powers of the inverse of the root of x^5 = x + 1.
const STEP: DVec4 = DVec4::new(
    0.856_674_883_854_502_9,
    0.733_891_856_627_126,
    0.628_706_721_037_808_7,
    0.538_597_257_223_610_1,
);

/// The PSF of a direction under perturbation `number`.
pub fn psf(directions: &Directions, id: DirectionId, number: u32, resolution: u32) -> Psf {
    if number == 0 {
        return Psf::new(directions.vector(id), resolution);
    }
    let centred = |v: DVec4| v - v.round();
    let turn = centred(STEP * f64::from(number));
    // Grids of neighbouring directions must not fall alike onto the scene's edges.
    let own = centred(STEP * f64::from(id.0));
    let shift = centred(DVec4::new(turn.z + own.x, turn.w + own.y, 0.0, 0.0));
    let unit = directions.perturbed(id, DVec2::new(turn.x, turn.y));
    Psf::new(unit, resolution).shifted(Vec2::new(shift.x as f32, shift.y as f32))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn perturbed_grids_stay_near_their_direction_and_differ() {
        let directions = Directions::with_lines(129).unwrap();
        for id in (0..129).map(DirectionId) {
            let own = directions.vector(id);
            let plain = psf(&directions, id, 0, 64);
            assert_eq!(plain, Psf::new(own, 64));
            let all: Vec<Psf> = (0..16).map(|n| psf(&directions, id, n, 64)).collect();
            for (n, p) in all.iter().enumerate() {
                assert!((p.direction.length() - 1.0).abs() < 1e-5);
                // 129 lines are about 13 degrees apart.
                assert!(p.direction.dot(own) > 0.93, "{id:?}, {n}: {}", p.direction.dot(own));
                assert!(p.shift.abs().max_element() <= 0.5);
                assert!(all[..n].iter().all(|other| other != p), "{id:?}: {n} is not new");
            }
        }
    }
}
