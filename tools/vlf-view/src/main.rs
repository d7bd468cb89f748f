//! `vlf-view`: a walk through a baked virtual light field.

mod source;
mod walk;
mod window;

use bytesize::ByteSize;
use clap::Parser;
use source::Method;
use std::path::PathBuf;
use std::process::ExitCode;
use vlf::format::limits::Limits;
use vlf::look::packed::Access;
use vlf::{Camera, exit};
use walk::Walk;
use window::{HELP, Show, WindowError};

/// Walks through a baked virtual light field.
#[derive(Debug, Parser)]
#[command(version, after_help = HELP)]
struct Args {
    /// The packed light field (NAME.vlf) or the field itself (NAME.field)
    path: PathBuf,
    /// Size of the window in pixels
    #[arg(long, default_value = "640x480", value_name = "WxH", value_parser = size)]
    size: (u32, u32),
    /// How pictures are taken
    #[arg(long, value_enum, default_value_t = Method::Field)]
    method: Method,
    /// Exposure in stops: radiance times 2^EV [default: from the first frame]
    #[arg(long, value_name = "EV", allow_negative_numbers = true, value_parser = stops)]
    exposure: Option<f32>,
    /// Read a pack piece by piece instead of mapping it. Use this when others may cut the file short
    /// meanwhile: that ends a process which has mapped it with SIGBUS
    #[arg(long)]
    no_map: bool,
    /// Memory that decoded maps may take
    #[arg(long, default_value = "1GiB")]
    memory: ByteSize,
    // Not a comment for the documentation, which would take [x,y,z] for a link.
    #[arg(
        long,
        value_name = "CAM.json",
        help = r#"Where to start: a JSON file {"eye":[x,y,z],"target":[x,y,z],"up":[x,y,z],"vfov_deg":d,"width":w,"height":h}"#
    )]
    camera: Option<PathBuf>,
    #[command(flatten)]
    limits: Limits,
}

fn main() -> ExitCode {
    let args = Args::parse();
    match view(&args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            eprintln!("vlf-view: {e:#}");
            let no_window = e.is::<WindowError>();
            ExitCode::from(if no_window { exit::IO } else { exit::code(e.as_ref()) })
        }
    }
}

fn view(args: &Args) -> anyhow::Result<()> {
    let access = if args.no_map { Access::Read } else { Access::Mapped };
    let source =
        source::open(&args.path, args.method, (access, args.memory.as_u64()), &args.limits)?;
    let start: Camera = match &args.camera {
        Some(path) => Camera::open(path)?,
        None => source.start,
    };
    window::run(Show {
        title: format!("{} - F1 for help", args.path.display()),
        walk: Walk::new(&start, source.speed),
        size: args.size,
        exposure: args.exposure,
        painter: source.painter,
    })?;
    Ok(())
}

fn size(text: &str) -> Result<(u32, u32), String> {
    let sides =
        text.split_once(['x', 'X']).and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    match sides {
        Some((w @ 1..=16_384, h @ 1..=16_384)) => Ok((w, h)),
        _ => Err("expected a width and a height from 1 to 16384, such as 640x480".into()),
    }
}

fn stops(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(ev) if ev.is_finite() && ev.abs() <= 100.0 => Ok(ev),
        _ => Err("expected a number of stops between -100 and 100".into()),
    }
}
