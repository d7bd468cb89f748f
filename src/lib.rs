//! Bakes the global illumination of a scene into a *virtual light field* and looks it up.

pub mod radiance;

pub mod ids;

pub mod directions;

pub mod psf;

pub mod format;

pub mod scene;

pub mod gather;

pub mod field;

pub mod bake;

pub mod pack;

pub mod look;

pub mod exit;

pub use directions::Directions;
pub use field::FieldError;
pub use format::manifest::Parameters;
pub use ids::{Cell, DirectionId, MaterialId, Sense, Side, SurfaceId, TileId};
pub use look::lightfield::LightField;
pub use psf::Psf;
pub use radiance::Rgb;
pub use scene::Scene;
pub use scene::camera::Camera;
