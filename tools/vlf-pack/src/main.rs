//! The program `vlf-pack`: a finished field becomes one file.

use bytesize::ByteSize;
use clap::{Parser, ValueEnum};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use vlf::field::storage::disk::Disk;
use vlf::format::container::Codec;
use vlf::format::limits::Limits;
use vlf::pack::{PackReport, pack_from};

/// Strips a finished field of what only baking needs and writes it as one file.
///
/// Every chunk is verified on the way. The same field gives the same bytes.
#[derive(Parser)]
#[command(version, max_term_width = 100)]
struct Cli {
    /// The field: a directory that `vlf bake` has finished
    field: PathBuf,
    /// The pack
    #[arg(short, long)]
    output: PathBuf,
    /// How chunks are stored
    #[arg(long, value_enum, default_value = "zstd")]
    codec: CodecName,
    /// Threads [default: one for each processor]
    #[arg(long)]
    threads: Option<usize>,
    /// Print one JSON object on standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    limits: Limits,
}

#[derive(Clone, Copy, ValueEnum)]
enum CodecName {
    /// As they are: larger, looked up without decoding
    Raw,
    /// One zstd frame a chunk
    Zstd,
}

fn main() -> ExitCode {
    match run(&Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let _ = writeln!(std::io::stderr(), "vlf-pack: {error:#}");
            ExitCode::from(vlf::exit::code(error.as_ref()))
        }
    }
}

fn run(cli: &Cli) -> anyhow::Result<()> {
    let codec = match cli.codec {
        CodecName::Raw => Codec::Raw,
        CodecName::Zstd => Codec::Zstd,
    };
    let bar = ProgressBar::with_draw_target(Some(1000), ProgressDrawTarget::stderr());
    bar.set_style(ProgressStyle::with_template("   packing [{bar:32}] {eta} left")?);
    let threads = cli.threads.unwrap_or(0);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    let field = Disk::within(&cli.field, cli.limits);
    let progress = |part: f32| bar.set_position((1000.0 * part) as u64);
    let report = pool.install(|| pack_from(&field, &cli.output, codec, &progress))?;
    bar.finish_and_clear();
    let text = if cli.json { serde_json::to_string(&report)? } else { in_words(&report) };
    writeln!(std::io::stdout().lock(), "{text}")?;
    Ok(())
}

fn in_words(report: &PackReport) -> String {
    let size = |bytes: u64| ByteSize::b(bytes).display().iec().to_string();
    let line = |name, (before, after): (u64, u64)| {
        let ratio = before as f64 / after.max(1) as f64;
        format!("{name:<22} {:>12} -> {:>12}  {ratio:.2} : 1\n", size(before), size(after))
    };
    line("scene, texture maps", report.scene)
        + &line("total radiance maps", report.maps)
        + &format!("{} directions, {} values, ", report.directions, report.values)
        + &format!("{} in all", size(report.bytes))
}
