//! Bakes the global illumination of a scene into a *virtual light field* and looks it up
//! (Slater et al. 2004).
//!
//! A [`Scene`] is planar [`Surface`]s of diffuse and mirror [`Material`]s in the unit ball. Light
//! travels along fixed lines, [`Directions`], used both ways; the parallel rays of one line are a
//! parallel subfield, [`Psf`], a grid of [`Cell`]s grouped into tiles. [`bake()`] sends the scene's
//! light along all of them, cycle by cycle, and keeps what it finds in a *field*, a directory;
//! [`pack()`] makes one file of a finished field. [`LightField`] opens either, and answers what
//! radiance, an [`Rgb`] in W sr^-1 m^-2, leaves a surface at a point in a direction. [`take`] asks it
//! for every pixel of a [`Camera`] and gives a [`Picture`].
//!
//! ```
//! use std::sync::atomic::AtomicBool;
//! use vlf::{Codec, LightField, Method, Outcome, Parameters, Scene, Visible, bundled};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let folder = tempfile::tempdir()?;
//! let (field, file) = (folder.path().join("room.field"), folder.path().join("room.vlf"));
//!
//! // Scene -> field: 33 lines, 16 x 16 rays each. Far too few, but fast.
//! let (scene, _) = Scene::bundled("cornell")?;
//! let parameters = Parameters {
//!     directions: 33,
//!     resolution: 16,
//!     tile: 8,
//!     cycles: Some(3),
//!     ..Parameters::default()
//! };
//! let options = vlf::bake::Options {
//!     memory: 256 << 20,
//!     threads: 1,
//!     stop: &AtomicBool::new(false),
//!     progress: &|_| (),
//!     order: None,
//!     commit_every: 5.0,
//!     terms: vlf::field::Terms::default(),
//!     force: false,
//! };
//! assert_eq!(vlf::bake(&scene, &parameters, &field, &options)?, Outcome::Finished);
//!
//! // Field -> file.
//! vlf::pack(&field, &file, Codec::Zstd, &|_| ())?;
//!
//! // File -> picture.
//! let light = LightField::open(&file)?;
//! let visible = Visible::new(&light.scene);
//! let mut camera = bundled::cameras("cornell")?.remove(0);
//! (camera.width, camera.height) = (24, 24);
//! let how = (Method::Field, vlf::look::render::Options { samples: 1, ..Default::default() });
//! let picture = vlf::take(&light, &visible, &camera, how, &|_| ())?;
//! assert!(picture.pixels[12 * 24 + 12].mean() > 0.0);
//! # Ok(())
//! # }
//! ```
//!
//! The modules stand in the order in which the data goes through them; each imports only from those
//! above it, and [`look`] knows nothing of how a field is made. `format-spec/` describes the files.

pub mod level;

pub mod radiance;

pub mod ids;

pub mod directions;

pub mod psf;

pub mod format;

pub mod scene;

pub mod visible;

pub mod paths;

pub mod gather;

pub mod textured;

pub mod field;

pub mod bake;

pub mod pack;

pub mod plan;

pub mod look;

pub mod verify;

pub mod exit;

pub use bake::{BakeError, Outcome, bake};
pub use directions::Directions;
pub use field::FieldError;
pub use format::FormatError;
pub use format::container::Codec;
pub use format::manifest::{Parameters, Specular, Transfer};
pub use ids::{Cell, DirectionId, MaterialId, Sense, Side, SmallCell, SurfaceId, TileId};
pub use look::image::Picture;
pub use look::lightfield::{LightField, LookError};
pub use look::render::method::{Method, take};
pub use pack::pack;
pub use psf::Psf;
pub use radiance::Rgb;
pub use scene::camera::Camera;
pub use scene::{Material, Scene, SceneError, Surface, bundled};
pub use visible::Visible;
