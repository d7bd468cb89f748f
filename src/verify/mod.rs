//! The whole of a field or pack checked: structure, hashes, values.
//!
//! In: a field in any state, or a pack. Out: a [`Report`] of what was looked at and of everything in it
//! that is damaged; one fault does not hide the next. Nothing is written and no lock is taken, so that a
//! field can be checked where it may only be read, and while it is baked. Directions are checked side
//! by side, one map a thread in memory.
//!
//! [`field`] checks what the newest sound commit names, [`pack`] one file.

mod field;

mod pack;

pub use field::field;
pub use pack::pack;

use crate::bake::cycle::supplied::Supplied;
use crate::bake::ledger::Tally;
use crate::bake::transfer::Fixed;
use crate::directions::Directions;
use crate::field::FieldError;
use crate::format::bytes::Reader;
use crate::format::container::{ChunkEntry, ChunkKind, Header, NO_DIRECTION};
use crate::format::manifest::{Manifest, Phase};
use crate::format::{Fault, FormatError};
use crate::scene::texels;
use serde::Serialize;
use std::fmt;
use std::io::ErrorKind;

/// Findings that a report lists; more are only counted.
pub const LISTED: usize = 100;

/// Directions checked between two looks at what was found.
const BLOCK: usize = 1024;

/// What a check has found.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Report {
    /// Identity of the field, in hexadecimal.
    pub field: String,
    /// The commit or pack that was checked; `None` when a pack's record is damaged.
    pub state: Option<State>,
    /// Files that could be opened.
    pub files: u64,
    /// Chunks in them.
    pub chunks: u64,
    /// Bytes of the files.
    pub bytes: u64,
    /// How many things are wrong.
    pub found: u64,
    /// The first [`LISTED`] of them, in the order of the files.
    pub findings: Vec<Finding>,
    /// Digest of the finished field as its record states it, in hexadecimal.
    pub stated_digest: Option<String>,
    /// The same computed from the files: of a finished field whose files are sound. A pack lacks the
    /// current texture map, which counts into it.
    pub digest: Option<String>,
}

/// Where a field stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct State {
    /// Number of the commit; 0 for a pack.
    pub commit: u64,
    /// The phase.
    pub phase: Phase,
    /// The cycle under way, or the cycles done.
    pub cycle: u32,
    /// Lines of the step under way that are done.
    pub done: u32,
    /// Lines in all.
    pub directions: u32,
}

/// Kinds of findings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Trouble {
    /// Missing, damaged or in the wrong place.
    Damaged,
    /// Perhaps good, but made by another version.
    Unsupported,
    /// Perhaps good, but larger than a limit that can be raised.
    Limited,
    /// The system refused to read it.
    Unreadable,
}

/// One thing that is wrong.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// What kind of thing.
    pub trouble: Trouble,
    /// The file, within the field.
    pub file: String,
    /// The part of the file.
    pub section: Option<String>,
    /// The line that the file or chunk belongs to.
    pub direction: Option<u32>,
    /// Where in the file the part begins.
    pub offset: Option<u64>,
    /// What is wrong with it.
    pub what: String,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}", self.file)?;
        match (&self.section, self.direction) {
            (Some(section), Some(direction)) => write!(f, ": {section} of direction {direction}")?,
            (Some(section), None) => write!(f, ": {section}")?,
            (None, Some(direction)) => write!(f, ": direction {direction}")?,
            (None, None) => {}
        }
        write!(f, ": {}", self.what)?;
        match self.offset {
            Some(offset) => write!(f, " at offset {offset:#x}"),
            None => Ok(()),
        }
    }
}

impl Report {
    fn of(header: &Header, manifest: Option<&Manifest>) -> Report {
        let state = manifest.map(|m| State {
            commit: m.sequence,
            phase: m.phase,
            cycle: m.cycle,
            done: m.done_count(),
            directions: m.parameters.directions,
        });
        let finished = manifest.filter(|m| m.phase == Phase::Finished);
        let stated_digest = finished.map(|m| hex(&m.digest));
        Report { field: hex(&header.field), state, stated_digest, ..Report::default() }
    }

    /// Whether nothing is wrong.
    pub fn is_sound(&self) -> bool {
        self.found == 0
    }

    /// The worst kind of finding.
    pub fn trouble(&self) -> Option<Trouble> {
        let is = |t: &Trouble| self.findings.iter().any(|f| f.trouble == *t);
        [Trouble::Damaged, Trouble::Unsupported, Trouble::Limited, Trouble::Unreadable]
            .into_iter()
            .find(is)
    }

    fn add(&mut self, checked: Checked) {
        self.files += checked.files;
        self.chunks += checked.chunks;
        self.bytes += checked.bytes;
        for finding in checked.findings {
            self.found += 1;
            // The list must not hide damage behind what could only not be read.
            let worse =
                finding.trouble == Trouble::Damaged && self.trouble() != Some(Trouble::Damaged);
            if self.findings.len() < LISTED {
                self.findings.push(finding);
            } else if worse {
                self.findings[LISTED - 1] = finding;
            }
        }
    }
}

/// What the check of a file, or of a part of one, gave.
#[derive(Default)]
struct Checked {
    files: u64,
    chunks: u64,
    bytes: u64,
    /// Of its chunks, in the directory's order.
    hashes: Vec<u64>,
    findings: Vec<Finding>,
}

/// A file or a part of one, for findings.
#[derive(Clone, Default)]
struct Place {
    file: String,
    section: Option<String>,
    direction: Option<u32>,
    offset: Option<u64>,
    /// How the readers' messages name the chunk, which is named already.
    named: String,
}

impl Place {
    fn file(name: &str, direction: u32) -> Place {
        let direction = Some(direction).filter(|d| *d != NO_DIRECTION);
        Place { file: name.to_owned(), direction, ..Place::default() }
    }

    fn chunk(&self, entry: &ChunkEntry) -> Place {
        let direction = Some(entry.id.direction).filter(|d| *d != NO_DIRECTION);
        Place {
            section: Some(section(entry.id.kind).to_owned()),
            direction: direction.or(self.direction),
            offset: Some(entry.offset),
            file: self.file.clone(),
            named: format!("{}: ", entry.id),
        }
    }

    fn finding(self, trouble: Trouble, what: impl Into<String>) -> Finding {
        let Place { file, section, direction, offset, .. } = self;
        Finding { trouble, file, section, direction, offset, what: what.into() }
    }

    fn damaged(self, what: impl Into<String>) -> Finding {
        self.finding(Trouble::Damaged, what)
    }

    fn fault(mut self, fault: Fault) -> Finding {
        if fault.is_unsupported() {
            return self.finding(Trouble::Unsupported, fault.to_string());
        }
        if fault.is_limited() {
            return self.finding(Trouble::Limited, fault.to_string());
        }
        match fault {
            Fault::Checksum { what, offset } => {
                self.section.get_or_insert(what);
                self.offset = Some(offset);
                self.damaged("checksum mismatch")
            }
            other => {
                let what = other.to_string();
                let what = what.strip_prefix(&self.named).unwrap_or(&what).to_owned();
                self.damaged(what)
            }
        }
    }

    fn error(self, error: FieldError) -> Finding {
        match error {
            FieldError::Format(FormatError { fault, .. }) => self.fault(fault),
            FieldError::Io { source, .. } => match source.kind() {
                ErrorKind::NotFound | ErrorKind::NotADirectory => self.damaged("is missing"),
                ErrorKind::UnexpectedEof => self.damaged("truncated while it was read"),
                _ => self.finding(Trouble::Unreadable, format!("cannot be read: {source}")),
            },
            other => self.finding(Trouble::Unreadable, other.to_string()),
        }
    }
}

/// What a chunk is called.
fn section(kind: ChunkKind) -> &'static str {
    match kind {
        ChunkKind::Record => "record",
        ChunkKind::Scene => "scene",
        ChunkKind::TotalTexture => "total texture map",
        ChunkKind::CurrentTexture => "current texture map",
        ChunkKind::HalfTexture => "texture map of half of the lines",
        ChunkKind::Sums => "sums",
        ChunkKind::Unshot => "unshot map",
        ChunkKind::Arrived => "arrived map",
        ChunkKind::Total => "total map",
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

/// Checks what a record says beyond [`Manifest::check`]: its identity, and that it agrees with itself.
fn agrees(manifest: &Manifest, header: &Header) -> Result<(), Fault> {
    let p = &manifest.parameters;
    let require = |holds: bool, what: &str| match holds {
        true => Ok(()),
        false => Err(Fault::invalid(what)),
    };
    require(
        crate::field::identity(manifest)? == header.field,
        "its identity is not that of its parameters and scene",
    )?;
    let lattice = Directions::with_lines(p.directions).is_some();
    require(lattice, "there is no lattice of so many directions")?;
    require(manifest.ledger.len() == manifest.cycle as usize, "not one ledger a finished cycle")?;
    let beyond = (p.directions..8 * manifest.done.len() as u32).any(|d| manifest.is_done(d));
    require(!beyond, "directions are done that there are not")?;
    let finished = manifest.phase == Phase::Finished;
    require(!finished || manifest.done_count() == p.directions, "finished, but not all is done")?;
    require(finished || manifest.digest == [0; 16], "not finished, but it has a digest")?;
    let propagating = manifest.phase == Phase::Propagating;
    require(propagating || !manifest.has_sums, "it has sums of no cycle")?;
    require(propagating || manifest.cycle > 0, "its totals are of no cycle")
}

/// Checks the values of a texture map that comes in blocks.
#[derive(Default)]
struct TextureBlocks {
    rest: Vec<u8>,
    values: Vec<crate::radiance::Rgb>,
}

impl TextureBlocks {
    fn take(&mut self, block: &[u8]) -> Result<(), Fault> {
        self.rest.extend_from_slice(block);
        let whole = self.rest.len() / 12 * 12;
        self.values.clear();
        texels::read_values(&self.rest[..whole], &mut self.values)?;
        self.rest.drain(..whole);
        Ok(())
    }
}

/// Checks the values of sums that come in blocks: that they could have been summed over lines.
struct SumsBlocks {
    rest: Vec<u8>,
    surfaces: u32,
    headed: bool,
}

impl SumsBlocks {
    /// Of a scene of so many surfaces.
    fn of(surfaces: u32) -> SumsBlocks {
        SumsBlocks { rest: Vec::new(), surfaces, headed: false }
    }

    fn take(&mut self, block: &[u8]) -> Result<(), Fault> {
        self.rest.extend_from_slice(block);
        let mut r = Reader::new(&self.rest);
        if !self.headed {
            if (self.rest.len() as u64) < Supplied::head(self.surfaces) {
                return Ok(());
            }
            Tally::read(&mut r)?;
            Supplied::read(&mut r, self.surfaces)?;
            self.headed = true;
        }
        while r.left() >= size_of::<Fixed>() {
            let [red, green, blue, lines] = [r.i64()?, r.i64()?, r.i64()?, r.i64()?];
            if [red, green, blue, lines].iter().any(|v| *v < 0) {
                return Err(Fault::invalid("sums: a texel's are negative"));
            }
            if lines == 0 && [red, green, blue] != [0; 3] {
                return Err(Fault::invalid("sums: a texel has light of no line"));
            }
        }
        let used = self.rest.len() - r.left();
        self.rest.drain(..used);
        Ok(())
    }
}

/// Refuses a chunk whose length is not the one that the scene gives it.
fn check_length(entry: &ChunkEntry, expected: Option<u64>) -> Result<(), Fault> {
    match expected {
        Some(expected) if entry.raw != expected => Err(Fault::invalid(format!(
            "{} bytes, where the scene's texels take {expected}",
            entry.raw
        ))),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_finding_says_where_and_what_once() {
        let place = Place::file("total/000017.tiles", 17);
        let say = |finding: Finding| finding.to_string();
        let missing = FieldError::io("read", "x".as_ref())(ErrorKind::NotFound.into());
        let said = say(place.clone().error(missing));
        assert_eq!(said, "total/000017.tiles: direction 17: is missing");
        let fault = Fault::Checksum { what: "first block".into(), offset: 0 };
        let said = say(place.clone().fault(fault));
        let expected = "first block of direction 17: checksum mismatch at offset 0x0";
        assert_eq!(said, format!("total/000017.tiles: {expected}"));
        let named = Place { named: "Total of direction 17: ".into(), ..place.clone() };
        let said = say(named.fault(Fault::invalid("Total of direction 17: not a zstd frame")));
        assert_eq!(said, "total/000017.tiles: direction 17: not a zstd frame");
        let other = Fault::Version { major: 2, minor: 0 };
        assert_eq!(place.fault(other).trouble, Trouble::Unsupported);
    }

    #[test]
    fn a_full_list_still_shows_the_worst() {
        let mut report = Report::default();
        let place = Place::file("scene", NO_DIRECTION);
        let add = |report: &mut Report, trouble| {
            let findings = vec![place.clone().finding(trouble, "")];
            report.add(Checked { findings, ..Checked::default() });
        };
        assert!(report.is_sound() && report.trouble().is_none());
        (0..2 * LISTED).for_each(|_| add(&mut report, Trouble::Unreadable));
        assert_eq!(report.trouble(), Some(Trouble::Unreadable));
        (0..3).for_each(|_| add(&mut report, Trouble::Damaged));
        assert_eq!(report.trouble(), Some(Trouble::Damaged));
        assert_eq!((report.findings.len(), report.found), (LISTED, 2 * LISTED as u64 + 3));
    }
}
