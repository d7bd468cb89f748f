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
use vlf::pack::{Diffuse, MOST_ERROR, Options, PackReport, Section, USUAL_ERROR, pack_from};

/// Strips a finished field of what only baking needs and writes it as one file.
///
/// Every chunk is verified on the way, and every map that was packed is decoded again and held against
/// the field's: the report says what was lost. The same field gives the same bytes.
#[derive(Parser)]
#[command(version, max_term_width = 100)]
struct Cli {
    /// The field: a directory that `vlf bake` has finished
    field: PathBuf,
    /// The pack
    #[arg(short, long)]
    output: PathBuf,
    /// How maps are stored
    #[arg(long, value_enum, default_value = "planes")]
    codec: CodecName,
    /// How far the radiance of a cell may be off, relative to its brightest channel: 0 to 0.25. 0 loses
    /// nothing; nor does `--codec raw`, whatever this says
    #[arg(long, value_name = "E", default_value_t = USUAL_ERROR, value_parser = error)]
    max_error: f32,
    /// What becomes of diffuse surfaces' maps: with `texture` they are left out, since they are a
    /// resampling of the texture maps, and lookup goes there
    #[arg(long, value_enum, default_value = "maps")]
    diffuse: DiffuseName,
    /// Memory that maps may take while they are packed
    #[arg(long, default_value = "256MiB")]
    memory: ByteSize,
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
    /// As they are: largest, looked up without decoding
    Raw,
    /// One zstd frame each
    Zstd,
    /// Rearranged, then one zstd frame each: smallest
    Planes,
}

#[derive(Clone, Copy, ValueEnum)]
enum DiffuseName {
    /// Kept
    Maps,
    /// Left to the texture maps
    Texture,
}

fn error(text: &str) -> Result<f32, String> {
    let number = text.parse().ok().filter(|e| (0.0..=MOST_ERROR).contains(e));
    number.ok_or_else(|| format!("a number from 0 to {MOST_ERROR}"))
}

fn main() -> ExitCode {
    match run(&Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let _ = writeln!(std::io::stderr(), "vlf-pack: {}", vlf::exit::said(error.as_ref()));
            ExitCode::from(vlf::exit::code(error.as_ref()))
        }
    }
}

fn run(cli: &Cli) -> anyhow::Result<()> {
    let codec = match cli.codec {
        CodecName::Raw => Codec::Raw,
        CodecName::Zstd => Codec::Zstd,
        CodecName::Planes => Codec::Planes,
    };
    let diffuse = match cli.diffuse {
        DiffuseName::Maps => Diffuse::Maps,
        DiffuseName::Texture => Diffuse::Texture,
    };
    let max_error = cli.max_error;
    let options = Options { codec, max_error, diffuse, memory: cli.memory.as_u64() };
    let bar = ProgressBar::with_draw_target(Some(1000), ProgressDrawTarget::stderr());
    bar.set_style(ProgressStyle::with_template("   packing [{bar:32}] {eta} left")?);
    let threads = cli.threads.unwrap_or(0);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    let field = Disk::within(&cli.field, cli.limits);
    let progress = |part: f32| bar.set_position((1000.0 * part) as u64);
    let report = pool.install(|| pack_from(&field, &cli.output, &options, &progress))?;
    bar.finish_and_clear();
    let text = if cli.json { serde_json::to_string(&report)? } else { in_words(&report) };
    writeln!(std::io::stdout().lock(), "{text}")?;
    Ok(())
}

fn in_words(report: &PackReport) -> String {
    let size = |bytes: u64| ByteSize::b(bytes).display().iec().to_string();
    let line = |name, part: Section| {
        let (before, after, ratio) = (size(part.before), size(part.after), part.ratio());
        format!("{name:<22} {before:>12} -> {after:>12} {ratio:>8.2} : 1\n")
    };
    let mut text: String = { report.sections().into_iter() }
        .chain([("all", report.whole())])
        .map(|(name, part)| line(name, part))
        .collect();
    text += &format!("{} directions, {} values, ", report.directions, report.values);
    text += &format!("{} in the file\n", size(report.bytes));
    let off = &report.deviation;
    text += &match off.at {
        None => format!("nothing lost: {} cells decode to what they were", off.cells),
        Some(at) => format!(
            "off by {:.2e} in the mean of {} cells, {:.2e} in the worst: direction {}, tile {} {}, \
             surface {}, {}",
            report.mean_error,
            off.cells,
            off.worst,
            at.direction,
            at.tile[0],
            at.tile[1],
            at.surface,
            if at.sense == 0 { "along" } else { "against" },
        ),
    };
    text
}
