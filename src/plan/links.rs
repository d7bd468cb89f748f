//! Bytes of the links that a bake keeps from cycle to cycle (see [`crate::bake::links`]).

use crate::bake::exchange::{order_contacts, see_each_other};
use crate::bake::layers::{Fragment, Layers};
use crate::bake::links::Shown;
use crate::bake::marks::Marks;
use crate::bake::step::Shared;

/// Bytes of the links of a PSF that has been rasterised.
pub fn bytes(shared: &Shared, marks: &Marks, layers: &mut Layers) -> u64 {
    const PAIR: u64 = size_of::<[u32; 2]>() as u64;
    let Shared { outlines, texels, .. } = *shared;
    let n = shared.parameters.resolution;
    // What the ends of a gap take that light passes; `None` is the space outside.
    let of = |near: Option<&Fragment>, far: Option<&Fragment>| {
        let is_mirror = |f: Option<&Fragment>| f.is_some_and(|f| f.texel() >= texels.diffuse);
        let is_sealed = near.is_some_and(|f| marks.is_sealed(f.value_along()))
            || far.is_some_and(|f| marks.is_sealed(f.value_against()));
        let touch = near.zip(far).is_some_and(|(near, far)| !see_each_other(*near, *far));
        let sent = |f| if is_mirror(f) { size_of::<Shown>() as u64 } else { PAIR };
        match (is_sealed || touch, is_mirror(near) || is_mirror(far)) {
            (true, _) => 0,
            (false, false) => PAIR,
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
