//! Bytes of the links that a bake keeps from cycle to cycle (see [`crate::bake::links`]).

use crate::bake::exchange::{order_contacts, see_each_other};
use crate::bake::layers::{Fragment, Layers};
use crate::bake::links::{Seen, Shown};
use crate::bake::marks::Marks;
use crate::bake::step::Shared;
use crate::format::manifest::Transfer;
use crate::ids::SmallCell;

/// Bytes of the links of a PSF that has been rasterised.
pub fn bytes(shared: &Shared, marks: &Marks, layers: &mut Layers) -> u64 {
    let (shown, seen) = (size_of::<Shown>() as u64, size_of::<Seen>() as u64);
    let cell = match shared.parameters.transfer {
        Transfer::Clip => size_of::<SmallCell>() as u64,
        Transfer::Sample => 0,
    };
    let pair = size_of::<[u32; 2]>() as u64 + cell;
    let Shared { outlines, texels, .. } = *shared;
    let n = shared.parameters.resolution;
    // What the ends of a gap take that light passes; `None` is the space outside.
    let of = |near: Option<&Fragment>, far: Option<&Fragment>| {
        let is_mirror = |f: Option<&Fragment>| f.is_some_and(|f| f.texel() >= texels.diffuse);
        let is_sealed = near.is_some_and(|f| marks.is_sealed(f.value_along()))
            || far.is_some_and(|f| marks.is_sealed(f.value_against()));
        let touch = near.zip(far).is_some_and(|(near, far)| !see_each_other(*near, *far));
        let sent = |f| if is_mirror(f) { shown } else { seen };
        match (is_sealed || touch, is_mirror(near) || is_mirror(far)) {
            (true, _) => 0,
            (false, false) => pair,
            (false, true) => sent(near) + sent(far),
        }
    };
    let cells = (0..n * n).map(|k| {
        let fragments = layers.slot(k as usize);
        order_contacts(fragments, &outlines.contacts, &texels.surface_of);
        let (Some(first), Some(last)) = (fragments.first(), fragments.last()) else { return 0 };
        let between = fragments.windows(2).map(|pair| of(Some(&pair[0]), Some(&pair[1])));
        of(None, Some(first)) + of(Some(last), None) + between.sum::<u64>()
    });
    cells.sum()
}
