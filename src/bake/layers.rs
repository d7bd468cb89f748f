//! Layers: every surface on every ray of a PSF, in order of depth, by rasterisation (section 3).
//!
//! In: the scene's outlines and a PSF. Out: for each cell a list of fragments sorted by depth, as in
//! a layered depth image (Shade et al. 1998). Each fragment carries the texel it lies in, found while
//! its span is filled. A cell holds a polygon when its middle lies inside; rows and spans are half
//! open, so that polygons that share an edge share no cell and leave none out. O(fragments).

use super::homes::Homes;
use super::transfer::clip::Projection;
use super::window::Window;
use crate::format::limits::Limits;
use crate::ids::{Cell, Sense, SurfaceId};
use crate::psf::Psf;
use crate::scene::contacts::Contacts;
use crate::scene::texels::Texels;
use crate::scene::{Polygon, Scene, Surface};
use glam::Vec3;
use std::collections::HashSet;
use std::mem::take;

/// Surfaces whose normal is closer to perpendicular to the direction than this are edge-on.
const EDGE_ON: f32 = 1e-5;

/// A surface on a ray. Ordered by depth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Fragment(u64);

const _: () = assert!(Limits::PUBLISHED.texels <= 1 << 31, "fragments cannot name all texels");

impl Fragment {
    /// A fragment at a depth in [-1, 1]; `faces_along` says whether the surface's normal points along
    /// the direction.
    pub fn new(depth: f32, texel: u32, faces_along: bool) -> Fragment {
        // With 2 added the depth is positive, and positive floats order as their bits do.
        let key = u64::from((depth + 2.0).to_bits()) << 32;
        Fragment(key | u64::from((texel << 1) | u32::from(faces_along)))
    }

    /// Depth along the PSF's direction, in the fitted scene's units.
    #[inline]
    pub fn depth(self) -> f32 {
        f32::from_bits((self.0 >> 32) as u32) - 2.0
    }

    /// The texel it lies in; of a mirror, the mirror's own number.
    #[inline]
    pub fn texel(self) -> u32 {
        self.0 as u32 >> 1
    }

    /// The same fragment in another texel.
    pub fn with_texel(self, texel: u32) -> Fragment {
        Fragment(self.0 >> 32 << 32 | u64::from((texel << 1) | u32::from(self.faces_along())))
    }

    /// Whether the surface's normal points along the direction.
    #[inline]
    pub fn faces_along(self) -> bool {
        self.0 & 1 == 1
    }

    /// The texture value of the side that faces one way.
    #[inline]
    pub fn value(self, facing: Sense) -> usize {
        match facing {
            Sense::Along => self.value_along(),
            Sense::Against => self.value_against(),
        }
    }

    /// The texture value of the side that faces along the direction: `2 texel + side`.
    #[inline]
    pub fn value_along(self) -> usize {
        (2 * self.texel() + u32::from(!self.faces_along())) as usize
    }

    /// The texture value of the side that faces against the direction.
    #[inline]
    pub fn value_against(self) -> usize {
        (2 * self.texel() + u32::from(self.faces_along())) as usize
    }
}

/// The scene's polygons laid out for rasterising; made once.
pub struct Outlines {
    surfaces: Vec<Plane>,
    polygons: Vec<Outline>,
    vertices: Vec<Vec3>,
    /// For each vertex whether the edge that ends there is a border of its surface, not one between two of
    /// the surface's polygons.
    borders: Vec<bool>,
    /// Which texels points of cut texels belong to.
    pub homes: Homes,
    /// Which surfaces lie in one plane, and which of them is in front.
    pub contacts: Contacts,
}

/// Where a surface lies and how its texels lie on it.
struct Plane {
    normal: Vec3,
    distance: f32,
    /// Normal and distance by which depths are found, if another surface's plane is its own too.
    shared: Option<(Vec3, f32)>,
    origin: Vec3,
    /// `u` and `v` in texels per unit length.
    texel_u: Vec3,
    texel_v: Vec3,
    first: u32,
    width: u32,
    height: u32,
    polygons: (u32, u32),
}

struct Outline {
    vertices: (u32, u32),
}

/// Rays along each edge of a cell that is split: 2 x 2 in the place of one.
pub const SPLIT: u32 = 2;

impl Outlines {
    /// Lays the scene's polygons out.
    pub fn new(scene: &Scene, texels: &Texels) -> Outlines {
        let mut out = Outlines {
            surfaces: Vec::new(),
            polygons: Vec::new(),
            vertices: Vec::new(),
            borders: Vec::new(),
            homes: Homes::new(texels),
            contacts: Contacts::new(scene),
        };
        let distance = |s: &Surface| s.normal.dot(s.origin);
        for (id, lattice) in scene.surface_ids().zip(&texels.lattices) {
            let surface = scene.surface(id);
            let plane: SurfaceId = out.contacts.plane_of(id);
            let shared = (plane != id).then(|| scene.surface(plane));
            let from = out.polygons.len() as u32;
            let inner = inner_edges(surface);
            for polygon in &surface.polygons {
                out.borders.extend(edges(polygon).map(|edge| !inner.contains(&edge)));
                let first = out.vertices.len() as u32;
                out.vertices.extend(&polygon.vertices);
                out.polygons.push(Outline { vertices: (first, out.vertices.len() as u32) });
            }
            out.surfaces.push(Plane {
                normal: surface.normal,
                distance: distance(surface),
                shared: shared.map(|s| (s.normal, distance(s))),
                origin: surface.origin,
                texel_u: surface.u * lattice.density.x,
                texel_v: surface.v * lattice.density.y,
                first: lattice.first,
                width: lattice.width,
                height: lattice.height,
                polygons: (from, out.polygons.len() as u32),
            });
        }
        out
    }

    /// Bytes of memory that they take.
    pub fn bytes(&self) -> u64 {
        let lists = size_of_val(self.surfaces.as_slice())
            + size_of_val(self.polygons.as_slice())
            + size_of_val(self.vertices.as_slice())
            + size_of_val(self.borders.as_slice());
        lists as u64 + self.homes.bytes() + self.contacts.bytes()
    }

    fn of(&self, plane: &Plane) -> &[Outline] {
        &self.polygons[plane.polygons.0 as usize..plane.polygons.1 as usize]
    }
}

/// A directed edge, by the bits of its ends.
type Edge = [[u32; 3]; 2];

/// The edges of a polygon, each before the vertex that it ends at.
fn edges(polygon: &Polygon) -> impl Iterator<Item = Edge> {
    let corners = &polygon.vertices;
    let bits = |k: usize| corners[k].to_array().map(f32::to_bits);
    (0..corners.len()).map(move |k| [bits((k + corners.len() - 1) % corners.len()), bits(k)])
}

/// The edges at which two polygons of a surface meet: each runs both ways.
fn inner_edges(surface: &Surface) -> HashSet<Edge> {
    if surface.polygons.len() == 1 {
        return HashSet::new();
    }
    let all: HashSet<Edge> = surface.polygons.iter().flat_map(edges).collect();
    all.iter().filter(|[a, b]| all.contains(&[*b, *a])).copied().collect()
}

/// How the cells of a PSF fall on the lattices of all surfaces. Those edge-on have no fragments; what
/// stands in their place is not to be used.
pub fn projections(outlines: &Outlines, psf: &Psf, out: &mut Vec<Projection>) {
    out.clear();
    out.extend(outlines.surfaces.iter().map(|plane| {
        let (size, first) = ([plane.width, plane.height], plane.first);
        let Some(Gradients { column, row, .. }) = Gradients::new(plane, psf) else {
            let none = [0.0; 2];
            return Projection { at_origin: none, per_column: none, per_row: none, first, size };
        };
        Projection {
            at_origin: [column.at_origin, row.at_origin],
            per_column: [column.per_column, row.per_column],
            per_row: [column.per_row, row.per_row],
            first,
            size,
        }
    }));
}

/// A function of column and row: `at_origin + x * per_column + y * per_row`.
#[derive(Clone, Copy)]
struct Affine {
    at_origin: f32,
    per_column: f32,
    per_row: f32,
}

/// How a surface's fragments vary over the cells of a PSF.
struct Gradients {
    depth: Affine,
    column: Affine,
    row: Affine,
    last_column: f32,
    last_row: f32,
    first: u32,
    width: u32,
    faces_along: bool,
}

impl Gradients {
    fn new(plane: &Plane, psf: &Psf) -> Option<Gradients> {
        let edge = psf.cell_edge();
        let (x0, y0) = origin_of(psf);
        let own = depth(plane.normal, plane.distance, psf)?;
        let origin = psf.right * x0 + psf.up * y0 + psf.direction * own.at_origin - plane.origin;
        let along_column = psf.right * edge + psf.direction * own.per_column;
        let along_row = psf.up * edge + psf.direction * own.per_row;
        let texel = |axis: Vec3| Affine {
            at_origin: origin.dot(axis),
            per_column: along_column.dot(axis),
            per_row: along_row.dot(axis),
        };
        Some(Gradients {
            depth: match plane.shared {
                Some((normal, distance)) => depth(normal, distance, psf)?,
                None => own,
            },
            column: texel(plane.texel_u),
            row: texel(plane.texel_v),
            last_column: (plane.width - 1) as f32,
            last_row: (plane.height - 1) as f32,
            first: plane.first,
            width: plane.width,
            faces_along: plane.normal.dot(psf.direction) > 0.0,
        })
    }
}

/// Where the first cell's corner lies along `right` and `up`.
fn origin_of(psf: &Psf) -> (f32, f32) {
    let edge = psf.cell_edge();
    (-psf.shift.x * edge - 1.0, -psf.shift.y * edge - 1.0)
}

/// How the depth of a plane varies; `None` if it is edge-on. On the plane `n . (right X + up Y +
/// direction Z) = distance`, with X, Y affine in the cell.
fn depth(normal: Vec3, distance: f32, psf: &Psf) -> Option<Affine> {
    let cosine = normal.dot(psf.direction);
    if cosine.abs() < EDGE_ON {
        return None;
    }
    let (edge, (x0, y0)) = (psf.cell_edge(), origin_of(psf));
    let zx = -normal.dot(psf.right) / cosine;
    let zy = -normal.dot(psf.up) / cosine;
    let z0 = distance / cosine + zx * x0 + zy * y0;
    Some(Affine { at_origin: z0, per_column: zx * edge, per_row: zy * edge })
}

impl Affine {
    fn in_row(self, y: f32) -> f32 {
        self.at_origin + y * self.per_row
    }
}

/// A surface's fragments in one row.
struct InRow<'a> {
    of: &'a Gradients,
    depth: f32,
    column: f32,
    row: f32,
    depths: (f32, f32),
}

impl<'a> InRow<'a> {
    fn new(span: &Span, of: &'a Gradients) -> InRow<'a> {
        let y = span.row as f32 + 0.5;
        let (depth, column, row) = (of.depth.in_row(y), of.column.in_row(y), of.row.in_row(y));
        InRow { of, depth, column, row, depths: span.depths }
    }

    #[inline]
    fn fragment(&self, column: u32) -> Fragment {
        let (x, g) = (column as f32 + 0.5, self.of);
        // Near edge-on planes the plane's own depth is too steep to be trusted beyond the polygon's.
        let z = (self.depth + x * g.depth.per_column).clamp(self.depths.0, self.depths.1);
        let c = (self.column + x * g.column.per_column).clamp(0.0, g.last_column) as u32;
        let r = (self.row + x * g.row.per_column).clamp(0.0, g.last_row) as u32;
        Fragment::new(z, g.first + r * g.width + c, g.faces_along)
    }
}

/// A run of cells of one row inside one polygon.
struct Span {
    row: u32,
    from: u32,
    to: u32,
    gradients: u32,
    depths: (f32, f32),
}

/// Every surface on every ray of one PSF. Reused from direction to direction.
#[derive(Default)]
pub struct Layers {
    resolution: u32,
    /// For each cell, row by row, its first fragment; one more at the end.
    first: Vec<u32>,
    fragments: Vec<Fragment>,
    projected: Vec<Vec3>,
    gradients: Vec<Gradients>,
    spans: Vec<Span>,
    crossings: Vec<f32>,
    window: Window,
    /// Cells of surfaces that receive, while a window is found.
    receiving: Window,
    split: Window,
}

/// The lines of a PSF that are wanted: those that meet surfaces of which one sends, and others receive.
pub struct Through<'a, S> {
    /// By surface, whether it may send; `None`: any does.
    pub senders: Option<&'a [bool]>,
    /// Whether one of these sends from a point.
    pub sends: S,
    /// By surface, whether it is to receive; `None`: any is.
    pub receivers: Option<&'a [bool]>,
}

/// The surfaces that a list names.
fn chosen<'a>(
    outlines: &'a Outlines,
    which: &'a [bool],
) -> impl Iterator<Item = (SurfaceId, &'a Plane)> {
    let all = outlines.surfaces.iter().zip(which).enumerate();
    all.filter(|(_, (_, chosen))| **chosen).map(|(id, (plane, _))| (SurfaceId(id as u32), plane))
}

impl Layers {
    /// Rasterises all surfaces along a PSF.
    pub fn rasterise(&mut self, outlines: &Outlines, psf: &Psf) {
        let n = psf.resolution;
        self.begin(outlines, psf);
        for plane in &outlines.surfaces {
            self.span_surface(outlines, psf, plane);
        }
        self.fill(n);
        self.sort();
    }

    /// Rasterises all surfaces, but only the cells on whose lines some send, or receive, or both. The
    /// cells are [`Layers::window`]; the fragments of the k-th are [`Layers::slot`] k.
    pub fn rasterise_through<S: Fn(SurfaceId, Vec3) -> bool>(
        &mut self,
        outlines: &Outlines,
        psf: &Psf,
        through: &Through<S>,
    ) {
        let n = psf.resolution;
        self.begin(outlines, psf);
        let (mut window, mut receiving) = (take(&mut self.window), take(&mut self.receiving));
        window.clear(n);
        receiving.clear(n);
        match through.receivers {
            Some(receivers) => self.open_surfaces(outlines, psf, receivers, &mut receiving),
            None => (0..n).for_each(|row| receiving.open(row, (0, n))),
        }
        match through.senders {
            Some(senders) => {
                // Spans of senders are found again, where these meet the window.
                let (spans, gradients) = (self.spans.len(), self.gradients.len());
                let senders = (senders, through);
                self.open_senders(outlines, psf, senders, (&receiving, &mut window));
                self.spans.truncate(spans);
                self.gradients.truncate(gradients);
            }
            None => std::mem::swap(&mut window, &mut receiving),
        }
        window.close();
        (self.window, self.receiving) = (window, receiving);
        let is_spanned = |surface: usize| through.receivers.is_some_and(|r| r[surface]);
        let planes = outlines.surfaces.iter().enumerate();
        self.span_in_window(outlines, psf, planes.map(|(s, plane)| (plane, is_spanned(s))));
        self.fill_window();
        self.sort();
    }

    /// Opens those cells of others of which a surface sends along their lines.
    fn open_senders<S: Fn(SurfaceId, Vec3) -> bool>(
        &mut self,
        outlines: &Outlines,
        psf: &Psf,
        (senders, through): (&[bool], &Through<S>),
        (among, window): (&Window, &mut Window),
    ) {
        for (surface, plane) in chosen(outlines, senders) {
            let first = self.spans.len();
            let Some(depth) = self.span_surface(outlines, psf, plane) else { continue };
            for span in &self.spans[first..] {
                let y = span.row as f32 + 0.5;
                let sends = |column: &u32| {
                    if !among.has(Cell { i: *column, j: span.row }) {
                        return false;
                    }
                    let x = *column as f32 + 0.5;
                    let z = depth.in_row(y) + x * depth.per_column;
                    let z = z.clamp(span.depths.0, span.depths.1);
                    (through.sends)(surface, psf.unproject(x, y, z))
                };
                for column in (span.from..span.to).filter(sends) {
                    window.open(span.row, (column, column + 1));
                }
            }
        }
    }

    /// Finds the spans of some surfaces, and opens their cells.
    fn open_surfaces(
        &mut self,
        outlines: &Outlines,
        psf: &Psf,
        which: &[bool],
        window: &mut Window,
    ) {
        for (_, plane) in chosen(outlines, which) {
            let first = self.spans.len();
            self.span_surface(outlines, psf, plane);
            for span in &self.spans[first..] {
                window.open(span.row, (span.from, span.to));
            }
        }
    }

    /// Finds the spans of a surface; returns how its depth varies, `None` if it is edge-on.
    fn span_surface(&mut self, outlines: &Outlines, psf: &Psf, plane: &Plane) -> Option<Affine> {
        let gradients = Gradients::new(plane, psf)?;
        let depth = gradients.depth;
        self.gradients.push(gradients);
        for polygon in outlines.of(plane) {
            self.span_polygon(polygon, psf.resolution, (0, psf.resolution));
        }
        Some(depth)
    }

    /// Finds the spans of the planes that are not done yet, as far as they may meet the window.
    fn span_in_window<'a>(
        &mut self,
        outlines: &Outlines,
        psf: &Psf,
        planes: impl Iterator<Item = (&'a Plane, bool)>,
    ) {
        for (plane, _) in planes.filter(|(_, done)| !done) {
            let mut known = false;
            for polygon in outlines.of(plane) {
                let range = polygon.vertices.0 as usize..polygon.vertices.1 as usize;
                if !self.window.may_meet(&self.projected[range]) {
                    continue;
                }
                if !known {
                    let Some(gradients) = Gradients::new(plane, psf) else { break };
                    self.gradients.push(gradients);
                    known = true;
                }
                self.span_polygon(polygon, psf.resolution, self.window.rows());
            }
        }
    }

    /// Finds the cells of the PSF that was rasterised which a border of a surface passes through. What
    /// their middle rays meet does not tell what the rays beside it do (section 5: "aliasing at polygon
    /// boundaries").
    pub fn find_split(&mut self, outlines: &Outlines) {
        let n = self.resolution;
        self.split.clear(n);
        for polygon in outlines.surfaces.iter().flat_map(|plane| outlines.of(plane)) {
            let range = polygon.vertices.0 as usize..polygon.vertices.1 as usize;
            let (loop_, borders) = (&self.projected[range.clone()], &outlines.borders[range]);
            let mut from = loop_[loop_.len() - 1];
            for (&to, is_border) in loop_.iter().zip(borders) {
                if *is_border {
                    open_along(&mut self.split, (from, to), n);
                }
                from = to;
            }
        }
        self.split.close();
    }

    /// Whether [`Layers::find_split`] found a cell.
    #[inline]
    pub fn is_split(&self, cell: Cell) -> bool {
        self.split.has(cell)
    }

    /// Rasterises all surfaces along `parted`, the PSF with its cells [`SPLIT`] by [`SPLIT`], but only
    /// in the split cells, which become [`Layers::window`].
    pub fn rasterise_split(&mut self, outlines: &Outlines, parted: &Psf) {
        self.begin(outlines, parted);
        self.window.clear(parted.resolution);
        for cell in self.split.cells() {
            for row in 0..SPLIT {
                self.window.open(SPLIT * cell.j + row, (SPLIT * cell.i, SPLIT * (cell.i + 1)));
            }
        }
        self.window.close();
        let planes = outlines.surfaces.iter().map(|plane| (plane, false));
        self.span_in_window(outlines, parted, planes);
        self.fill_window();
        self.sort();
    }

    fn begin(&mut self, outlines: &Outlines, psf: &Psf) {
        self.resolution = psf.resolution;
        self.projected.clear();
        self.projected.extend(outlines.vertices.iter().map(|v| psf.project(*v)));
        self.gradients.clear();
        self.spans.clear();
    }

    fn sort(&mut self) {
        for bounds in self.first.windows(2) {
            sort_few(&mut self.fragments[bounds[0] as usize..bounds[1] as usize]);
        }
    }

    /// Finds a polygon's spans, row by row, even-odd.
    fn span_polygon(&mut self, polygon: &Outline, n: u32, rows: (u32, u32)) {
        let loop_ = &self.projected[polygon.vertices.0 as usize..polygon.vertices.1 as usize];
        let (mut low, mut high) = (loop_[0], loop_[0]);
        for v in loop_ {
            low = low.min(*v);
            high = high.max(*v);
        }
        let (from_row, to_row) = cells_between(low.y, high.y, n);
        let (from_row, to_row) = (from_row.max(rows.0), to_row.min(rows.1));
        for row in from_row..to_row {
            let y = row as f32 + 0.5;
            self.crossings.clear();
            let mut a = loop_[loop_.len() - 1];
            for &b in loop_ {
                if (a.y <= y) != (b.y <= y) {
                    // From the lower end, so that both polygons of an edge find the same crossing.
                    let (p, q) = if (a.y, a.x) <= (b.y, b.x) { (a, b) } else { (b, a) };
                    self.crossings.push(p.x + (y - p.y) * ((q.x - p.x) / (q.y - p.y)));
                }
                a = b;
            }
            if self.crossings.len() > 2 {
                self.crossings.sort_unstable_by(f32::total_cmp);
            }
            for pair in self.crossings.chunks_exact(2) {
                let (left, right) = (pair[0].min(pair[1]), pair[0].max(pair[1]));
                let (from, to) = cells_between(left, right, n);
                if from < to {
                    let gradients = (self.gradients.len() - 1) as u32;
                    self.spans.push(Span { row, from, to, gradients, depths: (low.z, high.z) });
                }
            }
        }
    }

    /// Turns spans into fragments by a counting sort over cells.
    fn fill(&mut self, n: u32) {
        let cells = (n * n) as usize;
        self.first.clear();
        self.first.resize(cells + 1, 0);
        for span in &self.spans {
            let row = (span.row * n) as usize;
            for count in &mut self.first[row + span.from as usize..row + span.to as usize] {
                *count += 1;
            }
        }
        self.ends_from_counts();
        for span in &self.spans {
            let of = InRow::new(span, &self.gradients[span.gradients as usize]);
            let first = (span.row * n + span.from) as usize;
            let slots = &mut self.first[first..first + (span.to - span.from) as usize];
            for (k, slot) in slots.iter_mut().enumerate() {
                *slot -= 1;
                self.fragments[*slot as usize] = of.fragment(span.from + k as u32);
            }
        }
    }

    /// The same for the window's cells only.
    fn fill_window(&mut self) {
        self.first.clear();
        self.first.resize(self.window.cells().len() + 1, 0);
        for span in &self.spans {
            self.window.for_each(span.row, (span.from, span.to), |slot, _| self.first[slot] += 1);
        }
        self.ends_from_counts();
        for span in &self.spans {
            let of = InRow::new(span, &self.gradients[span.gradients as usize]);
            self.window.for_each(span.row, (span.from, span.to), |slot, column| {
                self.first[slot] -= 1;
                self.fragments[self.first[slot] as usize] = of.fragment(column);
            });
        }
    }

    /// Each count becomes the end of its cell; filling moves it back to the beginning.
    fn ends_from_counts(&mut self) {
        let mut total = 0;
        for count in &mut self.first {
            total += *count;
            *count = total;
        }
        self.fragments.clear();
        self.fragments.resize(total as usize, Fragment(0));
    }

    /// The cells that were rasterised through the window, row by row.
    pub fn window(&self) -> &[Cell] {
        self.window.cells()
    }

    /// The fragments of the window's k-th cell, or, without a window, of the k-th cell of the grid.
    #[inline]
    pub fn slot(&mut self, k: usize) -> &mut [Fragment] {
        &mut self.fragments[self.first[k] as usize..self.first[k + 1] as usize]
    }

    /// Cells along an edge.
    pub fn resolution(&self) -> u32 {
        self.resolution
    }

    /// The fragments of the cell in column `i`, row `j`, nearest along the direction first.
    #[inline]
    pub fn cell(&mut self, i: u32, j: u32) -> &mut [Fragment] {
        self.slot((j * self.resolution + i) as usize)
    }

    /// Number of fragments over all cells.
    pub fn len(&self) -> usize {
        self.fragments.len()
    }

    /// Whether no surface was met.
    pub fn is_empty(&self) -> bool {
        self.fragments.is_empty()
    }
}

/// Columns (or rows) whose middle lies in `[low, high)`, inside the grid.
fn cells_between(low: f32, high: f32, n: u32) -> (u32, u32) {
    let first = |v: f32| {
        // Rounded up by hand: without SSE 4.1 it would be a call.
        let at = (v - 0.5).clamp(0.0, n as f32);
        let below = at as u32;
        below + u32::from(at > below as f32)
    };
    (first(low), first(high))
}

/// Opens the cells that a line from one place (column, row) to another passes through.
fn open_along(window: &mut Window, (a, b): (Vec3, Vec3), n: u32) {
    let (p, q) = if a.y <= b.y { (a, b) } else { (b, a) };
    let within = |v: f32| (v.max(0.0) as u32).min(n);
    let last = within(q.y.floor() + 1.0);
    for row in within(p.y)..last {
        // The part of the line between the row's edges.
        let (low, high) = ((row as f32).max(p.y), (row as f32 + 1.0).min(q.y));
        let at = |y: f32| p.x + (y - p.y) * ((q.x - p.x) / (q.y - p.y));
        let (x, z) = if q.y > p.y { (at(low), at(high)) } else { (p.x, q.x) };
        let (from, to) = (within(x.min(z)), within(x.max(z).floor() + 1.0));
        if from < to {
            window.open(row, (from, to));
        }
    }
}

/// Insertion sort: most cells hold a handful.
fn sort_few(fragments: &mut [Fragment]) {
    if fragments.len() > 24 {
        return fragments.sort_unstable();
    }
    for i in 1..fragments.len() {
        let item = fragments[i];
        let mut k = i;
        while k > 0 && fragments[k - 1] > item {
            fragments[k] = fragments[k - 1];
            k -= 1;
        }
        fragments[k] = item;
    }
}

#[cfg(test)]
mod tests;
