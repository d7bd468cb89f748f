//! `vlf verify`.

use super::progress::{Bar, tell};
use super::{args, bake, say};
use bytesize::ByteSize;
use serde_json::json;
use std::fmt::Write;
use vlf::exit;
use vlf::field::FieldError;
use vlf::field::storage::disk::Disk;
use vlf::format::manifest::Phase;
use vlf::verify::{self, Report, Trouble};

/// Findings that are repeated on standard error.
const TOLD: usize = 5;

pub fn run(a: &args::Verify) -> anyhow::Result<u8> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(bake::threads(a.threads)?).build()?;
    let bar = Bar::new("verifying");
    let result = pool.install(|| match a.field.is_dir() {
        true => verify::field(&Disk::within(&a.field, a.limits), &|part| bar.part(part)),
        false => verify::pack(&a.field, &a.limits, &|part| bar.part(part)),
    });
    bar.end();
    if a.json {
        say(&as_json(a, &result)?.to_string())?;
    }
    let report = result?;
    if !a.json {
        say(&as_text(a, &report)?)?;
    }
    for finding in report.findings.iter().take(TOLD) {
        // A pack is the file itself.
        match a.field.is_dir() {
            true => tell(&format!("vlf: {}/{finding}", a.field.display())),
            false => tell(&format!("vlf: {finding}")),
        }
    }
    if report.found > TOLD as u64 {
        tell(&format!("vlf: {} more", report.found - TOLD as u64));
    }
    Ok(match report.trouble() {
        None => 0,
        Some(Trouble::Damaged) => exit::CORRUPT,
        Some(Trouble::Unsupported) => exit::UNSUPPORTED,
        Some(Trouble::Limited) => exit::LIMIT,
        Some(Trouble::Unreadable) => exit::IO,
    })
}

fn as_json(
    a: &args::Verify,
    result: &Result<Report, FieldError>,
) -> anyhow::Result<serde_json::Value> {
    let mut out = match result {
        Ok(report) => serde_json::to_value(report)?,
        Err(error) => json!({"error": error.to_string()}),
    };
    out["path"] = json!(a.field.display().to_string());
    out["sound"] = json!(result.as_ref().is_ok_and(Report::is_sound));
    Ok(out)
}

fn as_text(a: &args::Verify, report: &Report) -> anyhow::Result<String> {
    let mut out = format!("field {}", report.field);
    if let Some(s) = report.state {
        let (done, all) = (s.done, s.directions);
        let commit = match s.commit {
            0 => "packed".to_owned(),
            commit => format!("commit {commit}"),
        };
        write!(out, "\n  {commit}, ")?;
        match s.phase {
            Phase::Propagating => {
                write!(out, "cycle {}: {done} of {all} directions done", s.cycle + 1)?;
            }
            Phase::WritingTotals => write!(out, "total maps: {done} of {all} directions done")?,
            Phase::Finished => write!(out, "finished after {} cycles", s.cycle)?,
        }
    }
    let bytes = ByteSize::b(report.bytes).display().iec();
    let files = if report.files == 1 { "file" } else { "files" };
    write!(out, "\n  checked {} {files}, {} chunks, {bytes}", report.files, report.chunks)?;
    if a.digest {
        match (&report.digest, &report.stated_digest) {
            (Some(digest), _) => write!(out, "\n  digest {digest}")?,
            (None, Some(stated)) => write!(out, "\n  digest {stated} (as stated)")?,
            (None, None) => write!(out, "\n  no digest: not finished")?,
        }
    }
    match report.found {
        0 => write!(out, "\n  sound")?,
        1 => write!(out, "\n  1 fault")?,
        n => write!(out, "\n  {n} faults")?,
    }
    for finding in &report.findings {
        write!(out, "\n    {finding}")?;
    }
    match report.found - report.findings.len() as u64 {
        0 => {}
        more => write!(out, "\n    and {more} more")?,
    }
    Ok(out)
}
