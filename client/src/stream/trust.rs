//! Certificate verification: exactly the certificate with the given fingerprint is trusted, without
//! any authority.

use super::ConnectError;
use rustls::{
    CertificateError, DigitallySignedStruct, Error, SignatureScheme,
    client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier},
    crypto::{CryptoProvider, verify_tls12_signature, verify_tls13_signature},
    pki_types::{CertificateDer, ServerName, UnixTime},
};
use std::{
    str::FromStr,
    sync::{Arc, OnceLock},
};

/// BLAKE3 of a server's certificate (DER).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Fingerprint(pub [u8; 32]);

impl FromStr for Fingerprint {
    type Err = ConnectError;
    /// 64 hexadecimal digits.
    fn from_str(text: &str) -> Result<Self, ConnectError> {
        blake3::Hash::from_hex(text.trim())
            .map(|h| Self(*h.as_bytes()))
            .map_err(|_| ConnectError::FingerprintText(text.to_owned()))
    }
}

impl std::fmt::Display for Fingerprint {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&blake3::Hash::from_bytes(self.0).to_hex())
    }
}

impl Fingerprint {
    /// Parses one fingerprint, or two with a comma between them while a server's certificate
    /// changes.
    ///
    /// # Errors
    /// If the text is no fingerprint.
    pub fn pair(text: &str) -> Result<(Self, Option<Self>), ConnectError> {
        match text.split_once(',') {
            Some((now, next)) => Ok((now.parse()?, Some(next.parse()?))),
            None => Ok((text.parse()?, None)),
        }
    }
}

/// Accepts one certificate, or the one that will replace it. The handshake's signature is verified
/// as usual, so that the server must hold the key.
#[derive(Debug)]
pub(super) struct PinnedVerifier {
    expected: Option<Fingerprint>,
    next: Option<Fingerprint>,
    found: OnceLock<Fingerprint>,
    provider: Arc<CryptoProvider>,
}

impl PinnedVerifier {
    pub fn new(expected: Option<Fingerprint>, next: Option<Fingerprint>, provider: Arc<CryptoProvider>) -> Arc<Self> {
        Arc::new(Self { expected, next, found: OnceLock::new(), provider })
    }

    /// The reason why the certificate was refused, if one was shown.
    pub fn refusal(&self) -> Option<ConnectError> {
        let found = *self.found.get()?;
        match self.expected {
            None => Some(ConnectError::UnknownServer { fingerprint: found.to_string() }),
            Some(e) if !self.accepts(found) => {
                Some(ConnectError::Fingerprint { expected: e.to_string(), found: found.to_string() })
            }
            Some(_) => None,
        }
    }

    fn accepts(&self, found: Fingerprint) -> bool {
        self.expected == Some(found) || (self.expected.is_some() && self.next == Some(found))
    }
}

impl ServerCertVerifier for PinnedVerifier {
    fn verify_server_cert(
        &self,
        end_entity: &CertificateDer<'_>,
        _intermediates: &[CertificateDer<'_>],
        _server_name: &ServerName<'_>,
        _ocsp_response: &[u8],
        _now: UnixTime,
    ) -> Result<ServerCertVerified, Error> {
        let found = Fingerprint(*blake3::hash(end_entity).as_bytes());
        let _ = self.found.set(found);
        if self.accepts(found) {
            return Ok(ServerCertVerified::assertion());
        }
        Err(Error::InvalidCertificate(CertificateError::ApplicationVerificationFailure))
    }
    fn verify_tls12_signature(
        &self,
        message: &[u8],
        cert: &CertificateDer<'_>,
        dss: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        verify_tls12_signature(message, cert, dss, &self.provider.signature_verification_algorithms)
    }
    fn verify_tls13_signature(
        &self,
        message: &[u8],
        cert: &CertificateDer<'_>,
        dss: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        verify_tls13_signature(message, cert, dss, &self.provider.signature_verification_algorithms)
    }
    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.provider.signature_verification_algorithms.supported_schemes()
    }
}
