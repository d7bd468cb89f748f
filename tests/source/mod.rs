//! Reading the repository's own text, for the tests that hold it to its rules.

use std::fs;
use std::path::{Path, PathBuf};

/// The repository's root.
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The files under `dir` that `wanted` accepts, sorted; none if there is no such directory.
/// Build products and hidden directories are passed over.
pub fn files(dir: &Path, wanted: &dyn Fn(&Path) -> bool) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let Ok(entries) = fs::read_dir(dir) else { return found };
    for path in entries.map(|entry| entry.unwrap().path()) {
        let name = path.file_name().unwrap().to_string_lossy();
        if path.is_dir() {
            if name != "target" && !name.starts_with('.') {
                found.extend(files(&path, wanted));
            }
        } else if wanted(&path) {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// Whether a path names a Rust source.
pub fn is_rust(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "rs")
}

/// Rust text with its comments and the insides of its literals turned into spaces. Lines keep
/// their numbers, and what is left is code.
pub fn code(text: &str) -> String {
    let from: Vec<char> = text.chars().collect();
    let at = |i: usize| from.get(i).copied().unwrap_or('\0');
    let is_word = |c: char| c.is_alphanumeric() || c == '_';
    let mut out = from.clone();
    let blank = |out: &mut Vec<char>, span: std::ops::Range<usize>| {
        for c in &mut out[span.start.min(from.len())..span.end.min(from.len())] {
            if *c != '\n' {
                *c = ' ';
            }
        }
    };
    let mut i = 0;
    while i < from.len() {
        let start = i;
        if at(i) == '/' && at(i + 1) == '/' {
            while i < from.len() && at(i) != '\n' {
                i += 1;
            }
            blank(&mut out, start..i);
        } else if at(i) == '/' && at(i + 1) == '*' {
            // Block comments nest.
            let mut depth = 0;
            while i < from.len() {
                let step = match (at(i), at(i + 1)) {
                    ('/', '*') => {
                        depth += 1;
                        2
                    }
                    ('*', '/') => {
                        depth -= 1;
                        2
                    }
                    _ => 1,
                };
                i += step;
                if depth == 0 {
                    break;
                }
            }
            blank(&mut out, start..i);
        } else if at(i) == '"' {
            i += 1;
            while i < from.len() && at(i) != '"' {
                i += if at(i) == '\\' { 2 } else { 1 };
            }
            blank(&mut out, start + 1..i);
            i += 1;
        } else if is_word(at(i)) {
            // A whole word, so that a raw string's prefix is told from the end of a name.
            while is_word(at(i)) {
                i += 1;
            }
            let word: String = from[start..i].iter().collect();
            let mut open = i;
            while at(open) == '#' {
                open += 1;
            }
            if matches!(word.as_str(), "r" | "br" | "cr") && at(open) == '"' {
                let hashes = open - i;
                let mut end = open + 1;
                while end < from.len()
                    && !(at(end) == '"' && (1..=hashes).all(|h| at(end + h) == '#'))
                {
                    end += 1;
                }
                blank(&mut out, open + 1..end);
                i = end + 1 + hashes;
            }
        } else if at(i) == '\'' && at(i + 1) == '\\' {
            i += 3;
            while i < from.len() && at(i) != '\'' {
                i += 1;
            }
            blank(&mut out, start + 1..i);
            i += 1;
        } else if at(i) == '\'' && at(i + 2) == '\'' {
            blank(&mut out, start + 1..i + 2);
            i += 3;
        } else {
            i += 1;
        }
    }
    out.into_iter().collect()
}

/// The numbers, from 1, of the lines of `code` in which `word` stands as a whole word.
#[allow(dead_code, reason = "not every test that reads the sources looks for words")]
pub fn lines_with_word(code: &str, word: &str) -> Vec<usize> {
    let is_word = |c: char| c.is_alphanumeric() || c == '_';
    let stands_in = |line: &str| {
        line.match_indices(word).any(|(at, _)| {
            !line[..at].ends_with(is_word) && !line[at + word.len()..].starts_with(is_word)
        })
    };
    code.lines().zip(1..).filter(|(line, _)| stands_in(line)).map(|(_, number)| number).collect()
}
