//! Where the texture maps P^C, P^N and P^T live: a lattice of square texels over each diffuse surface.
//!
//! In: the scene and the texels' edge. Out: for every surface the size of its lattice and the number
//! of its first texel, so that one flat array holds the maps of all surfaces. Each texel has two
//! values, one a side: value `2 * texel + side`. Mirrors have no texture map; they take one texel
//! each, at the end, so that a fragment of any surface can be named by a texel number.

mod sixteen;

pub use sixteen::Places;

use crate::format::bytes::{Reader, Writer};
use crate::format::{Fault, room_for};
use crate::ids::{Side, SurfaceId};
use crate::radiance::Rgb;
use crate::scene::cuts::Cuts;
use crate::scene::{Reflectance, Scene, Surface};
use glam::{Vec2, Vec3, Vec3A};
use std::ops::Range;

/// The lattice of one surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lattice {
    /// Number of the first texel; texels run row by row along the surface's `u`.
    pub first: u32,
    /// Texels along `u`.
    pub width: u32,
    /// Texels along `v`.
    pub height: u32,
    /// Texels per unit length along `u` and `v`: `width / extent.x`, `height / extent.y`.
    pub density: Vec2,
}

/// The lattices of all surfaces.
#[derive(Clone, Debug, PartialEq)]
pub struct Texels {
    /// One lattice a surface.
    pub lattices: Vec<Lattice>,
    /// For each texel its surface.
    pub surface_of: Vec<u32>,
    /// Texels below this number belong to diffuse surfaces, the others are mirrors, one each.
    pub diffuse: u32,
    /// Where other surfaces cut them.
    pub cuts: Cuts,
}

impl Texels {
    /// Bytes of memory that they take.
    pub fn bytes(&self) -> u64 {
        let lists = size_of_val(self.lattices.as_slice()) + size_of_val(self.surface_of.as_slice());
        lists as u64 + self.cuts.bytes()
    }

    /// Lays texels of about `edge` (in the fitted scene's units), or finer by the surface's own
    /// [`fineness`](Surface::fineness), over every diffuse surface. A lattice divides its surface's
    /// bounding rectangle evenly, so that it ends where the surface ends.
    pub fn new(scene: &Scene, edge: f32) -> Texels {
        Texels::lay(scene, edge, Vec::new())
    }

    /// As [`Texels::new`], for a scene that a file holds.
    ///
    /// # Errors
    /// When there is no memory for them.
    pub fn try_new(scene: &Scene, edge: f32) -> Result<Texels, Fault> {
        let room = room_for(Texels::count(scene, edge), || "texels".into())?;
        Ok(Texels::lay(scene, edge, room))
    }

    /// `surface_of` is empty, with or without room.
    fn lay(scene: &Scene, edge: f32, mut surface_of: Vec<u32>) -> Texels {
        let mut lattices = vec![
            Lattice { first: 0, width: 1, height: 1, density: Vec2::ONE };
            scene.surfaces.len()
        ];
        for mirrors in [false, true] {
            for id in scene.surface_ids() {
                if scene.material_of(id).reflectance.is_mirror() != mirrors {
                    continue;
                }
                let surface = scene.surface(id);
                let lattice = &mut lattices[id.index()];
                lattice.first = surface_of.len() as u32;
                if !mirrors {
                    [lattice.width, lattice.height] = size(surface.extent, surface.fineness, edge);
                }
                let count = Vec2::new(lattice.width as f32, lattice.height as f32);
                lattice.density = count / surface.extent.max(Vec2::splat(f32::MIN_POSITIVE));
                let texels = lattice.width as usize * lattice.height as usize;
                surface_of.resize(surface_of.len() + texels, id.0);
            }
        }
        let is_diffuse = |s: &u32| !scene.material_of(SurfaceId(*s)).reflectance.is_mirror();
        let diffuse = surface_of.partition_point(is_diffuse) as u32;
        let cuts = Cuts::new(scene, &lattices, surface_of.len());
        Texels { lattices, surface_of, diffuse, cuts }
    }

    /// How many texels [`Texels::new`] would lay, without laying them.
    pub fn count(scene: &Scene, edge: f32) -> u64 {
        let of = |surface: &Surface| match scene.materials[surface.material.index()].reflectance {
            Reflectance::Mirror(_) => 1,
            Reflectance::Diffuse(_) => {
                let [width, height] = size(surface.extent, surface.fineness, edge);
                u64::from(width) * u64::from(height)
            }
        };
        scene.surfaces.iter().map(of).fold(0, u64::saturating_add)
    }

    /// Number of texels, mirrors' included; there are twice as many values.
    pub fn len(&self) -> usize {
        self.surface_of.len()
    }

    /// For each texel whether another surface meets it.
    pub fn met(&self) -> Vec<bool> {
        (0..self.len() as u32).map(|t| self.cuts.is_met(t)).collect()
    }

    /// Whether a cut has a say in what [`sample`] finds between two places of a lattice, in texels along `u` and `v`.
    pub fn is_near_cut(&self, lattice: &Lattice, low: Vec2, high: Vec2) -> bool {
        let width = lattice.width;
        let [from, to] = [low, high].map(|at| lattice.around(at).0[0] - lattice.first);
        let (columns, mut rows) = (from % width..=to % width, from / width..=to / width);
        rows.any(|row| columns.clone().any(|c| self.cuts.is_near(lattice.first + row * width + c)))
    }

    /// Whether the scene has no surface at all.
    pub fn is_empty(&self) -> bool {
        self.surface_of.is_empty()
    }

    /// The texel of a surface that holds a point of its plane; points outside go to the nearest.
    pub fn at(&self, id: SurfaceId, surface: &Surface, point: Vec3) -> u32 {
        let lattice = self.lattices[id.index()];
        lattice.holding(surface.coordinates(point) * lattice.density)
    }
}

/// Columns and rows of texels on a diffuse surface.
pub fn size(extent: Vec2, fineness: u8, edge: f32) -> [u32; 2] {
    let finer = f32::from(1u16 << fineness);
    let count = (extent * finer / edge).round().max(Vec2::ONE);
    [count.x as u32, count.y as u32]
}

/// The bytes of a texture map: three f32 a value.
pub fn to_bytes(values: &[Rgb]) -> Vec<u8> {
    let mut w = Writer(Vec::with_capacity(12 * values.len()));
    values.iter().flat_map(|v| v.0).for_each(|c| w.f32(c));
    w.0
}

/// The texture map of `count` values that bytes hold.
///
/// # Errors
/// When the bytes are of another length, or a radiance is negative or not finite.
pub fn from_bytes(bytes: &[u8], count: usize) -> Result<Vec<Rgb>, Fault> {
    if bytes.len() as u64 != 12 * count as u64 {
        let has = bytes.len();
        return Err(Fault::invalid(format!("texture map: {has} bytes for {count} values")));
    }
    let mut values = room_for(count as u64, || "texture map".into())?;
    read_values(bytes, &mut values)?;
    Ok(values)
}

/// Appends the values of a part of a texture map.
///
/// # Errors
/// When the bytes hold no whole number of values, or a radiance is negative or not finite.
pub fn read_values(bytes: &[u8], values: &mut Vec<Rgb>) -> Result<(), Fault> {
    let mut r = Reader::new(bytes);
    while r.left() > 0 {
        let value = Rgb([r.f32()?, r.f32()?, r.f32()?]);
        if !value.is_physical() {
            return Err(Fault::invalid("texture map: a radiance is negative or not finite"));
        }
        values.push(value);
    }
    Ok(())
}

/// Radiance leaving side `side` of a diffuse surface at a point of its plane, from a texture map of
/// [`Texels::len`] texels and two values each: bilinear between texel middles, constant beyond the
/// outermost ones, and from the point's own side where other surfaces cut this one. W sr^-1 m^-2.
pub fn sample(
    texels: &Texels,
    values: &[Rgb],
    id: SurfaceId,
    surface: &Surface,
    side: Side,
    point: Vec3,
) -> Rgb {
    let lattice = &texels.lattices[id.index()];
    let at = surface.coordinates(point) * lattice.density;
    sample_at(texels, values, lattice, side, (at, lattice.around(at)))
}

/// The same at a place of a lattice, in texels along `u` and `v` from the surface's origin, with what
/// [`Lattice::around`] says of it.
#[inline]
pub fn sample_at(
    texels: &Texels,
    values: &[Rgb],
    lattice: &Lattice,
    side: Side,
    (at, (block, f)): (Vec2, ([u32; 4], Vec2)),
) -> Rgb {
    if texels.cuts.is_near(block[0]) {
        return sample_near_cuts((texels, values), lattice, side, (at, (block, f)));
    }
    // Three channels at once.
    let value = |texel: u32| Vec3A::from_array(values[2 * texel as usize + side.index()].0);
    let [a, b, c, d] = block.map(value);
    let upper = a * (1.0 - f.x) + b * f.x;
    let lower = c * (1.0 - f.x) + d * f.x;
    Rgb((upper * (1.0 - f.y) + lower * f.y).to_array())
}

/// The same where cuts are near: texels on the far side of one have no say.
fn sample_near_cuts(
    (texels, values): (&Texels, &[Rgb]),
    lattice: &Lattice,
    side: Side,
    (at, (block, f)): (Vec2, ([u32; 4], Vec2)),
) -> Rgb {
    let value = |texel: u32| values[2 * texel as usize + side.index()];
    let weights = [(1.0 - f.x) * (1.0 - f.y), f.x * (1.0 - f.y), (1.0 - f.x) * f.y, f.x * f.y];
    let (mut sum, mut weight) = (Rgb::BLACK, 0.0);
    for (texel, w) in block.into_iter().zip(weights) {
        let is_seen = || !texels.cuts.is_crossed(lattice, at, texels.cuts.site(lattice, texel));
        if w > 0.0 && is_seen() {
            sum += value(texel) * w;
            weight += w;
        }
    }
    if weight > 0.0 {
        return sum / weight;
    }
    value(texels.cuts.home(lattice, lattice.holding(at), at))
}

impl Lattice {
    /// Number of its texels.
    #[allow(clippy::len_without_is_empty, reason = "there is always one")]
    pub fn len(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// The places of its texels' values in texture maps.
    pub fn values(&self) -> Range<usize> {
        let first = self.first as usize;
        2 * first..2 * (first + self.len())
    }

    /// The texel that holds a place, in texels along `u` and `v`; places outside go to the nearest.
    fn holding(&self, at: Vec2) -> u32 {
        let column = (at.x.max(0.0) as u32).min(self.width - 1);
        let row = (at.y.max(0.0) as u32).min(self.height - 1);
        self.first + row * self.width + column
    }

    /// The four texels around a place, two rows of two, and how far it is from the first one's middle
    /// to the last one's.
    #[inline]
    pub fn around(&self, at: Vec2) -> ([u32; 4], Vec2) {
        let last = Vec2::new((self.width - 1) as f32, (self.height - 1) as f32);
        let p = (at - 0.5).clamp(Vec2::ZERO, last);
        let (column, row) = (p.x as u32, p.y as u32);
        // The place is not negative: what is cut off is what rounding down takes.
        (self.block(column, row), p - Vec2::new(column as f32, row as f32))
    }

    /// A texel by its column and row, and those to the right of it, below it, and both, as far as there are.
    #[inline]
    fn block(&self, column: u32, row: u32) -> [u32; 4] {
        let right = (column + 1).min(self.width - 1);
        let below = (row + 1).min(self.height - 1);
        let texel = |c: u32, r: u32| self.first + r * self.width + c;
        [texel(column, row), texel(right, row), texel(column, below), texel(right, below)]
    }
}
