//! `vlf render`.

use super::progress::{Bar, tell};
use super::{args, bake, say, usage};
use anyhow::Context;
use glam::DVec3;
use serde_json::json;
use std::path::Path;
use std::time::Instant;
use vlf::Visible;
use vlf::format::text::shown;
use vlf::look::image::{Picture, write_exr, write_png};
use vlf::look::packed::Access;
use vlf::look::render::{Options, method};
use vlf::look::tone;
use vlf::{Camera, DirectionId, LightField};

/// Damaged directions that a warning names.
const NAMED: usize = 20;

/// What a picture's name says it is.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Exr,
    Png,
}

pub fn run(a: &args::Render) -> anyhow::Result<u8> {
    let kind = kind(&a.output)?;
    let camera = camera(a)?;
    may_replace(&a.output, kind)?;
    let access = if a.no_map { Access::Read } else { Access::Mapped };
    let began = Instant::now();
    let field = LightField::open_within(&a.field, access, &a.limits)?;
    let field = field.with_memory(a.memory.as_u64());
    let visible = Visible::new(&field.scene);
    check_eye(&field, &visible, &camera)?;
    let opening = began.elapsed().as_secs_f64();
    let options = (a.method.into(), Options { samples: a.samples });
    let (mut picture, missing, seconds) = match a.tolerate {
        true => take_tolerant(&field, &visible, &camera, options, a.threads)?,
        false => {
            let (picture, seconds) = take(&field, &visible, &camera, options, a.threads)?;
            (picture, Vec::new(), seconds)
        }
    };
    let damaged = field.damaged();
    if !damaged.is_empty() {
        method::mark(&mut picture, &missing, a.exposure);
        tell(&warning(&missing, camera.width * camera.height, &damaged));
    }
    write(&a.output, kind, &picture, a.exposure)?;
    if a.json {
        let pixels = json!([camera.width, camera.height]);
        let mut out = json!({"picture": a.output, "size": pixels, "seconds": seconds});
        out["opening_seconds"] = json!(opening);
        if a.tolerate {
            out["damaged_directions"] = json!(damaged);
            out["marked_pixels"] = json!(missing.len());
        }
        say(&out.to_string())?;
    } else {
        tell(&format!("{}: {:.2} s", a.output.display(), seconds));
    }
    Ok(0)
}

/// What a picture lacks, in a line.
fn warning(missing: &[usize], pixels: u32, damaged: &[DirectionId]) -> String {
    let named: Vec<String> = damaged.iter().take(NAMED).map(|d| d.0.to_string()).collect();
    let more = match damaged.len().saturating_sub(NAMED) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    format!(
        "warning: {} of {pixels} pixels need missing or damaged maps and are magenta: directions {}{more}",
        missing.len(),
        named.join(", ")
    )
}

fn kind(path: &Path) -> anyhow::Result<Kind> {
    match path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase).as_deref() {
        Some("exr") => Ok(Kind::Exr),
        Some("png") => Ok(Kind::Png),
        _ => Err(usage(format!("{}: the name must end in .exr or .png", path.display()))),
    }
}

/// Refuses to replace a file that is not a picture of the kind that would take its place.
fn may_replace(path: &Path, kind: Kind) -> anyhow::Result<()> {
    use std::io::Read;
    let Ok(file) = std::fs::File::open(path) else { return Ok(()) };
    let magic: &[u8] = match kind {
        Kind::Exr => &[0x76, 0x2f, 0x31, 0x01],
        Kind::Png => b"\x89PNG",
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
        _ => return Err(usage("say where to look from: --camera, or --eye and --target")),
    };
    if let Some(size) = a.size {
        (camera.width, camera.height) = (size.0, size.1);
    }
    camera.check()?;
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

/// The same where damaged maps are tolerated. Returns the pixels that needed them as well.
fn take_tolerant(
    field: &LightField,
    visible: &Visible,
    camera: &Camera,
    options: (method::Method, Options),
    threads: Option<usize>,
) -> anyhow::Result<(Picture, Vec<usize>, f64)> {
    let ((picture, missing), seconds) = timed(threads, |progress| {
        method::take_tolerant(field, visible, camera, options, progress)
    })?;
    Ok((picture, missing, seconds))
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

fn write(path: &Path, kind: Kind, picture: &Picture, ev: Option<f32>) -> anyhow::Result<()> {
    match kind {
        Kind::Exr => write_exr(path, picture)?,
        Kind::Png => {
            let ev = ev.unwrap_or_else(|| tone::auto_exposure(picture));
            write_png(path, &tone::develop(picture, ev))?;
        }
    }
    Ok(())
}
