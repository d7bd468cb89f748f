//! `vlf demo`.

use super::bake::How;
use super::progress::{Bar, tell};
use super::{args, bake, info, render};
use anyhow::Context;
use bytesize::ByteSize;
use vlf::Visible;
use vlf::bake::quality::Quality;
use vlf::format::container::Codec;
use vlf::format::limits::Limits;
use vlf::look::image::{write_exr, write_png};
use vlf::look::render::Options;
use vlf::look::render::method::Method;
use vlf::look::tone;
use vlf::scene::bundled;
use vlf::{LightField, Parameters, Scene};

/// Memory granted to the demo's bake.
const MEMORY: u64 = 512 << 20;

/// Size of the demo's pictures.
const SIZE: (u32, u32) = (800, 600);

pub fn run(a: &args::Demo) -> anyhow::Result<u8> {
    let (scene, report) = Scene::bundled(&a.scene)?;
    std::fs::create_dir_all(&a.output)
        .with_context(|| format!("{}: cannot be made", a.output.display()))?;
    bake::tell_report(&report);
    let field = a.output.join(&a.scene).with_extension("field");
    // Somewhat fewer lines than `preview` spends, so that the whole takes less than a minute on two
    // cores, and so larger texels, on whose walls fewer lines do not show.
    let perturbations = vec![6, 2, 1];
    let defaults = bake::defaults(Quality::Preview);
    let parameters =
        Parameters { perturbations, texel_cells: 1.0, unshot_fraction: 4e-3, ..defaults };
    let (code, _) =
        bake::bake_with_bar(&scene, &parameters, &field, How::usual(MEMORY, a.threads))?;
    if code != 0 {
        return Ok(code);
    }
    tell(&info::summary(&field, &Limits::default())?);

    let packed = field.with_extension("vlf");
    let bar = Bar::new("packing");
    let report = vlf::pack::pack(&field, &packed, Codec::Zstd, &|part| bar.part(part))?;
    let seconds = bar.end().as_secs_f64();
    let size = |b: u64| ByteSize::b(b).display().iec().to_string();
    let (from, to) = (size(report.whole().before), size(report.bytes));
    tell(&format!("packed {from} into {}: {to}, {seconds:.1} s", packed.display()));

    let field = LightField::open(&packed)?;
    let visible = Visible::new(&field.scene);
    for (view, camera) in bundled::cameras(&a.scene)?.into_iter().enumerate() {
        let camera = vlf::Camera { width: SIZE.0, height: SIZE.1, ..camera };
        let mut ev = None;
        for (name, method) in [("trace", Method::Trace), ("field", Method::Field)] {
            let options = (method, Options::default());
            let (picture, seconds) = render::take(&field, &visible, &camera, options, a.threads)?;
            let path = a.output.join(format!("{}-{}-{name}.png", a.scene, view + 1));
            // Both methods at one exposure, so that they can be compared by eye.
            let ev = *ev.get_or_insert_with(|| tone::auto_exposure(&picture));
            write_png(&path, &tone::develop(&picture, ev))?;
            write_exr(&path.with_extension("exr"), &picture)?;
            tell(&format!("{}: {seconds:.1} s", path.display()));
        }
    }
    tell(&format!("walk through it: vlf-view {}", packed.display()));
    Ok(0)
}
