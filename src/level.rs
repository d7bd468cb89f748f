//! Which of the processor's instructions are used: the best that it has, unless others are asked for. They change
//! no bit of a field or a picture; asking is for measuring them, and for proving that.

use fearless_simd::Level;
#[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
use fearless_simd::Simd;
use std::sync::OnceLock;

/// What was asked for first, or taken first.
static CHOSEN: OnceLock<Level> = OnceLock::new();

/// Names of levels, the least first; beyond `portable` those of x86.
pub const NAMES: [&str; 4] = ["portable", "sse4.2", "avx2", "avx512"];

/// A level by its name; `None` for one that this processor does not have.
fn named(name: &str) -> Option<Level> {
    #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
    {
        let best = Level::new();
        match name {
            "sse4.2" => return best.as_sse4_2().map(|simd| simd.level()),
            "avx2" => return best.as_avx2().map(|simd| simd.level()),
            "avx512" => return best.as_avx512().map(|simd| simd.level()),
            _ => {}
        }
    }
    (name == "portable").then(Level::baseline)
}

/// Asks for a level by its name, once and before anything is baked.
///
/// # Errors
/// When there is no such level, this processor does not have it, or another one is in use.
pub fn ask_for(name: &str) -> Result<(), String> {
    if !NAMES.contains(&name) {
        return Err(format!("no level is called `{name}`; there are {}", NAMES.join(", ")));
    }
    let level = named(name).ok_or_else(|| format!("this processor has no {name}"))?;
    CHOSEN.set(level).map_err(|_| "another level is in use".to_owned())
}

/// The level that is used.
pub fn level() -> Level {
    *CHOSEN.get_or_init(Level::new)
}

/// All levels that this processor has.
#[cfg(test)]
pub fn all() -> Vec<Level> {
    NAMES.iter().filter_map(|name| named(name)).chain([Level::new()]).collect()
}
