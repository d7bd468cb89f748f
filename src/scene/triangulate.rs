//! Polygons to triangles.

use super::Polygon;
use glam::Vec3;

/// Triangles of a polygon, as indices of its vertices.
pub fn triangles(polygon: &Polygon, _normal: Vec3) -> Vec<[usize; 3]> {
    (1..polygon.vertices.len() - 1).map(|i| [0, i, i + 1]).collect()
}
