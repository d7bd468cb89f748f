//! Reach: which sides of which texels no light can come to.
//!
//! In: the scene's outlines and lines. Out: the sealed values: insides of closed boxes, floors under
//! boxes, outsides of a room's walls. They take part in most of the exchanges of a scene and in none of
//! its light. Pairs with a sealed end are left out of every cycle: that is fast, and a texel on which a
//! box's wall stands is then not darkened by what it sees inside the box.
//!
//! Values (a texel's side) that exchange light are joined into sets by union and find, in one sweep
//! over the lines; cut texels, which see two spaces, join nothing. A set is sealed when no emitter is in
//! it and backs are at one end at least of each of its pairs, as inside solids. Cut texels are never
//! sealed.

use super::exchange;
use super::layers::Layers;
use super::step::Shared;
use crate::ids::{DirectionId, SurfaceId};
use crate::psf::Psf;

/// Sets of values that exchange light.
#[derive(Clone, Debug)]
pub struct Reach {
    parent: Vec<u32>,
    /// Values that were joined front to front.
    open: Vec<bool>,
}

/// Which texture values no light can come to, one bit each.
#[derive(Clone, Debug, Default)]
pub struct Sealed(Vec<u64>);

impl Sealed {
    /// Whether no light can come to a value.
    pub fn has(&self, value: usize) -> bool {
        self.0[value / 64] >> (value % 64) & 1 == 1
    }
}

impl Reach {
    /// Every value by itself.
    pub fn new(values: usize) -> Reach {
        Reach { parent: (0..values as u32).collect(), open: vec![false; values] }
    }

    fn root(&mut self, mut value: u32) -> u32 {
        while self.parent[value as usize] != value {
            let above = self.parent[self.parent[value as usize] as usize];
            self.parent[value as usize] = above;
            value = above;
        }
        value
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.parent[a.max(b) as usize] = a.min(b);
    }

    /// Joins what another sweep joined.
    pub fn merge(&mut self, other: &Reach) {
        for (value, parent) in other.parent.iter().enumerate() {
            self.join(value as u32, *parent);
            self.open[value] |= other.open[value];
        }
    }

    /// Joins the values that look at each other along the lines of a direction.
    pub fn sweep(&mut self, shared: &Shared, cut: &[bool], id: DirectionId, layers: &mut Layers) {
        let resolution = shared.parameters.resolution;
        let psf = Psf::new(shared.directions.vector(id), resolution);
        layers.rasterise(shared.outlines, &psf);
        for j in 0..resolution {
            for i in 0..resolution {
                let fragments = layers.cell(i, j);
                exchange::order_contacts(fragments);
                for pair in fragments.windows(2) {
                    let (near, far) = (pair[0], pair[1]);
                    let is_cut = cut[near.texel() as usize] || cut[far.texel() as usize];
                    if is_cut || !exchange::see_each_other(near, far) {
                        continue;
                    }
                    let (a, b) = (near.value_along() as u32, far.value_against() as u32);
                    self.join(a, b);
                    // Even values are fronts.
                    self.open[a as usize] |= a % 2 == 0 && b % 2 == 0;
                }
            }
        }
    }

    /// The values that no light can come to.
    pub fn sealed(mut self, shared: &Shared, cut: &[bool]) -> Sealed {
        let values = self.parent.len();
        let mut lit = vec![false; values];
        let mut alone = vec![true; values];
        for value in 0..values as u32 {
            let root = self.root(value) as usize;
            let surface = SurfaceId(shared.texels.surface_of[value as usize / 2]);
            let emits = value % 2 == 0 && !shared.scene.material_of(surface).emitted.is_black();
            lit[root] |= emits || self.open[value as usize];
            alone[root] &= root == value as usize;
        }
        let mut sealed = Sealed(vec![0; values.div_ceil(64)]);
        for value in 0..values {
            let root = self.root(value as u32) as usize;
            // A front that nothing was joined to has only been missed.
            let missed = alone[root] && value % 2 == 0;
            if !lit[root] && !missed && !cut[value / 2] {
                sealed.0[value / 64] |= 1 << (value % 64);
            }
        }
        sealed
    }
}
