//! `vlf scene`.

use super::progress::tell;
use super::{args, usage};
use anyhow::Context;
use std::fs::File;
use std::io::Write;
use std::path::Path;
use vlf::scene::{boxes, bundled};

pub fn run(a: &args::Scene) -> anyhow::Result<u8> {
    let (obj, mtl) = match a.name.as_str() {
        "boxes" if (224..=100_000).contains(&a.polygons) => boxes::box_field(a.polygons, a.seed),
        "boxes" => {
            return Err(usage(format!("--polygons {}: 224 to 100000", a.polygons)));
        }
        name => bundled::text(name)?,
    };
    // The OBJ names its library; give that the OBJ's own name.
    let library = a.output.with_extension("mtl");
    let name = library.file_name().and_then(|n| n.to_str()).unwrap_or("scene.mtl");
    let line = |l: &str| match l.starts_with("mtllib ") {
        true => format!("mtllib {name}\n"),
        false => format!("{l}\n"),
    };
    write_new(&a.output, &obj.lines().map(line).collect::<String>())?;
    write_new(&library, &mtl)?;
    tell(&format!("{} and {name}", a.output.display()));
    Ok(0)
}

/// Writes a file that does not exist yet.
fn write_new(path: &Path, text: &str) -> anyhow::Result<()> {
    let write = || File::create_new(path)?.write_all(text.as_bytes());
    write().with_context(|| format!("{}: cannot be written", path.display()))
}
