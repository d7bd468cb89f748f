//! Which polygons come near a surface's plane: a hierarchy of boxes over all polygons of a scene.

use crate::ids::SurfaceId;
use crate::scene::{Polygon, Scene, Surface};
use glam::Vec3;

/// Polygons in a box that is not divided any further.
const FEW: usize = 4;

/// A polygon with the box around it.
struct Boxed<'a> {
    surface: SurfaceId,
    polygon: &'a Polygon,
    low: Vec3,
    high: Vec3,
}

/// The polygons, ordered so that every node of the hierarchy is a run of them: the halves of a node
/// are the nodes of its halves.
pub(super) struct Near<'a> {
    polygons: Vec<Boxed<'a>>,
    /// Boxes of the nodes, in the order in which a walk meets them.
    nodes: Vec<(Vec3, Vec3)>,
}

impl<'a> Near<'a> {
    /// Of a scene. O(n log n).
    pub(super) fn new(scene: &'a Scene) -> Near<'a> {
        let of = |surface: SurfaceId| {
            scene.surface(surface).polygons.iter().map(move |polygon| {
                let corners = || polygon.vertices.iter().copied();
                let low = corners().fold(Vec3::INFINITY, Vec3::min);
                let high = corners().fold(Vec3::NEG_INFINITY, Vec3::max);
                Boxed { surface, polygon, low, high }
            })
        };
        let mut polygons: Vec<Boxed> = scene.surface_ids().flat_map(of).collect();
        let mut nodes = Vec::new();
        divide(&mut polygons, &mut nodes);
        Near { polygons, nodes }
    }

    /// Calls `visit` with the polygons of other surfaces whose boxes come within `reach` of a
    /// surface's rectangle and of its plane.
    pub(super) fn visit(
        &self,
        id: SurfaceId,
        surface: &Surface,
        reach: f32,
        visit: &mut dyn FnMut(&'a Polygon),
    ) {
        let (u, v) = (surface.u * surface.extent.x, surface.v * surface.extent.y);
        let corners = [Vec3::ZERO, u, v, u + v].map(|c| surface.origin + c);
        let low = corners.iter().copied().fold(Vec3::INFINITY, Vec3::min) - reach;
        let high = corners.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max) + reach;
        let meets = |(from, to): (Vec3, Vec3)| {
            let (middle, half) = ((from + to) * 0.5, (to - from) * 0.5);
            let height = (middle - surface.origin).dot(surface.normal).abs();
            from.cmple(high).all()
                && to.cmpge(low).all()
                && height <= half.dot(surface.normal.abs()) + reach
        };
        let mut look = |p: &Boxed<'a>| {
            if p.surface != id && meets((p.low, p.high)) {
                visit(p.polygon);
            }
        };
        // Nodes as (number, first polygon, end).
        let mut open = vec![(0, 0, self.polygons.len())];
        while let Some((node, from, to)) = open.pop() {
            if from == to || !meets(self.nodes[node]) {
                continue;
            }
            if to - from <= FEW {
                self.polygons[from..to].iter().for_each(&mut look);
                continue;
            }
            let middle = usize::midpoint(from, to);
            open.push((node + 1 + nodes_of(middle - from), middle, to));
            open.push((node + 1, from, middle));
        }
    }
}

/// Nodes of a hierarchy over so many polygons.
fn nodes_of(polygons: usize) -> usize {
    if polygons <= FEW {
        return 1;
    }
    let half = polygons / 2;
    1 + nodes_of(half) + nodes_of(polygons - half)
}

/// Orders polygons into halves along their longest axis, again and again, and puts the boxes down.
fn divide(polygons: &mut [Boxed], nodes: &mut Vec<(Vec3, Vec3)>) {
    let low = polygons.iter().map(|p| p.low).fold(Vec3::INFINITY, Vec3::min);
    let high = polygons.iter().map(|p| p.high).fold(Vec3::NEG_INFINITY, Vec3::max);
    nodes.push((low, high));
    if polygons.len() > FEW {
        let axis = (high - low).max_position();
        let half = polygons.len() / 2;
        let at = |p: &Boxed| p.low[axis] + p.high[axis];
        polygons.select_nth_unstable_by(half, |a, b| at(a).total_cmp(&at(b)));
        let (first, second) = polygons.split_at_mut(half);
        divide(first, nodes);
        divide(second, nodes);
    }
}
