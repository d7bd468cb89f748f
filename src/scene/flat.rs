//! Faces of any kind to simple planar polygons in the unit ball. O(corners) but for concave faces.

use super::Fit;
use super::outline::{Outline, flatten, outline, twice_area};
use super::report::Tally;
use super::texture::Affine;
use super::triangulate::ears;
use glam::{DVec2, DVec3, Vec3};
use std::collections::HashMap;

/// How far the farthest vertex stays from the unit sphere, so that rounding cannot push it out.
const MARGIN: f64 = 1e-4;

/// Faces whose height over their longest reach is less than this, in the unit ball, have no area: it
/// is a few times what a coordinate in f32 can tell apart.
const THIN: f64 = 5e-7;

/// A corner may leave the plane of its face by this fraction of the face's reach, and by [`FLAT`].
const PLANAR: f64 = 1e-5;

/// What rounding in files of seven digits may move a corner off its plane by, in the unit ball.
pub(super) const FLAT: f64 = 2e-6;

/// A face as read: indices of its corners, its material's number and its line.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Face {
    /// Corners.
    pub corners: Vec<u32>,
    /// The place of its image that each corner shows, or none if that is not known; `None` without image.
    pub places: Option<Vec<DVec2>>,
    /// Number of the material.
    pub material: u32,
    /// Line in the OBJ file; 0 in files without lines.
    pub line: u32,
}

/// A simple planar polygon of positive area.
#[derive(Clone, Debug)]
pub(super) struct Flat {
    /// Corners, counter-clockwise about the normal.
    pub corners: Vec<u32>,
    /// Number of the material.
    pub material: u32,
    /// Unit normal.
    pub normal: DVec3,
    /// Area in the fitted scene's units.
    pub area: f64,
    /// Where an image lies on it.
    pub image: Option<Box<Affine>>,
}

/// What became of faces that were not taken as they stand.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tallies {
    /// Dropped: no area.
    pub no_area: Tally,
    /// Dropped: the outline crosses itself.
    pub crossing: Tally,
    /// Split: the outline touches itself.
    pub touching: Tally,
    /// Split: not planar.
    pub not_planar: Tally,
    /// Textured, but where is not known.
    pub no_places: Tally,
}

/// The ball about the middle of the bounding box of all faces that have an area; `None` without such.
pub(super) fn fit(positions: &[DVec3], faces: &[Face]) -> Option<Fit> {
    let used = || {
        faces
            .iter()
            .filter(|face| {
                let (twice, reach) = twice_area(positions, &face.corners);
                twice.length() > 1e-12 * reach * reach
            })
            .flat_map(|face| face.corners.iter().map(|c| positions[*c as usize]))
    };
    let low = used().reduce(DVec3::min)?;
    let high = used().reduce(DVec3::max)?;
    let centre = low + 0.5 * (high - low);
    let farthest = used().map(|p| p.distance(centre)).fold(0.0, f64::max);
    let radius = farthest * (1.0 + MARGIN);
    (radius > 0.0).then_some(Fit { centre, radius })
}

/// Positions in the unit ball, those that round to the same one welded, and the new index of each.
pub(super) fn weld(positions: &[DVec3], fit: &Fit) -> (Vec<Vec3>, Vec<u32>) {
    let mut seen: HashMap<[u32; 3], u32> = HashMap::with_capacity(positions.len());
    let mut points = Vec::new();
    let index = positions
        .iter()
        .map(|p| {
            // Adding zero turns -0 into +0.
            let p = fit.to_unit(*p) + Vec3::ZERO;
            *seen.entry(p.to_array().map(f32::to_bits)).or_insert_with(|| {
                points.push(p);
                (points.len() - 1) as u32
            })
        })
        .collect();
    (points, index)
}

/// Turns a face into polygons, counting what had to be changed.
pub(super) fn resolve(points: &[DVec3], face: &Face, tallies: &mut Tallies, out: &mut Vec<Flat>) {
    let kept = without_spikes(&face.corners);
    let corners = kept.iter().map(|k| face.corners[*k]).collect();
    let Some(mut whole) = flat(points, corners, face.material) else {
        tallies.no_area.add(face.line);
        return;
    };
    let loop_3d: Vec<DVec3> = whole.corners.iter().map(|c| points[*c as usize]).collect();
    let loop_2d = flatten(&loop_3d, whole.normal);
    let shape = outline(&loop_2d);
    if shape == Outline::Crossing {
        tallies.crossing.add(face.line);
        return;
    }
    let planar = is_planar(&loop_3d, whole.normal);
    let places = face.places.as_deref().unwrap_or_default();
    if face.places.is_some() && places.is_empty() {
        tallies.no_places.add(face.line);
    }
    // Where an image lies on some of the corners, if it lies evenly.
    let image = |normal: DVec3, of: &[usize]| {
        let placed = of.iter().filter_map(|k| Some((loop_3d[*k], *places.get(kept[*k])?)));
        Affine::of(normal, placed.clone()).filter(|affine| affine.fits(placed)).map(Box::new)
    };
    let even = places.is_empty() || {
        whole.image = image(whole.normal, &(0..kept.len()).collect::<Vec<_>>());
        whole.image.is_some() || kept.len() == 3
    };
    if planar && shape == Outline::Simple && even {
        out.push(whole);
        return;
    }
    let pieces = ears(&loop_2d);
    // Triangles of a loop that turns inside out over itself do not add up.
    let area = |[a, b, c]: [DVec2; 3]| (b - a).perp_dot(c - a);
    let sum: f64 = pieces.iter().map(|t| area(t.map(|i| loop_2d[i]))).sum();
    let own: f64 =
        (1..loop_2d.len() - 1).map(|i| area([loop_2d[0], loop_2d[i], loop_2d[i + 1]])).sum();
    if (sum - own).abs() > 1e-6 * own.abs() {
        tallies.crossing.add(face.line);
        return;
    }
    if !planar {
        tallies.not_planar.add(face.line);
    } else if shape == Outline::Touching {
        tallies.touching.add(face.line);
    }
    // A piece without area leaves no hole that anything could pass.
    out.extend(pieces.iter().filter_map(|t| {
        let piece = flat(points, t.map(|i| whole.corners[i]).to_vec(), face.material)?;
        Some(Flat { image: image(piece.normal, t), ..piece })
    }));
}

/// Which corners make a loop without repeated ones and without edges that go out and straight back.
fn without_spikes(corners: &[u32]) -> Vec<usize> {
    let mut kept: Vec<usize> = Vec::with_capacity(corners.len());
    for (k, &c) in corners.iter().enumerate() {
        if kept.last().is_some_and(|last| corners[*last] == c) {
            continue;
        }
        if kept.len() >= 2 && corners[kept[kept.len() - 2]] == c {
            kept.pop();
        } else {
            kept.push(k);
        }
    }
    let same = |a: usize, b: usize| corners[a] == corners[b];
    // The same where the end meets the start.
    let (mut from, mut to) = (0, kept.len());
    while to - from > 1 {
        if same(kept[from], kept[to - 1]) {
            to -= 1;
        } else if to - from > 2 && same(kept[from], kept[to - 2]) {
            to -= 2;
        } else if to - from > 2 && same(kept[from + 1], kept[to - 1]) {
            from += 1;
            to -= 1;
        } else {
            break;
        }
    }
    kept[from..to].to_vec()
}

/// A loop as a polygon, or `None` if it has no area.
fn flat(points: &[DVec3], corners: Vec<u32>, material: u32) -> Option<Flat> {
    if corners.len() < 3 {
        return None;
    }
    let (twice, reach) = twice_area(points, &corners);
    let length = twice.length();
    // Slivers so long and thin that the fit left them out may reach outside the ball.
    let inside = || corners.iter().all(|c| points[*c as usize].length_squared() < 1.0);
    let fits = length > THIN * reach && inside();
    let flat =
        || Flat { corners, material, normal: twice / length, area: 0.5 * length, image: None };
    fits.then(flat)
}

fn is_planar(points: &[DVec3], normal: DVec3) -> bool {
    let n = points.len() as f64;
    let middle = points.iter().sum::<DVec3>() / n;
    let reach = points.iter().map(|p| p.distance(middle)).fold(0.0, f64::max);
    points.iter().all(|p| (*p - middle).dot(normal).abs() <= PLANAR * reach + FLAT)
}
