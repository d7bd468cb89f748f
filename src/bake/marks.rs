//! Marks: what is to be known of a texel before its fragments exchange light, one byte each.
//!
//! In: the scene's texels, and which of their values no light can come to (see [`super::reach`]). Most
//! cells hold nothing that is marked; one look at each fragment's byte tells.

use crate::scene::texels::Texels;

/// No light can come to the front, or to the back, of the texel.
const SEALED: [u8; 2] = [1, 2];

/// Other surfaces cut the texel; its fragments may belong to others.
pub const CUT: u8 = 4;

/// The texel stands for a mirror.
pub const MIRROR: u8 = 8;

/// The marks of all texels.
#[derive(Clone, Debug, Default)]
pub struct Marks(Vec<u8>);

impl Marks {
    /// None on so many texels.
    pub fn none(texels: usize) -> Marks {
        Marks(vec![0; texels])
    }

    /// Of a scene's texels, of which none is sealed yet.
    pub fn new(texels: &Texels) -> Marks {
        let mark = |texel: u32| match (texels.cuts.is_cut(texel), texel >= texels.diffuse) {
            (true, _) => CUT,
            (false, true) => MIRROR,
            (false, false) => 0,
        };
        Marks((0..texels.len() as u32).map(mark).collect())
    }

    /// The marks of a texel.
    #[inline]
    pub fn of(&self, texel: u32) -> u8 {
        self.0[texel as usize]
    }

    /// Notes that no light can come to a texture value.
    pub fn seal(&mut self, value: usize) {
        self.0[value / 2] |= SEALED[value % 2];
    }

    /// Whether light can come to a texture value, and no other surface cuts its texel.
    #[inline]
    pub fn is_whole(&self, value: usize) -> bool {
        self.0[value / 2] & (SEALED[value % 2] | CUT) == 0
    }

    /// Whether no light can come to a texture value.
    #[inline]
    pub fn is_sealed(&self, value: usize) -> bool {
        self.0[value / 2] & SEALED[value % 2] != 0
    }
}
