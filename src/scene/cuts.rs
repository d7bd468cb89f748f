//! Cuts: where other surfaces' polygons pass through a surface, or stand on it.
//!
//! In: the scene and its lattices. Out: for each texel the segments that cut it, its *site*, and which
//! texel a point belongs to. What a texel receives on one side of a cut has nothing to do with what it
//! receives on the other: under a box that stands on a floor it is dark, beside it light. So a texel
//! stands for one of its pieces only, that of its site, and the others belong to the nearest texels
//! whose sites lie on their side, as small cells are merged in cut-cell methods of flow (Ye et al.
//! 1999). A piece shut in on all sides stays with its texel.

mod meets;

mod near;

mod pieces;

use crate::ids::SurfaceId;
use crate::scene::texels::Lattice;
use crate::scene::{Scene, Surface};
use glam::Vec2;
use meets::Segment;
use near::Near;
use pieces::{Piece, crosses};

/// A segment this near to a texel cuts it as well, as far as sampling can tell. In texels.
const MARGIN: f32 = 0.05;

/// A segment this near to the border of its surface has nothing of it behind it. In texels.
const BORDER: f32 = 2e-3;

/// Texels away, along rows and columns, that a point may belong to.
pub const REACH: i32 = 2;

/// One bit a texel.
#[derive(Clone, Debug, Default, PartialEq)]
struct Bits(Vec<u64>);

impl Bits {
    fn none(count: usize) -> Bits {
        Bits(vec![0; count.div_ceil(64)])
    }

    #[inline]
    fn has(&self, at: u32) -> bool {
        self.0[at as usize / 64] >> (at % 64) & 1 == 1
    }

    fn set(&mut self, at: u32) {
        self.0[at as usize / 64] |= 1 << (at % 64);
    }
}

/// The cuts of all texels of a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cuts {
    /// Texels that a segment meets, those on the border of their lattice included.
    met: Bits,
    /// Texels with segments that divide their lattice.
    cut: Bits,
    /// For each word of `cut` the number of cut texels before it.
    before: Vec<u32>,
    /// Texels that are cut, or whose neighbour to the right, below, or both, is.
    near: Bits,
    /// For each cut texel where its segments start; one more at the end.
    starts: Vec<u32>,
    segments: Vec<Segment>,
    /// For each cut texel its site, in texels along `u` and `v`.
    sites: Vec<Vec2>,
    /// For each cut texel which points of a grid its surface covers.
    covered: Vec<u64>,
}

impl Cuts {
    /// Of `count` texels, none of which is cut.
    pub fn none(count: usize) -> Cuts {
        let none = || Bits::none(count);
        Cuts { met: none(), cut: none(), near: none(), ..Cuts::default() }
    }

    /// Finds the cuts of a scene's texels. Mirrors have no texels to be cut. O(n log n) in the polygons
    /// and linear in texels and segments.
    pub fn new(scene: &Scene, lattices: &[Lattice], count: usize) -> Cuts {
        let mut cuts = Cuts::none(count);
        let near = Near::new(scene);
        // Texel and segment.
        let mut pairs: Vec<(u32, Segment)> = Vec::new();
        let diffuse = |id: &SurfaceId| !scene.material_of(*id).reflectance.is_mirror();
        let all = || scene.surface_ids().filter(diffuse);
        for id in all() {
            let lattice = &lattices[id.index()];
            let hull = hull(scene.surface(id), lattice);
            for segment in meets::segments(&near, id, scene.surface(id), lattice) {
                let divides = divides(segment, &hull);
                meets::along(segment, lattice, MARGIN, &mut |column, row| {
                    let texel = lattice.first + row * lattice.width + column;
                    cuts.met.set(texel);
                    if divides {
                        pairs.push((texel, segment));
                    }
                });
            }
        }
        pairs.sort_by_key(|p| p.0);
        cuts.index(&pairs);
        for id in all() {
            cuts.mark_near(&lattices[id.index()]);
            cuts.settle(scene.surface(id), &lattices[id.index()]);
        }
        cuts
    }

    /// Bytes of memory that they take.
    pub fn bytes(&self) -> u64 {
        let bits = [&self.met, &self.cut, &self.near].map(|bits| size_of_val(bits.0.as_slice()));
        let lists = size_of_val(self.before.as_slice())
            + size_of_val(self.starts.as_slice())
            + size_of_val(self.segments.as_slice())
            + size_of_val(self.sites.as_slice())
            + size_of_val(self.covered.as_slice());
        (bits.iter().sum::<usize>() + lists) as u64
    }

    /// Puts segments down by texel. `pairs` is in the texels' order.
    fn index(&mut self, pairs: &[(u32, Segment)]) {
        for of_texel in pairs.chunk_by(|a, b| a.0 == b.0) {
            self.cut.set(of_texel[0].0);
            self.starts.push(self.segments.len() as u32);
            self.segments.extend(of_texel.iter().map(|p| p.1));
        }
        self.starts.push(self.segments.len() as u32);
        let mut before = 0;
        for word in &self.cut.0 {
            self.before.push(before);
            before += word.count_ones();
        }
    }

    fn mark_near(&mut self, lattice: &Lattice) {
        let Lattice { first, width, height, .. } = *lattice;
        for texel in first..first + width * height {
            let (column, row) = ((texel - first) % width, (texel - first) / width);
            let (right, below) =
                (u32::from(column + 1 < width), u32::from(row + 1 < height) * width);
            let block = [texel, texel + right, texel + below, texel + right + below];
            if block.iter().any(|t| self.cut.has(*t)) {
                self.near.set(texel);
            }
        }
    }

    /// Chooses the sites of a surface's cut texels.
    fn settle(&mut self, surface: &Surface, lattice: &Lattice) {
        let from = self.sites.len();
        let end = lattice.first + lattice.width * lattice.height;
        let cut: Vec<u32> = (lattice.first..end).filter(|t| self.cut.has(*t)).collect();
        let mut covered = vec![0; cut.len()];
        let index = |column, row| {
            let texel = lattice.first + row * lattice.width + column;
            self.rank(texel).map(|k| k - from)
        };
        if !cut.is_empty() {
            pieces::cover(surface, lattice, &index, &mut covered);
        }
        let corner = |texel| middle(lattice, texel) - 0.5;
        for (texel, covered) in cut.iter().zip(&covered) {
            let own = self.segments_of(*texel);
            let mut pieces = pieces::pieces(*covered, corner(*texel), own);
            let corner = corner(*texel);
            pieces.iter_mut().for_each(|p| p.site += corner);
            // The one that cannot go elsewhere, or else the largest.
            let can_go = |p: &Piece| self.whole_neighbour(lattice, *texel, p.site);
            let chosen = (0..pieces.len())
                .max_by_key(|k| (!can_go(&pieces[*k]), pieces[*k].points, usize::MAX - k));
            let middle = middle(lattice, *texel);
            let Some(chosen) = chosen else {
                self.sites.push(middle);
                continue;
            };
            let site = pieces[chosen].site;
            let centred = !own.iter().any(|s| crosses(s, site, middle) || grazes(s, middle));
            self.sites.push(if centred { middle } else { site });
        }
        self.covered.extend(covered);
    }

    /// Whether a piece of a texel can belong to an uncut texel.
    fn whole_neighbour(&self, lattice: &Lattice, texel: u32, point: Vec2) -> bool {
        around(lattice, texel, REACH).any(|other| {
            !self.cut.has(other) && !self.is_crossed(lattice, point, middle(lattice, other))
        })
    }

    /// How many texels are cut.
    pub fn len(&self) -> usize {
        self.sites.len()
    }

    /// Whether none is.
    pub fn is_empty(&self) -> bool {
        self.sites.is_empty()
    }

    /// Whether a segment meets a square within a cut texel, given by its middle and half its edge, in
    /// texels along `u` and `v`.
    pub fn divide(&self, texel: u32, middle: Vec2, half: f32) -> bool {
        let meets = |[a, b]: &Segment| {
            let (low, high) = (a.min(*b), a.max(*b));
            // Separating axes: the square's, and the segment's normal.
            let along = *b - *a;
            let off = along.perp_dot(middle - *a).abs();
            (low - half).cmple(middle).all()
                && (high + half).cmpge(middle).all()
                && off <= half * (along.x.abs() + along.y.abs())
        };
        self.segments_of(texel).iter().any(meets)
    }

    /// The number of a cut texel among the cut ones.
    pub fn rank(&self, texel: u32) -> Option<usize> {
        let (word, bit) = (texel as usize / 64, texel % 64);
        let bits = self.cut.0[word];
        let below = || (bits & ((1 << bit) - 1)).count_ones();
        (bits >> bit & 1 == 1).then(|| (self.before[word] + below()) as usize)
    }

    fn segments_of(&self, texel: u32) -> &[Segment] {
        self.rank(texel)
            .map_or(&[], |k| &self.segments[self.starts[k] as usize..self.starts[k + 1] as usize])
    }

    /// Whether another polygon meets a texel, be it along the border of its lattice.
    pub fn is_met(&self, texel: u32) -> bool {
        self.met.has(texel)
    }

    /// Whether a texel is divided.
    pub fn is_cut(&self, texel: u32) -> bool {
        self.cut.has(texel)
    }

    /// Whether a texel is divided, or its neighbour to the right, below, or both.
    #[inline]
    pub fn is_near(&self, texel: u32) -> bool {
        self.near.has(texel)
    }

    /// The point of a texel for which its value stands: its middle, or one in the piece that it keeps.
    /// In texels along `u` and `v`.
    pub fn site(&self, lattice: &Lattice, texel: u32) -> Vec2 {
        self.rank(texel).map_or_else(|| middle(lattice, texel), |k| self.sites[k])
    }

    /// Whether a segment parts two points of a lattice, given in texels along `u` and `v`.
    pub fn is_crossed(&self, lattice: &Lattice, p: Vec2, q: Vec2) -> bool {
        let last = Vec2::new((lattice.width - 1) as f32, (lattice.height - 1) as f32);
        let from = p.min(q).clamp(Vec2::ZERO, last).as_uvec2();
        let to = p.max(q).clamp(Vec2::ZERO, last).as_uvec2();
        (from.y..=to.y).any(|row| {
            let row = lattice.first + row * lattice.width;
            (row + from.x..=row + to.x)
                .any(|texel| self.segments_of(texel).iter().any(|s| crosses(s, p, q)))
        })
    }

    /// Whether light may be carried over from one texel of a lattice to a neighbour.
    pub fn are_joined(&self, lattice: &Lattice, a: u32, b: u32) -> bool {
        // Beside or below each other, and neither is cut.
        let side_by_side = [1, lattice.width].contains(&a.abs_diff(b));
        if side_by_side && !self.is_near(a.min(b)) {
            return true;
        }
        !self.is_crossed(lattice, self.site(lattice, a), self.site(lattice, b))
    }

    /// The texel to which a point of a lattice belongs that lies in `texel`: the nearest whose site no
    /// segment parts from it. In texels along `u` and `v`.
    pub fn home(&self, lattice: &Lattice, texel: u32, point: Vec2) -> u32 {
        let sees = |t: u32| !self.is_crossed(lattice, point, self.site(lattice, t));
        if !self.is_cut(texel) || sees(texel) {
            return texel;
        }
        for reach in 1..=REACH {
            let off = |t: u32| self.site(lattice, t).distance_squared(point);
            let seen = around(lattice, texel, reach).filter(|t| sees(*t));
            if let Some(home) = seen.min_by(|a, b| off(*a).total_cmp(&off(*b))) {
                return home;
            }
        }
        texel
    }

    /// Whether the surface covers a point of a cut texel, to an eighth of a texel.
    pub fn covers(&self, lattice: &Lattice, texel: u32, point: Vec2) -> bool {
        let inside = point - (middle(lattice, texel) - 0.5);
        self.rank(texel).is_none_or(|k| pieces::covers(self.covered[k], inside))
    }
}

/// The middle of a texel, in texels along `u` and `v`.
fn middle(lattice: &Lattice, texel: u32) -> Vec2 {
    let at = texel - lattice.first;
    Vec2::new((at % lattice.width) as f32 + 0.5, (at / lattice.width) as f32 + 0.5)
}

/// The texels of a lattice at most `reach` away from one along rows and columns, without itself.
fn around(lattice: &Lattice, texel: u32, reach: i32) -> impl Iterator<Item = u32> {
    let Lattice { first, width, height, .. } = *lattice;
    let reach = reach as u32;
    let (column, row) = ((texel - first) % width, (texel - first) / width);
    let rows = row.saturating_sub(reach)..(row + reach + 1).min(height);
    let columns = column.saturating_sub(reach)..(column + reach + 1).min(width);
    rows.flat_map(move |r| columns.clone().map(move |c| first + r * width + c))
        .filter(move |other| *other != texel)
}

/// The convex hull of a surface, counter-clockwise, in texels along `u` and `v` (Andrew 1979).
fn hull(surface: &Surface, lattice: &Lattice) -> Vec<Vec2> {
    let corners = surface.polygons.iter().flat_map(|p| &p.vertices);
    let mut points: Vec<Vec2> =
        corners.map(|v| surface.coordinates(*v) * lattice.density).collect();
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    let half = |points: &mut dyn Iterator<Item = Vec2>| {
        let mut chain: Vec<Vec2> = Vec::new();
        for p in points {
            while let [.., a, b] = chain[..] {
                if (b - a).perp_dot(p - b) > 0.0 {
                    break;
                }
                chain.pop();
            }
            chain.push(p);
        }
        chain.pop();
        chain
    };
    let mut hull = half(&mut points.iter().copied());
    hull.extend(half(&mut points.iter().rev().copied()));
    hull
}

/// Whether a segment parts anything of a surface: it does not if it runs outside its hull.
fn divides(segment: Segment, hull: &[Vec2]) -> bool {
    let mut before = hull.last().copied().unwrap_or_default();
    hull.iter().all(|corner| {
        let edge = (*corner - before).normalize_or_zero();
        let inside = segment.iter().any(|end| edge.perp_dot(*end - before) > BORDER);
        before = *corner;
        inside
    })
}

/// Whether a point lies on a segment, as far as rounding can tell.
fn grazes([a, b]: &Segment, p: Vec2) -> bool {
    let along = *b - *a;
    let t = ((p - *a).dot(along) / along.length_squared().max(f32::MIN_POSITIVE)).clamp(0.0, 1.0);
    (*a + along * t).distance(p) < MARGIN
}

#[cfg(test)]
mod tests;
