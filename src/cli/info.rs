//! `vlf info`.

use super::{args, say};
use bytesize::ByteSize;
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::Path;
use vlf::field::storage::disk::Disk;
use vlf::field::{self, files};
use vlf::format::container::{ChunkKind, FileKind, NO_DIRECTION};
use vlf::format::limits::Limits;
use vlf::format::manifest::{Grids, Manifest, Phase, Specular, Transfer, record_from_bytes};
use vlf::format::{Fault, names};

/// Surfaces whose error is shown.
const WORST: usize = 5;

/// Bytes of a texel in a texture map: both sides, three f32 each.
const TEXEL: u64 = 24;

pub fn run(a: &args::Info) -> anyhow::Result<u8> {
    if a.json {
        say(&json(&a.field, &a.limits)?.to_string())?
    } else {
        say(&summary(&a.field, &a.limits)?)?
    }
    Ok(0)
}

struct Facts {
    manifest: Manifest,
    id: [u8; 16],
    /// Name and bytes of each part.
    parts: Vec<(&'static str, u64)>,
    surfaces: u32,
    /// Texels, where there are texture maps.
    texels: Option<u64>,
    packed: bool,
}

impl Facts {
    /// Fragments on a ray of the grids that are done, on the average.
    fn fragments_a_ray(&self) -> Option<f64> {
        let p = &self.manifest.parameters;
        let finished = self.manifest.grids.iter().take(self.manifest.cycle as usize).zip(0..);
        let of = |(grids, cycle): (&u32, u32)| {
            Grids { perturbations: *grids, ..p.grids(cycle) }.per_line()
        };
        let shot: f64 = finished.map(of).sum();
        let grids = shot * f64::from(p.directions) + self.total_maps() as f64;
        let rays = grids * f64::from(p.resolution).powi(2);
        (rays > 0.0).then(|| self.manifest.statistics.fragments as f64 / rays)
    }

    /// Surfaces in a tile of the total maps that are done, on the average.
    fn surfaces_a_tile(&self) -> Option<f64> {
        let p = &self.manifest.parameters;
        let tiles = self.total_maps() * u64::from(p.resolution / p.tile).pow(2);
        (tiles > 0).then(|| self.manifest.statistics.entries as f64 / tiles as f64)
    }

    fn total_maps(&self) -> u64 {
        match self.manifest.phase {
            Phase::Propagating => 0,
            _ => self.manifest.done_count().into(),
        }
    }
}

fn facts(path: &Path, limits: &Limits) -> anyhow::Result<Facts> {
    if path.is_dir() {
        let (header, manifest) = field::read_manifest(&Disk::within(path, *limits))?;
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
        let parts = match manifest.has_sums {
            true => [parts, vec![("sums", size(&names::sums(manifest.sequence)))]].concat(),
            false => parts,
        };
        let texels = texels(path, &names::textures(manifest.cycle), limits);
        let (id, surfaces) = (header.field, header.surfaces);
        return Ok(Facts { manifest, id, parts, surfaces, texels, packed: false });
    }
    let mut file = files::open_at(path, FileKind::Pack, limits)?;
    let entry = file.find(ChunkKind::Record, NO_DIRECTION)?;
    let record = file.chunk(&entry)?;
    let in_file = |f: Fault| f.in_file(path.display());
    let manifest: Manifest = record_from_bytes(&record).map_err(in_file)?;
    let directory = &file.directory;
    manifest.check(&directory.header).map_err(in_file)?;
    let stored = |kind| -> u64 {
        directory.entries.iter().filter(|e| e.id.kind == kind).map(|e| e.stored).sum()
    };
    let parts = vec![
        ("scene", stored(ChunkKind::Scene)),
        ("texture maps", stored(ChunkKind::TotalTexture)),
        ("total radiance maps", stored(ChunkKind::Total)),
    ];
    let (id, surfaces) = (directory.header.field, directory.header.surfaces);
    let textures = file.find(ChunkKind::TotalTexture, NO_DIRECTION);
    let texels = textures.ok().map(|entry| entry.raw / TEXEL);
    Ok(Facts { manifest, id, parts, surfaces, texels, packed: true })
}

/// Texels of a field, from the length of its texture maps.
fn texels(field: &Path, name: &str, limits: &Limits) -> Option<u64> {
    let file = files::open(&Disk::within(field, *limits), name, FileKind::Textures).ok()?;
    Some(file.find(ChunkKind::TotalTexture, NO_DIRECTION).ok()?.raw / TEXEL)
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
pub fn standing(path: &Path, limits: &Limits) -> anyhow::Result<String> {
    let (_, m) = field::read_manifest(&Disk::within(path, *limits))?;
    let (done, all) = (m.done_count(), m.parameters.directions);
    Ok(match m.phase {
        Phase::Propagating => format!("in cycle {}, at direction {done} of {all}", m.cycle + 1),
        Phase::WritingTotals => format!("writing total maps, at direction {done} of {all}"),
        Phase::Finished => "when it was finished".to_owned(),
    })
}

/// What a field or pack is, in lines.
pub fn summary(path: &Path, limits: &Limits) -> anyhow::Result<String> {
    let facts = facts(path, limits)?;
    let Facts { manifest: m, parts, .. } = &facts;
    let p = &m.parameters;
    let mut out = String::new();
    writeln!(out, "field {} of {} surfaces", hex(&facts.id), facts.surfaces)?;
    writeln!(
        out,
        "  {} directions, {} x {} cells in tiles of {}, texels of {} cells{}, {}{}",
        p.directions,
        p.resolution,
        p.resolution,
        p.tile,
        p.texel_cells,
        if p.refined > 1.0 { " or finer" } else { "" },
        if p.one_sided { "one-sided" } else { "two-sided" },
        match p.filter {
            0 => String::new(),
            1 => ", filtered once".to_owned(),
            most => format!(", filtered at most {most} times"),
        }
    )?;
    writeln!(
        out,
        "  transfer {}, specular {}, resample {}",
        match p.transfer {
            Transfer::Sample => "sample",
            Transfer::Clip => "clip",
        },
        match p.specular {
            Specular::Maps => "maps",
            Specular::Trace => "trace",
        },
        if p.resample { "on" } else { "off" }
    )?;
    let numbers = |counts: &[u32]| {
        let counts: Vec<String> = counts.iter().map(u32::to_string).collect();
        counts.join(", ")
    };
    let most = if p.target_error > 0.0 { "at most " } else { "" };
    let thinned = match p.thinned {
        0 => String::new(),
        thinned => format!(", 1/{}", 1u64 << (2 * thinned)),
    };
    write!(
        out,
        "  grids a direction by cycle: {most}{}{thinned}, ...; ",
        numbers(&p.perturbations)
    )?;
    match p.cycles {
        Some(cycles) => writeln!(out, "{cycles} cycles")?,
        None => writeln!(out, "cycles until {} % is unshot", 100.0 * p.unshot_fraction)?,
    }
    match m.phase {
        Phase::Finished => write!(out, "  finished after {} cycles", m.cycle)?,
        _ => write!(out, "  not finished: {}", standing(path, limits)?)?,
    }
    writeln!(
        out,
        "{}",
        if facts.packed { "; packed".into() } else { format!("; commit {}", m.sequence) }
    )?;
    if p.target_error > 0.0 {
        let spent = numbers(m.grids.get(..m.cycle as usize).unwrap_or_default());
        writeln!(out, "  aims at relMSE {:.1e}; grids spent: {spent}", p.target_error)?;
    }
    error(m, &mut out)?;
    let total: u64 = parts.iter().map(|(_, b)| b).sum();
    writeln!(out, "  {} in all", size(total))?;
    for (name, bytes) in parts.iter().filter(|(_, bytes)| *bytes > 0) {
        writeln!(out, "    {:<22} {:>12}", name, size(*bytes))?;
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
    work(&facts, &mut out)?;
    if m.phase == Phase::Finished {
        write!(out, "  digest {}", hex(&m.digest))?;
    }
    Ok(out.trim_end().to_owned())
}

/// What is wrong with the light, by estimate.
fn error(m: &Manifest, out: &mut String) -> anyhow::Result<()> {
    let e = &m.error;
    if m.cycle == 0 {
        return Ok(());
    }
    writeln!(
        out,
        "  estimated relMSE of pictures {:.1e}: {:.1e} from lines, {:.1e} from texels",
        e.relmse,
        e.noise,
        e.relmse - e.noise
    )?;
    for s in e.worst.iter().take(WORST) {
        let part = 100.0 * s.part;
        writeln!(
            out,
            "    {part:>5.1} % of it on surface {:<7} {:.1e} there",
            s.surface, s.relmse
        )?;
    }
    Ok(())
}

/// What the bake took.
fn work(facts: &Facts, out: &mut String) -> anyhow::Result<()> {
    let s = &facts.manifest.statistics;
    if s.seconds > 0.0 {
        writeln!(out, "  baked in {:.1} s", s.seconds)?;
    } else {
        writeln!(out, "  baked")?;
    }
    let mut line = |name: &str, text: String| writeln!(out, "    {name:<22} {text}");
    if let Some(texels) = facts.texels {
        line("texels", texels.to_string())?;
    }
    let rays = facts.fragments_a_ray().map_or(String::new(), |n| format!(", {n:.2} a ray"));
    line("fragments", format!("{}{rays}", s.fragments))?;
    if let Some(surfaces) = facts.surfaces_a_tile() {
        line("surfaces in a tile", format!("{surfaces:.2} on the average"))?;
    }
    if s.gathers > 0 {
        let part = 100.0 * s.holes as f64 / s.gathers as f64;
        line("lookups of mirrors", format!("{}, {} ({part:.2} %) in holes", s.gathers, s.holes))?;
    }
    let c = &s.cache;
    if c.hits + c.misses > 0 {
        let part = 100.0 * c.hits as f64 / (c.hits + c.misses) as f64;
        let pages = format!("{} hits ({part:.1} %), {} misses", c.hits, c.misses);
        line("page cache", format!("{pages}, {} evictions", c.evictions))?;
        let read = format!("{} read, {} pages twice", size(c.bytes), c.redundant);
        line("", format!("{read}; {} at most, {:.1} s waited", size(c.peak), c.wait))?;
    }
    if !facts.packed {
        line("written", size(s.bytes_written))?;
        let sync = match s.sync {
            Some(0.0) => "with every commit".to_owned(),
            Some(seconds) => format!("every {seconds} s"),
            None => "left to the system".to_owned(),
        };
        line("sync", sync)?;
    }
    Ok(())
}

fn size(bytes: u64) -> String {
    ByteSize::b(bytes).display().iec().to_string()
}

/// The same as one JSON object.
pub fn json(path: &Path, limits: &Limits) -> anyhow::Result<Value> {
    let facts = facts(path, limits)?;
    let (fragments_a_ray, surfaces_a_tile) = (facts.fragments_a_ray(), facts.surfaces_a_tile());
    let Facts { manifest: m, id, parts, surfaces, texels, packed } = facts;
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
        "texels": texels,
        "packed": packed,
        "commit": m.sequence,
        "parameters": m.parameters,
        "phase": m.phase,
        "cycles": m.cycle,
        "directions_done": m.done_count(),
        "bytes": sizes,
        "ledger": ledger,
        "grids": m.grids,
        "error": m.error,
        "statistics": m.statistics,
        "fragments_a_ray": fragments_a_ray,
        "surfaces_a_tile": surfaces_a_tile,
        "digest": hex(&m.digest),
    }))
}
