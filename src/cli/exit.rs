//! Exit codes: 0 done, 2 usage, 3 input or output, 4 corrupt data, 5 unsupported version, 6 locked,
//! 7 limit, 8 another bake, 130 and 143 interrupted.

use vlf::bake::BakeError;
use vlf::field::FieldError;
use vlf::format::{Fault, FormatError};
use vlf::look::image::ImageError;
use vlf::look::lightfield::LookError;
use vlf::pack::PackError;
use vlf::scene::SceneError;
use vlf::scene::camera::CameraError;

/// What was asked for cannot be meant.
pub const USAGE: u8 = 2;
const IO: u8 = 3;
const CORRUPT: u8 = 4;
const UNSUPPORTED: u8 = 5;
const LOCKED: u8 = 6;
const LIMIT: u8 = 7;
const IDENTITY: u8 = 8;

/// A mistake in what was asked for.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct Usage(pub String);

/// Shorthand for an error of usage.
pub fn usage(what: impl Into<String>) -> anyhow::Error {
    Usage(what.into()).into()
}

/// The exit code of an error.
pub fn code(error: &anyhow::Error) -> u8 {
    error.chain().find_map(|e| one(e)).unwrap_or(IO)
}

/// Whether the reader of standard output has gone.
pub fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error
        .downcast_ref::<std::io::Error>()
        .is_some_and(|e| e.kind() == std::io::ErrorKind::BrokenPipe)
}

fn one(e: &(dyn std::error::Error + 'static)) -> Option<u8> {
    if e.is::<Usage>() {
        return Some(USAGE);
    }
    if let Some(e) = e.downcast_ref::<BakeError>() {
        return Some(match e {
            BakeError::Parameter(_) => USAGE,
            BakeError::Field(e) => field(e),
            BakeError::Memory { .. } => LIMIT,
            _ => CORRUPT,
        });
    }
    if let Some(e) = e.downcast_ref::<PackError>() {
        return Some(match e {
            PackError::Field(e) => field(e),
            PackError::Unfinished(_) => USAGE,
            _ => IO,
        });
    }
    if let Some(e) = e.downcast_ref::<LookError>() {
        return Some(match e {
            LookError::Format(e) => format(e),
            LookError::Unfinished { .. } => USAGE,
            _ => IO,
        });
    }
    if let Some(e) = e.downcast_ref::<SceneError>() {
        return Some(match e {
            SceneError::Read { .. } | SceneError::Library { .. } => IO,
            SceneError::TooLarge { .. } => LIMIT,
            SceneError::UnknownBundled { .. } => USAGE,
            _ => CORRUPT,
        });
    }
    if let Some(e) = e.downcast_ref::<CameraError>() {
        return Some(camera(e));
    }
    if let Some(e) = e.downcast_ref::<ImageError>() {
        return Some(match e {
            ImageError::Damaged { .. } => CORRUPT,
            ImageError::TooLarge { .. } => LIMIT,
            _ => IO,
        });
    }
    e.downcast_ref::<FieldError>()
        .map(field)
        .or_else(|| e.downcast_ref::<FormatError>().map(format))
}

fn camera(e: &CameraError) -> u8 {
    match e {
        CameraError::Field { .. } => USAGE,
        CameraError::Json(_) => CORRUPT,
        CameraError::File { source, .. } => camera(source),
        _ => IO,
    }
}

fn field(e: &FieldError) -> u8 {
    match e {
        FieldError::Format(e) => format(e),
        FieldError::Locked(_) => LOCKED,
        FieldError::Identity { .. } => IDENTITY,
        FieldError::Foreign(_) => CORRUPT,
        _ => IO,
    }
}

fn format(e: &FormatError) -> u8 {
    match &e.fault {
        fault if fault.is_unsupported() => UNSUPPORTED,
        Fault::Limit { .. } => LIMIT,
        _ => CORRUPT,
    }
}
