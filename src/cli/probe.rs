//! `vlf probe`.

use super::{args, say, usage};
use glam::DVec3;
use serde_json::json;
use vlf::format::text::shown;
use vlf::look::packed::Access;
use vlf::look::render::method::{Method, look_along};
use vlf::visible::Hit;
use vlf::{LightField, Rgb, Side, Visible};

pub fn run(a: &args::Probe) -> anyhow::Result<u8> {
    let access = if a.no_map { Access::Read } else { Access::Mapped };
    let field = LightField::open_within(&a.field, access, &a.limits)?;
    let visible = Visible::new(&field.scene);
    let (eye, target) = (DVec3::from(a.eye.0), DVec3::from(a.target.0));
    let dir = (target - eye).try_normalize();
    let dir = dir.ok_or_else(|| usage("--eye and --target are the same place"))?.as_vec3();
    let hit = visible.nearest(field.scene.fit.to_unit(eye), dir, 0.0);
    let Some(hit) = hit else {
        say(if a.json { "{\"surface\":null}" } else { "the ray meets no surface" })?;
        return Ok(0);
    };
    let [by_field, by_trace] = [Method::Field, Method::Trace]
        .map(|method| look_along(&field, &visible, method, dir, &hit));
    let (by_field, by_trace) = (by_field?, by_trace?);
    match a.json {
        true => say(&in_json(&field, &hit, by_field, by_trace).to_string())?,
        false => say(&in_words(&field, &hit, by_field, by_trace))?,
    }
    Ok(0)
}

fn side(hit: &Hit) -> &'static str {
    match hit.side {
        Side::Front => "front",
        Side::Back => "back",
    }
}

fn in_json(field: &LightField, hit: &Hit, by_field: Rgb, by_trace: Rgb) -> serde_json::Value {
    let fit = &field.scene.fit;
    json!({
        "surface": hit.surface.0,
        "material": field.scene.material_of(hit.surface).name,
        "side": side(hit),
        "point": fit.to_own(hit.point).to_array(),
        "distance": f64::from(hit.distance) * fit.radius,
        "field": by_field,
        "trace": by_trace,
    })
}

fn in_words(field: &LightField, hit: &Hit, by_field: Rgb, by_trace: Rgb) -> String {
    let scene = &field.scene;
    let (material, point) = (scene.material_of(hit.surface), scene.fit.to_own(hit.point));
    let kind = if material.reflectance.is_mirror() { "mirror" } else { "diffuse" };
    let radiance = |Rgb([r, g, b]): Rgb| format!("{r:.6} {g:.6} {b:.6} W sr^-1 m^-2");
    format!(
        "surface {}, {} of {kind} material `{}`, at {:.4} {:.4} {:.4}, {:.4} away\n\
         field  {}\ntrace  {}",
        hit.surface.0,
        side(hit),
        shown(&material.name),
        point.x,
        point.y,
        point.z,
        f64::from(hit.distance) * scene.fit.radius,
        radiance(by_field),
        radiance(by_trace),
    )
}
