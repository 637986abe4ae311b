//! How texts are shown to people: errors with their causes, texts of the other side escaped.

use std::{borrow::Cow, error::Error, io};

/// Whether what keeps a file from being read or written stays so: a full disk may be emptied, a
/// folder that is not there does not come by itself.
pub fn is_lasting(e: &io::Error) -> bool {
    use io::ErrorKind as Kind;
    matches!(
        e.kind(),
        Kind::NotFound | Kind::PermissionDenied | Kind::NotADirectory | Kind::IsADirectory | Kind::AlreadyExists
    )
}

/// An error with its causes, each thing once: many an error says its cause in its own words.
pub fn said(error: &(dyn Error + 'static)) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(e) = cause {
        let more = e.to_string();
        if !text.contains(&more) {
            text = format!("{text}: {more}");
        }
        cause = e.source();
    }
    text
}

/// A text of the other side, safe to write into a log, a terminal or a page: characters that end a
/// line, steer a terminal or hide or reorder others are written as `\n` or `\u{1b}`.
pub fn escaped(text: &str) -> Cow<'_, str> {
    if !text.contains(is_steering) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        match is_steering(c) {
            true => out.extend(c.escape_default()),
            false => out.push(c),
        }
    }
    Cow::Owned(out)
}

/// Control characters, line and paragraph separators, marks of writing direction, invisible ones.
fn is_steering(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{200b}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}')
        || matches!(c, '\u{feff}' | '\u{fff9}'..='\u{fffb}' | '\u{e0000}'..='\u{e007f}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error)]
    enum Trouble {
        #[error("{0}")]
        Plain(&'static str),
        #[error("walls.glb: {0}")]
        Repeats(#[source] Box<Trouble>),
        #[error("cannot be built")]
        Adds(#[source] Box<Trouble>),
    }

    #[test]
    fn a_cause_is_told_once() {
        let repeats = || Trouble::Repeats(Box::new(Trouble::Plain("no triangles")));
        assert_eq!(said(&Trouble::Plain("no triangles")), "no triangles");
        assert_eq!(said(&repeats()), "walls.glb: no triangles");
        assert_eq!(said(&Trouble::Adds(Box::new(repeats()))), "cannot be built: walls.glb: no triangles");
    }

    #[test]
    fn a_text_of_the_other_side_stays_on_its_line() {
        for plain in ["", "Zoë, guide", "館 🏛 \u{200d}", r"a\b"] {
            assert!(matches!(escaped(plain), Cow::Borrowed(p) if p == plain), "{plain}");
        }
        assert_eq!(escaped("a\nb\r\t\u{1b}[2J\u{9b}"), r"a\nb\r\t\u{1b}[2J\u{9b}");
        assert_eq!(escaped("\u{202e}cod.exe\u{2028}\u{feff}"), r"\u{202e}cod.exe\u{2028}\u{feff}");
    }
}
