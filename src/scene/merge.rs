//! Polygons to surfaces: coplanar polygons of one material that share edges become one, if an image
//! on them lies evenly on all.
//!
//! Regions grow from the largest polygon left over shared edges, and every corner is held against one
//! plane for the whole region, so that a finely divided curve cannot creep into one surface.
//! O(n log n) in the corners; the same scene gives the same surfaces in the same order.

use super::dissolve::dissolved;
use super::flat::{FLAT, Flat};
use super::overlap::overlap;
use super::texture::Affine;
use super::{Material, Polygon, Surface};
use crate::ids::MaterialId;
use glam::{DVec2, DVec3, Vec2, Vec3};
use std::collections::HashSet;
use std::ops::Range;

/// Neighbours whose normals differ by more than this cosine are not compared any further.
const ALIGNED: f64 = 0.999;

/// How often a region's plane is fitted again; each time its reach grows severalfold.
const MOST_FITS: usize = 16;

/// Edges shared by more polygons than this are not merged over: comparing all pairs is quadratic.
const MOST_AT_AN_EDGE: usize = 16;

/// Merges polygons into surfaces, in the order of each surface's first polygon.
pub(super) fn merge(
    points: &[DVec3],
    mut flats: Vec<Flat>,
    materials: &[Material],
) -> Vec<Surface> {
    let neighbours = Neighbours::new(&flats);
    let mut seeds: Vec<u32> = (0..flats.len() as u32).collect();
    // A large polygon's plane is the surest. Areas are finite.
    seeds.sort_by(|&a, &b| {
        flats[b as usize].area.total_cmp(&flats[a as usize].area).then(a.cmp(&b))
    });
    let mut taken = vec![false; flats.len()];
    // All groups behind each other, each as its first polygon and its range.
    let mut members: Vec<u32> = Vec::with_capacity(flats.len());
    let mut groups: Vec<(u32, Range<u32>)> = Vec::new();
    for seed in seeds {
        if taken[seed as usize] {
            continue;
        }
        let mut group = grow(points, &flats, &neighbours, &mut taken, seed);
        group.sort_unstable();
        // One polygon cannot, nor can two triangles on the two sides of an edge.
        let corners: usize = group.iter().map(|p| flats[*p as usize].corners.len()).sum();
        let sure = group.len() == 1 || group.len() == 2 && corners == 6;
        let pieces = if !sure && overlaps(points, &flats, &group) { 1 } else { group.len() };
        for piece in group.chunks(pieces) {
            let first = members.len() as u32;
            members.extend(piece);
            groups.push((piece[0], first..members.len() as u32));
        }
    }
    drop(neighbours);
    groups.sort_unstable_by_key(|(first, _)| *first);
    let group = |range: &Range<u32>| &members[range.start as usize..range.end as usize];
    // A polygon's corners are let go of as soon as its surface has them: of a large scene they are much.
    let mut made = |(_, range): &(u32, Range<u32>)| {
        let group = group(range);
        let surface = surface(points, &flats, materials, group);
        group.iter().for_each(|p| flats[*p as usize].corners = Vec::new());
        surface
    };
    groups.iter().map(&mut made).collect()
}

/// The polygons reached from a seed over shared edges that lie in one plane with it, within [`FLAT`].
///
/// The plane of a small seed is not sure enough to reach across a large wall, so it is fitted again to
/// what has been found, and kept as long as everything found lies in it.
fn grow(
    points: &[DVec3],
    flats: &[Flat],
    neighbours: &Neighbours,
    taken: &mut [bool],
    seed: u32,
) -> Vec<u32> {
    taken[seed as usize] = true;
    let mut group = vec![seed];
    for _ in 0..MOST_FITS {
        let found = group.len();
        let (normal, middle) = plane_of(points, flats, &group);
        let image = image_of(points, flats, normal, &group);
        let lies_in = |polygon: u32| {
            let flat = &flats[polygon as usize];
            let mut corners = flat.corners.iter();
            corners.all(|c| (points[*c as usize] - middle).dot(normal).abs() <= FLAT)
                && match (image, &flat.image) {
                    (None, None) => true,
                    (Some(image), Some(_)) => image.fits(shown(points, flat)),
                    _ => false,
                }
        };
        if !group.iter().all(|p| lies_in(*p)) {
            break;
        }
        let mut next = 0;
        while next < group.len() {
            for &other in neighbours.of(group[next]) {
                let aligned = flats[other as usize].normal.dot(normal) > ALIGNED;
                if !taken[other as usize] && aligned && lies_in(other) {
                    taken[other as usize] = true;
                    group.push(other);
                }
            }
            next += 1;
        }
        if group.len() == found {
            break;
        }
    }
    group
}

/// The plane that fits some polygons: unit normal by area, and the mean of the corners.
fn plane_of(points: &[DVec3], flats: &[Flat], group: &[u32]) -> (DVec3, DVec3) {
    let members = || group.iter().map(|p| &flats[*p as usize]);
    let normal = members().map(|f| f.normal * f.area).sum::<DVec3>();
    let corners = members().flat_map(|f| f.corners.iter().map(|c| points[*c as usize]));
    let count = members().map(|f| f.corners.len()).sum::<usize>() as f64;
    (normal.normalize_or(flats[group[0] as usize].normal), corners.sum::<DVec3>() / count)
}

/// The corners of a polygon and the places of its image that they show.
fn shown<'a>(
    points: &'a [DVec3],
    flat: &'a Flat,
) -> impl Iterator<Item = (DVec3, DVec2)> + Clone + use<'a> {
    let corners = flat.corners.iter().map(|c| points[*c as usize]);
    flat.image
        .as_deref()
        .into_iter()
        .flat_map(move |image| corners.clone().map(move |p| (p, image.at(p))))
}

/// Where the image of some polygons lies, if they have one.
fn image_of(points: &[DVec3], flats: &[Flat], normal: DVec3, group: &[u32]) -> Option<Affine> {
    match group {
        [] => None,
        [one] => flats[*one as usize].image.as_deref().copied(),
        many => {
            flats[many[0] as usize].image.as_ref()?;
            Affine::of(normal, many.iter().flat_map(|p| shown(points, &flats[*p as usize])))
        }
    }
}

/// Which polygons share an edge and could be one surface.
struct Neighbours {
    /// Where each polygon's neighbours start in `list`; one more at the end.
    starts: Vec<u32>,
    list: Vec<u32>,
}

impl Neighbours {
    fn new(flats: &[Flat]) -> Neighbours {
        // Every edge as (lower corner, higher corner, polygon, whether it runs upwards).
        let mut edges: Vec<(u32, u32, u32, bool)> = Vec::new();
        for (i, flat) in flats.iter().enumerate() {
            for (a, b) in edges_of(flat) {
                edges.push((a.min(b), a.max(b), i as u32, a < b));
            }
        }
        edges.sort_unstable();
        let mut pairs: Vec<(u32, u32)> = Vec::new();
        for shared in edges.chunk_by(|e, f| (e.0, e.1) == (f.0, f.1)) {
            if shared.len() > MOST_AT_AN_EDGE {
                continue;
            }
            // Two polygons that run along an edge in opposite senses lie on its two sides. Where a
            // third one matches as well, two of them overlap and none is merged.
            let partners = |e: &(u32, u32, u32, bool)| {
                let flat = &flats[e.2 as usize];
                let mut fitting = shared.iter().filter(move |o| {
                    let other = &flats[o.2 as usize];
                    o.2 != e.2
                        && o.3 != e.3
                        && other.material == flat.material
                        && other.normal.dot(flat.normal) > ALIGNED
                });
                fitting.next().filter(|_| fitting.next().is_none())
            };
            for edge in shared {
                if let Some(other) = partners(edge)
                    && partners(other).is_some_and(|back| back == edge)
                {
                    pairs.push((edge.2, other.2));
                }
            }
        }
        pairs.sort_unstable();
        let mut starts = vec![0u32; flats.len() + 1];
        for &(from, _) in &pairs {
            starts[from as usize + 1] += 1;
        }
        for i in 0..flats.len() {
            starts[i + 1] += starts[i];
        }
        Neighbours { starts, list: pairs.into_iter().map(|(_, to)| to).collect() }
    }

    fn of(&self, polygon: u32) -> &[u32] {
        let i = polygon as usize;
        &self.list[self.starts[i] as usize..self.starts[i + 1] as usize]
    }
}

/// The edges of some polygons of one plane that do not also run the other way: inner ones do, diagonals of
/// divided rectangles among them.
fn outer_edges(flats: &[Flat], group: &[u32]) -> Vec<(u32, u32)> {
    let all = || group.iter().flat_map(|p| edges_of(&flats[*p as usize]));
    if group.len() == 1 {
        return all().collect();
    }
    let known: HashSet<(u32, u32)> = all().collect();
    all().filter(|(a, b)| !known.contains(&(*b, *a))).collect()
}

fn edges_of(flat: &Flat) -> impl Iterator<Item = (u32, u32)> {
    let c = &flat.corners;
    (0..c.len()).map(move |i| (c[i], c[(i + 1) % c.len()]))
}

/// Whether any two polygons of a group overlap in its plane: a plane winding over itself can.
fn overlaps(points: &[DVec3], flats: &[Flat], group: &[u32]) -> bool {
    let normal: DVec3 = group.iter().map(|p| flats[*p as usize].normal).sum();
    let (u, v) = normal.normalize_or(DVec3::Z).any_orthonormal_pair();
    let loops: Vec<Vec<DVec2>> = group
        .iter()
        .map(|p| {
            let corners = flats[*p as usize].corners.iter().map(|c| points[*c as usize]);
            corners.map(|p| DVec2::new(p.dot(u), p.dot(v))).collect()
        })
        .collect();
    overlap(&loops, FLAT)
}

/// One surface of a group of polygons, its axes along the longest edge of its boundary.
fn surface(points: &[DVec3], flats: &[Flat], materials: &[Material], group: &[u32]) -> Surface {
    let members = || group.iter().map(|p| &flats[*p as usize]);
    let corners = || members().flat_map(|f| f.corners.iter().map(|c| points[*c as usize]));
    let (normal, middle) = plane_of(points, flats, group);

    let outer = outer_edges(flats, group);
    let mut along = DVec3::ZERO;
    for &(a, b) in &outer {
        let edge = points[b as usize] - points[a as usize];
        // A little more, so that rounding does not choose between equal edges.
        if edge.length() > along.length() * (1.0 + 1e-5) {
            along = edge;
        }
    }
    let along = along - normal * along.dot(normal);
    let u = along.normalize_or(normal.any_orthonormal_vector());
    let v = normal.cross(u);
    let plane = |p: DVec3| DVec2::new((p - middle).dot(u), (p - middle).dot(v));
    let low = corners().map(plane).fold(DVec2::INFINITY, DVec2::min);
    let high = corners().map(plane).fold(DVec2::NEG_INFINITY, DVec2::max);
    let extent: Vec2 = (high - low).as_vec2();
    let polygon = |corners: &[u32]| Polygon {
        vertices: corners.iter().map(|c| points[*c as usize].as_vec3()).collect::<Vec<Vec3>>(),
    };
    let whole = (group.len() > 1).then(|| dissolved(points, &outer, normal)).flatten();
    let polygons = match whole {
        Some(corners) => vec![polygon(&corners)],
        None => members().map(|f| polygon(&f.corners)).collect(),
    };
    let material = flats[group[0] as usize].material;
    let corner = middle + u * low.x + v * low.y;
    let placement = materials[material as usize].texture.and_then(|texture| {
        image_of(points, flats, normal, group)?.on(corner, u, v, texture.clamp)
    });
    Surface {
        material: MaterialId(material),
        normal: normal.as_vec3(),
        origin: corner.as_vec3(),
        u: u.as_vec3(),
        v: v.as_vec3(),
        extent,
        fineness: 0,
        polygons,
        placement: placement.map(Box::new),
    }
}
