//! All `unsafe` code stands in one file, the one that maps a packed field into memory. Whoever
//! audits the library reads that file and no other.

mod source;

use std::fs;

/// The one file, from the repository's root. It need not exist.
const ALLOWED: &str = "src/look/mapping.rs";

#[test]
fn unsafe_code_stands_in_one_file() {
    let root = source::root();
    let mut offenders = Vec::new();
    for dir in ["src", "tools"] {
        for file in source::files(&root.join(dir), &source::is_rust) {
            if file == root.join(ALLOWED) {
                continue;
            }
            let code = source::code(&fs::read_to_string(&file).unwrap());
            for line in source::lines_with_word(&code, "unsafe") {
                offenders.push(format!("{}:{line}", file.strip_prefix(root).unwrap().display()));
            }
        }
    }
    assert!(offenders.is_empty(), "outside {ALLOWED}:\n{}\n", offenders.join("\n"));
}

/// Words in comments, strings and longer names do not count; code between them does.
#[test]
fn only_code_counts() {
    let text = r##"// unsafe
/* unsafe /* unsafe */ unsafe */
#![deny(unsafe_code)]
let a = "unsafe \" unsafe"; let b = r#"unsafe " unsafe"#; let c = br"unsafe\"; let d = '"';
let e = '\''; unsafe { f::<'a>('u') } // unsafe
fn g<'a>(x: &'a str) {} unsafe fn h() {}
let r#unsafe = "
unsafe"; let i = '\u{22}'; #[unsafe(no_mangle)]
"##;
    let code = source::code(text);
    assert_eq!(code.lines().count(), text.lines().count());
    assert_eq!(source::lines_with_word(&code, "unsafe"), [5, 6, 7, 8]);
}
