//! Which texel a point of a cut texel belongs to, looked up.
//!
//! In: the scene's texels and their cuts. Out: for each eighth by eighth of a cut texel its home, see
//! [`Cuts::home`](crate::scene::cuts::Cuts::home). Only in those that a cut divides is it searched for.

use crate::scene::Scene;
use crate::scene::cuts::REACH;
use crate::scene::texels::{Lattice, Texels};
use glam::Vec2;

/// Parts along a texel's edge.
const PARTS: u32 = 8;

/// A part whose points belong to more than one texel.
const DIVIDED: u8 = u8::MAX;

/// A part is taken as divided if a cut comes this near, in texels: points are rounded.
const ROUNDING: f32 = 1e-3;

/// Columns, and rows, of the texels that a point may belong to.
const WIDE: i32 = 2 * REACH + 1;

/// The homes of all parts of cut texels, as places in the square of texels around theirs.
#[derive(Clone, Debug)]
pub struct Homes(Vec<u8>);

impl Homes {
    /// Of a scene.
    pub fn new(scene: &Scene, texels: &Texels) -> Homes {
        let cuts = &texels.cuts;
        let mut homes = Vec::with_capacity(cuts.len() * (PARTS * PARTS) as usize);
        for id in scene.surface_ids() {
            let lattice = &texels.lattices[id.index()];
            let all = lattice.first..lattice.first + lattice.width * lattice.height;
            for texel in all.filter(|t| cuts.is_cut(*t)) {
                let corner = place(lattice, texel).as_vec2();
                for part in 0..PARTS * PARTS {
                    let inside = glam::UVec2::new(part % PARTS, part / PARTS).as_vec2() + 0.5;
                    let middle = corner + inside / PARTS as f32;
                    let half = 0.5 / PARTS as f32 + ROUNDING;
                    homes.push(if cuts.divide(texel, middle, half) {
                        DIVIDED
                    } else {
                        let home = cuts.home(lattice, texel, middle);
                        let away = place(lattice, home) - place(lattice, texel) + REACH;
                        (away.y * WIDE + away.x) as u8
                    });
                }
            }
        }
        Homes(homes)
    }

    /// The texel to which a point in `texel` belongs, in texels along `u` and `v`.
    pub fn of(&self, texels: &Texels, lattice: &Lattice, texel: u32, at: Vec2) -> u32 {
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
}

/// Column and row of a texel.
fn place(lattice: &Lattice, texel: u32) -> glam::IVec2 {
    let at = texel - lattice.first;
    glam::UVec2::new(at % lattice.width, at / lattice.width).as_ivec2()
}
