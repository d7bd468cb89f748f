//! Limits on what a file may state: anything beyond is refused before memory is asked for.

#![deny(
    clippy::arithmetic_side_effects,
    clippy::cast_possible_truncation,
    clippy::indexing_slicing
)]

use super::Fault;
use crate::directions::MOST_LINES;

/// The most bytes of the manifest's record, which no flag raises.
pub const RECORD: u64 = 64 << 20;

/// The most times that the edges of a surface's texels are halved.
pub const FINENESS: u8 = 4;

/// The most surfaces whose error a record states.
pub const WORST: usize = 64;

/// The most bytes of a material's name, which no flag raises.
pub const NAME: u32 = 4096;

/// The most cells along the edge of a PSF that the code can count: their square fits into 32 bits.
pub(super) const MOST_CELLS: u32 = 0xffff;

/// The most texels that fragments can name.
const MOST_TEXELS: u64 = 1 << 31;

/// The most pixels whose sums fit into 64 bits, and into a number that is exact.
const MOST_PIXELS: u64 = 1 << 32;

/// The most bytes of OBJ and MTL whose vertices 32 bits can name: a vertex takes 8 at least.
const MOST_SCENE_BYTES: u64 = 8 << 32;

/// Largest values that a file may state. A reader that trusts a file, and has the memory, may raise
/// them; each is a flag of every program that opens one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::Args)]
#[command(next_help_heading = "Limits on what files may state, above which they are refused")]
pub struct Limits {
    /// Lines of a field; can be lowered only
    #[arg(id = "limit-directions", long, value_name = "N", hide_short_help = true, default_value_t = Limits::PUBLISHED.directions)]
    pub directions: u32,
    /// Cells along the edge of a direction's grid, to 65535
    #[arg(id = "limit-resolution", long, value_name = "N", hide_short_help = true, default_value_t = Limits::PUBLISHED.resolution)]
    pub resolution: u32,
    /// Cells along the edge of a tile, to 65535
    #[arg(id = "limit-tile", long, value_name = "N", hide_short_help = true, default_value_t = Limits::PUBLISHED.tile)]
    pub tile: u32,
    /// Surfaces of a field, polygons of an OBJ
    #[arg(id = "limit-surfaces", long, value_name = "N", hide_short_help = true, default_value_t = Limits::PUBLISHED.surfaces)]
    pub surfaces: u32,
    /// Texels of a scene, to 2^31; a texture map takes 24 bytes each
    #[arg(id = "limit-texels", long, value_name = "N", hide_short_help = true, default_value_t = Limits::PUBLISHED.texels)]
    pub texels: u64,
    /// Bytes of a stored scene or of a direction's map, decoded
    #[arg(id = "limit-chunk", long, value_name = "BYTES", hide_short_help = true, default_value_t = Limits::PUBLISHED.chunk)]
    pub chunk: u64,
    /// Pixels of a scene's images together; each takes 3 bytes
    #[arg(id = "limit-pixels", long, value_name = "N", hide_short_help = true, default_value_t = Limits::PUBLISHED.pixels)]
    pub pixels: u64,
    /// Bytes of OBJ, MTL and images together, to 2^35
    #[arg(id = "limit-scene", long, value_name = "BYTES", hide_short_help = true, default_value_t = Limits::PUBLISHED.scene)]
    pub scene: u64,
}

impl Default for Limits {
    fn default() -> Limits {
        Limits::PUBLISHED
    }
}

/// The flag of a limit, for messages.
pub type Flag = Option<&'static str>;

impl Limits {
    /// Those of the format's specification. Of a chunk's bytes: 2^24 surfaces of a triangle each take
    /// 1.7 GB, four full layers at the largest resolution 3.2 GB.
    pub const PUBLISHED: Limits = Limits {
        directions: MOST_LINES,
        resolution: 1 << 13,
        tile: 256,
        surfaces: 1 << 24,
        texels: 1 << 27,
        chunk: 1 << 32,
        pixels: 1 << 28,
        scene: 2 << 30,
    };

    /// The number of lines, if it is within the limit.
    ///
    /// # Errors
    /// [`Fault::Limit`], as for all that follow.
    pub fn check_directions(&self, count: u32) -> Result<u32, Fault> {
        let fixed = MOST_LINES.into();
        let flag = "--limit-directions";
        within("direction count", count, (self.directions.into(), fixed, flag))
    }

    /// Cells along the edge of a PSF.
    ///
    /// # Errors
    /// Above the limit.
    pub fn check_resolution(&self, cells: u32) -> Result<u32, Fault> {
        let flag = "--limit-resolution";
        within("resolution", cells, (self.resolution.into(), MOST_CELLS.into(), flag))
    }

    /// Cells along the edge of a tile.
    ///
    /// # Errors
    /// Above the limit.
    pub fn check_tile(&self, cells: u32) -> Result<u32, Fault> {
        within("tile size", cells, (self.tile.into(), MOST_CELLS.into(), "--limit-tile"))
    }

    /// Surfaces of a scene.
    ///
    /// # Errors
    /// Above the limit.
    pub fn check_surfaces(&self, count: u32) -> Result<u32, Fault> {
        let fixed = u32::MAX.into();
        within("surface count", count, (self.surfaces.into(), fixed, "--limit-surfaces"))
    }

    /// Texels of a scene.
    ///
    /// # Errors
    /// Above the limit.
    pub fn check_texels(&self, count: u64) -> Result<u64, Fault> {
        within("texel count", count, (self.texels, MOST_TEXELS, "--limit-texels"))
    }

    /// Bytes of a chunk whose length, decoded, goes with the scene, `fixed` at most by what else its
    /// file states.
    ///
    /// # Errors
    /// Above the limit.
    pub fn check_chunk(&self, bytes: u64, fixed: u64) -> Result<u64, Fault> {
        within("chunk length", bytes, (self.chunk, fixed, "--limit-chunk"))
    }

    /// Bytes of a chunk of `head` bytes and `each` a texel, decoded.
    ///
    /// # Errors
    /// Above the limit.
    pub fn check_texel_chunk(&self, bytes: u64, head: u64, each: u64) -> Result<u64, Fault> {
        let [limit, fixed] =
            [self.texels, MOST_TEXELS].map(|n| n.saturating_mul(each).saturating_add(head));
        within("chunk length", bytes, (limit, fixed, "--limit-texels"))
    }

    /// Pixels of a scene's images together.
    ///
    /// # Errors
    /// Above the limit.
    pub fn check_pixels(&self, count: u64) -> Result<u64, Fault> {
        within("pixel count", count, (self.pixels, MOST_PIXELS, "--limit-pixels"))
    }

    /// The most pixels of a scene's images together, and what raises it.
    pub fn pixels(&self) -> (u64, Flag) {
        match self.pixels {
            pixels if pixels < MOST_PIXELS => (pixels, Some("--limit-pixels")),
            _ => (MOST_PIXELS, None),
        }
    }

    /// The most polygons of an OBJ, and what raises it.
    pub fn polygons(&self) -> (u64, Flag) {
        (self.surfaces.into(), Some("--limit-surfaces"))
    }

    /// The most bytes of OBJ, MTL and images together, and what raises it.
    pub fn scene_bytes(&self) -> (u64, Flag) {
        match self.scene {
            bytes if bytes < MOST_SCENE_BYTES => (bytes, Some("--limit-scene")),
            _ => (MOST_SCENE_BYTES, None),
        }
    }
}

/// A value, if it is within its limit: the one that the flag sets, and the one that the code or the
/// file itself fixes. The flag is named where it helps.
fn within<T: Copy + Into<u64>>(
    what: &'static str,
    value: T,
    (limit, fixed, flag): (u64, u64, &'static str),
) -> Result<T, Fault> {
    match value.into() {
        v if v <= limit.min(fixed) => Ok(value),
        v => {
            let flag = (v <= fixed).then_some(flag);
            Err(Fault::Limit { what, value: v, limit: limit.min(fixed), flag })
        }
    }
}

/// A flag as messages end in it.
pub fn in_brackets(flag: &Flag) -> String {
    flag.map_or(String::new(), |flag| format!(" ({flag})"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::{Args, Command, FromArgMatches};

    #[test]
    fn a_message_names_the_flag_that_helps() {
        let limits = Limits { surfaces: 1 << 16, ..Limits::default() };
        let said = |result: Result<u32, Fault>| result.unwrap_err().to_string();
        assert_eq!(limits.check_surfaces(1 << 16), Ok(1 << 16));
        let expected = "surface count 4294967295 exceeds limit 65536 (--limit-surfaces)";
        assert_eq!(said(limits.check_surfaces(u32::MAX)), expected);
        // No flag helps beyond what the code can count.
        assert_eq!(said(limits.check_resolution(65_536)), "resolution 65536 exceeds limit 8192");
        let most = Limits { resolution: u32::MAX, directions: u32::MAX, ..limits };
        assert_eq!(said(most.check_resolution(65_536)), "resolution 65536 exceeds limit 65535");
        let expected = "direction count 524290 exceeds limit 524289";
        assert_eq!(said(most.check_directions(524_290)), expected);
        let fewer = Limits { directions: 9, ..limits };
        let expected = "direction count 33 exceeds limit 9 (--limit-directions)";
        assert_eq!(said(fewer.check_directions(33)), expected);
    }

    #[test]
    fn without_flags_the_limits_are_the_published_ones() {
        let matches = Limits::augment_args(Command::new("x")).get_matches_from(["x"]);
        assert_eq!(Limits::from_arg_matches(&matches).unwrap(), Limits::PUBLISHED);
    }
}
