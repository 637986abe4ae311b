//! The only door to the file system: the scene file itself, and regular files in its folder or
//! below.
//!
//! A scene names other files by URI (glTF) or path (OBJ, PLY). A hostile scene names
//! `/etc/passwd`, `../../key`, a symbolic link out of its folder, a pipe, or a web address; none
//! of these is opened. Percent-encoding follows RFC 3986 section 2.1, `data:` URIs RFC 2397.

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Component, Path, PathBuf};

use base64::Engine;
use base64::alphabet::STANDARD;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};

use ldi_protocol::said::is_lasting;

use super::error::{Fault, SceneError};
use super::model::Note;

/// Padding is optional: exporters disagree about it, and it carries nothing.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &STANDARD,
    GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent),
);

const INSIDE: &str = "put the file into the scene file's folder and name it by a relative path";

/// Reads files of one folder until the byte budget is spent.
#[derive(Debug)]
pub(super) struct Files {
    folder: PathBuf,
    bytes_left: u64,
    limit: u64,
    /// See [`super::FileSpec::lenient`].
    pub(super) lenient: bool,
    missed: Vec<String>,
}

impl Files {
    /// Reads the scene file, and opens its folder (after following links) for what the scene
    /// refers to.
    pub(super) fn open(path: &Path, limit: u64) -> Result<(Self, Vec<u8>), SceneError> {
        let unreadable = |e: &io::Error| SceneError::Unreadable {
            file: path.display().to_string(),
            problem: e.to_string(),
            remedy: "check the path and its permissions".into(),
            permanent: is_lasting(e),
        };
        let real = fs::canonicalize(path).map_err(|e| unreadable(&e))?;
        let folder = real.parent().map(Path::to_path_buf).unwrap_or_default();
        let mut files = Self { folder, bytes_left: limit, limit, lenient: false, missed: Vec::new() };
        match files.read_regular(&real, "file") {
            Ok(Ok(bytes)) => Ok((files, bytes)),
            Ok(Err(fault)) => Err(fault.in_file(&path.display().to_string())),
            Err(e) => Err(unreadable(&e)),
        }
    }

    /// Bytes behind a glTF URI: `data:`, or a percent-encoded relative path.
    pub(super) fn read_uri(&mut self, uri: &str, place: &str) -> Result<Vec<u8>, Fault> {
        if let Some(data) = uri.strip_prefix("data:") {
            return decode_data_uri(data, place);
        }
        let path = percent_decode(uri.as_bytes())
            .and_then(|b| String::from_utf8(b).ok())
            .ok_or_else(|| Fault::invalid(place, format!("URI {} is wrongly percent-encoded", shown(uri)), INSIDE))?;
        self.read_relative(&path, place)
    }

    /// Bytes of the file at a relative path, which must stay inside the folder.
    pub(super) fn read_relative(&mut self, path: &str, place: &str) -> Result<Vec<u8>, Fault> {
        let refused = |why: &str| Fault::invalid(place, format!("path {} {why}", shown(path)), INSIDE);
        if path.is_empty() || path.contains('\0') {
            return Err(refused("is no file name"));
        }
        // A colon before any slash is a URI scheme (http:, file:) or a drive letter.
        if path.split('/').next().is_some_and(|first| first.contains(':')) {
            return Err(refused("has a scheme other than data:"));
        }
        let relative = Path::new(path);
        if path.starts_with(['/', '\\'])
            || !relative.components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir))
        {
            return Err(refused("leaves the scene file's folder"));
        }
        let real =
            fs::canonicalize(self.folder.join(relative)).map_err(|e| refused(&format!("cannot be read: {e}")))?;
        if !real.starts_with(&self.folder) {
            return Err(refused("is a link that leaves the scene file's folder"));
        }
        self.read_regular(&real, place).map_err(|e| refused(&format!("cannot be read: {e}")))?
    }

    /// What the scene can be shown without: None where it failed and the scene is to be shown all
    /// the same.
    pub(super) fn dispensable<T>(&mut self, found: Result<T, Fault>) -> Result<Option<T>, Fault> {
        match found {
            Ok(found) => Ok(Some(found)),
            Err(fault) if self.lenient => {
                self.missed.push(fault.in_short());
                Ok(None)
            }
            Err(fault) => Err(fault.or("name the scene as FILE?missing=plain to see it without")),
        }
    }

    /// What [`Self::dispensable`] went without.
    pub(super) fn missed(&self) -> Option<Note> {
        let what = format!("{} pictures or material libraries: {}", self.missed.len(), listed(&self.missed));
        (!self.missed.is_empty()).then(|| Note { what, why: "cannot be read; drawn in plain colours".into() })
    }

    /// Reads a regular file whole. The outer error is the system's, the inner one ours.
    fn read_regular(&mut self, real: &Path, place: &str) -> io::Result<Result<Vec<u8>, Fault>> {
        // Looked at before it is opened, since opening a pipe waits for ever.
        if !fs::metadata(real)?.is_file() {
            let why = "is not a regular file";
            return Ok(Err(Fault::invalid(place, why, "name a regular file")));
        }
        let file = File::open(real)?;
        let len = file.metadata()?.len();
        let too_large = || Fault::too_large(place, "bytes in the scene's files together", len, self.limit);
        if len > self.bytes_left {
            return Ok(Err(too_large()));
        }
        let mut bytes = Vec::with_capacity(usize::try_from(len).unwrap_or(0));
        // One byte more than allowed tells a file that grew since.
        file.take(self.bytes_left + 1).read_to_end(&mut bytes)?;
        match self.bytes_left.checked_sub(bytes.len() as u64) {
            Some(left) => self.bytes_left = left,
            None => return Ok(Err(too_large())),
        }
        Ok(Ok(bytes))
    }
}

/// The start of a name from the file, quoted and free of control characters, for messages.
pub(super) fn shown(text: &str) -> String {
    const MOST: usize = 80;
    let mut start: String = text.chars().take(MOST).map(|c| if c.is_control() { '\u{fffd}' } else { c }).collect();
    if text.chars().nth(MOST).is_some() {
        start.push_str("...");
    }
    format!("\"{start}\"")
}

/// The first few of many names, for a note.
pub(super) fn listed(names: &[String]) -> String {
    const MOST: usize = 8;
    let mut out = names[..names.len().min(MOST)].iter().map(|n| shown(n)).collect::<Vec<_>>().join(", ");
    if names.len() > MOST {
        out.push_str(&format!(" and {} more", names.len() - MOST));
    }
    out
}

fn decode_data_uri(data: &str, place: &str) -> Result<Vec<u8>, Fault> {
    let remedy = "write data:[type];base64,BYTES, or put the bytes into a file";
    let Some((head, body)) = data.split_once(',') else {
        return Err(Fault::invalid(place, "data: URI has no comma", remedy));
    };
    if head.ends_with(";base64") {
        BASE64.decode(body).map_err(|e| Fault::invalid(place, format!("data: URI is not base64: {e}"), remedy))
    } else {
        percent_decode(body.as_bytes())
            .ok_or_else(|| Fault::invalid(place, "data: URI is wrongly percent-encoded", remedy))
    }
}

fn percent_decode(text: &[u8]) -> Option<Vec<u8>> {
    let digit = |b: u8| char::from(b).to_digit(16);
    let mut out = Vec::with_capacity(text.len());
    let mut rest = text.iter();
    while let Some(&b) = rest.next() {
        out.push(if b == b'%' {
            let high = digit(*rest.next()?)?;
            let low = digit(*rest.next()?)?;
            (high * 16 + low) as u8
        } else {
            b
        });
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percent_encoding_follows_the_rfc() {
        assert_eq!(percent_decode(b"a%20b%2Fc").as_deref(), Some(b"a b/c".as_slice()));
        assert_eq!(percent_decode(b"%c3%a9").as_deref(), Some("é".as_bytes()));
        assert_eq!(percent_decode(b"a%2"), None);
        assert_eq!(percent_decode(b"a%zz"), None);
        // A sign is no hexadecimal digit, though integer parsers take it.
        assert_eq!(percent_decode(b"a%+1"), None);
    }

    #[test]
    fn data_uris_decode_with_and_without_padding() {
        let bytes = |uri| decode_data_uri(uri, "here").ok();
        assert_eq!(bytes("application/octet-stream;base64,AQI="), Some(vec![1, 2]));
        assert_eq!(bytes(";base64,AQI"), Some(vec![1, 2]));
        assert_eq!(bytes(",%01%02"), Some(vec![1, 2]));
        assert_eq!(bytes(";base64,*"), None);
        assert_eq!(bytes("no comma"), None);
    }

    #[test]
    fn messages_do_not_carry_control_characters() {
        assert_eq!(shown("a\x1b[31m"), "\"a\u{fffd}[31m\"");
        assert!(shown(&"x".repeat(1000)).len() < 100);
    }
}
