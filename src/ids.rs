//! Names of things: the paper's symbols as types.
//!
//! | paper | here | what |
//! |---|---|---|
//! | P, Q | [`SurfaceId`] | a receiving or sending surface |
//! | omega | [`DirectionId`] | a line direction of the set Omega_l |
//! | (s, t) | [`TileId`] | a tile of a parallel subfield, `0 <= s, t < n`, `n = N / m` |
//! | (u, v) | [`Cell`] | a cell of a parallel subfield, here counted over the whole PSF: `(s m + u, t m + v)` |

use serde::{Deserialize, Serialize};

/// A surface of the scene: its index in [`crate::Scene::surfaces`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct SurfaceId(pub u32);

impl SurfaceId {
    /// The index into arrays that hold one item a surface.
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// A material of the scene: its index in [`crate::Scene::materials`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct MaterialId(pub u32);

impl MaterialId {
    /// The index into arrays that hold one item a material.
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// A line direction: its index in [`crate::Directions`], `0 <= id < l`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct DirectionId(pub u32);

impl DirectionId {
    /// The index into arrays that hold one item a direction.
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// Which way along a line: with the direction of its PSF or against it. A line serves both.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Sense {
    /// Along `+omega`.
    Along,
    /// Along `-omega`.
    Against,
}

impl Sense {
    /// The other one.
    pub fn flip(self) -> Sense {
        match self {
            Sense::Along => Sense::Against,
            Sense::Against => Sense::Along,
        }
    }

    /// `+1` or `-1`.
    pub fn sign(self) -> f32 {
        match self {
            Sense::Along => 1.0,
            Sense::Against => -1.0,
        }
    }

    /// 0 for `Along`, 1 for `Against`: the order of the two on disk.
    pub fn slot(self) -> usize {
        self as usize
    }
}

/// Which side of a surface: the front is the one its normal points away from (counter-clockwise).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Side {
    /// The side the normal stands on.
    Front,
    /// The other.
    Back,
}

impl Side {
    /// 0 for the front, 1 for the back.
    pub fn index(self) -> usize {
        self as usize
    }

    /// `+1` for the front, `-1` for the back: what turns the normal to this side.
    pub fn sign(self) -> f32 {
        match self {
            Side::Front => 1.0,
            Side::Back => -1.0,
        }
    }

    /// The side that a vector pointing away from the surface stands on; `cosine` is its product
    /// with the normal.
    pub fn facing(cosine: f32) -> Side {
        if cosine > 0.0 { Side::Front } else { Side::Back }
    }
}

/// A tile `(s, t)` of a parallel subfield.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct TileId {
    /// Column of tiles.
    pub s: u32,
    /// Row of tiles.
    pub t: u32,
}

/// A cell of a parallel subfield, counted over the whole PSF: column `i = s m + u`, row `j = t m + v`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Cell {
    /// Column, `0 <= i < N`.
    pub i: u32,
    /// Row, `0 <= j < N`.
    pub j: u32,
}

/// A cell in four bytes: no PSF has more than 65,535 columns or rows ([`crate::format::limits`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SmallCell([u16; 2]);

impl From<Cell> for SmallCell {
    fn from(Cell { i, j }: Cell) -> SmallCell {
        SmallCell([i as u16, j as u16])
    }
}

impl From<SmallCell> for Cell {
    fn from(SmallCell([i, j]): SmallCell) -> Cell {
        Cell { i: i.into(), j: j.into() }
    }
}
