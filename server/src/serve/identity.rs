//! The server's certificate: self-signed, kept between runs, known to clients by its fingerprint.
//!
//! The fingerprint is the BLAKE3 hash of the certificate's DER encoding, 64 hexadecimal digits. A client that was
//! given the fingerprint needs no certificate authority: it accepts exactly this certificate. The key lies beside it, readable
//! by its owner only. A dataset is content that may be copied anywhere, so the identity never lies inside one.

use rustls::pki_types::{CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer};
use std::{
    io::Write,
    path::{Path, PathBuf},
};

/// Longest certificate or key file; real ones have a few hundred bytes.
const MAX_FILE_BYTES: u64 = 64 * 1024;

/// A certificate with its key.
#[derive(Debug)]
pub struct Identity {
    /// DER.
    pub certificate: CertificateDer<'static>,
    /// PKCS 8 DER.
    pub key: PrivateKeyDer<'static>,
}

/// Why there is no identity.
#[derive(Debug, thiserror::Error)]
pub enum IdentityError {
    /// A file of the identity cannot be read or written.
    #[error("{path}: {source}; set `identity` to another folder in the --config file")]
    File {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The certificate could not be made.
    #[error("cannot make a certificate: {0}")]
    Make(#[from] rcgen::Error),
}

impl Identity {
    /// A new one.
    ///
    /// # Errors
    /// The system gives no randomness.
    pub fn generate() -> Result<Self, IdentityError> {
        let made = rcgen::generate_simple_self_signed(vec!["ldi-server".to_owned(), "localhost".to_owned()])?;
        let key = PrivatePkcs8KeyDer::from(made.signing_key.serialize_der());
        Ok(Self { certificate: made.cert.der().clone(), key: key.into() })
    }

    /// The one kept in `folder`, made on the first run.
    ///
    /// # Errors
    /// The folder cannot be made, read or written.
    pub fn in_folder(folder: &Path) -> Result<Self, IdentityError> {
        let (certificate, key) = (folder.join("certificate.der"), folder.join("key.der"));
        if certificate.exists() && key.exists() {
            let key = PrivatePkcs8KeyDer::from(read_small(&key)?);
            return Ok(Self { certificate: CertificateDer::from(read_small(&certificate)?), key: key.into() });
        }
        std::fs::create_dir_all(folder).map_err(|source| IdentityError::File { path: folder.into(), source })?;
        let new = Self::generate()?;
        // The key first: a certificate without its key is made anew on the next run.
        write_private(&key, new.key.secret_der())?;
        write_private(&certificate, &new.certificate)?;
        Ok(new)
    }

    /// The kept one of `folder` or of the user's state folder; else, with a warning, a new one for this run.
    ///
    /// # Errors
    /// A named folder that cannot be used.
    pub fn open(folder: Option<&Path>) -> Result<Self, IdentityError> {
        if let Some(folder) = folder {
            return Self::in_folder(folder);
        }
        let Some(folder) = state_folder() else { return Self::generate() };
        Self::in_folder(&folder).or_else(|e| {
            tracing::warn!("{e}; this run has a certificate and a fingerprint of its own");
            Self::generate()
        })
    }

    /// The fingerprint, 64 hexadecimal digits.
    pub fn fingerprint(&self) -> String {
        blake3::hash(&self.certificate).to_hex().to_string()
    }
}

fn state_folder() -> Option<PathBuf> {
    let named = |name| std::env::var_os(name).map(PathBuf::from).filter(|p| p.is_absolute());
    let state = named("XDG_STATE_HOME").or_else(|| Some(named("HOME")?.join(".local/state")))?;
    Some(state.join("ldi-server"))
}

fn read_small(path: &Path) -> Result<Vec<u8>, IdentityError> {
    use std::io::Read;
    let mut bytes = Vec::new();
    std::fs::File::open(path)
        .and_then(|f| f.take(MAX_FILE_BYTES).read_to_end(&mut bytes))
        .map_err(|source| IdentityError::File { path: path.into(), source })?;
    Ok(bytes)
}

/// Writes a file that only its owner may read, whole or not at all.
fn write_private(path: &Path, bytes: &[u8]) -> Result<(), IdentityError> {
    let temporary = path.with_extension(format!("{}.tmp", std::process::id()));
    let mut options = std::fs::OpenOptions::new();
    options.write(true).create(true).truncate(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    options
        .open(&temporary)
        .and_then(|mut f| f.write_all(bytes).and_then(|()| f.sync_all()))
        .and_then(|()| std::fs::rename(&temporary, path))
        .map_err(|source| IdentityError::File { path: path.into(), source })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_identity_stays_and_a_new_one_differs() {
        let folder = std::env::temp_dir().join(format!("ldi-identity-{}", std::process::id()));
        let first = Identity::in_folder(&folder).unwrap();
        assert_eq!(Identity::in_folder(&folder).unwrap().fingerprint(), first.fingerprint());
        assert_ne!(Identity::generate().unwrap().fingerprint(), first.fingerprint());
        assert_eq!(first.fingerprint().len(), 64);
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            let mode = std::fs::metadata(folder.join("key.der")).unwrap().permissions().mode();
            assert_eq!(mode & 0o077, 0, "others may read the key");
        }
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_named_in_the_error() {
        let e = Identity::in_folder(Path::new("/dev/null/x")).unwrap_err();
        assert!(e.to_string().contains("/dev/null/x"), "{e}");
    }
}
