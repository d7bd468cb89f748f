//! Strings that come from files, as messages show them: what they do to a terminal is nothing.

/// A name or a word: short and in one line.
pub fn shown(text: &str) -> String {
    inert(text, 40)
}

/// So many characters of a text in one line, with all escaped that moves a terminal's cursor, changes its
/// colours or turns the text around. Nothing else is done with such a text: no path is made of it.
pub fn inert(text: &str, most: usize) -> String {
    let mut out = String::new();
    for c in text.chars().take(most) {
        match c {
            '\'' | '"' => out.push(c),
            c => out.extend(c.escape_debug()),
        }
    }
    if text.chars().nth(most).is_some() {
        out.push('…');
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_is_shown_short_in_one_line_and_without_effect() {
        assert_eq!(shown("Bob's \"wall\" é"), "Bob's \"wall\" é");
        let hostile = "\u{1b}[2J\u{1b}]0;title\u{7}\r\n\t\u{9b}31m\u{202e}\u{0}\u{200b}";
        let said = inert(hostile, 100);
        assert!(said.starts_with("\\u{1b}[2J\\u{1b}]0;title\\u{7}\\r\\n\\t\\u{9b}31m"), "{said}");
        assert!(said.chars().all(|c| c.is_ascii_graphic()), "{said}");
        assert_eq!(shown(&"x".repeat(41)), format!("{}…", "x".repeat(40)));
        assert_eq!(shown(&"x".repeat(40)), "x".repeat(40));
    }
}
