//! What a fuzzer once found, and what it begins with, goes through every target's body again.

#[path = "../fuzz/src/lib.rs"]
#[allow(dead_code, reason = "only fuzz targets run guarded")]
mod bodies;

use std::fs;
use std::path::{Path, PathBuf};

fn files(folder: PathBuf) -> Vec<PathBuf> {
    let Ok(entries) = fs::read_dir(folder) else { return Vec::new() };
    entries.map(|e| e.unwrap().path()).filter(|p| p.is_file()).collect()
}

#[test]
fn seeds_and_regressions_do_no_harm() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let samples = root.join("format-spec/samples");
    for (name, target) in bodies::TARGETS {
        let mut inputs = files(root.join("fuzz/corpus-seeds").join(name));
        if matches!(name, "header" | "pack") {
            inputs.extend(files(samples.clone()));
            inputs.extend(files(samples.join("damaged")));
        }
        assert!(inputs.len() > 1, "{name} has nothing to begin with");
        inputs.extend(files(root.join("fuzz/regressions").join(name)));
        for input in inputs {
            eprintln!("{name}: {}", input.display());
            target(&fs::read(&input).unwrap());
        }
    }
}
