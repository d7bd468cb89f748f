//! A pack over a slow line: whoever fetches byte ranges of it has a first picture after four, a small
//! part of the file, mirrors included. The reader here knows the specification's order and nothing else.

mod common;

use common::{Baked, camera, parameters, picture, scene};
use glam::Vec3;
use std::cell::Cell;
use std::fs;
use std::ops::Range;
use vlf::format::container::{ChunkEntry, ChunkKind, Codec, Directory, FIRST_BLOCK, decode};
use vlf::format::limits::Limits;
use vlf::format::manifest::{Manifest, record_from_bytes};
use vlf::format::tiles::{Layout, TileMap};
use vlf::gather::{Around, mirrored};
use vlf::look::image::Picture;
use vlf::look::render::{Options, method::Method, render};
use vlf::pack::{Options as PackOptions, pack_from};
use vlf::scene::{Reflectance, stored, texels};
use vlf::textured::{Texture, filled};
use vlf::visible::Hit;
use vlf::{Camera, Directions, LightField, Psf, Rgb, Scene, Visible};

/// The lattice that is fetched for the first picture.
const LINES: u32 = 129;

/// A file at the other end.
struct Remote<'a> {
    file: &'a [u8],
    fetched: Cell<(usize, usize)>,
}

impl Remote<'_> {
    fn get(&self, range: Range<u64>) -> &[u8] {
        let bytes = &self.file[range.start as usize..range.end as usize];
        let (ranges, sum) = self.fetched.get();
        self.fetched.set((ranges + 1, sum + bytes.len()));
        bytes
    }
}

/// A run of chunks, fetched at once.
struct Run<'a> {
    from: u64,
    bytes: &'a [u8],
    directory: &'a Directory,
}

impl Run<'_> {
    fn chunk(&self, entry: &ChunkEntry) -> Vec<u8> {
        let stored = &self.bytes[(entry.offset - self.from) as usize..][..entry.stored as usize];
        decode(&self.directory.header.field, entry, stored).unwrap().into_owned()
    }
}

fn first_picture(remote: &Remote, camera: &Camera) -> Picture {
    let (length, limits) = (remote.file.len() as u64, Limits::default());
    let block = remote.get(0..FIRST_BLOCK as u64);
    let end = Directory::length(block, length, &limits).unwrap() as u64;
    let head = [block, remote.get(FIRST_BLOCK as u64..end)].concat();
    let directory = &Directory::parse(&head, length, &limits).unwrap();
    let run = |from: u64, to: u64| Run { from, bytes: remote.get(from..to), directory };

    let maps = &directory.entries[3..];
    let parts = run(end, maps[0].offset);
    let part = |kind| parts.chunk(directory.entries.iter().find(|e| e.id.kind == kind).unwrap());
    let manifest: Manifest = record_from_bytes(&part(ChunkKind::Record)).unwrap();
    let scene = stored::from_bytes(&part(ChunkKind::Scene), &limits).unwrap();
    let lattice = texels::Texels::new(&scene, manifest.parameters.texel_edge());
    let total = texels::from_bytes(&part(ChunkKind::TotalTexture), 2 * lattice.len()).unwrap();
    let texture = Texture { scene: &scene, texels: &lattice, total: &total };

    // By their vectors, the lines of the coarse lattice among all.
    let coarse = Directions::with_lines(LINES).unwrap();
    let all = Directions::with_lines(directory.header.directions).unwrap();
    let header = &directory.header;
    let (tiles, surfaces, exponent) =
        ((header.resolution, header.tile), header.surfaces, header.exponent);
    let run = run(maps[0].offset, maps[LINES as usize].offset);
    let maps: Vec<(Vec<u8>, Layout)> = { coarse.ids() }
        .map(|id| {
            let is_line =
                |e: &&ChunkEntry| all.vector(vlf::DirectionId(e.id.direction)) == coarse.vector(id);
            let entry = maps[..LINES as usize].iter().find(is_line).expect("it is not in the run");
            let bytes = run.chunk(entry);
            let layout = Layout::check_packed(&bytes, tiles, surfaces, exponent).unwrap();
            let psf = Psf::new(coarse.vector(id), header.resolution);
            let bytes = filled(&TileMap::new(&bytes, &layout), &psf, exponent, &texture).unwrap();
            let layout = Layout::check_packed(&bytes, tiles, surfaces, exponent).unwrap();
            (bytes, layout)
        })
        .collect();

    let radiance = |dir: Vec3, hit: &Hit| {
        let plane = scene.surface(hit.surface);
        let Reflectance::Mirror(factor) = scene.material_of(hit.surface).reflectance else {
            return texels::sample(&lattice, &total, hit.surface, plane, hit.side, hit.point);
        };
        let normal = plane.normal * hit.side.sign();
        let around = Around::new(&coarse, header.resolution, mirrored(-dir, normal), normal);
        let near = around.near.map(|near| {
            let (bytes, layout) = &maps[near.direction.index()];
            Some(TileMap::new(bytes, layout))
        });
        around.radiance(&near, hit.surface, hit.point).unwrap_or_default() * factor
    };
    let options = Options { samples: 1, ..Options::default() };
    render(&scene, &Visible::new(&scene), camera, options, &radiance, &|_| {})
}

/// Which pixels show a mirror.
fn mirrors(scene: &Scene, camera: &Camera) -> Vec<bool> {
    let shown = |_: Vec3, hit: &Hit| {
        let is_mirror = scene.material_of(hit.surface).reflectance.is_mirror();
        Rgb::splat(f32::from(u8::from(is_mirror)))
    };
    let options = Options { samples: 1, ..Options::default() };
    let picture = render(scene, &Visible::new(scene), camera, options, &shown, &|_| {});
    picture.pixels.iter().map(|p| p.max() > 0.5).collect()
}

#[test]
fn four_ranges_make_a_first_picture() {
    let baked = Baked::new(&scene("cornell_mirror"), &parameters(2049, 32, 2));
    let camera = camera("cornell_mirror", 64, 48);
    let out = baked.path.with_extension("vlf");
    for max_error in [0.0, 0.01] {
        let options = PackOptions { max_error, ..PackOptions::exact(Codec::Planes) };
        let field = vlf::field::storage::disk::Disk::new(&baked.path);
        pack_from(&field, &out, &options, &|_| {}).unwrap();
        let file = fs::read(&out).unwrap();
        let remote = Remote { file: &file, fetched: Cell::new((0, 0)) };
        let first = first_picture(&remote, &camera);
        let (ranges, bytes) = remote.fetched.get();
        assert!(ranges <= 4, "{ranges} ranges");
        assert!(bytes * 4 < file.len(), "{bytes} of {} bytes", file.len());

        let pack = LightField::open(&out).unwrap();
        let whole = picture(&pack, &camera, Method::Trace, 1);
        let (mut off, mut sum, mut count) = (0.0, 0.0, 0);
        let is_mirror = mirrors(&pack.scene, &camera);
        for ((first, whole), is_mirror) in first.pixels.iter().zip(&whole.pixels).zip(is_mirror) {
            match is_mirror {
                true => {
                    off += (first.mean() - whole.mean()).abs();
                    sum += whole.mean();
                    count += 1;
                }
                false => assert_eq!(first, whole),
            }
        }
        assert!(count > 100, "the camera sees no mirror");
        assert!(off < 0.35 * sum, "mirrors are off by {off} of {sum}");
    }
}
