//! Which texel a point of a cut texel belongs to, looked up.
//!
//! In: the scene's texels and their cuts. Out: for each eighth by eighth of a cut texel its home, see
//! [`Cuts::home`](crate::scene::cuts::Cuts::home). Only in those that a cut divides is it searched for.

use crate::scene::Scene;
use crate::scene::cuts::REACH;
use crate::scene::texels::{Lattice, Texels};
use glam::{Vec2, Vec3};
use rayon::prelude::*;

/// Parts along a texel's edge.
const PARTS: u32 = 8;

/// A part whose points belong to more than one texel.
const DIVIDED: u8 = u8::MAX;

/// A part is taken as divided if a cut comes this near, in texels: points are rounded.
const ROUNDING: f32 = 1e-3;

/// Columns, and rows, of the texels that a point may belong to.
const WIDE: i32 = 2 * REACH + 1;

/// Cut texels whose pieces are looked at before their areas are moved.
const AT_ONCE: usize = 1024;

/// Points by which the areas of a texel's pieces are found.
const SAMPLES: u32 = 256;

/// The homes of all parts of cut texels, as places in the square of texels around theirs.
#[derive(Clone, Debug)]
pub struct Homes(Vec<u8>);

impl Homes {
    /// Of a scene's texels.
    pub fn new(texels: &Texels) -> Homes {
        let cuts = &texels.cuts;
        let home = |lattice: &Lattice, texel: u32, part: u32| {
            let inside = glam::UVec2::new(part % PARTS, part / PARTS).as_vec2() + 0.5;
            let middle = place(lattice, texel).as_vec2() + inside / PARTS as f32;
            if cuts.divide(texel, middle, 0.5 / PARTS as f32 + ROUNDING) {
                return DIVIDED;
            }
            let home = cuts.home(lattice, texel, middle);
            let away = place(lattice, home) - place(lattice, texel) + REACH;
            (away.y * WIDE + away.x) as u8
        };
        let of_surface = |lattice: &Lattice| -> Vec<u8> {
            let all = lattice.first..lattice.first + lattice.width * lattice.height;
            let cut = all.filter(|t| cuts.is_cut(*t));
            cut.flat_map(|t| (0..PARTS * PARTS).map(move |part| (t, part)))
                .map(|(texel, part)| home(lattice, texel, part))
                .collect()
        };
        let homes: Vec<Vec<u8>> = texels.lattices.par_iter().map(of_surface).collect();
        Homes(homes.concat())
    }

    /// Bytes of memory that they take.
    pub fn bytes(&self) -> u64 {
        self.0.len() as u64
    }

    /// The texel to which a point in `texel` belongs.
    pub fn of(&self, scene: &Scene, texels: &Texels, texel: u32, point: Vec3) -> u32 {
        let surface = texels.surface_of[texel as usize] as usize;
        let lattice = &texels.lattices[surface];
        let at = scene.surfaces[surface].coordinates(point) * lattice.density;
        self.in_lattice(texels, lattice, texel, at)
    }

    /// The same for a point given in texels along `u` and `v`.
    fn in_lattice(&self, texels: &Texels, lattice: &Lattice, texel: u32, at: Vec2) -> u32 {
        let Some(rank) = texels.cuts.rank(texel) else { return texel };
        let inside = (at - place(lattice, texel).as_vec2()) * PARTS as f32;
        let part = inside.clamp(Vec2::ZERO, Vec2::splat((PARTS - 1) as f32)).as_uvec2();
        let home = self.0[rank * (PARTS * PARTS) as usize + (part.y * PARTS + part.x) as usize];
        if home == DIVIDED {
            return texels.cuts.home(lattice, texel, at);
        }
        let (column, row) = (i32::from(home) % WIDE - REACH, i32::from(home) / WIDE - REACH);
        texel.wrapping_add_signed(row * lattice.width as i32 + column)
    }

    /// Moves the areas of texels' pieces, one number a texel, to the texels that they belong to.
    pub fn move_areas(&self, texels: &Texels, areas: &mut [f32]) {
        let before = areas.to_vec();
        let homes_of = |texel: &u32| -> Vec<u32> {
            let lattice = &texels.lattices[texels.surface_of[*texel as usize] as usize];
            let corner = place(lattice, *texel).as_vec2();
            let points = (0..SAMPLES).map(|k| corner + sample(k));
            let covered = points.filter(|p| texels.cuts.covers(lattice, *texel, *p));
            covered.map(|point| self.in_lattice(texels, lattice, *texel, point)).collect()
        };
        let cut: Vec<u32> = (0..texels.diffuse).filter(|t| texels.cuts.is_cut(*t)).collect();
        for some in cut.chunks(AT_ONCE) {
            let homes: Vec<Vec<u32>> = some.par_iter().map(homes_of).collect();
            // One after the other, so that the sums have the same bits with any number of threads.
            for (texel, homes) in some.iter().zip(homes) {
                let part = before[*texel as usize] / homes.len() as f32;
                for home in homes {
                    areas[*texel as usize] -= part;
                    areas[home as usize] += part;
                }
            }
        }
        // What rounding leaves of a texel that has given everything away.
        areas.iter_mut().for_each(|a| *a = a.max(0.0));
    }
}

/// The k-th point of a texel, evenly spread along any line (Roberts' sequence R2).
fn sample(k: u32) -> Vec2 {
    let part = |step: f64| (0.5 + f64::from(k + 1) * step).fract() as f32;
    Vec2::new(part(0.754_877_666_246_692_8), part(0.569_840_290_998_053_3))
}

/// Column and row of a texel.
fn place(lattice: &Lattice, texel: u32) -> glam::IVec2 {
    let at = texel - lattice.first;
    glam::UVec2::new(at % lattice.width, at / lattice.width).as_ivec2()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::SurfaceId;
    use crate::scene::areas::areas;
    use crate::scene::test_scenes::{quad, room, scene_of};

    /// A floor of 8 x 8 texels with a wall upright across it, a part of the way.
    fn halves(at: f32) -> Scene {
        let floor = quad(0, Vec3::new(-0.5, -0.5, 0.0), Vec3::X, Vec3::Y);
        let wall = quad(0, Vec3::new(at - 0.5, -0.6, 0.0), Vec3::Y * 1.2, Vec3::Z * 0.2);
        scene_of(vec![floor, wall], room().materials)
    }

    #[test]
    fn areas_go_with_the_pieces_to_their_own_side() {
        for at in [0.375f32, 0.4, 0.4375, 0.45, 0.49] {
            let scene = halves(at);
            let texels = Texels::new(&scene, 0.125);
            let homes = Homes::new(&texels);
            let mut areas = areas(&scene, &texels);
            homes.move_areas(&texels, &mut areas);
            let lattice = &texels.lattices[0];
            let (mut left, mut all) = (0.0, 0.0);
            for texel in 0..lattice.width * lattice.height {
                let area = areas[texel as usize];
                let site = texels.cuts.site(lattice, texel) / lattice.density;
                left += if site.x < at { area } else { 0.0 };
                all += area;
            }
            assert!((all - 1.0).abs() < 1e-5, "{at}: {all}");
            assert!((left - at).abs() < 2e-3, "{at}: {left}");
        }
    }

    /// The table says what the search says.
    #[test]
    fn homes_are_those_that_a_search_finds_on_the_points_own_side() {
        let at = 0.43;
        let scene = halves(at);
        let texels = Texels::new(&scene, 0.125);
        let homes = Homes::new(&texels);
        let (surface, lattice) = (&scene.surfaces[0], &texels.lattices[0]);
        for k in 0..4000 {
            let p = sample(k);
            let point = surface.origin + surface.u * p.x + surface.v * p.y;
            let texel = texels.at(SurfaceId(0), surface, point);
            let home = homes.of(&scene, &texels, texel, point);
            let site = texels.cuts.site(lattice, home) / lattice.density;
            assert_eq!(p.x < at, site.x < at, "{p}");
            if !texels.cuts.is_cut(texel) {
                assert_eq!(home, texel);
            }
        }
    }
}
