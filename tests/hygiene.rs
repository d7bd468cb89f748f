//! Nothing half done is left lying about: no note to do something later without its reason, no
//! leftover of debugging, no test switched off without saying why.

mod source;

use std::fs;
use std::path::{Path, PathBuf};

/// The words of a note. Put together here, so that this file does not find itself.
const NOTES: [&str; 3] = [concat!("TO", "DO"), concat!("FIX", "ME"), concat!("XX", "X")];

/// Macros that do not belong in finished code.
const MACROS: [&str; 3] = ["todo", "dbg", "unimplemented"];

/// A note has a reason when a colon and at least three words follow on its line.
fn notes_without_reason(text: &str) -> Vec<usize> {
    let has_reason = |rest: &str| {
        rest.strip_prefix(':').is_some_and(|reason| reason.split_whitespace().count() >= 3)
    };
    let unreasoned = |line: &str, note: &str| {
        !source::lines_with_word(line, note).is_empty()
            && line.split_once(note).is_some_and(|(_, rest)| !has_reason(rest))
    };
    text.lines()
        .zip(1..)
        .filter(|(line, _)| NOTES.iter().any(|note| unreasoned(line, note)))
        .map(|(_, number)| number)
        .collect()
}

/// Lines of Rust with a macro of [`MACROS`], or with an `ignore` that gives no reason.
fn leftovers(text: &str) -> Vec<usize> {
    let code = source::code(text);
    let calls = |line: &str| {
        MACROS.iter().any(|name| {
            line.match_indices(&format!("{name}!"))
                .any(|(at, _)| !line[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_'))
        })
    };
    let ignores = |line: &str| {
        ["#[ignore", ", ignore"].iter().any(|start| {
            line.split_once(start).is_some_and(|(_, rest)| match rest.trim_start().chars().next() {
                Some('=') => rest.contains("\"\""),
                Some(c) => matches!(c, ']' | ')'),
                None => false,
            })
        })
    };
    code.lines()
        .zip(1..)
        .filter(|(line, _)| calls(line) || ignores(line))
        .map(|(_, number)| number)
        .collect()
}

/// Every source, document and script of the repository.
fn texts() -> Vec<PathBuf> {
    let root = source::root();
    let is_text = |path: &Path| {
        path.extension().is_some_and(|extension| {
            ["rs", "md", "toml", "sh", "py", "txt", "yml", "yaml"].iter().any(|e| extension == *e)
        })
    };
    let mut texts = source::files(root, &is_text);
    texts.extend(source::files(&root.join(".ci"), &|_| true));
    texts
}

#[test]
fn nothing_half_done() {
    let mut found = Vec::new();
    let mut seen = 0;
    for file in texts() {
        let text = fs::read_to_string(&file).unwrap();
        let name = file.strip_prefix(source::root()).unwrap().display().to_string();
        let mut say = |lines: Vec<usize>, what: &str| {
            found.extend(lines.iter().map(|line| format!("{name}:{line}: {what}")));
        };
        say(notes_without_reason(&text), "a note without its reason");
        if source::is_rust(&file) {
            say(leftovers(&text), "a leftover, or a test ignored without a reason");
        }
        seen += 1;
    }
    assert!(seen > 10, "only {seen} files read: the walk is broken");
    assert!(found.is_empty(), "\n{}\n", found.join("\n"));
}

#[test]
fn the_check_tells_a_reason_from_none() {
    let note = NOTES[0];
    assert_eq!(
        notes_without_reason(&format!("// {note}\n// {note}: later\n// {note} why not")),
        [1, 2, 3]
    );
    let reasoned = format!("// {note}: obj2 has no fourth index yet\n// {note}S and {note}_LIST");
    assert!(notes_without_reason(&reasoned).is_empty());

    let bang = "!";
    assert_eq!(leftovers(&format!("{}{bang}()\n dbg{bang}(x)", MACROS[0])), [1, 2]);
    assert!(leftovers(&format!("my_dbg{bang}(x) // dbg{bang}(x)\n\"dbg{bang}\"")).is_empty());
    assert_eq!(leftovers("#[ignore]\n#[cfg_attr(x, ignore)]\n#[ignore = \"\"]"), [1, 2, 3]);
    assert!(leftovers("#[ignore = \"an hour long\"]").is_empty());
}
