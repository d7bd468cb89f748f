//! Notes on what of a glTF file was not taken as it stands: one of a kind, with the names of all it is about.

use crate::format::text::shown;
use crate::scene::report::{Note, NoteKind};

/// The most names of a note.
const MOST_NAMES: usize = 8;

/// One note under way.
struct Saying {
    kind: NoteKind,
    /// What it is about, one and several.
    what: [&'static str; 2],
    text: String,
    names: Vec<String>,
}

/// What there is to say.
pub(super) struct Said<'a> {
    file: &'a str,
    sayings: Vec<Saying>,
}

/// What notes are about.
pub(super) const MATERIAL: [&str; 2] = ["material", "materials"];

/// The same.
pub(super) const NODE: [&str; 2] = ["node", "nodes"];

impl<'a> Said<'a> {
    /// Nothing yet, of a file.
    pub fn new(file: &'a str) -> Said<'a> {
        Said { file, sayings: Vec::new() }
    }

    /// Says something of something with a name. Said again it counts once.
    pub fn add(&mut self, kind: NoteKind, what: [&'static str; 2], name: &str, text: &str) {
        let same = |s: &&mut Saying| s.kind == kind && s.text == text;
        let saying = match self.sayings.iter_mut().find(same) {
            Some(saying) => saying,
            None => {
                let (text, names) = (text.to_owned(), Vec::new());
                self.sayings.push(Saying { kind, what, text, names });
                let last = self.sayings.len() - 1;
                &mut self.sayings[last]
            }
        };
        if !saying.names.iter().any(|known| known == name) {
            saying.names.push(name.to_owned());
        }
    }

    /// All of it.
    pub fn notes(self) -> Vec<Note> {
        let note = |Saying { kind, what: [one, several], text, names }: Saying| {
            let listed: Vec<String> =
                names.iter().take(MOST_NAMES).map(|n| format!("`{}`", shown(n))).collect();
            let listed = listed.join(", ");
            let subject = match names.len() {
                1 => format!("{one} {listed}"),
                n if n > MOST_NAMES => format!("{n} {several} {listed} and others"),
                n => format!("{n} {several} {listed}"),
            };
            Note { kind, subject, file: self.file.to_owned(), line: 0, text }
        };
        self.sayings.into_iter().map(note).collect()
    }
}
