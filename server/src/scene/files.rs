//! The only door to the file system: the scene file itself, and regular files in its folder or
//! below.
//!
//! A scene names other files by URI (glTF) or path (OBJ, PLY). A hostile scene names
//! `/etc/passwd`, `../../key`, a symbolic link out of its folder, a pipe, or a web address; none
//! of these is opened. Percent-encoding follows RFC 3986 section 2.1, `data:` URIs RFC 2397.
//!
//! Scenes travel from machine to machine, and paths in them do not fit any more. A file that is
//! not where the path says is looked for inside the folder under other spellings of the path
//! ([`spellings`]): with the separators and letter case of Windows, without a query, in other code
//! pages, and by the last parts of a path that leaves the folder. What is found under another name
//! is noted.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Component, Path, PathBuf};

use base64::Engine;
use base64::alphabet::STANDARD;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};

use ldi_protocol::said::is_lasting;

use super::error::{Fault, SceneError};
use super::model::Note;
use super::recognise;
use super::text;
use super::unpack::{self, Archive};

/// Padding is optional: exporters disagree about it, and it carries nothing.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &STANDARD,
    GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent),
);

const INSIDE: &str = "put the file into the scene file's folder, where it is found by its name, or name it by a path \
                      relative to it";
/// Entries of a folder among which a name in another letter case is looked for.
const MOST_ENTRIES: usize = 65_536;
/// Parts of a path that are tried: longer ones are mistakes.
const MOST_PARTS: usize = 64;

/// Reads files of one folder until the byte budget is spent.
#[derive(Debug)]
pub(super) struct Files {
    folder: PathBuf,
    /// Where the scene comes out of an archive: its files come first.
    archive: Option<Archive>,
    bytes_left: u64,
    limit: u64,
    /// See [`super::FileSpec::lenient`].
    pub(super) lenient: bool,
    /// See [`super::FileSpec::spaces_are_rooms`].
    pub(super) spaces_are_rooms: bool,
    missed: Vec<String>,
    faults: Vec<Fault>,
    elsewhere: Vec<String>,
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
        let mut files = Self {
            folder,
            archive: None,
            bytes_left: limit,
            limit,
            lenient: false,
            spaces_are_rooms: false,
            missed: Vec::new(),
            faults: Vec::new(),
            elsewhere: Vec::new(),
        };
        match files.read_regular(&real, "file") {
            Ok(Ok(bytes)) => Ok((files, bytes)),
            Ok(Err(fault)) => Err(fault.in_file(&path.display().to_string())),
            Err(e) => Err(unreadable(&e)),
        }
    }

    /// The scene in a gzip file or zip archive, with its name; other files as they are.
    pub(super) fn unpacked(&mut self, name: &str, bytes: Vec<u8>) -> Result<(String, Vec<u8>), Fault> {
        if unpack::is_gzip(&bytes) {
            let out = unpack::gunzip(&bytes, self.bytes_left)?;
            self.bytes_left -= out.len() as u64;
            let lower = name.to_ascii_lowercase();
            let inner = if lower.ends_with(".gz") { &name[..name.len() - 3] } else { name };
            return Ok((inner.to_owned(), out));
        }
        if !unpack::is_zip(&bytes) {
            return Ok((name.to_owned(), bytes));
        }
        // An archive of one format, whatever else is in it.
        if name.to_ascii_lowercase().ends_with(".usdz")
            && let Some(fault) = recognise::foreign(name, &bytes)
        {
            return Err(fault);
        }
        let (archive, scene) = Archive::open(bytes)?;
        self.archive = Some(archive);
        let file = scene.rsplit('/').next().unwrap_or(&scene).to_owned();
        match self.read_packed(&file) {
            Some(bytes) => Ok((file, bytes?)),
            None => Err(Fault::broken("zip archive", format!("{} is listed, but not there", shown(&scene)))),
        }
    }

    /// Bytes behind a glTF URI: `data:`, or a percent-encoded relative path.
    pub(super) fn read_uri(&mut self, uri: &str, place: &str) -> Result<Vec<u8>, Fault> {
        if let Some(data) = uri.strip_prefix("data:") {
            return decode_data_uri(data, place);
        }
        // Many writers do not encode at all, so a percent sign may be one.
        let path = text::line(&percent_decode_where_it_is(uri.as_bytes())).into_owned();
        match self.read_relative(&path, place) {
            Err(_) if path != uri && self.find(uri).is_some() => self.read_relative(uri, place),
            read => read,
        }
    }

    /// Bytes of the file at a relative path, which must stay inside the folder.
    pub(super) fn read_relative(&mut self, path: &str, place: &str) -> Result<Vec<u8>, Fault> {
        let refused = |why: &str| Fault::invalid(place, format!("path {} {why}", shown(path)), INSIDE);
        if path.is_empty() || path.contains('\0') {
            return Err(refused("is no file name"));
        }
        if is_web_address(path) {
            let problem = format!("path {} has a scheme other than data:, and nothing is downloaded", shown(path));
            return Err(Fault::invalid(
                place,
                problem,
                "download the file into the scene file's folder and name it there",
            ));
        }
        for parts in self.archive.as_ref().map(|_| spellings(path)).unwrap_or_default() {
            let name: Vec<_> = parts.iter().map(|p| p.to_string_lossy()).collect();
            if let Some(bytes) = self.read_packed(&name.join("/")) {
                return bytes.map_err(|f| f.within(place));
            }
        }
        let why = match self.inside(path) {
            Ok(real) => {
                return self.read_regular(&real, place).map_err(|e| refused(&format!("cannot be read: {e}")))?;
            }
            Err(why) => why,
        };
        let Some(real) = self.find(path) else { return Err(refused(&why)) };
        let found = real.strip_prefix(&self.folder).unwrap_or(&real).display().to_string();
        // Separators alone are no other name.
        if path.replace('\\', "/").trim_start_matches("./") != found {
            self.elsewhere.push(format!("{path} as {found}"));
        }
        self.read_regular(&real, place).map_err(|e| refused(&format!("cannot be read: {e}")))?
    }

    /// Whether a file is found under a path or another spelling of it.
    pub(super) fn has(&self, path: &str) -> bool {
        let packed = |parts: Vec<OsString>| {
            let name: Vec<_> = parts.iter().map(|p| p.to_string_lossy()).collect();
            self.archive.as_ref().is_some_and(|a| a.holds(&name.join("/")))
        };
        self.inside(path).is_ok() || self.find(path).is_some() || spellings(path).into_iter().any(packed)
    }

    /// The real path of a file exactly as named, or why it is not opened.
    fn inside(&self, path: &str) -> Result<PathBuf, String> {
        // A colon before any slash is a URI scheme (file:) or a drive letter.
        if path.split('/').next().is_some_and(|first| first.contains(':')) {
            return Err("has a scheme other than data:".into());
        }
        let relative = Path::new(path);
        if path.starts_with(['/', '\\'])
            || !relative.components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir))
        {
            return Err("leaves the scene file's folder".into());
        }
        let real = fs::canonicalize(self.folder.join(relative)).map_err(|e| format!("cannot be read: {e}"))?;
        if !real.starts_with(&self.folder) {
            return Err("is a link that leaves the scene file's folder".into());
        }
        Ok(real)
    }

    /// The real path of a regular file inside the folder under another spelling of a path.
    fn find(&self, path: &str) -> Option<PathBuf> {
        if path.is_empty() || path.contains('\0') || is_web_address(path) {
            return None;
        }
        spellings(path).into_iter().find_map(|parts| {
            let mut at = self.folder.clone();
            for part in parts {
                let exact = at.join(&part);
                at = if exact.symlink_metadata().is_ok() { exact } else { in_other_case(&at, &part)? };
            }
            let real = fs::canonicalize(at).ok()?;
            (real.starts_with(&self.folder) && real.is_file()).then_some(real)
        })
    }

    fn read_packed(&mut self, name: &str) -> Option<Result<Vec<u8>, Fault>> {
        let read = self.archive.as_mut()?.read(name, self.bytes_left)?;
        if let Ok(bytes) = &read {
            self.bytes_left = self.bytes_left.saturating_sub(bytes.len() as u64);
        }
        Some(read)
    }

    /// What the scene can be shown without, and so need not be read where `needed` is false: None
    /// where it failed. What is needed and failed is told by [`Self::verdict`], all at once, unless
    /// the scene is to be shown all the same.
    pub(super) fn dispensable<T>(&mut self, found: Result<T, Fault>, needed: bool) -> Option<T> {
        match found {
            Ok(found) => Some(found),
            Err(fault) if self.lenient || !needed => {
                self.missed.push(fault.in_short());
                None
            }
            Err(fault) => {
                self.faults.push(fault);
                None
            }
        }
    }

    /// Fails with everything that [`Self::dispensable`] missed, and with `last` where reading ended
    /// with another fault.
    pub(super) fn verdict(&mut self, last: Option<Fault>) -> Result<(), Fault> {
        let mut faults = std::mem::take(&mut self.faults);
        if !faults.is_empty() {
            let first = faults.remove(0);
            faults.insert(0, first.or("name the scene as FILE?missing=plain to see it without"));
        }
        faults.extend(last);
        Fault::together(faults).map_or(Ok(()), Err)
    }

    /// What was missed, and what was found under another name.
    pub(super) fn notes(&self) -> Vec<Note> {
        let mut out = Vec::new();
        if !self.missed.is_empty() {
            let what = format!("{} pictures or material libraries: {}", self.missed.len(), listed(&self.missed));
            out.push(Note { what, why: "cannot be read; drawn in plain colours".into() });
        }
        if !self.elsewhere.is_empty() {
            let what = format!("{} files under other names: {}", self.elsewhere.len(), listed(&self.elsewhere));
            out.push(Note { what, why: "no file is where the scene says; these lie in its folder".into() });
        }
        out
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

/// Whether a path names a file on another machine.
fn is_web_address(path: &str) -> bool {
    let scheme = path.split_once(':').map(|(scheme, _)| scheme.to_ascii_lowercase());
    matches!(scheme.as_deref(), Some("http" | "https" | "ftp" | "blob" | "s3" | "omniverse"))
}

/// Paths inside the folder, as their parts, that a path in a scene may mean, likeliest first.
fn spellings(path: &str) -> Vec<Vec<OsString>> {
    let slashed = path.replace('\\', "/");
    let mut texts = vec![slashed.clone()];
    // A query that keeps browsers from caching.
    texts.extend(slashed.split_once(['?', '#']).map(|(before, _)| before.to_owned()));
    texts.extend(text::other_spellings(&slashed));
    let (mut whole, mut ends) = (Vec::new(), Vec::new());
    for text in &texts {
        let text = text.strip_prefix("file:").unwrap_or(text);
        let leaves = text.starts_with('/') || text.contains(':') || text.split('/').any(|p| p == "..");
        let after_up = text.split('/').rev().take_while(|p| *p != "..").filter(|p| !matches!(*p, "" | "."));
        let mut parts: Vec<OsString> = after_up.take(MOST_PARTS).map(OsString::from).collect();
        parts.reverse();
        if parts.is_empty() {
            continue;
        }
        if !leaves {
            whole.push(parts.clone());
        }
        ends.extend((usize::from(!leaves)..parts.len()).map(|from| parts[from..].to_vec()));
    }
    whole.extend(ends);
    whole
}

/// The entry of a folder whose name differs in letter case only.
fn in_other_case(folder: &Path, name: &std::ffi::OsStr) -> Option<PathBuf> {
    let wanted = name.to_str()?.to_lowercase();
    let entries = fs::read_dir(folder).ok()?.take(MOST_ENTRIES).flatten();
    let alike = entries.map(|e| e.file_name()).filter(|n| n.to_str().is_some_and(|n| n.to_lowercase() == wanted));
    // The order of a folder's entries is not the same everywhere.
    alike.min().map(|found| folder.join(found))
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

/// [`percent_decode`], with percent signs that start no escape left as they are.
fn percent_decode_where_it_is(text: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(text.len());
    let mut rest = text;
    while let Some((&b, after)) = rest.split_first() {
        match rest.get(..3).filter(|_| b == b'%').and_then(percent_decode) {
            Some(decoded) => {
                out.extend(decoded);
                rest = &rest[3..];
            }
            None => {
                out.push(b);
                rest = after;
            }
        }
    }
    out
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
    fn percent_signs_that_start_no_escape_stay() {
        assert_eq!(percent_decode_where_it_is(b"50%.png"), b"50%.png");
        assert_eq!(percent_decode_where_it_is(b"a%20b%2"), b"a b%2");
        assert_eq!(percent_decode_where_it_is(b"%%41"), b"%A");
    }

    #[test]
    fn paths_are_looked_for_in_other_spellings() {
        let of = |path| -> Vec<String> {
            let joined = |parts: Vec<OsString>| parts.join(std::ffi::OsStr::new("/")).to_string_lossy().into_owned();
            spellings(path).into_iter().map(joined).collect()
        };
        assert_eq!(of("tex\\a.png"), ["tex/a.png", "a.png"]);
        assert_eq!(of("C:\\me\\a.png"), ["C:/me/a.png", "me/a.png", "a.png"]);
        assert_eq!(of("../../x/../tex/a.png"), ["tex/a.png", "a.png"]);
        assert_eq!(of("a.png?v=3"), ["a.png?v=3", "a.png"]);
        assert_eq!(of("file:///C:/tex/a.png"), ["C:/tex/a.png", "tex/a.png", "a.png"]);
        assert_eq!((of(".."), of("/")), (vec![], vec![]));
        assert!(of(&"a/".repeat(100_000)).len() <= 64);
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
