//! Exit codes that all programs share: 0 done, 2 usage, 3 input or output, 4 corrupt data, 5 unsupported version, 6 locked,
//! 7 limit, 8 another bake, 130 and 143 interrupted.

use crate::bake::BakeError;
use crate::field::FieldError;
use crate::format::text::inert;
use crate::format::{Fault, FormatError};
use crate::look::image::ImageError;
use crate::look::lightfield::LookError;
use crate::look::path::PathError;
use crate::pack::PackError;
use crate::scene::SceneError;
use crate::scene::camera::CameraError;
use std::error::Error;

/// What was asked for cannot be meant.
pub const USAGE: u8 = 2;
/// The system refused; a field is intact and can be gone on with.
pub const IO: u8 = 3;
/// What is there is damaged.
pub const CORRUPT: u8 = 4;
/// It may be good, but this version cannot read it.
pub const UNSUPPORTED: u8 = 5;
const LOCKED: u8 = 6;
/// More than a limit allows.
pub const LIMIT: u8 = 7;
const IDENTITY: u8 = 8;

/// A mistake in what was asked for.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct Usage(pub String);

/// What was asked for is more than this machine allows.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct Limit(pub String);

/// The exit code of an error: that of the first error in its chain of causes that has one.
pub fn code(error: &(dyn Error + 'static)) -> u8 {
    causes(error).find_map(one).unwrap_or(IO)
}

/// Whether the reader of standard output has gone.
pub fn is_broken_pipe(error: &(dyn Error + 'static)) -> bool {
    let gone = |e: &std::io::Error| e.kind() == std::io::ErrorKind::BrokenPipe;
    causes(error).any(|e| e.downcast_ref().is_some_and(gone))
}

/// The most characters of a cause.
const LONGEST: usize = 1000;

/// An error and its causes in one line, each once: many tell their cause themselves.
pub fn said(error: &(dyn Error + 'static)) -> String {
    causes(error).fold(String::new(), |said, cause| {
        let cause = cause.to_string();
        // What others say of a file may hold what is in it.
        let cause = if said.is_empty() { cause } else { inert(&cause, LONGEST) };
        match said.as_str() {
            "" => cause,
            before if before.contains(&cause) => said,
            before => format!("{before}: {cause}"),
        }
    })
}

fn causes<'a>(error: &'a (dyn Error + 'static)) -> impl Iterator<Item = &'a (dyn Error + 'static)> {
    std::iter::successors(Some(error), |e: &&'a (dyn Error + 'static)| (*e).source())
}

fn one(e: &(dyn Error + 'static)) -> Option<u8> {
    if e.is::<Usage>() {
        return Some(USAGE);
    }
    if e.is::<Limit>() {
        return Some(LIMIT);
    }
    if let Some(e) = e.downcast_ref::<BakeError>() {
        return Some(match e {
            BakeError::Parameter(_) => USAGE,
            BakeError::Field(e) => field(e),
            BakeError::Memory { .. } => LIMIT,
            BakeError::Space { .. } => IO,
            _ => CORRUPT,
        });
    }
    if let Some(e) = e.downcast_ref::<PackError>() {
        return Some(match e {
            PackError::Field(e) => field(e),
            PackError::Unfinished(_) => USAGE,
            PackError::Foreign(_) => CORRUPT,
            PackError::Memory { .. } => LIMIT,
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
    if let Some(e) = e.downcast_ref::<PathError>() {
        return Some(path(e));
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

fn path(e: &PathError) -> u8 {
    match e {
        PathError::Read { .. } => IO,
        PathError::Json(_) => CORRUPT,
        PathError::View { source, .. } => camera(source),
        PathError::File { source, .. } => path(source),
        _ => USAGE,
    }
}

fn field(e: &FieldError) -> u8 {
    match e {
        FieldError::Format(e) => format(e),
        FieldError::Locked { .. } | FieldError::Moving(_) => LOCKED,
        FieldError::Identity { .. } => IDENTITY,
        FieldError::Foreign(_) => CORRUPT,
        _ => IO,
    }
}

fn format(e: &FormatError) -> u8 {
    match &e.fault {
        fault if fault.is_unsupported() => UNSUPPORTED,
        Fault::Limit { .. } | Fault::Memory { .. } => LIMIT,
        _ => CORRUPT,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::camera::CameraError;

    #[test]
    fn a_cause_is_said_once() {
        let bad = serde_json::from_str::<u32>("?").unwrap_err();
        let error = CameraError::File { path: "cam.json".into(), source: Box::new(bad.into()) };
        let line = said(&error);
        assert!(line.starts_with("cam.json: not a camera: expected value"), "{line}");
        assert_eq!(line.matches("expected value").count(), 1, "{line}");
        // And one that its error does not tell is added.
        let other = anyhow::Error::new(Usage("no such line".into())).context("line 7");
        assert_eq!(said(other.as_ref()), "line 7: no such line");
    }
}
