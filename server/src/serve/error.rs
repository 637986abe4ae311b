//! Why a server does not run.

use std::net::SocketAddr;

/// Errors of [`super::serve`].
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// An address is taken or not ours.
    #[error("cannot listen for {what} on {address}: {source}; choose another address, or port 0 for a free one")]
    Bind {
        /// QUIC or HTTP.
        what: &'static str,
        /// The address.
        address: SocketAddr,
        /// What the system says.
        source: std::io::Error,
    },
    /// Settings or the token file.
    #[error(transparent)]
    Config(#[from] super::config::ConfigError),
    /// The certificate.
    #[error(transparent)]
    Identity(#[from] super::identity::IdentityError),
    /// TLS refuses the certificate or key.
    #[error("TLS refuses the certificate or its key: {0}; the two must belong together")]
    Tls(String),
    /// The manifest's root does not fit the protocol.
    #[error("{name}: its manifest root has {bytes} bytes, at most {limit} can be sent; build the dataset again")]
    RootTooLong {
        /// Of the dataset.
        name: String,
        /// Its length.
        bytes: usize,
        /// What the protocol allows.
        limit: usize,
    },
    /// No dataset can be opened.
    #[error("{0}")]
    Dataset(String),
    /// The ready line could not be written.
    #[error("standard output: {0}")]
    Stdout(std::io::Error),
}
