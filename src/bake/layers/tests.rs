use super::*;
use crate::radiance::Rgb;
use crate::scene::test_scenes::{material, quad, scene_of};
use crate::scene::{Polygon, Reflectance, Surface};
use glam::Vec2;
use proptest::prelude::*;

fn rectangle(corner: Vec3, a: Vec3, b: Vec3) -> Surface {
    quad(0, corner, a, b)
}

fn scene(surfaces: Vec<Surface>) -> Scene {
    let white = material("white", 0.0, Reflectance::Diffuse(Rgb::splat(0.5)));
    scene_of(surfaces, vec![white])
}

/// Where the ray through a cell's middle meets a rectangle: depth, texel, and by how much of its
/// edges it misses or meets (in double precision, from the definition).
fn meet(surface: &Surface, psf: &Psf, x: f64, y: f64) -> Option<(f64, Vec2, f64)> {
    let edge = 2.0 / f64::from(psf.resolution);
    let (right, up, w) = (psf.right.as_dvec3(), psf.up.as_dvec3(), psf.direction.as_dvec3());
    let at = |c: f64, s: f32| (c - f64::from(s)) * edge - 1.0;
    let from = right * at(x, psf.shift.x) + up * at(y, psf.shift.y);
    let normal = surface.normal.as_dvec3();
    let depth = (surface.origin.as_dvec3() - from).dot(normal) / w.dot(normal);
    let p = from + w * depth - surface.origin.as_dvec3();
    let (u, v) = (p.dot(surface.u.as_dvec3()), p.dot(surface.v.as_dvec3()));
    let extent = surface.extent.as_dvec2();
    let inside = u.min(extent.x - u).min(v).min(extent.y - v);
    depth.is_finite().then(|| (depth, Vec2::new(u as f32, v as f32), inside))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    /// Of all cells those come that hold a sender, a receiver, or both, as is asked, as they are among all.
    #[test]
    fn lines_through_senders_and_receivers_are_those_of_the_whole_that_meet_them(
        rectangles in prop::collection::vec(
            (prop::array::uniform3(-0.4f32..0.4), prop::array::uniform3(-0.5f32..0.5)), 1..8),
        sends in prop::array::uniform8(any::<bool>()),
        receives in prop::array::uniform8(any::<bool>()),
        asked in 1..4u8,
        direction in prop::array::uniform3(-1.0f32..1.0),
    ) {
        let direction = Vec3::from(direction);
        prop_assume!(direction.length() > 0.1);
        let placed = rectangles.into_iter().map(|(corner, a)| (Vec3::from(corner), Vec3::from(a)));
        let wide = |(corner, a): (Vec3, Vec3)| rectangle(corner, a, a.any_orthonormal_vector() * 0.3);
        let scene = scene(placed.filter(|(_, a)| a.length() > 0.02).map(wide).collect());
        let psf = Psf::new(direction.normalize(), 16);
        let texels = Texels::new(&scene, psf.cell_edge());
        let outlines = Outlines::new(&scene, &texels);
        let all_may: [&[bool]; 2] = [&sends, &receives];
        let named = |k: usize| (asked >> k & 1 == 1).then(|| &all_may[k][..scene.surfaces.len()]);
        let through =
            Through { senders: named(0), sends: |_, _| true, receivers: named(1) };
        let (mut all, mut some) = (Layers::default(), Layers::default());
        all.rasterise(&outlines, &psf);
        some.rasterise_through(&outlines, &psf, &through);
        let mut expected = Vec::new();
        for cell in (0..16).flat_map(|j| (0..16).map(move |i| Cell { i, j })) {
            let fragments = all.cell(cell.i, cell.j).to_vec();
            let meets = |which: &[bool]| {
                let of = |f: &Fragment| which[texels.surface_of[f.texel() as usize] as usize];
                fragments.iter().any(of)
            };
            if [0, 1].into_iter().all(|k| named(k).is_none_or(meets)) {
                expected.push((cell, fragments));
            }
        }
        let cells = some.window().to_vec();
        let found: Vec<_> =
            cells.into_iter().enumerate().map(|(k, cell)| (cell, some.slot(k).to_vec())).collect();
        prop_assert_eq!(found, expected);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    /// Where a cell is not split, all its rays meet the same surfaces; where it is, those of its parts
    /// are what the PSF of parted cells has there.
    #[test]
    fn a_cell_whose_rays_differ_is_split(
        rectangles in prop::collection::vec(
            (prop::array::uniform3(-0.4f32..0.4), prop::array::uniform3(-0.5f32..0.5)), 1..8),
        direction in prop::array::uniform3(-1.0f32..1.0),
        shift in prop::array::uniform2(-0.5f32..0.5),
    ) {
        let direction = Vec3::from(direction);
        prop_assume!(direction.length() > 0.1);
        let placed = rectangles.into_iter().map(|(corner, a)| (Vec3::from(corner), Vec3::from(a)));
        let placed = placed.filter(|(_, a)| a.length() > 0.02);
        let wide = |(corner, a): (Vec3, Vec3)| rectangle(corner, a, a.any_orthonormal_vector() * 0.3);
        let scene = scene(placed.map(wide).collect());
        let psf = Psf::new(direction.normalize(), 16).shifted(Vec2::from(shift));
        let parted = psf.parted(SPLIT);
        let texels = Texels::new(&scene, psf.cell_edge());
        let outlines = Outlines::new(&scene, &texels);
        let surfaces = |fragments: &mut [Fragment]| -> Vec<u32> {
            let of = |f: &Fragment| texels.surface_of[f.texel() as usize];
            let mut surfaces: Vec<u32> = fragments.iter().map(of).collect();
            // Where two cross, their order changes from ray to ray without a border.
            surfaces.sort_unstable();
            surfaces
        };
        let (mut own, mut all) = (Layers::default(), Layers::default());
        own.rasterise(&outlines, &psf);
        own.find_split(&outlines);
        all.rasterise(&outlines, &parted);
        for cell in (0..16 * 16).map(|k| Cell { i: k % 16, j: k / 16 }) {
            for part in 0..SPLIT * SPLIT {
                let (i, j) = (SPLIT * cell.i + part % SPLIT, SPLIT * cell.j + part / SPLIT);
                let same = surfaces(all.cell(i, j)) == surfaces(own.cell(cell.i, cell.j));
                prop_assert!(same || own.is_split(cell));
            }
        }
        own.rasterise_split(&outlines, &parted);
        for (slot, cell) in own.window().to_vec().into_iter().enumerate() {
            prop_assert_eq!(surfaces(own.slot(slot)), surfaces(all.cell(cell.i, cell.j)));
            let whole = Cell { i: cell.i / SPLIT, j: cell.j / SPLIT };
            prop_assert!(own.is_split(whole));
        }
    }

    /// Rectangles strewn about: each ray meets those that the definition says, in that order, in
    /// those texels, from those sides.
    #[test]
    fn every_ray_meets_what_a_brute_force_search_finds(
        rectangles in prop::collection::vec(
            (prop::array::uniform3(-0.4f32..0.4), prop::array::uniform3(-0.5f32..0.5),
             prop::array::uniform3(-0.5f32..0.5)), 1..12),
        direction in prop::array::uniform3(-1.0f32..1.0),
        shift in prop::array::uniform2(-0.5f32..0.5),
    ) {
        let direction = Vec3::from(direction);
        prop_assume!(direction.length() > 0.1);
        let mut surfaces = Vec::new();
        for (corner, a, b) in rectangles {
            let (corner, a) = (Vec3::from(corner), Vec3::from(a) * 0.6);
            let b = a.cross(Vec3::from(b));
            if a.length() > 0.02 && b.length() > 1e-3 {
                surfaces.push(rectangle(corner, a, b.normalize() * 0.3));
            }
        }
        let scene = scene(surfaces);
        let n = 16;
        let psf = Psf::new(direction.normalize(), n).shifted(Vec2::from(shift));
        let texels = Texels::new(&scene, psf.cell_edge());
        let mut layers = Layers::default();
        layers.rasterise(&Outlines::new(&scene, &texels), &psf);
        for cell in 0..n * n {
            let (i, j) = (cell % n, cell / n);
            let (x, y) = (f64::from(i) + 0.5, f64::from(j) + 0.5);
            let mut expected = Vec::new();
            let mut unsure = Vec::new();
            for id in scene.surface_ids() {
                let surface = scene.surface(id);
                let cosine = surface.normal.dot(psf.direction);
                let Some((depth, at, inside)) = meet(surface, &psf, x, y) else { continue };
                // Edge-on planes and rays along an edge are rounding's to decide.
                if cosine.abs() < 1e-3 || inside.abs() < 1e-5 / f64::from(cosine.abs()) {
                    unsure.push(id.0);
                } else if inside > 0.0 {
                    expected.push((depth, id.0, at, cosine > 0.0));
                }
            }
            expected.sort_by(|a, b| a.0.total_cmp(&b.0));
            let found: Vec<Fragment> = layers
                .cell(i, j)
                .iter()
                .filter(|f| !unsure.contains(&texels.surface_of[f.texel() as usize]))
                .copied()
                .collect();
            prop_assert_eq!(found.len(), expected.len());
            for (f, (depth, _, _, _)) in found.iter().zip(&expected) {
                prop_assert!((f64::from(f.depth()) - depth).abs() < 1e-3);
            }
            for f in &found {
                let surface = texels.surface_of[f.texel() as usize];
                let e = expected.iter().find(|e| e.1 == surface);
                let Some((depth, _, at, along)) = e else {
                    return Err(TestCaseError::fail(format!("surface {surface} is not there")));
                };
                prop_assert!((f64::from(f.depth()) - depth).abs() < 1e-4);
                prop_assert_eq!(f.faces_along(), *along);
                let lattice = texels.lattices[surface as usize];
                let inside = f.texel() - lattice.first;
                let middle = Vec2::new(
                    (inside % lattice.width) as f32 + 0.5,
                    (inside / lattice.width) as f32 + 0.5,
                );
                let off = (*at * lattice.density - middle).abs();
                prop_assert!(off.max_element() < 0.51, "texel {middle} for {at}");
            }
            // In order wherever depths differ by more than their rounding.
            for pair in found.windows(2) {
                prop_assert!(pair[0].depth() <= pair[1].depth());
            }
        }
    }
}

#[test]
fn halves_of_a_square_share_no_cell_and_leave_none_out() {
    // Two triangles with their diagonal through the middles of cells, and a fan about a middle.
    let v = |x: f32, y: f32| Vec3::new(x, y, 0.0);
    let corners = [v(-0.5, -0.5), v(0.5, -0.5), v(0.5, 0.5), v(-0.5, 0.5)];
    let middle = v(1.0 / 16.0, 1.0 / 16.0);
    let mut fan = rectangle(corners[0], Vec3::X, Vec3::Y);
    fan.polygons = (0..4)
        .map(|k| Polygon { vertices: vec![corners[k], corners[(k + 1) % 4], middle] })
        .collect();
    let mut halves = rectangle(corners[0], Vec3::X, Vec3::Y);
    halves.polygons = [[0, 1, 2], [0, 2, 3]]
        .map(|t| Polygon { vertices: t.map(|k: usize| corners[k]).to_vec() })
        .to_vec();
    for surface in [fan, halves] {
        let scene = scene(vec![surface]);
        let psf = Psf::new(Vec3::Z, 16);
        let texels = Texels::new(&scene, psf.cell_edge());
        let mut layers = Layers::default();
        layers.rasterise(&Outlines::new(&scene, &texels), &psf);
        for cell in 0..256 {
            let (i, j) = (cell % 16, cell / 16);
            let inside = (4..12).contains(&i) && (4..12).contains(&j);
            assert_eq!(layers.cell(i, j).len(), usize::from(inside), "cell {i}, {j}");
        }
        assert_eq!(layers.len(), 64);
    }
}
