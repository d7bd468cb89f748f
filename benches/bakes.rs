//! Times of whole bakes of the bundled office, beside the least that they could take: rasterising and sorting
//! the same layers and nothing else, and copying the field's bytes; see the README beside this file.
//!
//!     cargo bench --bench bakes [-- LINES RESOLUTION ROUNDS]

use rayon::prelude::*;
use std::fs::{self, File};
use std::io::Write;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};
use std::time::Instant;
use vlf::bake::layers::{Layers, Outlines};
use vlf::bake::{Options, Progress, bake_in, texels};
use vlf::field::Terms;
use vlf::field::storage::Storage;
use vlf::field::storage::disk::Disk;
use vlf::field::storage::memory::Memory;
use vlf::format::manifest::Phase;
use vlf::{DirectionId, Directions, Parameters, Psf, Scene, Transfer};

/// Cycles of a bake.
const CYCLES: u32 = 4;

/// What is timed, in this order.
const NAMES: [&str; 6] = [
    "rasterising the layers of 4 cycles",
    "propagating, sampled",
    "propagating, clipped",
    "a whole bake in memory",
    "a whole bake on disk",
    "copying the field's bytes",
];

fn main() {
    let words = std::env::args().skip(1).filter(|a| a != "--bench");
    let numbers: Vec<u32> = words.map(|word| word.parse().expect("a number")).collect();
    let of = |k: usize, usual| numbers.get(k).copied().unwrap_or(usual);
    let parameters = Parameters {
        directions: of(0, 2049),
        resolution: of(1, 128),
        tile: 16,
        cycles: Some(CYCLES),
        perturbations: vec![1],
        texel_cells: 1.0,
        filter: 0,
        ..Parameters::default()
    };
    let (scene, _) = Scene::bundled("office").expect("it is bundled");
    let clipped = Parameters { transfer: Transfer::Clip, ..parameters.clone() };
    let mut seconds = vec![Vec::new(); NAMES.len()];
    // In turn, so that a machine that is busy for a while is so for all of them.
    for _ in 0..of(2, 3) {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let field = folder.path().join("office.field");
        let sampled = bake(Arc::new(Memory::default()), &scene, &parameters);
        let times = [
            rasterise(&scene, &parameters),
            sampled.propagating,
            bake(Arc::new(Memory::default()), &scene, &clipped).propagating,
            sampled.all,
            bake(Arc::new(Disk::new(&field)), &scene, &parameters).all,
            copy(&field, &folder.path().join("copy")),
        ];
        times.into_iter().zip(&mut seconds).for_each(|(time, all)| all.push(time));
    }
    let medians: Vec<f64> = seconds.iter_mut().map(|all| median(all)).collect();
    for (name, median) in NAMES.iter().zip(&medians) {
        println!("{name:36} {median:8.2} s");
    }
    let [layers, sampled, clipped, memory, disk, copy] = medians[..] else { return };
    println!("{:36} {:8.2}", "propagating / layers, sampled", sampled / layers);
    println!("{:36} {:8.2}", "propagating / layers, clipped", clipped / layers);
    println!("{:36} {:8.2}", "what the disk adds / copying", (disk - memory) / copy);
}

/// Seconds of a bake.
struct Times {
    propagating: f64,
    all: f64,
}

/// Bakes on as many threads as there are processors.
fn bake(storage: Arc<dyn Storage>, scene: &Scene, parameters: &Parameters) -> Times {
    let began = Instant::now();
    // Until when lines were prepared, and light was propagated.
    let marks = Mutex::new([0.0; 2]);
    let progress = |p: &Progress| {
        let mut marks = marks.lock().expect("nobody panics");
        let now = began.elapsed().as_secs_f64();
        match (p.preparing, p.phase) {
            (true, _) => *marks = [now; 2],
            (false, Phase::Propagating) => marks[1] = now,
            _ => {}
        }
    };
    let options = Options {
        memory: 1 << 30,
        threads: rayon::current_num_threads(),
        stop: &AtomicBool::new(false),
        progress: &progress,
        order: None,
        commit_every: 5.0,
        terms: Terms::default(),
        force: true,
    };
    bake_in(storage, scene, parameters, &options).expect("it bakes");
    let [prepared, propagated] = *marks.lock().expect("nobody panics");
    Times { propagating: propagated - prepared, all: began.elapsed().as_secs_f64() }
}

/// Rasterises and sorts the layers of all lines, as often as a bake has cycles.
fn rasterise(scene: &Scene, parameters: &Parameters) -> f64 {
    let texels = texels(scene, parameters);
    let outlines = Outlines::new(scene, &texels);
    let directions = Directions::with_lines(parameters.directions).expect("a number of lines");
    let ids: Vec<DirectionId> = directions.ids().collect();
    let began = Instant::now();
    for _ in 0..CYCLES {
        ids.par_iter().for_each_init(Layers::default, |layers, id| {
            layers.rasterise(&outlines, &Psf::new(directions.vector(*id), parameters.resolution));
        });
    }
    began.elapsed().as_secs_f64()
}

/// Copies all files below a folder, and has them on the disk.
fn copy(from: &Path, to: &Path) -> f64 {
    let began = Instant::now();
    copy_folder(from, to).expect("it can be copied");
    began.elapsed().as_secs_f64()
}

fn copy_folder(from: &Path, to: &Path) -> std::io::Result<()> {
    fs::create_dir(to)?;
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        let to = to.join(entry.file_name());
        if entry.file_type()?.is_dir() {
            copy_folder(&entry.path(), &to)?;
        } else {
            let mut file = File::create(&to)?;
            file.write_all(&fs::read(entry.path())?)?;
            file.sync_all()?;
        }
    }
    File::open(to)?.sync_all()
}

/// The middle one, or the one after it.
fn median(of: &mut [f64]) -> f64 {
    of.sort_by(f64::total_cmp);
    of[of.len() / 2]
}
