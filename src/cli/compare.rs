//! `vlf compare`.

use super::{args, say};
use vlf::look::compare::{compare, difference_picture};
use vlf::look::image::{read_exr, write_png};
use vlf::look::tone::auto_exposure;

pub fn run(a: &args::Compare) -> anyhow::Result<u8> {
    let (test, reference) = (read_exr(&a.test)?, read_exr(&a.reference)?);
    let comparison = compare(&test, &reference)?;
    if let Some(path) = &a.output {
        write_png(path, &difference_picture(&test, &reference, auto_exposure(&reference))?)?;
    }
    if a.json {
        say(&serde_json::to_string(&comparison)?)?;
    } else {
        say(&comparison.to_string())?;
    }
    Ok(0)
}
