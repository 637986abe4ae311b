//! Text of files in the encodings that programs write: UTF-8, UTF-16, or bytes of a code page that
//! the file does not name.
//!
//! A line that is no UTF-8 is read byte by byte as Latin-1. That may show a name wrongly, but
//! different bytes stay different names, in a scene and in its material library alike.
//! [`other_spellings`] then looks such a name up in the code pages in use.

use std::borrow::Cow;

use encoding_rs::{BIG5, EUC_KR, Encoding, GBK, SHIFT_JIS, UTF_16BE, UTF_16LE, WINDOWS_1251, WINDOWS_1252};

/// Code pages in which names are looked for, by how many users have them.
const CODE_PAGES: [&Encoding; 6] = [WINDOWS_1252, GBK, SHIFT_JIS, BIG5, EUC_KR, WINDOWS_1251];

/// The text of a file, without a byte order mark.
pub(super) fn decode(bytes: &[u8]) -> Cow<'_, str> {
    let wide = match bytes {
        // A SketchUp file starts likewise, with a third byte that no UTF-16 text of ASCII has.
        [0xff, 0xfe, b, 0, ..] if b.is_ascii() => Some(UTF_16LE),
        [0xfe, 0xff, 0, b, ..] if b.is_ascii() => Some(UTF_16BE),
        [a, 0, b, 0, ..] if a.is_ascii_graphic() && b.is_ascii() => Some(UTF_16LE),
        [0, a, 0, b, ..] if a.is_ascii_graphic() && b.is_ascii() => Some(UTF_16BE),
        _ => None,
    };
    if let Some(encoding) = wide {
        return encoding.decode_with_bom_removal(bytes).0;
    }
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    match std::str::from_utf8(bytes) {
        Ok(text) => Cow::Borrowed(text),
        Err(_) => Cow::Owned(bytes.split_inclusive(|&b| b == b'\n').map(line).collect()),
    }
}

/// One line, in UTF-8 or byte by byte.
pub(super) fn line(bytes: &[u8]) -> Cow<'_, str> {
    match std::str::from_utf8(bytes) {
        Ok(text) => Cow::Borrowed(text),
        Err(_) => Cow::Owned(bytes.iter().map(|&b| char::from(b)).collect()),
    }
}

/// What a name that was read byte by byte says in the code pages in use; none for a name that is
/// plain ASCII or no such bytes.
pub(super) fn other_spellings(name: &str) -> Vec<String> {
    if name.is_ascii() {
        return Vec::new();
    }
    let bytes: Option<Vec<u8>> = name.chars().map(|c| u8::try_from(c).ok()).collect();
    let Some(bytes) = bytes else { return Vec::new() };
    let spelled = |page: &&'static Encoding| page.decode_without_bom_handling_and_without_replacement(&bytes);
    CODE_PAGES.iter().filter_map(spelled).map(Cow::into_owned).filter(|other| other != name).collect()
}

/// Words of a statement: separated by white space, or between quotation marks.
pub(super) fn quoted_words(text: &str) -> Vec<String> {
    let mut out = Vec::new();
    let mut rest = text.trim();
    while !rest.is_empty() {
        let (word, after) = match rest.strip_prefix('"').and_then(|inner| inner.split_once('"')) {
            Some((word, after)) => (word, after),
            None => rest.split_once(char::is_whitespace).unwrap_or((rest, "")),
        };
        if !word.is_empty() {
            out.push(word.to_owned());
        }
        rest = after.trim_start();
    }
    out
}

/// A name without the quotation marks around it.
pub(super) fn unquoted(name: &str) -> &str {
    let name = name.trim();
    let inside = |mark: char| name.strip_prefix(mark).and_then(|n| n.strip_suffix(mark)).filter(|n| !n.is_empty());
    inside('"').or_else(|| inside('\'')).unwrap_or(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_unknown_code_pages_stay_apart() {
        let text = decode(b"newmtl W\xe4nde\nnewmtl W\xf6nde\nnewmtl d\xc3\xa9j\xc3\xa0\n");
        assert_eq!(text, "newmtl Wände\nnewmtl Wönde\nnewmtl déjà\n");
    }

    #[test]
    fn wide_text_is_read_with_and_without_a_mark() {
        let wide = |big: bool, mark: bool| -> Vec<u8> {
            let text = if mark { "\u{feff}v 0 0 0\nö" } else { "v 0 0 0\nö" };
            text.encode_utf16().flat_map(|u| if big { u.to_be_bytes() } else { u.to_le_bytes() }).collect()
        };
        for (big, mark) in [(false, false), (false, true), (true, false), (true, true)] {
            assert_eq!(decode(&wide(big, mark)), "v 0 0 0\nö", "{big} {mark}");
        }
        assert_eq!(decode(b"\xef\xbb\xbfv 0"), "v 0");
    }

    #[test]
    fn names_are_spelled_in_code_pages() {
        // GBK of a red wall.
        let name = decode(b"\xba\xec\xc7\xbd.png");
        assert!(other_spellings(&name).contains(&"红墙.png".to_owned()));
        assert_eq!(other_spellings("wall.png"), Vec::<String>::new());
        assert_eq!(other_spellings("红墙.png"), Vec::<String>::new());
    }

    #[test]
    fn quotation_marks_hold_words_together() {
        assert_eq!(quoted_words("a.mtl  \"my b.mtl\" c"), ["a.mtl", "my b.mtl", "c"]);
        assert_eq!((unquoted(" \"a b\" "), unquoted("'a'"), unquoted("a\"b")), ("a b", "a", "a\"b"));
    }
}
