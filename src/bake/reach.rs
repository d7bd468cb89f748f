//! Reach: which sides of surfaces light can come to at all.
//!
//! In: the scene's outlines and lines. Out: for each surface and side, whether a chain of exchanges
//! leads there from an emitter. The insides of closed boxes and the outsides of a room's walls take
//! part in most of the exchanges of a scene and in none of its light; pairs of such sides are left out
//! of every cycle. One sweep over the lines, whose pairs are joined by union and find.

use super::exchange;
use super::layers::{Fragment, Layers};
use super::step::Shared;
use crate::ids::{DirectionId, Side};
use crate::psf::Psf;

/// Sets of sides that exchange light, by union and find; side `s` of surface `p` is `2 p + s`.
#[derive(Clone, Debug)]
pub struct Reach {
    parent: Vec<u32>,
}

impl Reach {
    /// Every side by itself.
    pub fn new(surfaces: usize) -> Reach {
        Reach { parent: (0..2 * surfaces as u32).collect() }
    }

    fn root(&mut self, mut side: u32) -> u32 {
        while self.parent[side as usize] != side {
            let above = self.parent[self.parent[side as usize] as usize];
            self.parent[side as usize] = above;
            side = above;
        }
        side
    }

    /// Joins the sets of two sides.
    pub fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.parent[a.max(b) as usize] = a.min(b);
    }

    /// Joins what another sweep joined.
    pub fn merge(&mut self, other: &Reach) {
        for (side, parent) in other.parent.iter().enumerate() {
            self.join(side as u32, *parent);
        }
    }

    /// Joins the sides that look at each other along the lines of a direction.
    pub fn sweep(&mut self, shared: &Shared, id: DirectionId, layers: &mut Layers) {
        let resolution = shared.parameters.resolution;
        let psf = Psf::new(shared.directions.vector(id), resolution);
        layers.rasterise(shared.outlines, &psf);
        let side = |fragment: Fragment, front: bool| {
            let surface = shared.texels.surface_of[fragment.texel() as usize];
            2 * surface + if front { Side::Front.index() } else { Side::Back.index() } as u32
        };
        // Neighbouring lines mostly join the same sides.
        let mut last = (u32::MAX, u32::MAX);
        for j in 0..resolution {
            for i in 0..resolution {
                let fragments = layers.cell(i, j);
                exchange::order_contacts(fragments);
                for pair in fragments.windows(2) {
                    let (near, far) = (pair[0], pair[1]);
                    let joined = (side(near, near.faces_along()), side(far, !far.faces_along()));
                    if joined != last && exchange::see_each_other(near, far) {
                        self.join(joined.0, joined.1);
                        last = joined;
                    }
                }
            }
        }
    }

    /// For each surface whether its front and its back can be reached from an emitter's front.
    pub fn lit(mut self, shared: &Shared) -> Vec<[bool; 2]> {
        let surfaces = self.parent.len() as u32 / 2;
        let mut reached = vec![false; self.parent.len()];
        for id in shared.scene.surface_ids() {
            if !shared.scene.material_of(id).emitted.is_black() {
                let root = self.root(2 * id.0);
                reached[root as usize] = true;
            }
        }
        (0..surfaces)
            .map(|s| [2 * s, 2 * s + 1].map(|side| reached[self.root(side) as usize]))
            .collect()
    }
}
