//! The module graph, as a test: a module imports only from modules listed above it in `lib.rs`,
//! and never from one it is kept apart from. So the part that looks would compile with the parts
//! that bake deleted, and whoever reads `lib.rs` from the top meets nothing before its time.

mod source;

use std::fs;

/// The data's way through the library. `lib.rs` lists those that exist in this order.
const ORDER: [&str; 17] = [
    "radiance",
    "ids",
    "directions",
    "psf",
    "format",
    "scene",
    "visible",
    "paths",
    "gather",
    "textured",
    "field",
    "bake",
    "pack",
    "plan",
    "look",
    "verify",
    "exit",
];

/// `(importer, imported)`: the reading side does not know how a field is made, the file does not
/// know what its bytes mean, and light is gathered from whatever holds it.
const APART: [(&str, &str); 10] = [
    ("look", "field"),
    ("look", "bake"),
    ("look", "pack"),
    ("look", "plan"),
    ("format", "scene"),
    ("format", "gather"),
    ("format", "textured"),
    ("format", "field"),
    ("format", "bake"),
    ("gather", "field"),
];

/// The program's own modules, which `main.rs` declares: they use the library as anyone does, and
/// nothing of the library knows of them.
const PROGRAM: [&str; 2] = ["main", "cli"];

/// The modules that the text of `lib.rs` declares, in its order.
fn modules(lib: &str) -> Vec<String> {
    let name = |line: &str| {
        let line = line.trim();
        let line = line.strip_prefix("pub(crate) ").unwrap_or(line);
        let line = line.strip_prefix("pub ").unwrap_or(line);
        Some(line.strip_prefix("mod ")?.trim_end_matches([';', ' ', '{']).to_owned())
    };
    source::code(lib).lines().filter_map(name).collect()
}

/// The names that follow `prefix` in `code`, groups (`crate::{a, b::{c}}`) included.
fn names_after(code: &str, prefix: &str) -> Vec<String> {
    let word = |s: &str| {
        s.chars().take_while(|c| c.is_alphanumeric() || matches!(c, '_' | '*')).collect::<String>()
    };
    let mut found = Vec::new();
    for (at, _) in code.match_indices(prefix) {
        let rest = &code[at + prefix.len()..];
        let Some(group) = rest.strip_prefix('{') else {
            found.push(word(rest));
            continue;
        };
        let (mut depth, mut start) = (0, true);
        for (i, c) in group.char_indices() {
            match c {
                '{' => depth += 1,
                '}' if depth == 0 => break,
                '}' => depth -= 1,
                ',' if depth == 0 => start = true,
                c if start && (c.is_alphabetic() || matches!(c, '_' | '*')) => {
                    found.push(word(&group[i..]));
                    start = false;
                }
                _ => {}
            }
        }
    }
    found
}

/// What is wrong with the imports of one file. `inside` is its path below `src/`, with `/`
/// between the parts; `order` is what `lib.rs` declares.
fn faults(inside: &str, text: &str, order: &[String]) -> Vec<String> {
    let module = inside.split(['/', '.']).next().unwrap();
    if PROGRAM.contains(&module) || module == "lib" {
        return Vec::new();
    }
    let rank = |name: &str| order.iter().position(|o| o == name);
    let Some(own) = rank(module) else {
        return vec![format!("src/{inside}: `{module}` is not declared in lib.rs")];
    };
    let code = source::code(text);
    let mut faults = Vec::new();
    let mut fault = |what: String| faults.push(format!("src/{inside}: {what}"));

    for to in names_after(&code, "crate::") {
        match rank(&to) {
            _ if to == module => {}
            None => fault(format!(
                "imports `crate::{to}`, which is no module; import it from the one it stands in"
            )),
            Some(_) if APART.contains(&(module, to.as_str())) => {
                fault(format!("`{module}` is kept apart from `{to}`"));
            }
            Some(other) if other > own => {
                fault(format!("`{module}` imports `{to}`, which is below it"));
            }
            Some(_) => {}
        }
    }

    // `super` would walk round the check above: twice it can leave the module from a folder's
    // files, once from the file that is the module itself.
    let is_top = inside == format!("{module}.rs") || inside == format!("{module}/mod.rs");
    for to in names_after(&code, "super::") {
        if to == "super" {
            fault("`super::super`: write `crate::` across folders".to_owned());
        } else if is_top && rank(&to).is_some() {
            fault(format!("`super::{to}`: write `crate::{to}`"));
        }
    }
    faults
}

#[test]
fn modules_import_only_from_above() {
    let src = source::root().join("src");
    let order = modules(&fs::read_to_string(src.join("lib.rs")).unwrap());
    assert!(!order.is_empty(), "lib.rs declares no module");
    let mut found = Vec::new();
    for file in source::files(&src, &source::is_rust) {
        let inside = file.strip_prefix(&src).unwrap().to_str().unwrap().replace('\\', "/");
        found.extend(faults(&inside, &fs::read_to_string(&file).unwrap(), &order));
    }
    assert!(found.is_empty(), "\n{}\n", found.join("\n"));
}

#[test]
fn lib_lists_the_modules_in_the_order_of_the_data() {
    let lib = fs::read_to_string(source::root().join("src/lib.rs")).unwrap();
    let listed: Vec<String> =
        modules(&lib).into_iter().filter(|m| ORDER.contains(&m.as_str())).collect();
    let expected: Vec<&str> = ORDER.into_iter().filter(|o| listed.iter().any(|m| m == o)).collect();
    assert_eq!(listed, expected);
    let program = modules(&lib).into_iter().find(|m| PROGRAM.contains(&m.as_str()));
    assert_eq!(program, None, "the program is not part of the library");
}

/// The check itself: what it must see, and what it must let pass.
#[test]
fn the_check_sees_every_way_up() {
    let order: Vec<String> = ORDER.iter().map(|&name| name.to_owned()).collect();
    let count = |inside: &str, text: &str| faults(inside, text, &order).len();

    assert_eq!(count("psf.rs", "use crate::ids::Cell;"), 0);
    assert_eq!(count("psf.rs", "//! [`crate::Scene`]\nconst A: &str = \"crate::bake\";"), 0);
    assert_eq!(count("psf.rs", "mod tests { use super::*; }"), 0);
    assert_eq!(count("scene/camera.rs", "use super::texels; use crate::scene::Fit;"), 0);

    assert_eq!(count("psf.rs", "use crate::bake::Cycle;"), 1);
    assert_eq!(count("psf.rs", "fn f() { crate::bake::run() }"), 1);
    assert_eq!(count("psf.rs", "use crate::{ids::{Cell, TileId}, scene::{camera, texels}};"), 1);
    assert_eq!(count("psf.rs", "use crate::{\n    bake,\n    look::{self},\n};"), 2);
    assert_eq!(count("psf.rs", "use crate::Scene;"), 1);
    assert_eq!(count("psf.rs", "use crate::*;"), 1);
    assert_eq!(count("psf.rs", "use super::bake::Cycle;"), 1);
    assert_eq!(count("scene/mod.rs", "use super::{ids, bake};"), 2);
    assert_eq!(count("scene/camera.rs", "use super::super::bake;"), 1);
    assert_eq!(count("scene/camera.rs", "use super::{super::bake, texels};"), 1);
    assert_eq!(count("stray.rs", ""), 1);
    assert_eq!(count("cli/bake.rs", "use super::info; use vlf::bake::bake;"), 0);
    assert_eq!(count("exit.rs", "use crate::cli::args;"), 1);
    for (importer, imported) in APART {
        assert_eq!(count(&format!("{importer}/x.rs"), &format!("use crate::{imported}::X;")), 1);
    }
}
