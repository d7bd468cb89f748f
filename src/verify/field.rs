//! A field directory, finished or not, against its newest sound commit.

use super::{
    BLOCK, Checked, Finding, Place, Report, SumsBlocks, TextureBlocks, agrees, check_length, hex,
};
use crate::bake::cycle::supplied::Supplied;
use crate::field::files::{self, Opened};
use crate::field::storage::Storage;
use crate::field::{FieldError, hash, read_manifest};
use crate::format::container::{
    ChunkEntry, ChunkId, ChunkKind, Codec, FileKind, Header, NO_DIRECTION,
};
use crate::format::manifest::{Manifest, Phase, record_from_bytes};
use crate::format::tiles::Layout;
use crate::format::{Fault, FormatError, names};
use crate::look::lightfield::{check_scene, texel_count};
use crate::scene::stored;
use rayon::prelude::*;

/// How often a field is looked at again that a bake has moved on meanwhile.
const TRIES: u32 = 5;

/// Checks all that the newest sound commit of a field names, on all threads of the rayon pool it is
/// called in. `progress` is told the finished part in [0, 1]. When something is wrong and the field has
/// moved on to another commit meanwhile, that one is checked instead.
///
/// # Errors
/// When there is no sound commit record, or one by another version; when the system refuses to read
/// them; [`FieldError::Moving`] when a bake was always ahead.
pub fn field(storage: &dyn Storage, progress: &(dyn Fn(f32) + Sync)) -> Result<Report, FieldError> {
    let mut before: Vec<Finding> = Vec::new();
    for _ in 0..TRIES {
        let (header, manifest) = read_manifest(storage)?;
        let mut report = Commit::new(storage, header, manifest, progress).check();
        if report.is_sound() {
            return Ok(report);
        }
        let (header, manifest) = read_manifest(storage)?;
        let now = Report::of(&header, Some(&manifest));
        let commit = |r: &Report| (r.field.clone(), r.state.map(|s| s.commit));
        if commit(&now) == commit(&report) {
            return Ok(report);
        }
        // What two commits in a row name and lack is not a file that the writer has removed.
        let found = std::mem::take(&mut report.findings);
        report.findings = found.iter().filter(|f| before.contains(f)).cloned().collect();
        if !report.findings.is_empty() {
            report.found = report.findings.len() as u64;
            return Ok(report);
        }
        before = found;
    }
    Err(FieldError::Moving(storage.place().to_owned()))
}

/// A file that must be there.
struct Expected {
    name: String,
    header: Header,
    chunks: &'static [ChunkKind],
}

/// The tile files of a folder that must be there.
struct Maps {
    folder: String,
    generation: u32,
    chunks: &'static [ChunkKind],
    directions: Vec<u32>,
}

/// A commit that is being checked.
struct Commit<'a> {
    storage: &'a dyn Storage,
    header: Header,
    manifest: Manifest,
    /// Texels, and whether there are mirrors; unknown when the scene is damaged.
    scene: Option<(u64, bool)>,
    progress: &'a (dyn Fn(f32) + Sync),
    report: Report,
}

impl<'a> Commit<'a> {
    fn new(
        storage: &'a dyn Storage,
        header: Header,
        manifest: Manifest,
        progress: &'a (dyn Fn(f32) + Sync),
    ) -> Commit<'a> {
        let report = Report::of(&header, Some(&manifest));
        Commit { storage, header, manifest, scene: None, progress, report }
    }

    fn expected(
        &self,
        name: String,
        kind: FileKind,
        generation: u32,
        chunks: &'static [ChunkKind],
    ) -> Expected {
        let direction = NO_DIRECTION;
        let header = Header { kind, generation, direction, ..self.header.clone() };
        Expected { name, header, chunks }
    }

    fn check(mut self) -> Report {
        let (cycle, phase) = (self.manifest.cycle, self.manifest.phase);

        // The commit records: both, unless there has been one commit only.
        let own = names::manifest(self.manifest.sequence);
        for name in names::MANIFESTS {
            let file = self.expected(name.to_owned(), FileKind::Manifest, 0, &[ChunkKind::Record]);
            let checked = self.file(&file);
            if name == own || self.manifest.sequence > 1 || !is_missing(&checked) {
                self.report.add(checked);
            }
        }

        // What goes soonest when a bake moves on comes first: the sums, then the textures.
        self.scene();
        if self.manifest.has_sums {
            let name = names::sums(self.manifest.sequence);
            let sums = self.expected(name, FileKind::Sums, cycle, &[ChunkKind::Sums]);
            let checked = self.file(&sums);
            self.report.add(checked);
        }
        let mut hashes = self.manifest.scene_hash.to_vec();
        if cycle > 0 {
            let chunks =
                &[ChunkKind::TotalTexture, ChunkKind::CurrentTexture, ChunkKind::HalfTexture];
            let textures = self.expected(names::textures(cycle), FileKind::Textures, cycle, chunks);
            let checked = self.file(&textures);
            hashes.extend(checked.hashes.iter().flat_map(|h| h.to_le_bytes()));
            self.report.add(checked);
        }

        let maps = self.maps();
        let all: usize = maps.iter().map(|m| m.directions.len()).sum();
        let mut done = 0;
        for maps in &maps {
            for block in maps.directions.chunks(BLOCK) {
                let checked: Vec<Checked> =
                    block.par_iter().map(|direction| self.map(maps, *direction)).collect();
                for checked in checked {
                    if phase == Phase::Finished {
                        hashes.extend(checked.hashes.iter().flat_map(|h| h.to_le_bytes()));
                    }
                    self.report.add(checked);
                }
                done += block.len();
                (self.progress)(done as f32 / all as f32);
            }
        }

        if phase == Phase::Finished && self.report.is_sound() {
            let digest = hash(&hashes);
            self.report.digest = Some(hex(&digest));
            if digest != self.manifest.digest {
                let place = Place::file(names::manifest(self.manifest.sequence), NO_DIRECTION);
                let stated = hex(&self.manifest.digest);
                let what = format!("states the digest {stated}, its files have {}", hex(&digest));
                let findings = vec![place.damaged(what)];
                self.report.add(Checked { findings, ..Checked::default() });
            }
        }
        self.report
    }

    /// Checks the scene, and notes what of it the other files depend on.
    fn scene(&mut self) {
        let file = self.expected(names::SCENE.to_owned(), FileKind::Scene, 0, &[ChunkKind::Scene]);
        let mut facts = None;
        let checked = checked_file(self.storage, &file, |opened, entry| {
            let bytes = opened.chunk(entry)?;
            let read = || {
                let limits = self.storage.limits();
                let scene = stored::from_bytes(&bytes, &limits)?;
                check_scene(&scene, self.header.surfaces)?;
                if hash(&bytes) != self.manifest.scene_hash {
                    return Err(Fault::invalid("is another scene than the record's"));
                }
                let is_mirror = |id| scene.material_of(id).reflectance.is_mirror();
                let texels = texel_count(&scene, &self.manifest, &limits)?;
                Ok((texels, scene.surface_ids().any(is_mirror)))
            };
            facts = Some(read().map_err(at_its_place)?);
            Ok(())
        });
        self.scene = facts;
        self.report.add(checked);
    }

    /// The tile files that the commit names.
    fn maps(&self) -> Vec<Maps> {
        let Manifest { phase, cycle, ref parameters, .. } = self.manifest;
        let all: Vec<u32> = (0..parameters.directions).collect();
        let done: Vec<u32> = all.iter().copied().filter(|d| self.manifest.is_done(*d)).collect();
        let unshot = |generation, directions| {
            let folder = names::generation(generation);
            let chunks: &[_] = &[ChunkKind::Unshot, ChunkKind::Arrived];
            // Without a sound scene a folder that is there says that there are mirrors.
            let mirrors = match self.scene {
                Some((_, mirrors)) => mirrors,
                None => self.storage.list(&folder).is_ok(),
            };
            (mirrors && self.manifest.parameters.stores_mirrors()).then_some(Maps {
                folder,
                generation,
                chunks,
                directions,
            })
        };
        let total = |directions| {
            let (folder, chunks) = (names::TOTAL.to_owned(), &[ChunkKind::Total]);
            Some(Maps { folder, generation: cycle, chunks, directions })
        };
        let shot = |all| if cycle > 0 { unshot(cycle, all) } else { None };
        let maps = match phase {
            Phase::Propagating => [shot(all), unshot(cycle + 1, done)],
            Phase::WritingTotals => [shot(all), total(done)],
            Phase::Finished => [total(all), None],
        };
        maps.into_iter().flatten().collect()
    }

    fn map(&self, maps: &Maps, direction: u32) -> Checked {
        let name = names::tile_file(&maps.folder, direction);
        let expected = self.expected(name, FileKind::Tiles, maps.generation, maps.chunks);
        self.file(&Expected { header: Header { direction, ..expected.header }, ..expected })
    }

    fn file(&self, file: &Expected) -> Checked {
        checked_file(self.storage, file, |opened, entry| self.values(file, opened, entry))
    }

    /// Checks a chunk's hash and what its bytes say.
    fn values(
        &self,
        file: &Expected,
        opened: &mut Opened,
        entry: &ChunkEntry,
    ) -> Result<(), FieldError> {
        let texels = self.scene.map(|(texels, _)| texels);
        match entry.id.kind {
            ChunkKind::TotalTexture | ChunkKind::CurrentTexture | ChunkKind::HalfTexture => {
                check_length(entry, texels.map(|t| 24 * t)).map_err(at_its_place)?;
                let mut blocks = TextureBlocks::default();
                opened.blocks(entry, |block| blocks.take(block))
            }
            ChunkKind::Sums => {
                let surfaces = self.header.surfaces;
                let length = texels.map(|t| Supplied::head(surfaces) + 128 * t);
                check_length(entry, length).map_err(at_its_place)?;
                let mut blocks = SumsBlocks::of(surfaces);
                opened.blocks(entry, |block| blocks.take(block))
            }
            ChunkKind::Record => {
                let bytes = opened.chunk(entry)?;
                check_record(&file.name, &bytes, &opened.directory.header).map_err(at_its_place)
            }
            _ => {
                let bytes = opened.chunk(entry)?;
                let Header { resolution, tile, surfaces, exponent, .. } = self.header;
                let layout = Layout::check(&bytes, resolution, tile, surfaces, exponent);
                layout.map(|_| ()).map_err(at_its_place)
            }
        }
    }
}

/// A fault on its way to a [`Place`], which knows the file.
fn at_its_place(fault: Fault) -> FieldError {
    FormatError { file: String::new(), fault }.into()
}

fn is_missing(checked: &Checked) -> bool {
    checked.findings.iter().any(|f| f.what == "is missing")
}

fn check_record(name: &str, bytes: &[u8], header: &Header) -> Result<(), Fault> {
    let manifest: Manifest = record_from_bytes(bytes)?;
    manifest.check(header)?;
    agrees(&manifest, header)?;
    match names::manifest(manifest.sequence) {
        own if own == name => Ok(()),
        own => Err(Fault::invalid(format!("is of commit {}, which is {own}'s", manifest.sequence))),
    }
}

/// Checks a file: first block and directory, that it belongs where it is and holds the chunks that it
/// must, and each chunk by `values`.
fn checked_file(
    storage: &dyn Storage,
    file: &Expected,
    mut values: impl FnMut(&mut Opened, &ChunkEntry) -> Result<(), FieldError>,
) -> Checked {
    let Expected { name, header, chunks } = file;
    let place = Place::file(name, header.direction);
    let mut checked = Checked::default();
    let opened = files::open(storage, name, header.kind);
    let mut opened = match opened {
        Ok(opened) => opened,
        Err(error) => {
            checked.findings.push(place.error(error));
            return checked;
        }
    };
    (checked.files, checked.bytes) = (1, opened.length);
    if let Some(what) = misplaced(&opened.directory.header, header) {
        checked.findings.push(place.damaged(what));
        return checked;
    }
    let entries = opened.directory.entries.clone();
    let id = |kind: &ChunkKind| ChunkId {
        kind: *kind,
        cycle: header.generation,
        direction: header.direction,
    };
    if !entries.iter().map(|e| e.id).eq(chunks.iter().map(id)) {
        checked.findings.push(place.clone().damaged("does not hold the chunks that it should"));
    }
    for entry in &entries {
        checked.chunks += 1;
        checked.hashes.push(entry.hash);
        let place = place.chunk(entry);
        if entry.codec != Codec::Raw && entry.id.kind != ChunkKind::Scene {
            checked.findings.push(place.damaged("is not stored raw"));
        } else if chunks.contains(&entry.id.kind)
            && let Err(error) = values(&mut opened, entry)
        {
            checked.findings.push(place.error(error));
        }
    }
    checked
}

/// Why a sound file is not the one that should be there, if it is not.
fn misplaced(own: &Header, expected: &Header) -> Option<String> {
    if own == expected {
        None
    } else if own.field != expected.field {
        Some("belongs to another field".to_owned())
    } else if (own.generation, own.direction) != (expected.generation, expected.direction) {
        let direction = match own.direction {
            NO_DIRECTION => "no direction".to_owned(),
            direction => format!("direction {direction}"),
        };
        Some(format!("belongs to generation {}, {direction}", own.generation))
    } else {
        Some("its sizes are not those of the field".to_owned())
    }
}
