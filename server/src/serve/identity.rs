//! The server's certificate: self-signed and kept between runs, or the operator's own.
//!
//! The fingerprint is the BLAKE3 hash of the certificate's DER encoding, 64 hexadecimal digits. A
//! client that was given the fingerprint needs no certificate authority: it accepts exactly this
//! certificate. The key lies beside it, readable by its owner only. A dataset is content that may
//! be copied anywhere, so the identity never lies inside one.
//!
//! A folder holds `certificate.der` and `key.der`; both or none, as clients know the server by
//! them. Whoever makes or changes them holds the folder's `lock`. `next/` holds the identity that
//! will replace them: it is announced to clients, which then know both.

use rustls::pki_types::{CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer, pem::PemObject as _};
use std::{
    fs::{self, File, OpenOptions},
    io::{self, Read as _, Write as _},
    path::{Path, PathBuf},
    time::{Duration, SystemTime},
};
use x509_parser::prelude::{FromDer as _, X509Certificate};

/// Longest certificate or key file; real ones have a few kilobytes at most.
const MAX_FILE_BYTES: u64 = 64 * 1024;
/// Lifetime of a certificate that is made here. Longer: a stolen key is good for longer; shorter:
/// operators rotate more often than they maintain a machine.
const LIFETIME: Duration = Duration::from_secs(2 * 365 * 86_400);
/// The certificate is valid from so long before it was made, for clocks that are behind.
const CLOCK_SKEW: Duration = Duration::from_secs(86_400);
/// Warnings begin so long before the end of the lifetime.
const WARN_BEFORE: Duration = Duration::from_secs(60 * 86_400);

/// A certificate with its key.
#[derive(Debug)]
pub struct Identity {
    /// DER, the server's own first.
    pub certificates: Vec<CertificateDer<'static>>,
    /// DER.
    pub key: PrivateKeyDer<'static>,
    /// Fingerprint of the certificate that will replace this one.
    pub next: Option<blake3::Hash>,
}

/// Why there is no identity.
#[derive(Debug, thiserror::Error)]
pub enum IdentityError {
    /// A file of the identity cannot be read or written.
    #[error("{path}: {source}; set `identity` to another folder in the --config file")]
    File {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// One of two files is missing.
    #[error(
        "{there} is there, but {missing} is not: half an identity. Restore the missing file from a backup; \
         or remove {there}, and every client has to be told the new fingerprint"
    )]
    Half {
        /// The file that exists.
        there: PathBuf,
        /// The file that does not.
        missing: PathBuf,
    },
    /// The key can be read or changed by others.
    #[error("{path}: its mode {mode:04o} lets others read or change the private key; run `chmod 600 {path}`")]
    Mode {
        /// The key.
        path: PathBuf,
        /// Permission bits.
        mode: u32,
    },
    /// A file that holds no certificate or key.
    #[error("{path}: {reason}; PEM or DER is needed")]
    Content {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// There is no next identity to switch to.
    #[error("{0}: there is no next identity; make one with `ldi-server identity --prepare`")]
    NoNext(PathBuf),
    /// No folder to keep an identity in.
    #[error("this user has no home folder: name a folder for the identity")]
    NoFolder,
    /// The certificate could not be made.
    #[error("cannot make a certificate: {0}")]
    Make(#[from] rcgen::Error),
}

impl IdentityError {
    fn file(path: &Path) -> impl Fn(io::Error) -> Self + '_ {
        move |source| Self::File { path: path.into(), source }
    }
}

impl Identity {
    /// A new one.
    ///
    /// # Errors
    /// The system gives no randomness.
    pub fn generate() -> Result<Self, IdentityError> {
        let mut params = rcgen::CertificateParams::new(vec!["ldi-server".to_owned(), "localhost".to_owned()])?;
        let now = SystemTime::now();
        params.not_before = (now - CLOCK_SKEW).into();
        params.not_after = (now + LIFETIME).into();
        let key = rcgen::KeyPair::generate()?;
        let made = params.self_signed(&key)?;
        let key = PrivatePkcs8KeyDer::from(key.serialize_der());
        Ok(Self { certificates: vec![made.der().clone()], key: key.into(), next: None })
    }

    /// The one kept in `folder`, made on the first run.
    ///
    /// # Errors
    /// The folder cannot be made, read or written, or holds half an identity.
    pub fn in_folder(folder: &Path) -> Result<Self, IdentityError> {
        // A reader needs no lock, as the certificate is written last, and whole.
        if !is_there(&certificate_in(folder))? || !is_there(&key_in(folder))? {
            fs::create_dir_all(folder).map_err(IdentityError::file(folder))?;
            let _lock = lock(folder)?;
            make_if_absent(folder)?;
        }
        let mut kept = load(folder)?;
        let next = next_in(folder);
        if is_there(&certificate_in(&next))? {
            kept.next = Some(load(&next)?.hash());
        }
        Ok(kept)
    }

    /// The kept one of `folder` or of the user's state folder; without such a folder, or when that
    /// cannot be written, a new one for this run.
    ///
    /// # Errors
    /// A named folder that cannot be used, or an identity that is damaged or open to others.
    pub fn open(folder: Option<&Path>) -> Result<Self, IdentityError> {
        if let Some(folder) = folder {
            return Self::in_folder(folder);
        }
        let Some(folder) = state_folder() else { return Self::generate() };
        Self::in_folder(&folder).or_else(|e| match e {
            IdentityError::File { .. } => {
                tracing::warn!("{e}; this run has a certificate and a fingerprint of its own");
                Self::generate()
            }
            e => Err(e),
        })
    }

    /// The operator's own, PEM or DER; further certificates of a PEM file are sent along.
    ///
    /// # Errors
    /// Files that cannot be read, hold something else, or a key that others may read.
    pub fn from_files(certificate: &Path, key: &Path) -> Result<Self, IdentityError> {
        let content = |path: &Path, reason: String| IdentityError::Content { path: path.into(), reason };
        let bytes = read_small(certificate)?;
        let certificates = match is_pem(&bytes) {
            true => CertificateDer::pem_slice_iter(&bytes).collect::<Result<Vec<_>, _>>(),
            false => Ok(vec![CertificateDer::from(bytes)]),
        };
        let certificates = certificates.map_err(|e| content(certificate, e.to_string()))?;
        let first = certificates.first().ok_or_else(|| content(certificate, "no certificate in it".into()))?;
        not_after(first).ok_or_else(|| content(certificate, "not a certificate".into()))?;
        check_mode(key)?;
        let bytes = read_small(key)?;
        let read = match is_pem(&bytes) {
            true => PrivateKeyDer::from_pem_slice(&bytes).map_err(|e| e.to_string()),
            false => PrivateKeyDer::try_from(bytes).map_err(str::to_owned),
        };
        Ok(Self { certificates, key: read.map_err(|e| content(key, e))?, next: None })
    }

    /// Makes the identity that will replace the one of `folder`, unless it is there.
    ///
    /// # Errors
    /// As [`Identity::in_folder`].
    pub fn prepare_next(folder: &Path) -> Result<Self, IdentityError> {
        Self::in_folder(folder)?;
        Self::in_folder(&next_in(folder))?;
        Self::in_folder(folder)
    }

    /// Replaces the identity of `folder` by the next one.
    ///
    /// # Errors
    /// There is none, or the files cannot be moved.
    pub fn switch(folder: &Path) -> Result<Self, IdentityError> {
        let next = next_in(folder);
        if !is_there(&certificate_in(&next))? {
            return Err(IdentityError::NoNext(next));
        }
        load(&next)?;
        {
            let _lock = lock(folder)?;
            for file in [key_in, certificate_in] {
                let (from, to) = (file(&next), file(folder));
                fs::rename(&from, &to).map_err(IdentityError::file(&to))?;
            }
        }
        Self::in_folder(folder)
    }

    fn hash(&self) -> blake3::Hash {
        blake3::hash(self.certificates.first().map_or(&[], |c| c))
    }

    /// The fingerprint, 64 hexadecimal digits.
    pub fn fingerprint(&self) -> String {
        self.hash().to_hex().to_string()
    }

    /// Days until the certificate's lifetime ends, below 0 after it.
    pub fn days_left(&self, now: SystemTime) -> Option<i64> {
        let end = not_after(self.certificates.first()?)?;
        let now = now.duration_since(SystemTime::UNIX_EPOCH).ok()?.as_secs() as i64;
        Some((end - now).div_euclid(86_400))
    }

    /// Warns when the lifetime is about to end. Clients that know the fingerprint do not ask for
    /// it.
    pub(super) fn warn_of_its_end(&self, now: SystemTime) {
        if let Some(days) = self.days_left(now)
            && days < (WARN_BEFORE.as_secs() / 86_400) as i64
        {
            tracing::warn!(
                "the certificate's lifetime ends in {days} days; make the next one known with \
                 `ldi-server identity --prepare`, and later take it with `--switch`"
            );
        }
    }
}

fn certificate_in(folder: &Path) -> PathBuf {
    folder.join("certificate.der")
}

fn key_in(folder: &Path) -> PathBuf {
    folder.join("key.der")
}

fn next_in(folder: &Path) -> PathBuf {
    folder.join("next")
}

/// The user's folder for the identity.
pub fn state_folder() -> Option<PathBuf> {
    let named = |name| std::env::var_os(name).map(PathBuf::from).filter(|p| p.is_absolute());
    let state = named("XDG_STATE_HOME").or_else(|| Some(named("HOME")?.join(".local/state")))?;
    Some(state.join("ldi-server"))
}

/// Held by whoever makes or changes an identity, until dropped.
fn lock(folder: &Path) -> Result<File, IdentityError> {
    let path = folder.join("lock");
    let file = OpenOptions::new().create(true).truncate(false).write(true).open(&path);
    file.and_then(|f| f.lock().map(|()| f)).map_err(IdentityError::file(&path))
}

fn make_if_absent(folder: &Path) -> Result<(), IdentityError> {
    let (certificate, key) = (certificate_in(folder), key_in(folder));
    match (is_there(&certificate)?, is_there(&key)?) {
        (true, true) => Ok(()),
        (true, false) => Err(IdentityError::Half { there: certificate, missing: key }),
        (false, true) => Err(IdentityError::Half { there: key, missing: certificate }),
        (false, false) => {
            let new = Identity::generate()?;
            write_private(&key, new.key.secret_der())?;
            write_private(&certificate, &new.certificates[0])
        }
    }
}

fn load(folder: &Path) -> Result<Identity, IdentityError> {
    Identity::from_files(&certificate_in(folder), &key_in(folder))
}

fn is_there(path: &Path) -> Result<bool, IdentityError> {
    path.try_exists().map_err(IdentityError::file(path))
}

fn is_pem(bytes: &[u8]) -> bool {
    bytes.windows(10).any(|w| w == b"-----BEGIN")
}

/// End of a certificate's lifetime, seconds since 1970. None: not a certificate.
fn not_after(certificate: &CertificateDer<'_>) -> Option<i64> {
    let (_, parsed) = X509Certificate::from_der(certificate).ok()?;
    Some(parsed.validity().not_after.timestamp())
}

fn read_small(path: &Path) -> Result<Vec<u8>, IdentityError> {
    let mut bytes = Vec::new();
    File::open(path).and_then(|f| f.take(MAX_FILE_BYTES).read_to_end(&mut bytes)).map_err(IdentityError::file(path))?;
    Ok(bytes)
}

/// Others may not read the key, and a group may not change it. A group may read it: services that
/// are given secrets run as members of one.
#[cfg(unix)]
fn check_mode(key: &Path) -> Result<(), IdentityError> {
    use std::os::unix::fs::PermissionsExt as _;
    let mode = fs::metadata(key).map_err(IdentityError::file(key))?.permissions().mode() & 0o7777;
    if mode & 0o027 == 0 { Ok(()) } else { Err(IdentityError::Mode { path: key.into(), mode }) }
}

#[cfg(not(unix))]
fn check_mode(_: &Path) -> Result<(), IdentityError> {
    Ok(())
}

/// Writes a file that only its owner may read, whole or not at all. Call with the lock held.
fn write_private(path: &Path, bytes: &[u8]) -> Result<(), IdentityError> {
    let temporary = path.with_extension("tmp");
    let mut options = OpenOptions::new();
    options.write(true).create(true).truncate(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    options
        .open(&temporary)
        .and_then(|mut f| f.write_all(bytes).and_then(|()| f.sync_all()))
        .and_then(|()| fs::rename(&temporary, path))
        .map_err(IdentityError::file(path))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("ldi-identity-unit-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        folder
    }

    #[test]
    fn the_identity_stays_and_a_new_one_differs() {
        let folder = folder("stays");
        let first = Identity::in_folder(&folder).unwrap();
        assert_eq!(Identity::in_folder(&folder).unwrap().fingerprint(), first.fingerprint());
        assert_ne!(Identity::generate().unwrap().fingerprint(), first.fingerprint());
        assert_eq!(first.fingerprint().len(), 64);
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            let mode = fs::metadata(folder.join("key.der")).unwrap().permissions().mode();
            assert_eq!(mode & 0o077, 0, "others may read the key");
        }
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_certificate_lives_for_two_years() {
        let made = Identity::generate().unwrap();
        let days = |after: Duration| made.days_left(SystemTime::now() + after).unwrap();
        assert!((728..=730).contains(&days(Duration::ZERO)), "{}", days(Duration::ZERO));
        assert!(days(LIFETIME + Duration::from_secs(86_400)) < 0);
    }

    #[test]
    fn the_next_identity_is_announced_before_it_is_taken() {
        let folder = folder("next");
        assert!(matches!(Identity::switch(&folder), Err(IdentityError::NoNext(_))));
        let before = Identity::prepare_next(&folder).unwrap();
        let next = before.next.expect("announced").to_hex().to_string();
        assert_eq!(Identity::prepare_next(&folder).unwrap().next, before.next, "made once");
        let after = Identity::switch(&folder).unwrap();
        assert_eq!((after.fingerprint(), after.next), (next, None));
        assert_ne!(after.fingerprint(), before.fingerprint());
        assert_eq!(Identity::in_folder(&folder).unwrap().fingerprint(), after.fingerprint());
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn ones_own_certificate_is_read_as_pem_and_der() {
        let folder = folder("own");
        fs::create_dir_all(&folder).unwrap();
        let key = rcgen::KeyPair::generate().unwrap();
        let made = rcgen::CertificateParams::new(vec!["museum.example".into()]).unwrap().self_signed(&key).unwrap();
        let files = [
            ("c.pem", made.pem().into_bytes()),
            ("c.der", made.der().to_vec()),
            ("k.pem", key.serialize_pem().into_bytes()),
            ("k.der", key.serialize_der()),
        ];
        for (name, bytes) in &files {
            write_private(&folder.join(name), bytes).unwrap();
        }
        for (certificate, key) in [("c.pem", "k.pem"), ("c.der", "k.der"), ("c.pem", "k.der")] {
            let own = Identity::from_files(&folder.join(certificate), &folder.join(key)).unwrap();
            assert_eq!(own.certificates, [made.der().clone()], "{certificate}, {key}");
        }
        for (certificate, key, named) in
            [("k.pem", "k.pem", "k.pem"), ("k.der", "k.der", "k.der"), ("c.pem", "c.pem", "c.pem"), ("x", "k.pem", "x")]
        {
            let e = Identity::from_files(&folder.join(certificate), &folder.join(key)).unwrap_err().to_string();
            assert!(e.contains(&folder.join(named).display().to_string()), "{certificate}, {key}: {e}");
        }
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_named_in_the_error() {
        let e = Identity::in_folder(Path::new("/dev/null/x")).unwrap_err();
        assert!(e.to_string().contains("/dev/null/x"), "{e}");
    }
}
