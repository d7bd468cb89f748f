//! Every package that `Cargo.lock` names, for any platform, may be used under a licence on a
//! short list; and the one package that is no longer maintained, bincode, stays where it is.

use serde_json::Value;
use std::process::Command;
use std::sync::OnceLock;

/// The licences accepted, as SPDX writes them.
const ALLOWED: [&str; 13] = [
    "MIT",
    "MIT-0",
    "Apache-2.0",
    "Apache-2.0 WITH LLVM-exception",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "0BSD",
    "BSL-1.0",
    "CC0-1.0",
    "ISC",
    "Unicode-3.0",
    "Unlicense",
    "Zlib",
];

/// What cargo knows of the dependencies.
///
/// For every platform if the packages are there or can be had; failing both, for this one, whose
/// packages are always there after a build.
fn metadata() -> &'static Value {
    static METADATA: OnceLock<Value> = OnceLock::new();
    METADATA.get_or_init(|| {
        let host = host();
        let attempts: [&[&str]; 3] =
            [&["--offline"], &[], &["--offline", "--filter-platform", &host]];
        let mut errors = String::new();
        for (attempt, arguments) in attempts.iter().enumerate() {
            let output = Command::new(cargo())
                .current_dir(env!("CARGO_MANIFEST_DIR"))
                .args(["metadata", "--format-version", "1", "--locked"])
                .args(*arguments)
                .env("CARGO_NET_RETRY", "1")
                .env("CARGO_HTTP_TIMEOUT", "20")
                .output()
                .expect("cargo runs");
            if output.status.success() {
                if attempt == 2 {
                    eprintln!("note: packages for other platforms than {host} were not checked");
                }
                return serde_json::from_slice(&output.stdout).expect("cargo prints JSON");
            }
            errors += &String::from_utf8_lossy(&output.stderr);
        }
        panic!("cargo metadata failed:\n{errors}")
    })
}

/// The cargo that runs this test, or the one that built it.
fn cargo() -> String {
    std::env::var("CARGO").unwrap_or_else(|_| env!("CARGO").to_owned())
}

/// This machine's target triple, as cargo names it.
fn host() -> String {
    let output = Command::new(cargo()).arg("-vV").output().expect("cargo runs");
    String::from_utf8_lossy(&output.stdout)
        .lines()
        .find_map(|line| line.strip_prefix("host: ").map(str::to_owned))
        .expect("cargo -vV names its host")
}

/// The list at `key` of a JSON object.
fn list<'a>(value: &'a Value, key: &str) -> &'a [Value] {
    value[key].as_array().map_or(&[], Vec::as_slice)
}

/// The string at `key` of a JSON object.
fn text<'a>(value: &'a Value, key: &str) -> &'a str {
    value[key].as_str().unwrap_or("")
}

/// Whether `expression` can be met with licences of [`ALLOWED`] alone.
///
/// SPDX expressions: WITH binds tighter than AND, AND tighter than OR; `/` is an old OR. An
/// expression that cannot be read is not met.
fn is_allowed(expression: &str) -> bool {
    let spaced = expression.replace('(', " ( ").replace(')', " ) ").replace('/', " OR ");
    let mut words = Words { words: spaced.split_whitespace().collect(), at: 0 };
    words.any() == Some(true) && words.at == words.words.len()
}

struct Words<'a> {
    words: Vec<&'a str>,
    at: usize,
}

impl<'a> Words<'a> {
    /// Steps over the next word if it is `word`.
    fn take(&mut self, word: &str) -> bool {
        let is_next = self.words.get(self.at) == Some(&word);
        self.at += usize::from(is_next);
        is_next
    }

    /// The next word, if it can be a licence's or an exception's name.
    fn name(&mut self) -> Option<&'a str> {
        let word = *self.words.get(self.at)?;
        self.at += 1;
        (!["(", ")", "AND", "OR", "WITH"].contains(&word)).then_some(word)
    }

    /// `all OR all ...`
    fn any(&mut self) -> Option<bool> {
        let mut met = self.all()?;
        while self.take("OR") {
            met |= self.all()?;
        }
        Some(met)
    }

    /// `one AND one ...`
    fn all(&mut self) -> Option<bool> {
        let mut met = self.one()?;
        while self.take("AND") {
            met &= self.one()?;
        }
        Some(met)
    }

    /// `( any )`, `name` or `name WITH exception`.
    fn one(&mut self) -> Option<bool> {
        if self.take("(") {
            let met = self.any()?;
            return self.take(")").then_some(met);
        }
        let name = self.name()?;
        if self.take("WITH") {
            let exception = self.name()?;
            return Some(ALLOWED.contains(&format!("{name} WITH {exception}").as_str()));
        }
        Some(ALLOWED.contains(&name))
    }
}

#[test]
fn every_licence_is_on_the_list() {
    let packages = list(metadata(), "packages");
    assert!(packages.len() > 50, "only {} packages: not the whole graph", packages.len());
    let refused: Vec<String> = packages
        .iter()
        .filter(|package| !is_allowed(text(package, "license")))
        .map(|package| {
            let licence = match text(package, "license") {
                "" => "no licence named",
                licence => licence,
            };
            format!("{} {}: {licence}", text(package, "name"), text(package, "version"))
        })
        .collect();
    assert!(refused.is_empty(), "not on the list:\n{}\n", refused.join("\n"));
}

/// bincode has no maintainer any more (RUSTSEC-2025-0141). 2.0.1 is the last that works (3.0.0 is
/// empty), and nothing but this library, which hides it behind its own format, may lean on it.
#[test]
fn bincode_is_pinned_and_only_ours() {
    let metadata = metadata();
    let versions: Vec<&str> = list(metadata, "packages")
        .iter()
        .filter(|package| text(package, "name") == "bincode")
        .map(|package| text(package, "version"))
        .collect();
    assert_eq!(versions, ["2.0.1"]);

    let name_of = |id: &str| {
        let package = list(metadata, "packages").iter().find(|package| text(package, "id") == id);
        text(package.expect("the graph names packages only"), "name")
    };
    let dependents: Vec<&str> = list(&metadata["resolve"], "nodes")
        .iter()
        .filter(|node| {
            list(node, "deps")
                .iter()
                .any(|dependency| name_of(text(dependency, "pkg")) == "bincode")
        })
        .map(|node| name_of(text(node, "id")))
        .collect();
    assert_eq!(dependents, ["vlf"]);
}

#[test]
fn expressions_are_read_as_spdx_means_them() {
    for met in [
        "MIT",
        "MIT/Apache-2.0",
        "Apache-2.0 / MIT",
        "MIT OR GPL-3.0-only",
        "GPL-3.0-only OR MIT",
        "(MIT OR Apache-2.0) AND Unicode-3.0",
        "MIT AND (GPL-2.0-only OR (ISC AND Zlib))",
        "Apache-2.0 WITH LLVM-exception",
        "Apache-2.0 WITH LLVM-exception OR GPL-3.0-only",
        // AND binds tighter than OR.
        "MIT OR GPL-3.0-only AND LGPL-2.1-only",
        "GPL-3.0-only AND LGPL-2.1-only OR MIT",
    ] {
        assert!(is_allowed(met), "{met}");
    }
    for refused in [
        "",
        "GPL-3.0-only",
        "mit",
        "MIT AND GPL-3.0-only",
        "(MIT OR Apache-2.0) AND GPL-3.0-only",
        "MIT WITH Classpath-exception-2.0",
        "GPL-2.0-only WITH Classpath-exception-2.0",
        "Apache-2.0+",
        "non-standard",
        // Not expressions at all.
        "MIT OR",
        "OR MIT",
        "MIT Apache-2.0",
        "(MIT",
        "MIT)",
        "MIT WITH",
        "()",
    ] {
        assert!(!is_allowed(refused), "{refused}");
    }
}
