//! What the journeys share: scenes, small bakes in temporary folders, pictures of them.

#![allow(dead_code, reason = "each journey takes its own part")]

pub mod store;

use glam::DVec3;
use std::cell::Cell;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use tempfile::TempDir;
use vlf::Visible;
use vlf::bake::{Options, Outcome, bake_in};
use vlf::field::storage::Storage;
use vlf::field::storage::disk::Disk;
use vlf::field::{Terms, read_manifest};
use vlf::format::manifest::Manifest;
use vlf::look::image::Picture;
use vlf::look::render::method::{Method, take};
use vlf::{Camera, LightField, Parameters, Scene, Specular};

/// The folders under `scenes/`.
pub const SCENES: [&str; 11] = [
    "cornell",
    "cornell_mirror",
    "furnace",
    "furnace_mirror",
    "gallery",
    "metal_sphere",
    "mirror_corridor",
    "office",
    "parallel_squares",
    "ring_caustic",
    "torture",
];

/// The OBJ of a bundled scene.
pub fn obj(name: &str) -> PathBuf {
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    scenes.join(name).join(name).with_extension("obj")
}

/// A bundled scene.
pub fn scene(name: &str) -> Scene {
    Scene::open(&obj(name)).unwrap().0
}

/// A scene from the text of its OBJ and of its MTL, called `test.mtl`.
pub fn scene_of(obj: &str, mtl: &str) -> Scene {
    let obj = format!("mtllib test.mtl\n{obj}");
    Scene::from_text(Path::new("test.obj"), &obj, &mut |_| Ok(mtl.into())).unwrap().0
}

/// OBJ and MTL of a bundled scene as [`scene_of`] takes them.
pub fn text(name: &str) -> (String, String) {
    let path = obj(name);
    let read = |path: &Path| std::fs::read_to_string(path).unwrap();
    (read(&path).replace("mtllib", "#"), read(&path.with_extension("mtl")))
}

/// The text of an OBJ with every vertex moved.
pub fn moved(obj: &str, to: impl Fn(DVec3) -> DVec3) -> String {
    let line = |line: &str| {
        let Some(rest) = line.strip_prefix("v ") else { return format!("{line}\n") };
        let numbers: Vec<f64> = rest.split_whitespace().map(|n| n.parse().unwrap()).collect();
        let v = to(DVec3::from_slice(&numbers));
        format!("v {} {} {}\n", v.x, v.y, v.z)
    };
    obj.lines().map(line).collect()
}

/// The first camera of a bundled scene, with a picture of another size.
pub fn camera(name: &str, width: u32, height: u32) -> Camera {
    let camera = Camera::open(&obj(name).with_file_name("camera_a.json")).unwrap();
    Camera { width, height, ..camera }
}

/// The bare lattice of `directions` lines, `cycles` times.
pub fn parameters(directions: u32, resolution: u32, cycles: u32) -> Parameters {
    Parameters {
        directions,
        resolution,
        tile: 16,
        cycles: Some(cycles),
        unshot_fraction: 1e-3,
        perturbations: vec![1],
        texel_cells: 1.0,
        refined: 1.0,
        supersample: false,
        filter: 0,
        one_sided: false,
        ..Parameters::default()
    }
}

/// The same with mirrors' maps stored in each cycle, sent on in the next and shown in the end.
pub fn stored(parameters: Parameters) -> Parameters {
    Parameters { specular: Specular::Maps, resample: false, ..parameters }
}

/// Both ways of mirrors: their maps stored, and paths followed through them.
pub fn both_ways(parameters: &Parameters) -> [(&'static str, Parameters); 2] {
    assert_eq!(parameters.specular, Specular::Trace);
    [("stored maps", stored(parameters.clone())), ("paths", parameters.clone())]
}

/// How a bake is run. None of it may change a bit of the field.
#[derive(Clone)]
pub struct How {
    pub memory: u64,
    pub threads: usize,
    pub order: Option<Vec<u32>>,
    pub commit_every: f64,
    /// Stops after this many reports of progress with light or maps.
    pub stop_after: Option<u32>,
}

impl Default for How {
    fn default() -> How {
        How { memory: 1 << 30, threads: 2, order: None, commit_every: 1e9, stop_after: None }
    }
}

/// Bakes, or goes on baking, at `path`.
pub fn bake_to(path: &Path, scene: &Scene, parameters: &Parameters, how: &How) -> Outcome {
    bake_into(Arc::new(Disk::new(path)), scene, parameters, how)
}

/// The same in any storage.
pub fn bake_into(
    storage: Arc<dyn Storage>,
    scene: &Scene,
    parameters: &Parameters,
    how: &How,
) -> Outcome {
    let stop = AtomicBool::new(false);
    let reports = Mutex::new(Cell::new(0));
    let options = Options {
        memory: how.memory,
        threads: how.threads,
        stop: &stop,
        progress: &|p| {
            if p.preparing {
                return;
            }
            let reports = reports.lock().unwrap();
            reports.set(reports.get() + 1);
            if how.stop_after == Some(reports.get()) {
                stop.store(true, Ordering::Relaxed);
            }
        },
        order: how.order.clone(),
        commit_every: how.commit_every,
        // What a loss of power costs is tested elsewhere.
        terms: Terms { sync: false, lock: true },
        force: false,
    };
    bake_in(storage, scene, parameters, &options).unwrap()
}

/// A finished field in a folder of its own, which goes with it.
pub struct Baked {
    pub folder: TempDir,
    pub path: PathBuf,
}

impl Baked {
    /// Bakes a scene with the usual options.
    pub fn new(scene: &Scene, parameters: &Parameters) -> Baked {
        Baked::with(scene, parameters, &How::default())
    }

    pub fn with(scene: &Scene, parameters: &Parameters, how: &How) -> Baked {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("test.field");
        assert_eq!(bake_to(&path, scene, parameters, how), Outcome::Finished);
        Baked { folder, path }
    }

    pub fn open(&self) -> LightField {
        LightField::open(&self.path).unwrap()
    }

    pub fn manifest(&self) -> Manifest {
        read_manifest(&Disk::new(&self.path)).unwrap().1
    }
}

/// A picture of a field.
pub fn picture(field: &LightField, camera: &Camera, method: Method, samples: u32) -> Picture {
    let visible = Visible::new(&field.scene);
    let options = vlf::look::render::Options { samples, ..Default::default() };
    take(field, &visible, camera, (method, options), &|_| {}).unwrap()
}

/// Mean radiance of the front of all surfaces of a material, where light can come, weighted by area;
/// mean of the channels.
pub fn mean_radiance(field: &LightField, material: &str) -> f64 {
    let areas = vlf::scene::areas::areas(&field.scene, &field.texels);
    let (mut sum, mut area) = (0.0, 0.0);
    let hidden = hidden(field);
    for (texel, surface) in field.texels.surface_of.iter().enumerate() {
        let name = &field.scene.material_of(vlf::SurfaceId(*surface)).name;
        if name == material && !hidden[texel] {
            sum += f64::from(field.total[2 * texel].mean()) * f64::from(areas[texel]);
            area += f64::from(areas[texel]);
        }
    }
    assert!(area > 0.0, "no surface of `{material}`");
    sum / area
}

/// A small generator of numbers (SplitMix64): the same in every run.
pub struct Dice(pub u64);

impl Dice {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// In [0, 1).
    pub fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// `0..count` in an order of its own.
    pub fn shuffled(&mut self, count: u32) -> Vec<u32> {
        let mut all: Vec<u32> = (0..count).collect();
        for k in (1..all.len()).rev() {
            all.swap(k, (self.next() % (k as u64 + 1)) as usize);
        }
        all
    }
}

/// A floor, a closed box that stands on it, and a lamp, seen from nowhere else: `floor` faces up, the
/// box's bottom lies in the floor's plane.
pub const BOX_ON_A_FLOOR: &str = "\
v -2 0 2\nv 2 0 2\nv 2 0 -2\nv -2 0 -2
v -0.53 0 0.47\nv 0.49 0 0.47\nv 0.49 0 -0.51\nv -0.53 0 -0.51
v -0.53 0.9 0.47\nv 0.49 0.9 0.47\nv 0.49 0.9 -0.51\nv -0.53 0.9 -0.51
v 0.7 2 0.3\nv 0.7 2 -0.3\nv 1.3 2 -0.3\nv 1.3 2 0.3
usemtl floor\nf 1 2 3 4
usemtl white\nf 8 7 6 5\nf 9 10 11 12\nf 5 6 10 9\nf 6 7 11 10\nf 7 8 12 11\nf 8 5 9 12
usemtl lamp\nf 16 15 14 13
";

/// Materials of [`BOX_ON_A_FLOOR`]. The lamp's front faces down.
pub const WHITE_AND_LAMP: &str = "\
newmtl floor\nKd 0.5 0.5 0.5\nillum 1
newmtl white\nKd 0.8 0.8 0.8\nillum 1
newmtl lamp\nKd 0 0 0\nKe 10 10 10\nillum 1
";

/// For each texel whether no light can come to its front: all around, its middle sees only backs, as
/// under a box. What such a texel holds is for lookups beside it; it is no light of the scene.
pub fn hidden(field: &LightField) -> Vec<bool> {
    const RAYS: usize = 64;
    let visible = Visible::new(&field.scene);
    let golden = std::f32::consts::PI * (3.0 - 5f32.sqrt());
    let of = |texel: usize| {
        let id = field.texels.surface_of[texel] as usize;
        let (surface, lattice) = (&field.scene.surfaces[id], field.texels.lattices[id]);
        let inside = texel as u32 - lattice.first;
        let place = |k: u32, density: f32| (k as f32 + 0.5) / density;
        let along_u = surface.u * place(inside % lattice.width, lattice.density.x);
        let along_v = surface.v * place(inside / lattice.width, lattice.density.y);
        let above = surface.origin + along_u + along_v + surface.normal * 1e-4;
        (0..RAYS).all(|k| {
            let z = (k as f32 + 0.5) / RAYS as f32;
            let (sin, cos) = (golden * k as f32).sin_cos();
            let across = (1.0 - z * z).sqrt();
            let direction =
                surface.u * (across * cos) + surface.v * (across * sin) + surface.normal * z;
            visible.nearest(above, direction, 0.0).is_some_and(|hit| hit.side == vlf::Side::Back)
        })
    };
    (0..field.texels.len()).map(of).collect()
}
