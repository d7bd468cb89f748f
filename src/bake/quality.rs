//! Quality presets: how many perturbed PSFs each cycle spends.
//!
//! Light falls from bounce to bounce and what it shows grows smoother, so the first cycles get the
//! most lines (section 5: "perturbing the initial few is generally adequate").

/// A preset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quality {
    /// The bare lattice: seconds.
    Draft,
    /// Soft shadows without bands that the eye finds.
    Preview,
    /// As many lines as pictures of a stated error need.
    Final,
}

impl Quality {
    /// PSFs that each direction stands for, cycle by cycle, and how much coarser the lattice is after
    /// these; see [`crate::format::manifest::Parameters`].
    pub fn perturbations(self) -> (Vec<u32>, u32) {
        match self {
            Quality::Draft => (vec![1], 0),
            Quality::Preview => (vec![8, 2, 1], 1),
            Quality::Final => (vec![192, 16, 8, 4], 1),
        }
    }

    /// Edge of a texel in cells, how many times as many there may be where light has edges, and the most
    /// passes of the filter. Half a cell and one pass show the edges of shadows and caustics sharper than a
    /// cell and none, with less noise, once there are lines enough; with as many as `final` may spend, finer
    /// texels show them sharper still. More than four passes hardly smooth walls any more.
    pub fn texels(self) -> (f64, f64, u32) {
        match self {
            Quality::Draft => (1.0, 1.0, 0),
            Quality::Preview => (0.5, 1.0, 4),
            Quality::Final => (0.5, 4.0, 4),
        }
    }

    /// The relMSE aimed at, of which [`Quality::perturbations`] are the bound then; 0: none.
    pub fn target_error(self) -> f64 {
        match self {
            Quality::Draft | Quality::Preview => 0.0,
            Quality::Final => 2e-4,
        }
    }
}
