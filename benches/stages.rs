//! Times the stages that a bake and a look spend their time in, on the bundled office; see the README
//! beside this file.

use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use glam::Vec3;
use std::path::PathBuf;
use std::sync::LazyLock;
use std::sync::atomic::AtomicBool;
use tempfile::TempDir;
use vlf::bake::layers::{Layers, Outlines};
use vlf::bake::marks::Marks;
use vlf::bake::step::{Cycle, Scratch, Shared, shoot};
use vlf::bake::totals::{self, Mirrors};
use vlf::bake::transfer::clip::{Clip, Ground, Projection};
use vlf::bake::transfer::{self, Current, FROM_OUTSIDE, Quantum, Shot};
use vlf::bake::{Options, emission, texels};
use vlf::field::Terms;
use vlf::field::storage::disk::Disk;
use vlf::format::container::{self, ChunkKind, FileKind, encode, unencoded};
use vlf::format::limits::Limits;
use vlf::format::tiles::{Layout, TileMap, exponent_for, half_to_f32, to_planes};
use vlf::pack::{PackReport, pack_from};
use vlf::scene::texels::Texels;
use vlf::{
    Camera, Cell, Codec, DirectionId, Directions, LightField, Parameters, Psf, Rgb, Scene,
    SmallCell, SurfaceId, Visible, bundled,
};

fn main() {
    divan::main();
}

/// What a bake of the office holds.
struct Office {
    scene: Scene,
    parameters: Parameters,
    texels: Texels,
    outlines: Outlines,
    directions: Directions,
    quantum: Quantum,
    exponent: i32,
}

fn parameters(directions: u32, resolution: u32) -> Parameters {
    Parameters {
        directions,
        resolution,
        tile: 16,
        cycles: Some(2),
        unshot_fraction: 1e-3,
        perturbations: vec![1],
        texel_cells: 1.0,
        filter: 0,
        one_sided: false,
        ..Parameters::default()
    }
}

static OFFICE: LazyLock<Office> = LazyLock::new(|| {
    let (scene, _) = Scene::bundled("office").expect("it is bundled");
    let parameters = parameters(2049, 128);
    let texels = texels(&scene, &parameters);
    let outlines = Outlines::new(&scene, &texels);
    let most = scene.materials.iter().map(|m| m.emitted.max()).fold(0.0, f32::max);
    let (quantum, exponent) = (Quantum::new(most), exponent_for(most));
    let directions = Directions::new(5);
    Office { scene, parameters, texels, outlines, directions, quantum, exponent }
});

impl Office {
    fn shared(&self) -> Shared<'_> {
        Shared {
            scene: &self.scene,
            texels: &self.texels,
            outlines: &self.outlines,
            directions: &self.directions,
            parameters: &self.parameters,
            quantum: self.quantum,
            exponent: self.exponent,
        }
    }

    fn psf(&self) -> Psf {
        Psf::new(self.directions.vector(LINE), self.parameters.resolution)
    }
}

/// A line that is parallel to nothing in the office.
const LINE: DirectionId = DirectionId(700);

/// Small fields of the office, baked when first asked for: one for looking, and one for packing, with as
/// many cells a tile and surface as the default has.
static BAKED: LazyLock<TempDir> = LazyLock::new(|| baked(64));
static TO_PACK: LazyLock<TempDir> = LazyLock::new(|| baked(128));

fn baked(resolution: u32) -> TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let field = folder.path().join("office.field");
    let options = Options {
        memory: 1 << 30,
        threads: 2,
        stop: &AtomicBool::new(false),
        progress: &|_| (),
        order: None,
        commit_every: 1e9,
        terms: Terms::default(),
        force: false,
    };
    let parameters = parameters(129, resolution);
    vlf::bake(&OFFICE.scene, &parameters, &field, &options).expect("it bakes");
    folder
}

/// A field packed by one thread.
fn packed(folder: &TempDir, options: &vlf::pack::Options) -> (PathBuf, PackReport) {
    let field = Disk::new(&folder.path().join("office.field"));
    let pack = folder.path().join("office.vlf");
    let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    let report = alone.install(|| pack_from(&field, &pack, options, &|_| ())).expect("it packs");
    (pack, report)
}

/// A field in a raw pack, opened.
static FIELD: LazyLock<LightField> = LazyLock::new(|| {
    let (pack, _) = packed(&BAKED, &vlf::pack::Options::exact(Codec::Raw));
    LightField::open(&pack).expect("it opens")
});

/// A small generator of numbers in [-1, 1) (SplitMix64).
struct Dice(u64);

impl Dice {
    fn roll(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 40) as f32 / (1u64 << 23) as f32 - 1.0
    }
}

/// Origin and direction of the rays through the middles of a small picture's pixels.
fn primary_rays() -> Vec<(Vec3, Vec3)> {
    let camera: Camera = bundled::cameras("office").expect("it has cameras").remove(0);
    let camera = Camera { width: 128, height: 96, ..camera };
    let view = camera.view(&OFFICE.scene.fit);
    let pixels = (0..96).flat_map(|y| (0..128).map(move |x| (x, y)));
    pixels.map(|(x, y)| view.ray(f64::from(x) + 0.5, f64::from(y) + 0.5)).collect()
}

/// The layers of one subfield: every surface on every ray.
#[divan::bench]
fn rasterise(bencher: Bencher) {
    let psf = OFFICE.psf();
    let mut layers = Layers::default();
    layers.rasterise(&OFFICE.outlines, &psf);
    let fragments = layers.len();
    bencher
        .counter(ItemsCount::new(fragments))
        .bench_local(|| layers.rasterise(black_box(&OFFICE.outlines), black_box(&psf)));
}

/// A whole step of the first cycle: layers, exchange, transfer, and the maps of what arrived at mirrors.
#[divan::bench]
fn shoot_one_direction(bencher: Bencher) {
    let shared = OFFICE.shared();
    let shot = emission(&OFFICE.scene, &OFFICE.texels);
    let shots: Vec<Shot> = shot.into_iter().map(transfer::shot).chain([FROM_OUTSIDE]).collect();
    let marks = Marks::new(&OFFICE.texels);
    let cycle = Cycle {
        number: 0,
        current: Current { shots: &shots, quantum: OFFICE.quantum },
        pages: None,
        paths: None,
        grids: 0..1,
        thinned: 0,
        few: None,
        lacking: None,
        kept: None,
        marks: &marks,
    };
    let mut scratch = Scratch::new(&OFFICE.texels);
    bencher.bench_local(|| shoot(&shared, &cycle, black_box(LINE), &mut scratch));
}

/// Two lattices that face each other, and the pairs of a PSF's cells that fall on them.
struct Facing {
    projections: [Projection; 2],
    surface_of: Vec<u32>,
    shots: Vec<Shot>,
    cells: Vec<SmallCell>,
    pairs: Vec<[u32; 2]>,
}

impl Facing {
    /// With texels of so many cells.
    fn new(texel: f32) -> Facing {
        const CELLS: u32 = 64;
        let size = [(1.5 * CELLS as f32 / texel) as u32; 2];
        let count = size[0] * size[1];
        let scaled = |edge: [f32; 2]| edge.map(|c| c / texel);
        let lattice = |first, column, row| Projection {
            at_origin: scaled([0.4 * CELLS as f32, 0.3]),
            per_column: scaled(column),
            per_row: scaled(row),
            first,
            size,
        };
        let projections =
            [lattice(0, [0.9, 0.3], [-0.3, 1.1]), lattice(count, [0.8, 0.4], [-0.3, 0.9])];
        let value = |p: &Projection, cell: Cell| {
            let at = |axis: usize| {
                let (x, y) = (cell.i as f32 + 0.5, cell.j as f32 + 0.5);
                (p.at_origin[axis] + x * p.per_column[axis] + y * p.per_row[axis]).max(0.0) as u32
            };
            2 * (p.first + at(1).min(size[1] - 1) * size[0] + at(0).min(size[0] - 1))
        };
        let cells = (0..CELLS * CELLS).map(|k| Cell { i: k % CELLS, j: k / CELLS });
        let pair = |cell| projections.each_ref().map(|p| value(p, cell));
        let pairs = cells.clone().map(pair).collect();
        let mut dice = Dice(1);
        let light = |_| transfer::shot(Rgb([(); 3].map(|()| dice.roll() + 1.0)));
        Facing {
            projections,
            surface_of: (0..2 * count).map(|texel| texel / count).collect(),
            shots: (0..4 * count as usize + 1).map(light).collect(),
            cells: cells.map(SmallCell::from).collect(),
            pairs,
        }
    }

    fn current(&self) -> Current<'_> {
        Current { shots: &self.shots, quantum: Quantum::new(2.0) }
    }
}

/// Exchange along pairs by exact clipping, with texels of so many cells. Counts overlaps.
#[divan::bench(args = [0.5, 1.0, 2.0])]
fn transfer_clipped(bencher: Bencher, texel: f32) {
    let facing = Facing::new(texel);
    let marks = Marks::none(facing.surface_of.len());
    let current = facing.current();
    let Facing { projections, surface_of, cells, pairs, .. } = &facing;
    let ground = Ground { projections, surface_of, marks: &marks };
    let mut clip = Clip::default();
    let mut sums = vec![[0; 4]; current.shots.len()];
    let ends = cells
        .iter()
        .zip(pairs)
        .flat_map(|(cell, ends)| ends.map(|value| (Cell::from(*cell), value)));
    let overlaps: usize = ends.map(|(cell, value)| clip.taps(cell, value, &ground).len()).sum();
    bencher.counter(ItemsCount::new(overlaps)).bench_local(|| {
        clip.exchange::<3, 1>((cells, black_box(pairs)), &ground, current, &mut sums)
    });
}

/// The same by the texels under the cells' middles. Counts transfers, two a pair.
#[divan::bench(args = [0.5, 1.0, 2.0])]
fn transfer_sampled(bencher: Bencher, texel: f32) {
    let facing = Facing::new(texel);
    let mut sums = vec![[0; 4]; facing.shots.len()];
    bencher.counter(ItemsCount::new(2 * facing.pairs.len())).bench_local(|| {
        transfer::exchange::<3, 1>(black_box(&facing.pairs), facing.current(), &mut sums)
    });
}

/// The total map of a direction.
#[divan::bench]
fn total_map(bencher: Bencher) {
    let shared = OFFICE.shared();
    let total = emission(&OFFICE.scene, &OFFICE.texels);
    let lit = totals::lit_sides(&OFFICE.texels, &total);
    let marks = Marks::new(&OFFICE.texels);
    let mut scratch = totals::Scratch::default();
    bencher.bench_local(|| {
        totals::total_map(
            &shared,
            black_box(LINE),
            (&total, &lit),
            (Mirrors::None, &marks),
            &mut scratch,
        )
    });
}

/// The three directions around a vector.
#[divan::bench]
fn nearest_three(bencher: Bencher) {
    let mut dice = Dice(1);
    let vectors: Vec<Vec3> = (0..4096)
        .map(|_| Vec3::new(dice.roll(), dice.roll(), dice.roll()).normalize_or(Vec3::Z))
        .collect();
    bencher.counter(ItemsCount::new(vectors.len())).bench_local(|| {
        vectors.iter().map(|v| OFFICE.directions.nearest_three(*v)[0].weight).sum::<f32>()
    });
}

/// What a map costs when it is first touched, but for its hash.
#[divan::bench]
fn check_a_tile_map(bencher: Bencher) {
    let shared = OFFICE.shared();
    let total = emission(&OFFICE.scene, &OFFICE.texels);
    let lit = totals::lit_sides(&OFFICE.texels, &total);
    let marks = Marks::new(&OFFICE.texels);
    let mut scratch = totals::Scratch::default();
    let map =
        totals::total_map(&shared, LINE, (&total, &lit), (Mirrors::None, &marks), &mut scratch);
    let surfaces = OFFICE.scene.surfaces.len() as u32;
    bencher
        .counter(divan::counter::BytesCount::new(map.len()))
        .bench_local(|| Layout::check(black_box(&map), 128, 16, surfaces, OFFICE.exponent));
}

/// What neighbouring pixels see: surface, point, and direction to the eye.
fn hits() -> Vec<(SurfaceId, Vec3, Vec3)> {
    let visible = Visible::new(&OFFICE.scene);
    let hit = |(origin, dir): (Vec3, Vec3)| {
        let hit = visible.nearest(origin, dir, 0.0)?;
        Some((hit.surface, hit.point, -dir))
    };
    primary_rays().into_iter().filter_map(hit).collect()
}

/// Radiance of what neighbouring pixels see, from a mapped raw pack: the maps are in memory and checked.
/// To be held against `look_up_floor`.
#[divan::bench]
fn look_up_radiance(bencher: Bencher) {
    let hits = hits();
    let mut accessor = FIELD.accessor();
    let mut all = || {
        let mut radiance = |hit: &(SurfaceId, Vec3, Vec3)| accessor.radiance(hit.0, hit.1, hit.2);
        hits.iter().filter_map(|hit| radiance(hit).ok()).map(|r| r.mean()).sum::<f32>()
    };
    black_box(all());
    bencher.counter(ItemsCount::new(hits.len())).bench_local(all);
}

/// The least that any lookup of this kind does: three directions, their grids, and twelve f16 cells out of
/// dense maps that hold one surface, so that none is searched for and none is missing.
#[divan::bench]
fn look_up_floor(bencher: Bencher) {
    const N: usize = 64;
    let (hits, directions) = (hits(), &FIELD.directions);
    let maps = vec![[0x3c00u16; 4]; directions.len() * N * N];
    let cell = |map: usize, x: usize, y: usize| {
        let bits = maps[(map * N + y.min(N - 1)) * N + x.min(N - 1)];
        Rgb([0, 1, 2].map(|c| half_to_f32(bits[c])))
    };
    let radiance = |(_, point, away): &(SurfaceId, Vec3, Vec3)| {
        let mut sum = Rgb::BLACK;
        for near in directions.nearest_three(*away) {
            let psf = Psf::new(directions.vector(near.direction), N as u32);
            let at = psf.project(*point) - 0.5;
            let (fx, fy) = (at.x - at.x.floor(), at.y - at.y.floor());
            let (x, y, map) = (at.x as usize, at.y as usize, near.direction.index());
            let upper = cell(map, x, y) * (1.0 - fx) + cell(map, x + 1, y) * fx;
            let lower = cell(map, x, y + 1) * (1.0 - fx) + cell(map, x + 1, y + 1) * fx;
            sum += (upper * (1.0 - fy) + lower * fy) * near.weight;
        }
        sum.mean()
    };
    bencher
        .counter(ItemsCount::new(hits.len()))
        .bench_local(|| hits.iter().map(radiance).sum::<f32>());
}

/// Packing by one thread, proof included; bytes are the field's. To be held against `planes_alone`.
#[divan::bench(args = [0.0, 0.002, 0.01], sample_count = 5)]
fn pack_planes(bencher: Bencher, max_error: f32) {
    let options = vlf::pack::Options { max_error, ..vlf::pack::Options::exact(Codec::Planes) };
    let before = packed(&TO_PACK, &options).1.whole().before;
    bencher
        .counter(divan::counter::BytesCount::new(before))
        .bench_local(|| packed(&TO_PACK, black_box(&options)));
}

/// What the codec alone takes for the same field's maps: planes, a frame, and both undone.
#[divan::bench(sample_count = 5)]
fn planes_alone(bencher: Bencher) {
    let (pack, _) = packed(&TO_PACK, &vlf::pack::Options::exact(Codec::Raw));
    let bytes = std::fs::read(&pack).expect("it is there");
    let directory = container::open("pack", &bytes, FileKind::Pack, &Limits::default());
    let directory = directory.expect("it opens");
    let surfaces = OFFICE.scene.surfaces.len() as u32;
    let maps: Vec<(Vec<u8>, Layout)> = { directory.entries.iter() }
        .filter(|entry| entry.id.kind == ChunkKind::Total)
        .map(|entry| {
            let map = directory.chunk(&bytes, entry).expect("it is sound").into_owned();
            let layout = Layout::check(&map, 128, 16, surfaces, directory.header.exponent);
            (map, layout.expect("it is sound"))
        })
        .collect();
    let there_and_back = |(map, layout): &(Vec<u8>, Layout)| {
        let planes = to_planes(&TileMap::new(map, layout));
        let stored = encode(Codec::Planes, &planes).expect("there is memory");
        let back = unencoded(Codec::Planes, map.len() as u64, &stored);
        back.is_ok_and(|back| *back == *map)
    };
    let before: usize = maps.iter().map(|(map, _)| map.len()).sum();
    bencher
        .counter(divan::counter::BytesCount::new(before))
        .bench_local(|| assert!(black_box(&maps).iter().all(there_and_back)));
}

/// A packed map of the office, read, decoded and filled, once for each line.
#[divan::bench(sample_count = 10)]
fn unpack_a_map(bencher: Bencher) {
    let options =
        vlf::pack::Options { max_error: 0.002, ..vlf::pack::Options::exact(Codec::Planes) };
    let (pack, _) = packed(&TO_PACK, &options);
    let field = LightField::open(&pack).expect("it opens").with_memory(0);
    let lines = field.directions.len() as u32;
    bencher
        .counter(ItemsCount::new(lines))
        .bench_local(|| (0..lines).filter(|line| field.map(*line).is_ok()).count());
}

/// The nearest surface of neighbouring pixels.
#[divan::bench]
fn primary_visibility(bencher: Bencher) {
    let visible = Visible::new(&OFFICE.scene);
    let rays = primary_rays();
    bencher.counter(ItemsCount::new(rays.len())).bench_local(|| {
        rays.iter().filter(|(origin, dir)| visible.nearest(*origin, *dir, 0.0).is_some()).count()
    });
}
