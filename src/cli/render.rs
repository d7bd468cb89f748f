//! `vlf render`.

use super::film::Film;
use super::progress::{Bar, tell};
use super::{args, bake, say, usage};
use anyhow::Context;
use glam::DVec3;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::time::Instant;
use vlf::Visible;
use vlf::format::text::shown;
use vlf::look::image::{Picture, write_exr, write_png};
use vlf::look::packed::Access;
use vlf::look::path::CameraPath;
use vlf::look::render::{Options, Projection, method};
use vlf::look::tone;
use vlf::{Camera, DirectionId, LightField};

/// Damaged directions that a warning names.
const NAMED: usize = 20;

/// Most frames of a film: nine hours at 30 a second.
const MOST_FRAMES: f64 = 1e6;

/// What an output's name says it is.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Exr,
    Png,
    Film,
}

/// A picture to take: its file, and what it is seen with. All frames of a film have one file.
struct Shot {
    output: PathBuf,
    camera: Camera,
}

pub fn run(a: &args::Render) -> anyhow::Result<u8> {
    let kind = kind(&a.output)?;
    let shots = shots(a, kind)?;
    if kind == Kind::Film && (a.path.is_none() || a.json && is_stdout(&a.output)) {
        return Err(usage("a film needs --path, and on standard output no --json beside it"));
    }
    shots.iter().try_for_each(|shot| may_replace(&shot.output, kind))?;
    let access = if a.no_map { Access::Read } else { Access::Mapped };
    let began = Instant::now();
    let field = LightField::open_within(&a.field, access, &a.limits)?;
    let field = field.with_memory(a.memory.as_u64());
    let visible = Visible::new(&field.scene);
    let first = shots[0].camera;
    check_eye(&field, &visible, &first)?;
    let opening = began.elapsed().as_secs_f64();
    let size = (first.width, first.height);
    let mut film = match kind {
        Kind::Film => Some(Film::create(&a.output, size, a.fps)?),
        Kind::Exr | Kind::Png => None,
    };
    let projection = match a.projection {
        Some(args::ProjectionName::Equirectangular) => Projection::Equirectangular,
        Some(args::ProjectionName::Cube) | None => Projection::Perspective,
    };
    let how = (a.method.into(), Options { samples: a.samples, projection });
    // One exposure for all, lest a film flickers and the faces of a cube show their edges.
    let mut exposure = a.exposure;
    let mut marked = 0;
    let (done, seconds) = timed(a.threads, |progress| {
        for (shot, number) in shots.iter().zip(0u32..) {
            let all = shots.len() as f32;
            let progress = |part: f32| progress((number as f32 + part) / all);
            let (mut picture, missing) = match a.tolerate {
                true => method::take_tolerant(&field, &visible, &shot.camera, how, &progress),
                false => {
                    let taken = method::take(&field, &visible, &shot.camera, how, &progress);
                    (taken.context("the picture was not written")?, Vec::new())
                }
            };
            marked += missing.len();
            method::mark(&mut picture, &missing, exposure);
            match (kind, &mut film) {
                (Kind::Exr, _) => write_exr(&shot.output, &picture)?,
                (_, film) => {
                    let ev = *exposure.get_or_insert_with(|| tone::auto_exposure(&picture));
                    let bitmap = tone::develop(&picture, ev);
                    match film {
                        Some(film) => film.push(&bitmap)?,
                        None => write_png(&shot.output, &bitmap)?,
                    }
                }
            }
        }
        anyhow::Ok(())
    })?;
    done?;
    let damaged = field.damaged();
    if !damaged.is_empty() {
        tell(&warning(
            marked,
            u64::from(size.0) * u64::from(size.1) * shots.len() as u64,
            &damaged,
        ));
    }
    if a.json {
        let picture = if shots.len() == 1 { &shots[0].output } else { &a.output };
        let mut out = json!({"picture": picture, "size": [size.0, size.1], "seconds": seconds});
        out["opening_seconds"] = json!(opening);
        if shots.len() > 1 {
            out["pictures"] = json!(shots.len());
        }
        if a.tolerate {
            out["damaged_directions"] = json!(damaged);
            out["marked_pixels"] = json!(marked);
        }
        say(&out.to_string())?;
    } else {
        let many =
            if shots.len() > 1 { format!("{} pictures, ", shots.len()) } else { String::new() };
        tell(&format!("{}: {many}{seconds:.2} s", a.output.display()));
    }
    Ok(0)
}

fn is_stdout(path: &Path) -> bool {
    path == Path::new("-")
}

/// All pictures that are asked for, in order; at least one.
fn shots(a: &args::Render, kind: Kind) -> anyhow::Result<Vec<Shot>> {
    let is_cube = a.projection == Some(args::ProjectionName::Cube);
    if is_cube && kind == Kind::Film {
        return Err(usage(
            "a cube has six pictures a frame: give -o a name that ends in .png or .exr",
        ));
    }
    let cameras = match &a.path {
        None => vec![camera(a)?],
        Some(path) => {
            let path = CameraPath::open(path)?;
            let size = a.size.map_or((960, 720), |size| (size.0, size.1));
            let frames = ((path.end() - path.start()) * a.fps).floor() + 1.0;
            if frames > MOST_FRAMES {
                return Err(usage(format!(
                    "{frames} frames are more than {MOST_FRAMES}; lower --fps"
                )));
            }
            (0..frames as u32).map(|k| path.at(path.start() + f64::from(k) / a.fps, size)).collect()
        }
    };
    cameras.iter().try_for_each(Camera::check)?;
    // walk.png, walk-0042.png, walk-front.png, walk-0042-front.png
    let named = |frame: usize, face: Option<&str>| {
        let numbered = a.path.is_some() && kind != Kind::Film;
        let number = if numbered { format!("-{frame:04}") } else { String::new() };
        let face = face.map_or(String::new(), |face| format!("-{face}"));
        let stem = a.output.file_stem().unwrap_or_default().to_string_lossy();
        let end = a.output.extension().unwrap_or_default().to_string_lossy();
        match number.is_empty() && face.is_empty() {
            true => a.output.clone(),
            false => a.output.with_file_name(format!("{stem}{number}{face}.{end}")),
        }
    };
    let mut shots = Vec::new();
    for (frame, camera) in cameras.into_iter().enumerate() {
        if is_cube {
            let face = |(name, camera)| Shot { output: named(frame, Some(name)), camera };
            shots.extend(camera.cube().map(face));
        } else {
            shots.push(Shot { output: named(frame, None), camera });
        }
    }
    Ok(shots)
}

/// What a picture lacks, in a line.
fn warning(missing: usize, pixels: u64, damaged: &[DirectionId]) -> String {
    let named: Vec<String> = damaged.iter().take(NAMED).map(|d| d.0.to_string()).collect();
    let more = match damaged.len().saturating_sub(NAMED) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    format!(
        "warning: {missing} of {pixels} pixels need missing or damaged maps and are magenta: directions {}{more}",
        named.join(", ")
    )
}

fn kind(path: &Path) -> anyhow::Result<Kind> {
    if is_stdout(path) {
        return Ok(Kind::Film);
    }
    match path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase).as_deref() {
        Some("exr") => Ok(Kind::Exr),
        Some("png") => Ok(Kind::Png),
        Some("y4m") => Ok(Kind::Film),
        _ => {
            let shown = path.display();
            Err(usage(format!("{shown}: the name must end in .exr or .png, or for a film in .y4m")))
        }
    }
}

/// Refuses to replace a file that is not a picture of the kind that would take its place.
fn may_replace(path: &Path, kind: Kind) -> anyhow::Result<()> {
    use std::io::Read;
    if is_stdout(path) {
        return Ok(());
    }
    let Ok(file) = std::fs::File::open(path) else { return Ok(()) };
    let magic: &[u8] = match kind {
        Kind::Exr => &[0x76, 0x2f, 0x31, 0x01],
        Kind::Png => b"\x89PNG",
        Kind::Film => b"YUV4",
    };
    let mut head = Vec::new();
    let is_file = file.metadata().is_ok_and(|m| m.is_file());
    if !is_file || file.take(4).read_to_end(&mut head).is_err() || head != magic {
        let shown = path.display();
        anyhow::bail!("{shown}: exists and is not a picture of that kind; nothing was changed");
    }
    Ok(())
}

fn camera(a: &args::Render) -> anyhow::Result<Camera> {
    let mut camera = match (&a.camera, a.eye, a.target) {
        (Some(path), _, _) => Camera::open(path)?,
        (None, Some(eye), Some(target)) => Camera {
            eye: DVec3::from(eye.0),
            target: DVec3::from(target.0),
            up: a.up.map_or(DVec3::Y, |up| DVec3::from(up.0)),
            vfov_deg: a.vfov.unwrap_or(60.0),
            width: 960,
            height: 720,
        },
        _ => return Err(usage("say where to look from: --camera, --eye and --target, or --path")),
    };
    if let Some(size) = a.size {
        (camera.width, camera.height) = (size.0, size.1);
    }
    Ok(camera)
}

/// Refuses an eye from which nothing can be seen.
pub fn check_eye(field: &LightField, visible: &Visible, camera: &Camera) -> anyhow::Result<()> {
    let eye = camera.view(&field.scene.fit).origin;
    let place = camera.eye;
    if let Some(id) = visible.touching(eye) {
        let material = shown(&field.scene.material_of(id).name);
        return Err(usage(format!(
            "the eye {place} lies on surface {} (material `{material}`); move it into the open",
            id.0
        )));
    }
    if visible.inside_a_solid(eye) {
        let what = "is inside a wall or a closed solid: every surface around shows its back";
        return Err(usage(format!("the eye {place} {what}; move it into the open")));
    }
    Ok(())
}

/// Takes a picture with a progress bar. Returns it with the seconds it took.
pub fn take(
    field: &LightField,
    visible: &Visible,
    camera: &Camera,
    options: (method::Method, Options),
    threads: Option<usize>,
) -> anyhow::Result<(Picture, f64)> {
    let (picture, seconds) =
        timed(threads, |progress| method::take(field, visible, camera, options, progress))?;
    Ok((picture.context("the picture was not written")?, seconds))
}

/// Runs something on so many threads, with a progress bar. Returns what it gave and the seconds it took.
fn timed<T: Send>(
    threads: Option<usize>,
    work: impl FnOnce(&(dyn Fn(f32) + Sync)) -> T + Send,
) -> anyhow::Result<(T, f64)> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(bake::threads(threads)?).build()?;
    let bar = Bar::new("rendering");
    let done = pool.install(|| work(&|part| bar.part(part)));
    Ok((done, bar.end().as_secs_f64()))
}
