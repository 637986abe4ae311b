//! Connection errors. Texts sent by the server are escaped before they are shown.

use ldi_protocol::{said::escaped, wire::RefusalCode};

/// Errors of [`super::Connection`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ConnectError {
    /// The address is invalid, or its name is unknown.
    #[error("{address}: {reason}; give HOST or HOST:PORT")]
    Address {
        /// The address as given.
        address: String,
        /// The cause.
        reason: String,
    },
    /// A fingerprint that is not 64 hexadecimal digits.
    #[error("\"{0}\" is no fingerprint: 64 hexadecimal digits, as the server prints them")]
    FingerprintText(String),
    /// No server answers.
    #[error(
        "{address} does not answer: {}; start `ldi-server serve DATASET --listen 0.0.0.0:PORT` there, check the address and the port, and let UDP pass the firewall",
        escaped(reason)
    )]
    Unreachable {
        /// The address.
        address: String,
        /// The cause.
        reason: String,
    },
    /// The server answers, but no certificate was given to compare with.
    #[error(
        "the server is not known here; if it prints fingerprint={fingerprint}, add --fingerprint {fingerprint} to this command"
    )]
    UnknownServer {
        /// Fingerprint of its certificate.
        fingerprint: String,
    },
    /// The server's certificate is not the expected one.
    #[error(
        "this client refuses the server: its certificate has the fingerprint {found}, and {expected} is expected; it is another server, a server with a new certificate, or someone in between; add --fingerprint {found} only if the server prints it"
    )]
    Fingerprint {
        /// Expected fingerprint.
        expected: String,
        /// Found fingerprint.
        found: String,
    },
    /// The server refuses the connection.
    #[error("the server refuses: {}", escaped(message))]
    Refused {
        /// Reason.
        code: RefusalCode,
        /// The server's message.
        message: String,
    },
    /// The server has no room, or too many connections from this address broke its rules.
    #[error(
        "the server lets nobody else in from here for now: it is full, or connections from this address broke its rules; try again in a minute"
    )]
    Busy,
    /// The server violates the protocol, or sends an unusable manifest.
    #[error("the server sends what cannot be used: {}", escaped(.0))]
    Protocol(String),
    /// The connection ended.
    #[error("the connection ended: {}", escaped(.0))]
    Lost(String),
    /// This machine cannot open a socket or a thread.
    #[error("cannot start: {0}")]
    Local(String),
}

impl ConnectError {
    /// Converts the server's refusal.
    pub(super) fn refused(code: RefusalCode, message: String) -> Self {
        match code {
            RefusalCode::Busy => Self::Busy,
            code => Self::Refused { code, message },
        }
    }

    /// The exit code of the command line: 2 for wrong usage, 1 when a retry may help, 42 when not.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Address { .. } | Self::FingerprintText(_) | Self::UnknownServer { .. } => 2,
            Self::Unreachable { .. } | Self::Busy | Self::Lost(_) | Self::Local(_) => 1,
            Self::Refused { code: RefusalCode::Rate, .. } => 1,
            Self::Fingerprint { .. } | Self::Refused { .. } | Self::Protocol(_) => 42,
        }
    }
}
