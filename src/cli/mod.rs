//! The command line. Only here and in `main` is anything printed.

mod args;
mod bake;
mod compare;
mod demo;
mod film;
mod group;
mod info;
mod plan;
mod probe;
mod progress;
mod render;
mod scene;
mod stats;
mod verify;
mod views;

use clap::Parser;
use std::io::{IsTerminal, Write};
use std::process::ExitCode;
use vlf::exit;
use vlf::level;

/// Parses the arguments, runs the command, prints what went wrong, and gives the exit code.
pub fn run() -> ExitCode {
    let level = std::env::var("VLF_LOG").unwrap_or_else(|_| "warn".to_owned());
    tracing_subscriber::fmt()
        .with_env_filter(tracing_subscriber::EnvFilter::new(level))
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .init();
    let result = chosen_level().and_then(|()| run_command(args::Cli::parse().command));
    match result {
        Ok(code) => ExitCode::from(code),
        Err(error) if exit::is_broken_pipe(error.as_ref()) => ExitCode::SUCCESS,
        Err(error) => {
            let _ = writeln!(std::io::stderr(), "vlf: {}", exit::said(error.as_ref()));
            ExitCode::from(exit::code(error.as_ref()))
        }
    }
}

/// Takes the instructions that `VLF_SIMD` asks for.
fn chosen_level() -> anyhow::Result<()> {
    match std::env::var("VLF_SIMD") {
        Ok(name) => level::ask_for(&name).map_err(|why| usage(format!("VLF_SIMD={name}: {why}"))),
        Err(_) => Ok(()),
    }
}

fn run_command(command: args::Command) -> anyhow::Result<u8> {
    match command {
        args::Command::Demo(a) => demo::run(&a),
        args::Command::Plan(a) => plan::run(&a),
        args::Command::Bake(a) => bake::run(&a),
        args::Command::Info(a) => info::run(&a),
        args::Command::Verify(a) => verify::run(&a),
        args::Command::Render(a) => render::run(&a),
        args::Command::Probe(a) => probe::run(&a),
        args::Command::Compare(a) => compare::run(&a),
        args::Command::Scene(a) => scene::run(&a),
    }
}

/// A mistake in what was asked for.
fn usage(what: impl Into<String>) -> anyhow::Error {
    exit::Usage(what.into()).into()
}

/// Prints a line on standard output; a closed pipe is an error that ends the program quietly.
fn say(text: &str) -> anyhow::Result<()> {
    writeln!(std::io::stdout().lock(), "{text}")?;
    Ok(())
}
