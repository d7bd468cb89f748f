//! `vlf plan`.

use super::bake::{commits, parameters, tell_report, threads};
use super::{args, say};
use bytesize::ByteSize;
use std::fmt::Write;
use std::sync::atomic::AtomicBool;
use vlf::Scene;
use vlf::bake::Options;
use vlf::field::Terms;
use vlf::field::storage::Storage;
use vlf::field::storage::disk::Disk;
use vlf::plan::{Plan, plan};

pub fn run(a: &args::Plan) -> anyhow::Result<u8> {
    let b = &a.baking;
    let (scene, report) = Scene::open_within(&b.scene, &b.limits)?;
    tell_report(&report);
    let (commit_every, sync) = commits(b.sync);
    let options = Options {
        memory: b.memory.as_u64(),
        threads: threads(b.threads)?,
        stop: &AtomicBool::new(false),
        progress: &|_| (),
        order: None,
        commit_every,
        terms: Terms { sync, ..Terms::default() },
        force: false,
    };
    let plan = plan(&scene, &parameters(b), &options)?;
    let free = a.output.as_ref().and_then(|place| Disk::new(place).free());
    if a.json {
        let mut json = serde_json::to_value(&plan)?;
        json["disk"]["free"] = free.into();
        json["report"] = serde_json::to_value(&report)?;
        say(&json.to_string())?;
    } else {
        say(&in_words(&plan, free, b.cycles.0.is_none())?)?;
    }
    Ok(0)
}

fn size(bytes: u64) -> String {
    ByteSize::b(bytes).display().iec().to_string()
}

/// The same, rounded up: what is shown must be enough when it is typed.
fn size_up(bytes: u64) -> String {
    let tenth = if bytes < 1 << 30 { (1 << 20) as f64 / 10.0 } else { (1 << 30) as f64 / 10.0 };
    let unit = if bytes < 1 << 30 { "MiB" } else { "GiB" };
    format!("{:.1} {unit}", (bytes as f64 / tenth).ceil() / 10.0)
}

/// The plan in lines.
fn in_words(p: &Plan, free: Option<u64>, auto: bool) -> anyhow::Result<String> {
    let mut out = String::new();
    let mut line = |what: &str, value: String, note: &str| {
        let note = if note.is_empty() { String::new() } else { format!("  {note}") };
        writeln!(out, "  {what:<28}{value:>12}{note}")
    };
    let head = format!(
        "{} directions, {} x {} cells, {} surfaces, {} of them mirrors, {} texels",
        p.directions, p.resolution, p.resolution, p.surfaces, p.mirrors, p.texels
    );
    line("disk, finished", size(p.disk.finished), "")?;
    line("  scene", size(p.disk.scene), "")?;
    line("  texture maps", size(p.disk.textures), "")?;
    line("  total radiance maps", size(p.disk.totals), "")?;
    line("disk, most while baking", size(p.disk.peak), "")?;
    line("disk, written in all", size(p.disk.written), "")?;
    if let Some(free) = free {
        let note = if free < p.disk.peak { "too little" } else { "" };
        line("disk, free", size(free), note)?;
    }
    line("packed", size(p.disk.packed), "")?;
    line("packed, raw", size(p.disk.packed_raw), "")?;
    line("packed, zstd", size(p.disk.packed_zstd), "")?;
    let m = &p.memory;
    let note = if m.granted < m.smallest { "a bake would be refused" } else { "" };
    line("memory, granted", size(m.granted), note)?;
    line("memory, smallest --memory", size_up(m.smallest), "")?;
    line("memory, useful --memory", size_up(m.useful), "")?;
    line("memory, really used", size(m.peak), "")?;
    line("cycles", p.cycles.to_string(), if auto { "expected" } else { "" })?;
    let note = match p.time.threads {
        1 => "on 1 thread, if the disk keeps up".to_owned(),
        n => format!("on {n} threads, if the disk keeps up"),
    };
    line("time", format!("{:.1} s", p.time.seconds), &note)?;
    line("  before the first cycle", format!("{:.1} s", p.time.beginning), "")?;
    line("  cycles", format!("{:.1} s", p.time.cycles), "")?;
    line("  total radiance maps", format!("{:.1} s", p.time.totals), "")?;
    if let Some(seconds) = p.time.processor {
        line("  of processors", format!("{seconds:.1} s"), "")?;
    }
    let (effort, seconds) = (&p.effort, p.effort.seconds);
    let (lines, maps) = (effort.rehearsed, effort.sampled);
    let foot = format!("from a bake of {lines} lines in memory and {maps} maps, in {seconds:.1} s");
    Ok(format!("{head}\n{out}  {foot}"))
}
