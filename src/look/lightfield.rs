//! The reader: a field, packed or not, opened for looking (section 6, first method).
//!
//! In: a `.vlf` file, mapped or read piece by piece, or a field directory. Out: the scene, the Total Texture Maps, and
//! the radiance of any surface at any point in any direction. Nothing is computed, only looked up.
//! Each direction's map is verified when it is first touched.

use super::accessor::Accessor;
use super::maps::{Map, Maps, Source};
use super::packed::{Access, PackFile};
use super::recent::Recent;
use crate::directions::Directions;
use crate::format::container::{self, ChunkKind, FileKind, Header, NO_DIRECTION};
use crate::format::limits::Limits;
use crate::format::manifest::{Manifest, Phase, record_from_bytes};
use crate::format::{Fault, FormatError, names};
use crate::ids::{DirectionId, SurfaceId};
use crate::radiance::Rgb;
use crate::scene::texels::{self, Texels};
use crate::scene::{Scene, stored};
use glam::Vec3;
use std::borrow::Cow;
use std::fs;
use std::io::ErrorKind::NotFound;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// Bytes that decoded maps may take, unless [`LightField::with_memory`] says otherwise.
pub const MEMORY: u64 = 1 << 30;

/// How often a field is opened again when the bake has removed what was about to be read.
const OVERTAKEN: u32 = 3;

/// Which fields will do.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Wanted {
    Finished,
    Newest,
}

/// Why a field cannot be looked at.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LookError {
    /// The system refused.
    #[error("{}: cannot be read: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's answer.
        source: std::io::Error,
    },
    /// A file is damaged or of another kind.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// The bake has not come to its end.
    #[error(
        "{}: the bake is not finished (cycle {cycle}, {done} of {directions} directions); \
         run the same `vlf bake` again to go on with it", path.display()
    )]
    Unfinished {
        /// The field.
        path: PathBuf,
        /// Cycle under way.
        cycle: u32,
        /// Directions done.
        done: u32,
        /// Directions in all.
        directions: u32,
    },
}

/// A field, opened for looking.
pub struct LightField {
    /// The scene.
    pub scene: Scene,
    /// Where the texture maps lie on it.
    pub texels: Texels,
    /// Total Texture Map P^T, two values a texel, emission included, W sr^-1 m^-2.
    pub total: Vec<Rgb>,
    /// The lines.
    pub directions: Directions,
    /// What the field is and how it was baked.
    pub manifest: Manifest,
    /// Whether maps have no diffuse surfaces: then the Total Texture Map has all there is of them.
    pub(super) diffuse_left_out: bool,
    pub(super) source: Source,
    maps: Maps,
    /// What accessors of before remembered, by the parts that they looked at, for those to come.
    remembered: Mutex<Vec<Option<Recent>>>,
}

/// For how many parts it is kept.
const MOST_PARTS: usize = 256;

fn read(path: &Path) -> Result<Vec<u8>, LookError> {
    let failed = |source| LookError::Io { path: path.to_owned(), source };
    let mut file = fs::File::open(path).map_err(failed)?;
    let mut bytes = Vec::new();
    if !file.metadata().map_err(failed)?.is_file() {
        return Err(failed(std::io::Error::other("not a regular file")));
    }
    file.read_to_end(&mut bytes).map_err(failed)?;
    Ok(bytes)
}

/// The newest sound commit record of the field in a folder: what it is and how far its bake has come. While
/// a bake is under way it can be asked for again and again; a record takes a few kilobytes.
///
/// # Errors
/// When there is none, or none is sound.
pub fn newest_manifest(path: &Path, limits: &Limits) -> Result<(Header, Manifest), LookError> {
    let manifest = |name: &str| match read(&path.join(name)) {
        Ok(bytes) => Ok(Some((path.join(name).display().to_string(), bytes))),
        Err(LookError::Io { source, .. }) if source.kind() == NotFound => Ok(None),
        Err(e) => Err(e),
    };
    let [first, second] = names::MANIFESTS;
    let files = [manifest(first)?, manifest(second)?];
    let (header, manifest, _) = Manifest::newest(&path.display().to_string(), files, limits)?;
    Ok((header, manifest))
}

/// A chunk of a field's file, which must be of the field, generation and direction of `place`.
pub(super) fn chunk_of(
    path: &Path,
    place: &Header,
    chunk: ChunkKind,
    limits: &Limits,
) -> Result<Vec<u8>, LookError> {
    let bytes = read(path)?;
    let name = path.display().to_string();
    let directory = container::open(&name, &bytes, place.kind, limits)?;
    let decoded = || {
        directory.header.check_place(&place.field, (place.generation, place.direction))?;
        directory.chunk(&bytes, directory.find(chunk, place.direction)?)
    };
    Ok(decoded().map_err(|f| f.in_file(name))?.into_owned())
}

impl LightField {
    /// Opens a packed field or a finished field directory. A pack is mapped where the system lets it
    /// be; should someone cut the file short meanwhile, the process ends with SIGBUS.
    ///
    /// # Errors
    /// When it is missing, neither of the two, damaged, or not finished.
    pub fn open(path: &Path) -> Result<LightField, LookError> {
        Self::open_within(path, Access::Mapped, &Limits::default())
    }

    /// The same by another access and within other limits on what a file may state. A pack that is read
    /// piece by piece and cut short meanwhile is an error like any other; maps of it that were looked
    /// at stay in memory.
    ///
    /// # Errors
    /// As [`LightField::open`].
    pub fn open_within(
        path: &Path,
        access: Access,
        limits: &Limits,
    ) -> Result<LightField, LookError> {
        match path.is_dir() {
            true => Self::open_field(path, limits, Wanted::Finished),
            false => Self::open_pack(path, access, limits),
        }
    }

    /// The same, but a field whose bake is under way is opened as well, at its newest whole generation:
    /// with the light of all cycles that are committed. [`LightField::is_finished`] says which it is. Of an
    /// unfinished field there are texture maps only, enough for
    /// [`Method::Trace`](crate::look::render::method::Method); in the first cycle only the lamps are lit.
    ///
    /// # Errors
    /// When it is missing, neither of the two, or damaged.
    pub fn open_newest(
        path: &Path,
        access: Access,
        limits: &Limits,
    ) -> Result<LightField, LookError> {
        if !path.is_dir() {
            return Self::open_pack(path, access, limits);
        }
        // Two commits later, the bake removes what is being read here; then there is something newer.
        let mut opened = Self::open_field(path, limits, Wanted::Newest);
        for _ in 0..OVERTAKEN {
            match &opened {
                Err(LookError::Io { source, .. }) if source.kind() == NotFound => {
                    opened = Self::open_field(path, limits, Wanted::Newest);
                }
                _ => break,
            }
        }
        opened
    }

    /// Whether all is there: the total radiance maps, too.
    pub fn is_finished(&self) -> bool {
        self.manifest.phase == Phase::Finished
    }

    fn open_pack(path: &Path, access: Access, limits: &Limits) -> Result<LightField, LookError> {
        let failed = |source| LookError::Io { path: path.to_owned(), source };
        let name = path.display().to_string();
        let file = PackFile::open(path, access).map_err(failed)?;
        let directory = file.directory(limits)?;
        let chunk = |kind| file.chunk(&directory, directory.find(kind, NO_DIRECTION)?);
        let parts = || -> Result<_, Fault> {
            let manifest: Manifest = record_from_bytes(&chunk(ChunkKind::Record)?)?;
            manifest.check(&directory.header)?;
            if manifest.phase != Phase::Finished {
                return Err(Fault::invalid("a pack of a bake that is not finished"));
            }
            if directory.entries.iter().any(|e| e.id.cycle != manifest.cycle) {
                return Err(Fault::invalid("its chunks are not of the record's cycle"));
            }
            let scene = stored::from_bytes(&chunk(ChunkKind::Scene)?, limits)?;
            check_scene(&scene, directory.header.surfaces)?;
            let texture = directory.find(ChunkKind::TotalTexture, NO_DIRECTION)?;
            let bytes = || file.chunk(&directory, texture);
            let (texels, total) = textures_of(&scene, &manifest, texture.raw, bytes, limits)?;
            Ok((manifest, scene, texels, total))
        };
        let (manifest, scene, texels, total) = parts().map_err(|f| f.in_file(&name))?;
        let header = directory.header.clone();
        // A directory that was checked has an entry for each.
        let mut places = vec![0; header.directions as usize];
        for (place, entry) in directory.entries.iter().enumerate() {
            if entry.id.kind == ChunkKind::Total {
                places[entry.id.direction as usize] = place;
            }
        }
        let source = Source::Pack { file: Arc::new(file), directory, places };
        Self::assemble(&name, (scene, texels, total), manifest, &header, source)
    }

    fn open_field(path: &Path, limits: &Limits, wanted: Wanted) -> Result<LightField, LookError> {
        let (header, manifest) = newest_manifest(path, limits)?;
        if wanted == Wanted::Finished && manifest.phase != Phase::Finished {
            return Err(LookError::Unfinished {
                path: path.to_owned(),
                cycle: manifest.cycle,
                done: manifest.done_count(),
                directions: manifest.parameters.directions,
            });
        }
        let place = |kind, generation| Header { kind, generation, ..header.clone() };
        let scene_path = path.join(names::SCENE);
        let bytes = chunk_of(&scene_path, &place(FileKind::Scene, 0), ChunkKind::Scene, limits)?;
        let in_scene = |f: Fault| f.in_file(scene_path.display());
        let scene = stored::from_bytes(&bytes, limits).map_err(in_scene)?;
        check_scene(&scene, header.surfaces).map_err(in_scene)?;
        let (texels, total) = match manifest.cycle {
            0 if manifest.phase != Phase::Finished => {
                lamps_alone(&scene, &manifest, limits).map_err(in_scene)?
            }
            cycle => {
                let texture_path = path.join(names::textures(cycle));
                let textures = place(FileKind::Textures, cycle);
                let bytes = chunk_of(&texture_path, &textures, ChunkKind::TotalTexture, limits)?;
                let raw = bytes.len() as u64;
                textures_of(&scene, &manifest, raw, || Ok(Cow::Owned(bytes)), limits)
                    .map_err(|f| f.in_file(texture_path.display()))?
            }
        };
        let source =
            Source::Field { path: path.to_owned(), header: header.clone(), limits: *limits };
        let parts = (scene, texels, total);
        Self::assemble(&path.display().to_string(), parts, manifest, &header, source)
    }

    fn assemble(
        name: &str,
        (scene, texels, total): (Scene, Texels, Vec<Rgb>),
        manifest: Manifest,
        header: &Header,
        source: Source,
    ) -> Result<LightField, LookError> {
        let lines = manifest.parameters.directions;
        let directions = Directions::with_lines(lines)
            .ok_or_else(|| Fault::invalid(format!("{lines} directions")).in_file(name))?;
        let maps = Maps::new(MEMORY);
        Ok(LightField {
            scene,
            texels,
            total,
            directions,
            manifest,
            diffuse_left_out: header.leaves_diffuse_out(),
            source,
            maps,
            remembered: Mutex::default(),
        })
    }

    /// The same with other room for decoded maps, in bytes; what threads look at, and what is remembered of
    /// parts of pictures, comes on top.
    pub fn with_memory(self, bytes: u64) -> LightField {
        LightField { maps: Maps::new(bytes), ..self }
    }

    /// The total radiance map of a direction, verified, with every value in place.
    ///
    /// # Errors
    /// When it is missing or damaged.
    pub fn map(&self, direction: u32) -> Result<Arc<Map>, FormatError> {
        let filled = self.filled(direction, self.held(direction)?);
        filled.map_err(|fault| fault.in_file(format!("direction {direction}")))
    }

    /// The same as it is held: a pack's may leave values to the texture map.
    pub(super) fn held(&self, direction: u32) -> Result<Arc<Map>, FormatError> {
        self.maps.get(direction, || self.load(direction))
    }

    /// Whether there is room for as many maps as are held: none that was looked at has to go for another.
    pub(super) fn has_room(&self) -> bool {
        self.maps.has_room()
    }

    /// A thread's own way to the maps, which remembers the last ones.
    pub fn accessor(&self) -> Accessor<'_> {
        self.accessor_for(0)
    }

    /// The same for a numbered part of pictures: what the last one for this part has seen is remembered, 1.7 MB
    /// for each of up to 256 parts, which come on top of what decoded maps may take.
    pub fn accessor_for(&self, part: usize) -> Accessor<'_> {
        Accessor::new(self, part)
    }

    /// What an accessor of before remembered of a part.
    pub(super) fn remembered(&self, part: usize) -> Recent {
        let mut kept = self.remembered.lock().unwrap_or_else(PoisonError::into_inner);
        kept.get_mut(part).and_then(Option::take).unwrap_or_default()
    }

    /// Keeps what an accessor remembers of a part for one to come.
    pub(super) fn remember(&self, part: usize, recent: Recent) {
        if part < MOST_PARTS {
            let mut kept = self.remembered.lock().unwrap_or_else(PoisonError::into_inner);
            if kept.len() <= part {
                kept.resize_with(part + 1, Option::default);
            }
            kept[part] = Some(recent);
        }
    }

    /// Bytes of decoded maps that are held.
    pub fn memory(&self) -> u64 {
        self.maps.bytes()
    }

    /// The directions whose maps were needed so far and found missing or damaged.
    pub fn damaged(&self) -> Vec<DirectionId> {
        self.maps.damaged()
    }

    /// Radiance leaving the side of `surface` that faces `away` (a unit vector pointing from the
    /// surface), at a point of its plane, in the fitted scene's units; W sr^-1 m^-2.
    ///
    /// For a mirror the field holds what arrives at it: the radiance from the mirrored direction is
    /// looked up and multiplied by the reflectance. Whoever looks often asks an [`Accessor`].
    ///
    /// ```
    /// use std::sync::atomic::AtomicBool;
    /// use vlf::{Codec, LightField, Parameters, Scene};
    ///
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # let folder = tempfile::tempdir()?;
    /// # let (baked, file) = (folder.path().join("room.field"), folder.path().join("room.vlf"));
    /// # let (scene, _) = Scene::bundled("cornell")?;
    /// # let small = Parameters { directions: 33, resolution: 16, tile: 8, ..Parameters::default() };
    /// # let parameters = Parameters { cycles: Some(2), ..small };
    /// # let options = vlf::bake::Options {
    /// #     memory: 256 << 20,
    /// #     threads: 1,
    /// #     stop: &AtomicBool::new(false),
    /// #     progress: &|_| (),
    /// #     order: None,
    /// #     commit_every: 5.0,
    /// #     terms: vlf::field::Terms::default(),
    /// #     force: false,
    /// # };
    /// # vlf::bake(&scene, &parameters, &baked, &options)?;
    /// # vlf::pack(&baked, &file, Codec::Planes, &|_| ())?;
    /// let light = LightField::open(&file)?;
    /// // What the lamp sends straight from its middle.
    /// let lamp = light.scene.surface_ids().find(|id| light.scene.material_of(*id).emitted.max() > 0.0);
    /// let lamp = lamp.ok_or("a room without a lamp")?;
    /// let surface = light.scene.surface(lamp);
    /// let middle = surface.origin + surface.u * (surface.extent.x / 2.0) + surface.v * (surface.extent.y / 2.0);
    /// let radiance = light.radiance(lamp, middle, surface.normal)?;
    /// assert!(radiance.max() >= 0.999 * light.scene.material_of(lamp).emitted.max());
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// When a direction's map is missing or damaged.
    pub fn radiance(
        &self,
        surface: SurfaceId,
        point: Vec3,
        away: Vec3,
    ) -> Result<Rgb, FormatError> {
        self.accessor().radiance(surface, point, away)
    }
}

/// The texels of a scene, and the values of its texture map, which must take `raw` bytes; that is
/// compared before `bytes` has to make room for them, since a file may ask for any number of texels.
fn textures_of<'a>(
    scene: &Scene,
    manifest: &Manifest,
    raw: u64,
    bytes: impl FnOnce() -> Result<Cow<'a, [u8]>, Fault>,
    limits: &Limits,
) -> Result<(Texels, Vec<Rgb>), Fault> {
    let count = texel_count(scene, manifest, limits)?;
    if 24 * count != raw {
        return Err(Fault::invalid(format!("texture map: {raw} bytes for {count} texels")));
    }
    let total = texels::from_bytes(&bytes()?, 2 * count as usize)?;
    Ok((Texels::try_new(scene, manifest.parameters.texel_edge())?, total))
}

/// The texels of a scene, and the texture map of a bake that has not ended its first cycle: what is
/// emitted and nothing else. There is no file of it.
fn lamps_alone(
    scene: &Scene,
    manifest: &Manifest,
    limits: &Limits,
) -> Result<(Texels, Vec<Rgb>), Fault> {
    texel_count(scene, manifest, limits)?;
    let texels = Texels::try_new(scene, manifest.parameters.texel_edge())?;
    let emitted = |surface: &u32| scene.material_of(SurfaceId(*surface)).emitted;
    let total = texels.surface_of.iter().flat_map(|s| [emitted(s), Rgb::BLACK]).collect();
    Ok((texels, total))
}

/// How many texels a scene has in a field. Counted, not laid: a file may ask for any number.
///
/// # Errors
/// When they are more than a field may have.
pub fn texel_count(scene: &Scene, manifest: &Manifest, limits: &Limits) -> Result<u64, Fault> {
    limits.check_texels(Texels::count(scene, manifest.parameters.texel_edge()))
}

/// Refuses a scene that is not the one of its file's header.
///
/// # Errors
/// When it has another number of surfaces.
pub fn check_scene(scene: &Scene, surfaces: u32) -> Result<(), Fault> {
    match scene.surfaces.len() as u64 == u64::from(surfaces) {
        true => Ok(()),
        false => Err(Fault::invalid("its scene has another number of surfaces than its header")),
    }
}
