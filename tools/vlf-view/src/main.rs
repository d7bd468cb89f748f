//! `vlf-view`: a walk through a baked virtual light field.

mod action;

mod walk;

mod collide;

mod views;

mod energy;

mod source;

mod pace;

mod paint;

mod state;

mod worker;

mod overlay;

mod shots;

mod bench;

mod http;

mod serve;

mod window;

#[cfg(test)]
mod testing;

use anyhow::Context;
use bytesize::ByteSize;
use clap::Parser;
use paint::Method;
use source::{Feed, Opening};
use state::Walkthrough;
use std::io::Write;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use views::Views;
use vlf::format::limits::Limits;
use vlf::look::packed::Access;
use vlf::look::path::{CameraPath, TimedView};
use vlf::{Camera, exit};
use window::{Show, WindowError};

/// Walks through a baked virtual light field.
#[derive(Debug, Parser)]
#[command(version, after_help = action::help())]
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
    /// Map a pack into memory instead of reading it piece by piece. Then a file that others cut short
    /// meanwhile ends the process with SIGBUS
    #[arg(long)]
    map: bool,
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
    /// Folder for screenshots
    #[arg(long, default_value = ".", value_name = "DIR")]
    shots: PathBuf,
    /// Write the walk to a file for --bench and `vlf render --path` when the window is closed
    #[arg(long, value_name = "PATH.json", conflicts_with = "bench")]
    record: Option<PathBuf>,
    /// Open no window: measure how long the frames of a walk take
    #[arg(long, value_name = "PATH.json")]
    bench: Option<PathBuf>,
    /// Open no window: show the walk in a browser, at an address such as 127.0.0.1:8080. Other machines are
    /// answered where the address is not a loopback one, if they have the token that is printed
    #[arg(long, value_name = "ADDRESS:PORT", conflicts_with_all = ["bench", "record"])]
    serve: Option<SocketAddr>,
    /// With --bench: one JSON object on standard output, times in milliseconds
    #[arg(long, requires = "bench")]
    json: bool,
    #[command(flatten)]
    limits: Limits,
}

fn main() -> ExitCode {
    let args = Args::parse();
    match view(&args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            eprintln!("vlf-view: {}", exit::said(e.as_ref()));
            let no_window = e.is::<WindowError>();
            ExitCode::from(if no_window { exit::IO } else { exit::code(e.as_ref()) })
        }
    }
}

fn view(args: &Args) -> anyhow::Result<()> {
    let access = if args.map { Access::Mapped } else { Access::Read };
    let (path, memory) = (args.path.clone(), args.memory.as_u64());
    let opening = Opening { path, access, memory, limits: args.limits };
    if let Some(path) = &args.bench {
        let path = CameraPath::open(path)?;
        return bench(args, &opening, &path);
    }
    let start = args.camera.as_deref().map(Camera::open).transpose()?;
    let feed = Arc::new(Feed::open(opening)?);
    let source = feed.now();
    let views = Views::of(&args.path);
    let start = start.or_else(|| views.get(1).copied()).unwrap_or(source.start);
    if let Some(address) = args.serve {
        let (path, method, exposure) = (args.path.clone(), args.method, args.exposure);
        let serve = serve::Serve { feed, path, start, method, exposure };
        return serve::run(serve, address).with_context(|| format!("{address}: cannot be served"));
    }
    let state = Walkthrough::new(start, source.speed, args.method, args.exposure).with_views(views);
    drop(source);
    let walked = window::run(Show {
        title: format!("{} - F1 for help", args.path.display()),
        size: args.size,
        state,
        feed,
        shots: (args.shots.clone(), stem(&args.path)),
    })?;
    args.record.as_deref().map_or(Ok(()), |path| record(path, walked))
}

fn bench(args: &Args, opening: &Opening, path: &CameraPath) -> anyhow::Result<()> {
    let source = opening.open()?;
    let finished = source.field.is_finished();
    let method = if finished { args.method } else { Method::Trace };
    let report = bench::run(&source, path, args.size, method);
    let text = if args.json { report.to_json().to_string() } else { report.to_text() };
    writeln!(std::io::stdout(), "{text}").context("standard output")
}

fn record(path: &Path, walked: Vec<TimedView>) -> anyhow::Result<()> {
    let text = serde_json::to_string(&CameraPath::new(walked)?)?;
    std::fs::write(path, text).with_context(|| format!("{}: cannot be written", path.display()))
}

/// The beginning of the names of screenshots.
fn stem(path: &Path) -> String {
    path.file_stem().map_or("view".into(), |stem| stem.to_string_lossy().into_owned())
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
