//! `vlf info`.

use super::{args, say};
use bytesize::ByteSize;
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::Path;
use vlf::field;
use vlf::format::container::{self, ChunkKind, Directory, FileKind, NO_DIRECTION};
use vlf::format::manifest::{Manifest, Phase, record_from_bytes};
use vlf::format::{FormatError, names};

pub fn run(a: &args::Info) -> anyhow::Result<u8> {
    if a.json {
        say(&json(&a.field)?.to_string())?
    } else {
        say(&summary(&a.field)?)?
    }
    Ok(0)
}

struct Facts {
    manifest: Manifest,
    id: [u8; 16],
    /// Name and bytes of each part.
    parts: Vec<(&'static str, u64)>,
    surfaces: u32,
}

fn facts(path: &Path) -> anyhow::Result<Facts> {
    if path.is_dir() {
        let (header, manifest) = if path.join(names::MANIFEST).is_file() {
            field::read_manifest(path)?
        } else {
            return Err(vlf::format::Fault::Foreign.in_file(path.display()).into());
        };
        let size = |name: &str| files_below(&path.join(name));
        let textures = size(&names::textures(manifest.cycle));
        let mirrors =
            size(&names::generation(manifest.cycle)) + size(&names::generation(manifest.cycle + 1));
        let parts = vec![
            ("scene", size(names::SCENE)),
            ("texture maps", textures),
            ("mirrors' unshot maps", mirrors),
            ("total radiance maps", size(names::TOTAL)),
        ];
        return Ok(Facts { manifest, id: header.field, parts, surfaces: header.surfaces });
    }
    let name = path.display().to_string();
    let directory = field::read_directory(path)?;
    if directory.header.kind != FileKind::Pack {
        let fault = vlf::format::Fault::invalid("not a packed field nor a field directory");
        return Err(fault.in_file(name).into());
    }
    let manifest = pack_manifest(path, &name, &directory)?;
    let stored = |kind| -> u64 {
        directory.entries.iter().filter(|e| e.id.kind == kind).map(|e| e.stored).sum()
    };
    let parts = vec![
        ("scene", stored(ChunkKind::Scene)),
        ("texture maps", stored(ChunkKind::TotalTexture)),
        ("total radiance maps", stored(ChunkKind::Total)),
    ];
    let (id, surfaces) = (directory.header.field, directory.header.surfaces);
    Ok(Facts { manifest, id, parts, surfaces })
}

fn pack_manifest(path: &Path, name: &str, directory: &Directory) -> anyhow::Result<Manifest> {
    let in_file = |f: vlf::format::Fault| -> FormatError { f.in_file(name) };
    let entry = *directory.find(ChunkKind::Record, NO_DIRECTION).map_err(in_file)?;
    // With the padding behind it.
    let end = (entry.offset + entry.stored).next_multiple_of(container::ALIGN as u64);
    let head = field::files::read_first(path, usize::try_from(end)?)?;
    let bytes = directory.chunk(&head, &entry);
    Ok(record_from_bytes(&bytes.map_err(in_file)?).map_err(in_file)?)
}

/// Bytes of a file, or of all files below a folder; what is not there has none.
fn files_below(path: &Path) -> u64 {
    match std::fs::read_dir(path) {
        Ok(entries) => entries.flatten().map(|e| files_below(&e.path())).sum(),
        Err(_) => std::fs::metadata(path).map_or(0, |m| m.len()),
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

/// Where an unfinished bake stands, in words.
pub fn standing(path: &Path) -> anyhow::Result<String> {
    let (_, m) = field::read_manifest(path)?;
    let (done, all) = (m.done_count(), m.parameters.directions);
    Ok(match m.phase {
        Phase::Propagating => format!("in cycle {}, at direction {done} of {all}", m.cycle + 1),
        Phase::WritingTotals => format!("writing total maps, at direction {done} of {all}"),
        Phase::Finished => "when it was finished".to_owned(),
    })
}

/// What a field or pack is, in lines.
pub fn summary(path: &Path) -> anyhow::Result<String> {
    let Facts { manifest: m, id, parts, surfaces } = facts(path)?;
    let p = &m.parameters;
    let mut out = String::new();
    let size = |bytes: u64| ByteSize::b(bytes).display().iec().to_string();
    writeln!(out, "field {} of {surfaces} surfaces", hex(&id))?;
    writeln!(
        out,
        "  {} directions, {} x {} cells in tiles of {}, texels of {} cells, {}",
        p.directions,
        p.resolution,
        p.resolution,
        p.tile,
        p.texel_cells,
        if p.one_sided { "one-sided" } else { "two-sided" }
    )?;
    let perturbed: Vec<String> = p.perturbations.iter().map(u32::to_string).collect();
    writeln!(out, "  grids a direction by cycle: {}, ...", perturbed.join(", "))?;
    match m.phase {
        Phase::Finished => writeln!(out, "  finished after {} cycles", m.cycle)?,
        _ => writeln!(out, "  not finished: {}", standing(path)?)?,
    }
    let total: u64 = parts.iter().map(|(_, b)| b).sum();
    writeln!(out, "  {} in all", size(total))?;
    for (name, bytes) in parts {
        writeln!(out, "    {:<22} {:>12}", name, size(bytes))?;
    }
    writeln!(out, "  energy, in % of what each cycle began with")?;
    writeln!(
        out,
        "    cycle      income W   absorbed   left   unshot    holes  sampling  rounding  unaccounted"
    )?;
    for l in &m.ledger {
        let part = |v: f64| if l.income() > 0.0 { 100.0 * v / l.income() } else { 0.0 };
        writeln!(
            out,
            "    {:>5} {:>13.6} {:>10.3} {:>6.2} {:>8.3} {:>8.3} {:>9.4} {:>9.5} {:>12.1e}",
            l.cycle + 1,
            l.income(),
            part(l.absorbed),
            part(l.left),
            part(l.unshot()),
            part(l.holes),
            part(l.sampling),
            part(l.quantised),
            100.0 * l.residual()
        )?;
    }
    let s = &m.statistics;
    if s.seconds > 0.0 {
        write!(out, "  baked in {:.1} s", s.seconds)?;
    } else {
        write!(out, "  baked")?;
    }
    write!(out, ": {} fragments", s.fragments)?;
    if s.gathers > 0 {
        write!(out, ", {} lookups of mirrors, {} in holes", s.gathers, s.holes)?;
    }
    if m.phase == Phase::Finished {
        write!(out, "\n  digest {}", hex(&m.digest))?;
    }
    Ok(out)
}

/// The same as one JSON object.
pub fn json(path: &Path) -> anyhow::Result<Value> {
    let Facts { manifest: m, id, parts, surfaces } = facts(path)?;
    let ledger: Vec<Value> = m
        .ledger
        .iter()
        .map(|l| {
            let mut entry = serde_json::to_value(l).unwrap_or_default();
            entry["residual"] = l.residual().into();
            entry["unshot"] = l.unshot().into();
            entry
        })
        .collect();
    let sizes: serde_json::Map<String, Value> =
        parts.into_iter().map(|(n, b)| (n.replace([' ', '\''], "_"), b.into())).collect();
    Ok(json!({
        "field": hex(&id),
        "surfaces": surfaces,
        "parameters": m.parameters,
        "phase": m.phase,
        "cycles": m.cycle,
        "directions_done": m.done_count(),
        "bytes": sizes,
        "ledger": ledger,
        "statistics": m.statistics,
        "digest": hex(&m.digest),
    }))
}
