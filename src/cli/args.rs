//! What can be typed.

use bytesize::ByteSize;
use clap::{Args, Parser, Subcommand, ValueEnum};
use std::path::PathBuf;
use std::str::FromStr;
use vlf::bake::quality::Quality;
use vlf::format::limits::Limits;
use vlf::look::render::method::Method;
use vlf::{Specular, Transfer};

const AFTER: &str = "\
A scene goes three ways: `vlf bake` makes a field of it, `vlf-pack` makes one file of the field,
`vlf render` and `vlf-view` look at either.

  vlf demo                                        try it: a bundled room, baked, packed, rendered
  vlf scene cornell_mirror -o room.obj            a bundled scene to begin with
  vlf bake room.obj -o room.field
  vlf-pack room.field -o room.vlf
  vlf verify room.vlf
  vlf render room.vlf -o room.png --eye 0,1,3.4 --target 0,1,0
  vlf-view room.vlf

Lamps are materials with `Ke` in the MTL file, mirrors those with `illum 3` and `Ks`.

Exit codes: 0 done, 2 usage, 3 input or output, 4 damaged data, 5 unsupported version, 6 in use,
7 limit, 8 another bake is there, 130 and 143 interrupted (run again to go on).";

/// Bakes the light of a scene into a virtual light field and looks at it from anywhere.
#[derive(Parser)]
#[command(version, after_help = AFTER, max_term_width = 100)]
pub struct Cli {
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Subcommand)]
pub enum Command {
    /// Bake, pack and render a bundled room; needs no other file
    Demo(Demo),
    /// Say what a bake will take: disk, memory, time; writes nothing
    Plan(Plan),
    /// Bake a scene into a field, or go on with a bake that was stopped
    Bake(Bake),
    /// Say what a field or pack is, how it was baked, how wrong it is and where its light went
    Info(Info),
    /// Check everything in a field, finished or not, or in a pack
    Verify(Verify),
    /// Take a picture of a field or pack
    Render(Render),
    /// Say what radiance comes back along one ray, by both methods
    Probe(Probe),
    /// Compare two pictures: RMSE, relMSE, mean ratio
    Compare(Compare),
    /// Write a bundled scene, or the paper's field of boxes, as OBJ and MTL
    Scene(Scene),
}

#[derive(Args)]
pub struct Demo {
    /// Folder for the field, the pack and the pictures
    #[arg(short, long, default_value = "demo")]
    pub output: PathBuf,
    /// Which bundled scene
    #[arg(long, default_value = "office")]
    pub scene: String,
    /// Threads
    #[arg(long)]
    pub threads: Option<usize>,
}

#[derive(Args)]
pub struct Bake {
    #[command(flatten)]
    pub baking: Baking,
    /// The field: a directory that is made, or gone on with
    #[arg(short, long)]
    pub output: PathBuf,
    /// Do without a lock, where the file system has none. Two bakes into one field damage it
    #[arg(long)]
    pub no_lock: bool,
    /// Begin though the disk seems to be too small
    #[arg(long)]
    pub force: bool,
    /// Say at the end where the time of this run went, stage by stage
    #[arg(long)]
    pub stats: bool,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub json: bool,
}

#[derive(Args)]
pub struct Plan {
    #[command(flatten)]
    pub baking: Baking,
    /// Where the field would be: says what is free there
    #[arg(short, long)]
    pub output: Option<PathBuf>,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub json: bool,
}

/// What is baked, and with what.
#[derive(Args)]
pub struct Baking {
    /// The scene: a Wavefront OBJ, its MTL files and images beside it; or glTF 2.0, .gltf or .glb
    pub scene: PathBuf,
    /// Lines of the light field: 9, 33, 129, 513, 2049, 8193, ...
    #[arg(long, default_value_t = 2049)]
    pub directions: u32,
    /// Cells along an edge of each direction's grid
    #[arg(long, default_value_t = 128)]
    pub resolution: u32,
    /// Cells along an edge of a tile; must divide the resolution
    #[arg(long, default_value_t = 16)]
    pub tile: u32,
    /// Cycles of propagation, or `auto`: until a thousandth of the light is left
    #[arg(long, default_value = "auto")]
    pub cycles: Cycles,
    /// Grids that each direction stands for, its own included, in each cycle: N or N,N,...; the last
    /// counts for all later cycles and may be 1/4, 1/16, ...: one grid of so many of the directions.
    /// Overrides --quality
    #[arg(long)]
    pub perturb: Option<Perturb>,
    /// How many lines to spend
    #[arg(long, value_enum, default_value = "preview")]
    pub quality: QualityName,
    /// The relMSE that pictures should have about: each cycle ends with as few grids as bring its noise
    /// down to that, at most those of --quality or --perturb; 0: always these [default: 0.0002 with
    /// `--quality final`, else 0]
    #[arg(long, value_name = "E")]
    pub target_error: Option<f64>,
    /// Memory that the bake may hold
    #[arg(long, default_value = "512MiB")]
    pub memory: ByteSize,
    /// Threads [default: one for each processor]
    #[arg(long)]
    pub threads: Option<usize>,
    /// When the work done is forced to the disk, so that a power cut cannot take it: `commit`, with
    /// every direction or two; `interval:5s`; `none`, when the system likes. A killed bake loses
    /// at most as much in any case, 5 s with `none`
    #[arg(long, default_value = "interval:5s")]
    pub sync: SyncPolicy,
    /// Surfaces have a front only, as in the paper; their backs are black
    #[arg(long)]
    pub one_sided: bool,
    /// How light goes from texels to cells and back: `clip` by exact area of overlap, `sample` by
    /// the texel on each cell's middle ray
    #[arg(long, value_enum, default_value = "sample")]
    pub transfer: TransferName,
    /// How mirrors send light on: `trace` follows its true path, `maps` interpolates stored maps
    /// between directions, as in the paper
    #[arg(long, value_enum, default_value = "trace")]
    pub specular: SpecularName,
    /// Whether mirrors' total maps are found along true paths after the last cycle; `off`, with
    /// `--specular maps`, leaves them as they were propagated
    #[arg(long, value_enum, default_value = "on")]
    pub resample: Switch,
    /// Edge of a texel of the diffuse texture maps, in cells [default: 1 with `--quality draft`, else 0.5]
    #[arg(long)]
    pub texel: Option<f64>,
    /// Where light has edges, a pilot of few lines shows; there texels are made finer, to at most so
    /// many times as many in all; 1: nowhere [default: 4 with `--quality final`, else 1]
    #[arg(long, value_name = "TIMES")]
    pub refine: Option<f64>,
    /// Whether light is exchanged by 2 x 2 rays in the place of one in cells that a surface's border
    /// passes through; not in perturbed grids that hold only the lines of lamps, nor where `--specular
    /// maps` writes maps
    #[arg(long, value_enum, default_value = "off")]
    pub supersample: Switch,
    /// The most passes of a 3 x 3 texel filter over the first cycle's texture maps: each side of a surface has
    /// as many, from one on, as its error is least by, judged from two halves of the lines; later cycles'
    /// have one. 0: none [default: 0 with `--quality draft`, else 4]
    #[arg(long)]
    pub filter: Option<u32>,
    #[command(flatten)]
    pub limits: Limits,
}

#[derive(Args)]
pub struct Info {
    /// A field directory, finished or not, or a pack
    pub field: PathBuf,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub limits: Limits,
}

/// Checks structure, hashes and values of everything that a field's newest commit names, or of a pack.
/// Needs no write access and takes no lock: it works while a bake runs. Everything that is damaged is
/// listed; exit code 0 means that nothing is, 4 that something is.
#[derive(Args)]
pub struct Verify {
    /// A field directory, finished or not, or a pack
    pub field: PathBuf,
    /// Print the digest too: the same for every bake of the same scene with the same options
    #[arg(long)]
    pub digest: bool,
    /// Threads
    #[arg(long)]
    pub threads: Option<usize>,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub limits: Limits,
}

#[derive(Args)]
pub struct Render {
    /// A finished field directory or a pack
    pub field: PathBuf,
    /// The picture: .exr for linear radiance, .png for display. With --path the pictures are numbered,
    /// NAME-0000.png, or .y4m is a film, - one on standard output
    #[arg(short, long)]
    pub output: PathBuf,
    /// A camera file: {"eye":[x,y,z],"target":[x,y,z],"up":[x,y,z],"vfov_deg":d,"width":w,"height":h}
    #[arg(long, conflicts_with_all = ["eye", "target", "up", "vfov"])]
    pub camera: Option<PathBuf>,
    /// Where the eye is, in the scene's units
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub eye: Option<Triple>,
    /// What it looks at
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub target: Option<Triple>,
    /// Which way is up [default: 0,1,0]
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub up: Option<Triple>,
    /// Vertical field of view in degrees [default: 60]
    #[arg(long, value_name = "DEG")]
    pub vfov: Option<f64>,
    /// Views of a walk, for a film: {"views":[{"time":s,"eye":[x,y,z],"target":[x,y,z],"up":[x,y,z],"vfov_deg":d},...]}
    #[arg(long, value_name = "PATH.json", conflicts_with_all = ["camera", "eye", "target", "up", "vfov"])]
    pub path: Option<PathBuf>,
    /// Frames a second along the path
    #[arg(long, default_value_t = 25.0, value_name = "N", value_parser = frame_rate)]
    pub fps: f64,
    /// See all around the eye: one picture (twice as wide as high shows squares square), or the six faces
    /// of a cube, NAME-front.png and so on, as wide as the picture is high
    #[arg(long, value_enum)]
    pub projection: Option<ProjectionName>,
    /// Size of the picture [default: the camera file's, or 960x720]
    #[arg(long, value_name = "WxH")]
    pub size: Option<Size>,
    /// `field` looks everything up; `trace` follows rays at mirrors
    #[arg(long, value_enum, default_value = "trace")]
    pub method: MethodName,
    /// Samples a pixel
    #[arg(long, default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub samples: u32,
    /// Go on where direction maps are missing or damaged: pixels that need them are magenta. Without
    /// this no picture is made then (exit code 4)
    #[arg(long)]
    pub tolerate: bool,
    /// Read a pack piece by piece instead of mapping it. Use this when others may cut the file short
    /// meanwhile: that ends a process which has mapped it with SIGBUS. `vlf info` and `vlf verify`
    /// never map
    #[arg(long)]
    pub no_map: bool,
    /// Memory that decoded maps may take
    #[arg(long, default_value = "1GiB")]
    pub memory: ByteSize,
    /// Exposure of a PNG in EV (powers of two) [default: from the picture]
    #[arg(long, value_name = "EV", allow_hyphen_values = true)]
    pub exposure: Option<f32>,
    /// Threads
    #[arg(long)]
    pub threads: Option<usize>,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub limits: Limits,
}

#[derive(Args)]
pub struct Probe {
    /// A finished field directory or a pack
    pub field: PathBuf,
    /// Where the ray begins, in the scene's units
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub eye: Triple,
    /// What it goes through
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub target: Triple,
    /// Read a pack piece by piece instead of mapping it
    #[arg(long)]
    pub no_map: bool,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub limits: Limits,
}

#[derive(Args)]
pub struct Compare {
    /// The picture in question (EXR)
    pub test: PathBuf,
    /// The reference (EXR)
    pub reference: PathBuf,
    /// Write a PNG: test, reference, signed relative error (blue too dark, red too bright)
    #[arg(short, long)]
    pub output: Option<PathBuf>,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub json: bool,
}

#[derive(Args)]
pub struct Scene {
    /// cornell, cornell_mirror, office, or boxes
    pub name: String,
    /// The OBJ file; the MTL is written beside it
    #[arg(short, long)]
    pub output: PathBuf,
    /// For `boxes`: about how many polygons (the paper: 224 to 1736)
    #[arg(long, default_value_t = 224)]
    pub polygons: u32,
    /// For `boxes`: which arrangement
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// `--transfer`.
#[derive(Clone, Copy, ValueEnum)]
pub enum TransferName {
    /// By the texel on the middle ray
    Sample,
    /// By area of overlap
    Clip,
}

impl From<TransferName> for Transfer {
    fn from(name: TransferName) -> Transfer {
        match name {
            TransferName::Sample => Transfer::Sample,
            TransferName::Clip => Transfer::Clip,
        }
    }
}

/// `--specular`.
#[derive(Clone, Copy, ValueEnum)]
pub enum SpecularName {
    /// Stored maps
    Maps,
    /// True paths
    Trace,
}

impl From<SpecularName> for Specular {
    fn from(name: SpecularName) -> Specular {
        match name {
            SpecularName::Maps => Specular::Maps,
            SpecularName::Trace => Specular::Trace,
        }
    }
}

/// On or off.
#[derive(Clone, Copy, PartialEq, ValueEnum)]
pub enum Switch {
    On,
    Off,
}

impl Switch {
    pub fn is_on(self) -> bool {
        self == Switch::On
    }
}

/// `--quality`.
#[derive(Clone, Copy, ValueEnum)]
pub enum QualityName {
    /// The bare lines
    Draft,
    /// Soft shadows without visible bands
    Preview,
    /// As many lines as pictures of relMSE 0.0002 need, at most 24 times those of preview in the first
    /// cycle, and finer texels where light has edges
    Final,
}

impl From<QualityName> for Quality {
    fn from(name: QualityName) -> Quality {
        match name {
            QualityName::Draft => Quality::Draft,
            QualityName::Preview => Quality::Preview,
            QualityName::Final => Quality::Final,
        }
    }
}

/// `--method`.
#[derive(Clone, Copy, ValueEnum)]
pub enum MethodName {
    /// Everything from the total radiance maps
    Field,
    /// Diffuse surfaces from texture maps, mirrors by rays
    Trace,
}

/// `--projection`.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ProjectionName {
    /// Columns are angles about the vertical, rows angles from it
    Equirectangular,
    /// Six square pictures
    Cube,
}

fn frame_rate(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(fps) if (0.001..=1000.0).contains(&fps) => Ok(fps),
        _ => Err("expected a number of frames a second from 0.001 to 1000".into()),
    }
}

impl From<MethodName> for Method {
    fn from(name: MethodName) -> Method {
        match name {
            MethodName::Field => Method::Field,
            MethodName::Trace => Method::Trace,
        }
    }
}

/// `--perturb`.
#[derive(Clone)]
pub struct Perturb {
    /// Grids a direction, cycle by cycle.
    pub grids: Vec<u32>,
    /// After these, one grid of one in `4^thinned` directions.
    pub thinned: u32,
}

impl FromStr for Perturb {
    type Err = String;
    fn from_str(text: &str) -> Result<Perturb, String> {
        let wrong =
            || "whole numbers with commas between, the last perhaps 1/4, 1/16, ...".to_owned();
        let (grids, last) = match text.rsplit_once(',') {
            Some((before, last)) if last.trim().starts_with("1/") => (before, Some(last.trim())),
            _ => (text, None),
        };
        let grids: Result<Vec<u32>, _> = grids.split(',').map(|n| n.trim().parse()).collect();
        let part = last.map_or(Ok(1), |last| last["1/".len()..].parse::<u32>());
        match (grids, part) {
            (Ok(grids), Ok(part)) if part.is_power_of_two() && part.ilog2() % 2 == 0 => {
                Ok(Perturb { grids, thinned: part.ilog2() / 2 })
            }
            _ => Err(wrong()),
        }
    }
}

/// `--cycles`.
#[derive(Clone, Copy)]
pub struct Cycles(pub Option<u32>);

impl FromStr for Cycles {
    type Err = String;
    fn from_str(text: &str) -> Result<Cycles, String> {
        match text {
            "auto" => Ok(Cycles(None)),
            n => n.parse().map(|n| Cycles(Some(n))).map_err(|_| "a number or `auto`".to_owned()),
        }
    }
}

/// `--sync`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SyncPolicy {
    /// Commits as often as can be, each synced.
    Commit,
    /// Seconds between commits, each synced.
    Interval(f64),
    /// Commits that the system writes when it likes.
    None,
}

impl FromStr for SyncPolicy {
    type Err = String;
    fn from_str(text: &str) -> Result<SyncPolicy, String> {
        let seconds =
            |t: &str| t.trim_end_matches('s').parse().ok().filter(|s| (0.0..=86_400.0).contains(s));
        match (text, text.strip_prefix("interval:").and_then(seconds)) {
            ("commit", _) => Ok(SyncPolicy::Commit),
            ("none", _) => Ok(SyncPolicy::None),
            (_, Some(seconds)) => Ok(SyncPolicy::Interval(seconds)),
            _ => Err("commit, interval:SECONDSs or none".to_owned()),
        }
    }
}

/// Three coordinates.
#[derive(Clone, Copy)]
pub struct Triple(pub [f64; 3]);

impl FromStr for Triple {
    type Err = String;
    fn from_str(text: &str) -> Result<Triple, String> {
        let numbers: Result<Vec<f64>, _> = text.split(',').map(|n| n.trim().parse()).collect();
        let three = numbers.ok().and_then(|n| <[f64; 3]>::try_from(n).ok());
        three.map(Triple).ok_or_else(|| "three numbers with commas between, such as 0,1,3.4".into())
    }
}

/// Width and height.
#[derive(Clone, Copy)]
pub struct Size(pub u32, pub u32);

impl FromStr for Size {
    type Err = String;
    fn from_str(text: &str) -> Result<Size, String> {
        let wrong = || "width x height, such as 1280x720".to_owned();
        let (w, h) = text.split_once('x').ok_or_else(wrong)?;
        Ok(Size(w.parse().map_err(|_| wrong())?, h.parse().map_err(|_| wrong())?))
    }
}
