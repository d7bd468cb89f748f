//! `vlf bake`.

use super::args::{self, SyncPolicy};
use super::progress::{Bar, tell};
use super::stats::Spent;
use super::{group, info, say, usage, views};
use anyhow::Context;
use bytesize::ByteSize;
use signal_hook::consts::{SIGINT, SIGTERM};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use vlf::bake::profile::Profile;
use vlf::bake::{Options, Outcome, Progress, bake_in, checked};
use vlf::exit;
use vlf::field::Terms;
use vlf::field::storage::disk::Disk;
use vlf::format::limits::Limits;
use vlf::format::manifest::Parameters;
use vlf::scene::Report;
use vlf::scene::texels::Texels;
use vlf::{Scene, bake::quality::Quality};

/// What a bake may use and how it is kept.
#[derive(Clone, Copy)]
pub struct How {
    /// Bytes of memory.
    pub memory: u64,
    /// Threads asked for.
    pub threads: Option<usize>,
    /// When what is done is forced to the disk.
    pub sync: SyncPolicy,
    /// Whether the field is locked.
    pub lock: bool,
    /// Whether to begin though the disk seems too small.
    pub force: bool,
    /// What the field's files may state.
    pub limits: Limits,
}

impl How {
    /// With so much memory, and otherwise as usual.
    pub fn usual(memory: u64, threads: Option<usize>) -> How {
        let (sync, limits) = (SyncPolicy::Interval(5.0), Limits::default());
        How { memory, threads, sync, lock: true, force: false, limits }
    }
}

/// With `--cycles auto`: the fraction of the emitted light that may be left unshot.
const UNSHOT_FRACTION: f64 = 1e-3;

pub fn run(a: &args::Bake) -> anyhow::Result<u8> {
    let b = &a.baking;
    let (scene, report) = Scene::open_within(&b.scene, &b.limits)?;
    tell_report(&report);
    let how = How {
        memory: b.memory.as_u64(),
        threads: b.threads,
        sync: b.sync,
        lock: !a.no_lock,
        force: a.force,
        limits: b.limits,
    };
    let (code, spent) = bake_with_bar(&scene, &parameters(b), &a.output, how)?;
    if code != 0 {
        return Ok(code);
    }
    views::save(&a.output, &report.cameras)?;
    if a.json {
        let mut json = info::json(&a.output, &b.limits)?;
        json["report"] = serde_json::to_value(&report)?;
        if a.stats {
            json["stats"] = spent.json();
        }
        say(&json.to_string())?;
    } else {
        say(&info::summary(&a.output, &b.limits)?)?;
        if a.stats {
            say(&spent.text())?;
        }
    }
    Ok(0)
}

/// What decides the bits, as it was typed.
pub fn parameters(a: &args::Baking) -> Parameters {
    let quality: Quality = a.quality.into();
    let (perturbations, thinned) = match a.perturb.clone() {
        Some(perturb) => (perturb.grids, perturb.thinned),
        None => quality.perturbations(),
    };
    let (texel, refined, filter) = quality.texels();
    Parameters {
        directions: a.directions,
        resolution: a.resolution,
        tile: a.tile,
        cycles: a.cycles.0,
        unshot_fraction: UNSHOT_FRACTION,
        perturbations,
        thinned,
        texel_cells: a.texel.unwrap_or(texel),
        refined: a.refine.unwrap_or(refined),
        supersample: a.supersample.is_on(),
        filter: a.filter.unwrap_or(filter),
        one_sided: a.one_sided,
        transfer: a.transfer.into(),
        specular: a.specular.into(),
        resample: a.resample.is_on(),
        target_error: a.target_error.unwrap_or(match a.perturb {
            Some(_) => 0.0,
            None => quality.target_error(),
        }),
    }
}

/// Prints what was made of a scene's files.
pub fn tell_report(report: &Report) {
    tell(report.to_string().trim_end());
}

/// Threads asked for, or one for each processor.
pub fn threads(asked: Option<usize>) -> anyhow::Result<usize> {
    match asked {
        Some(n @ 1..=1024) => Ok(n),
        Some(n) => Err(usage(format!("--threads {n}: 1 to 1024"))),
        None => Ok(std::thread::available_parallelism().map_or(1, usize::from)),
    }
}

/// Parameters of a quality at the default size.
pub fn defaults(quality: Quality) -> Parameters {
    let (perturbations, thinned) = quality.perturbations();
    let (texel_cells, refined, filter) = quality.texels();
    let target_error = quality.target_error();
    let sizes = Parameters::default();
    Parameters { perturbations, thinned, texel_cells, refined, filter, target_error, ..sizes }
}

/// Seconds between commits, and whether they are synced.
pub fn commits(sync: SyncPolicy) -> (f64, bool) {
    match sync {
        SyncPolicy::Commit => (0.0, true),
        SyncPolicy::Interval(seconds) => (seconds, true),
        SyncPolicy::None => (5.0, false),
    }
}

/// Bakes with a progress bar; stops between directions when asked by a signal. Returns the exit code
/// and where the time went.
pub fn bake_with_bar(
    scene: &Scene,
    parameters: &Parameters,
    output: &Path,
    how: How,
) -> anyhow::Result<(u8, Spent)> {
    if let Some(limit) = group::memory_limit().filter(|limit| how.memory > *limit) {
        let words = |bytes| ByteSize::b(bytes).display().iec().to_string();
        let (memory, limit) = (words(how.memory), words(limit));
        return Err(
            exit::Limit(format!("--memory {memory} exceeds the control group's {limit}")).into()
        );
    }
    // What is made must be read again, from the first cycle's end on.
    checked(scene, parameters)?;
    let texels = Texels::count(scene, parameters.texel_edge());
    how.limits.check_texels(texels).map_err(|fault| exit::Limit(fault.to_string()))?;
    let stop = Arc::new(AtomicBool::new(false));
    let signal = Arc::new(AtomicUsize::new(0));
    for (number, code) in [(SIGINT, 130), (SIGTERM, 143)] {
        // A second signal ends the program at once; what is committed stays.
        signal_hook::flag::register_conditional_shutdown(number, code, stop.clone())?;
        signal_hook::flag::register(number, stop.clone())?;
        signal_hook::flag::register_usize(number, signal.clone(), code as usize)?;
    }
    // A file that may not grow is a full disk, not a reason to die.
    #[cfg(unix)]
    signal_hook::flag::register(signal_hook::consts::SIGXFSZ, Arc::new(AtomicBool::new(false)))?;
    let bar = Bar::new("baking");
    let (commit_every, sync) = commits(how.sync);
    let profile = Mutex::new(Profile::default());
    let told = |p: &Progress| {
        *profile.lock().unwrap_or_else(PoisonError::into_inner) = p.profile;
        bar.bake(p);
    };
    let options = Options {
        memory: how.memory,
        threads: threads(how.threads)?,
        stop: &stop,
        progress: &told,
        order: None,
        commit_every,
        terms: Terms { sync, lock: how.lock },
        force: how.force,
    };
    let disk = Arc::new(Disk::within(output, how.limits));
    let outcome = bake_in(disk, scene, parameters, &options);
    let seconds = bar.end().as_secs_f64();
    let profile = *profile.lock().unwrap_or_else(PoisonError::into_inner);
    let spent = Spent { profile, seconds, threads: options.threads };
    match outcome.with_context(|| format!("baking {}", output.display()))? {
        Outcome::Finished => Ok((0, spent)),
        Outcome::Stopped => {
            tell(&format!(
                "stopped cleanly {}; run the same command again to go on",
                info::standing(output, &how.limits)?
            ));
            Ok((signal.load(Ordering::Relaxed) as u8, spent))
        }
    }
}
