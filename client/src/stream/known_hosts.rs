//! Known servers: trust on first use, as in ssh.
//!
//! A text file with one server per line: `HOST:PORT FINGERPRINT`. Empty lines and lines that begin
//! with `#` are ignored. The program only appends lines; to forget a server, remove its line. A
//! server may have several lines: before it changes its certificate it announces the next one,
//! which is appended.

use super::Fingerprint;
use ldi_protocol::wire::DEFAULT_PORT;
use std::{
    fs,
    io::{ErrorKind, Write as _},
    path::{Path, PathBuf},
};

/// Largest file that is read, bytes.
const MAX_BYTES: u64 = 1 << 20;
/// Largest number of certificates learned per server: a server must not fill the file.
const MAX_LEARNED: usize = 16;

/// The file cannot be used, or contradicts a server's certificate.
#[derive(Debug, thiserror::Error)]
pub enum KnownHostsError {
    /// It cannot be read or written.
    #[error("{path}: {source}; give another file with --known-hosts, or the server's certificate with --fingerprint")]
    File {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// A line is malformed.
    #[error("{path}, line {line}: expected `HOST:PORT FINGERPRINT`; mend or remove the line")]
    Line {
        /// The file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
    },
    /// The file is too large to be a list of servers.
    #[error("{path}: {bytes} bytes; this is no file of known servers")]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Its size, bytes.
        bytes: u64,
    },
    /// The server's certificate has changed.
    #[error(
        "{path}, line {line}: {host} is known by the fingerprint {known}, but now shows {found}: it has a new certificate, or someone \
         stands in between. Ask whoever runs it; if the new one is right, remove the line and connect again"
    )]
    Changed {
        /// The file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// Host in the file.
        host: String,
        /// Fingerprint in the file.
        known: Fingerprint,
        /// Fingerprint found.
        found: Fingerprint,
    },
}

/// The file's knowledge of a server.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Acquaintance {
    /// The same certificate is known.
    Same,
    /// The server is unknown.
    Stranger,
}

/// The file's content when it was read.
#[derive(Debug, Clone)]
pub struct KnownHosts {
    path: PathBuf,
    /// Line number, host, fingerprint.
    entries: Vec<(usize, String, Fingerprint)>,
}

impl KnownHosts {
    /// Default path: `~/.config/ldi/known_hosts`, or the system's equivalent. None without a home
    /// folder.
    pub fn default_path() -> Option<PathBuf> {
        Some(directories::ProjectDirs::from("", "", "ldi")?.config_dir().join("known_hosts"))
    }

    /// Reads the file. An absent file knows no servers.
    ///
    /// # Errors
    /// If it cannot be read, or a line is not `HOST:PORT FINGERPRINT`.
    pub fn load(path: &Path) -> Result<Self, KnownHostsError> {
        let file = |source| KnownHostsError::File { path: path.to_owned(), source };
        let text = match fs::metadata(path) {
            Err(e) if e.kind() == ErrorKind::NotFound => String::new(),
            Err(e) => return Err(file(e)),
            Ok(m) if m.len() > MAX_BYTES => {
                return Err(KnownHostsError::TooLarge { path: path.to_owned(), bytes: m.len() });
            }
            Ok(_) => fs::read_to_string(path).map_err(file)?,
        };
        let mut entries = Vec::new();
        for (number, line) in (1..).zip(text.lines()) {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let entry =
                line.split_once(char::is_whitespace).and_then(|(host, print)| Some((host, print.parse().ok()?)));
            let (host, print) = entry.ok_or(KnownHostsError::Line { path: path.to_owned(), line: number })?;
            entries.push((number, host.to_owned(), print));
        }
        Ok(Self { path: path.to_owned(), entries })
    }

    /// Compares a server's certificate with the file. `server`: HOST or HOST:PORT.
    ///
    /// # Errors
    /// [`KnownHostsError::Changed`] if only other certificates of the server are known.
    pub fn check(&self, server: &str, found: Fingerprint) -> Result<Acquaintance, KnownHostsError> {
        let host = name_of(server);
        let mut of_host = self.entries.iter().filter(|e| e.1 == host).peekable();
        let Some(first) = of_host.peek().copied() else { return Ok(Acquaintance::Stranger) };
        if of_host.any(|e| e.2 == found) {
            return Ok(Acquaintance::Same);
        }
        let (path, line, known) = (self.path.clone(), first.0, first.2);
        Err(KnownHostsError::Changed { path, line, host, known, found })
    }

    /// Appends a server, at once, so that several clients can do so concurrently.
    ///
    /// # Errors
    /// If the file or its folder cannot be written.
    pub fn remember(&self, server: &str, print: Fingerprint) -> Result<(), KnownHostsError> {
        let add = || -> std::io::Result<()> {
            if let Some(folder) = self.path.parent() {
                fs::create_dir_all(folder)?;
            }
            let text = fs::read(&self.path).unwrap_or_default();
            // Terminates an unterminated last line.
            let start = if text.last().is_none_or(|b| *b == b'\n') { "" } else { "\n" };
            let line = format!("{start}{} {print}\n", name_of(server));
            fs::OpenOptions::new().append(true).create(true).open(&self.path)?.write_all(line.as_bytes())
        };
        add().map_err(|source| KnownHostsError::File { path: self.path.clone(), source })
    }

    /// Appends the certificate that will replace a known server's, unless it is known. Reads the
    /// file again, as other clients may have written to it.
    ///
    /// # Errors
    /// If the file cannot be read or written.
    pub fn learn(&self, server: &str, next: Fingerprint) -> Result<(), KnownHostsError> {
        let (now, host) = (Self::load(&self.path)?, name_of(server));
        let mut of_host = now.entries.iter().filter(|e| e.1 == host);
        let is_full = of_host.clone().count() >= MAX_LEARNED;
        if is_full || of_host.any(|e| e.2 == next) {
            return Ok(());
        }
        self.remember(server, next)
    }

    /// The latest known certificate of a server, other than this one.
    pub fn other(&self, server: &str, than: Fingerprint) -> Option<Fingerprint> {
        let host = name_of(server);
        self.entries.iter().rev().find(|e| e.1 == host && e.2 != than).map(|e| e.2)
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// HOST:PORT as it is written into the file.
fn name_of(server: &str) -> String {
    let host = server.trim().to_ascii_lowercase();
    let bare_v6 = host.parse::<std::net::Ipv6Addr>().is_ok();
    if bare_v6 {
        format!("[{host}]:{DEFAULT_PORT}")
    } else if host.ends_with(']') || !host.contains(':') {
        format!("{host}:{DEFAULT_PORT}")
    } else {
        host
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(name: &str, text: Option<&str>) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("ldi-known-{}-{name}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        let path = folder.join("deeper").join("known_hosts");
        if let Some(text) = text {
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(&path, text).unwrap();
        }
        path
    }

    const A: Fingerprint = Fingerprint([0xaa; 32]);
    const B: Fingerprint = Fingerprint([0xbb; 32]);

    #[test]
    fn a_stranger_is_remembered_and_a_change_is_named_with_its_line() {
        let path = file("remember", None);
        let empty = KnownHosts::load(&path).unwrap();
        assert_eq!(empty.check("Museum", A).unwrap(), Acquaintance::Stranger);
        empty.remember("Museum", A).unwrap();
        let known = KnownHosts::load(&path).unwrap();
        // The default port is the same server, another port is not.
        assert_eq!(known.check("museum:4433", A).unwrap(), Acquaintance::Same);
        assert_eq!(known.check("museum:4434", B).unwrap(), Acquaintance::Stranger);
        let error = known.check("museum", B).unwrap_err().to_string();
        for part in ["known_hosts, line 1", &"aa".repeat(32), &"bb".repeat(32), "remove the line"] {
            assert!(error.contains(part), "{error}");
        }
    }

    #[test]
    fn comments_are_kept_and_lines_do_not_run_together() {
        let path = file("lines", Some(&format!("# servers\n\n  hall:1   {A}")));
        let known = KnownHosts::load(&path).unwrap();
        assert_eq!(known.check("hall:1", A).unwrap(), Acquaintance::Same);
        known.remember("hall:1", B).unwrap();
        let known = KnownHosts::load(&path).unwrap();
        // Two certificates may be right for one name.
        assert_eq!(known.check("hall:1", A).unwrap(), Acquaintance::Same);
        assert_eq!(known.check("hall:1", B).unwrap(), Acquaintance::Same);
        let error = known.check("hall:1", Fingerprint([0; 32])).unwrap_err();
        assert!(matches!(error, KnownHostsError::Changed { line: 3, .. }), "{error}");
        assert!(fs::read_to_string(&path).unwrap().starts_with("# servers\n\n"));
    }

    #[test]
    fn the_next_certificate_is_learned_once() {
        let path = file("next", Some(&format!("hall:1 {A}\n")));
        let known = KnownHosts::load(&path).unwrap();
        assert_eq!(known.other("hall:1", A), None);
        for _ in 0..2 {
            known.learn("hall:1", B).unwrap();
        }
        assert_eq!(fs::read_to_string(&path).unwrap(), format!("hall:1 {A}\nhall:1 {B}\n"));
        let known = KnownHosts::load(&path).unwrap();
        assert_eq!((known.other("hall:1", A), known.other("hall:1", B)), (Some(B), Some(A)));
        assert_eq!(known.check("hall:1", B).unwrap(), Acquaintance::Same);
    }

    #[test]
    fn nonsense_is_refused_with_its_line() {
        for (text, line) in [("a b\n", 1), ("# x\nhall:1\n", 2), ("hall:1 00ff\n", 1)] {
            let error = KnownHosts::load(&file("nonsense", Some(text))).unwrap_err();
            assert!(matches!(error, KnownHostsError::Line { line: l, .. } if l == line), "{error}");
        }
        let huge = "#".repeat(MAX_BYTES as usize + 1);
        let error = KnownHosts::load(&file("huge", Some(&huge))).unwrap_err();
        assert!(matches!(error, KnownHostsError::TooLarge { .. }), "{error}");
    }

    #[test]
    fn names_have_a_port() {
        for (given, written) in
            [("::1", "[::1]:4433"), ("[::1]", "[::1]:4433"), ("[::1]:9", "[::1]:9"), ("Host", "host:4433")]
        {
            assert_eq!(name_of(given), written.replace("4433", &DEFAULT_PORT.to_string()));
        }
    }
}
