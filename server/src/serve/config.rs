//! The server's settings, from the command line or a TOML file with the same names.

use serde::Deserialize;
use std::{
    net::SocketAddr,
    path::{Path, PathBuf},
};

/// How a server listens and what it allows.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ServeConfig {
    /// UDP address of QUIC; port 0 picks a free one.
    pub listen: SocketAddr,
    /// TCP address of the HTTP page, or `off`; port 0 picks a free one.
    pub http: HttpAt,
    /// Names by which browsers reach the page, beside `localhost` and addresses. Pages of other
    /// names are not answered: their owners could have visitors' browsers read this one.
    pub http_names: Vec<String>,
    /// File with the secret that clients must show, surrounding white space ignored. None:
    /// everyone may come in.
    pub token_file: Option<PathBuf>,
    /// Folder of the certificate and its key. None: `$XDG_STATE_HOME/ldi-server`, else
    /// `$HOME/.local/state/ldi-server`, else a new certificate per run.
    pub identity: Option<PathBuf>,
    /// PEM or DER file of the operator's own certificate, instead of the one in `identity`; with
    /// `key`.
    pub certificate: Option<PathBuf>,
    /// PEM or DER file of its private key.
    pub key: Option<PathBuf>,
    /// Walkers in all. Each takes about 115 KiB while idle and up to `send_window` while it
    /// streams.
    pub max_connections: usize,
    /// Walkers from one IPv4 address or one /64 network of IPv6.
    pub max_connections_per_address: usize,
    /// Bytes of chunks per second that all walkers from one address (IPv6: /64 network) share; 0:
    /// no limit.
    pub bytes_per_second_per_address: f64,
    /// Control messages and requests per second of one client; short bursts of four times as many
    /// pass.
    pub messages_per_second: f64,
    /// Bytes that one connection may have on the way, unacknowledged. Smaller: less memory and
    /// fresher priorities; larger than bandwidth times round trip brings nothing.
    pub send_window: u64,
    /// What it is worth to send ahead of need, bytes: a chunk of so many is sent ahead if it is as
    /// likely to be needed as not, a larger one only if it is likelier. Larger: fewer frames lack
    /// something; smaller: fewer bytes are sent in vain. 0: nothing goes ahead.
    pub ahead_worth: u64,
    /// Which congestion controller: `cubic` or `newreno` (each loss slows them), `veno` (only
    /// losses with a queue), `bbr` (keeps its rate and floods queues).
    pub congestion: Congestion,
    /// Walkers may see on their maps where the others are.
    pub show_walkers: bool,
}

/// See [`ServeConfig::congestion`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Congestion {
    /// Shrinks at each loss.
    Cubic,
    /// Shrinks more at each loss, and grows more slowly.
    NewReno,
    /// Tells losses by chance from congestion: the default.
    Veno,
    /// Keeps its rate whatever is lost.
    Bbr,
}

/// Where HTTP is answered; None: nowhere.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub struct HttpAt(pub Option<SocketAddr>);

impl From<SocketAddr> for HttpAt {
    fn from(address: SocketAddr) -> Self {
        Self(Some(address))
    }
}

impl TryFrom<String> for HttpAt {
    type Error = String;
    fn try_from(text: String) -> Result<Self, String> {
        if text == "off" {
            return Ok(Self(None));
        }
        let wrong = |e| format!("{e}; an address and a port are needed, as 127.0.0.1:8080, or off");
        text.parse().map(|address| Self(Some(address))).map_err(wrong)
    }
}

impl Default for ServeConfig {
    fn default() -> Self {
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], ldi_protocol::wire::DEFAULT_PORT)),
            http: SocketAddr::from(([127, 0, 0, 1], 8080)).into(),
            http_names: Vec::new(),
            token_file: None,
            identity: None,
            certificate: None,
            key: None,
            max_connections: 2_000,
            max_connections_per_address: 1_000,
            bytes_per_second_per_address: 0.0,
            messages_per_second: 500.0,
            send_window: 4 << 20,
            ahead_worth: 2_500_000,
            congestion: Congestion::Veno,
            show_walkers: true,
        }
    }
}

/// A settings or token file that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("{path}: {source}; check that the file exists and may be read")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The file is no TOML of ours.
    #[error("{path}: {reason}")]
    Parse {
        /// The file.
        path: PathBuf,
        /// Line, column and what is wrong.
        reason: String,
    },
    /// A value that cannot work.
    #[error("{field}: {reason}")]
    Value {
        /// The setting.
        field: &'static str,
        /// What is wrong with it, and what would work.
        reason: String,
    },
}

/// Longest settings or token file.
const MAX_FILE_BYTES: u64 = 64 * 1024;

impl ServeConfig {
    /// Reads a TOML file; what it leaves out keeps its default.
    ///
    /// # Errors
    /// An unreadable file, unknown names, values of the wrong type.
    pub fn from_file(path: &Path) -> Result<Self, ConfigError> {
        let text = read_small(path)?;
        toml::from_str(&text).map_err(|e| ConfigError::Parse { path: path.into(), reason: e.to_string() })
    }

    /// Checks what types cannot.
    ///
    /// # Errors
    /// The first setting that cannot work.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let value = |field, reason: &str| Err(ConfigError::Value { field, reason: reason.into() });
        if self.max_connections == 0 || self.max_connections_per_address == 0 {
            return value("max_connections", "0 lets nobody in; use 1 or more");
        }
        if self.certificate.is_some() != self.key.is_some() {
            return value("certificate", "a certificate and its key are given together");
        }
        if self.messages_per_second.is_nan() || self.messages_per_second < 1.0 {
            return value("messages_per_second", "must be at least 1");
        }
        let per_address = self.bytes_per_second_per_address;
        if per_address.is_nan() || (per_address != 0.0 && per_address < 10_000.0) {
            return value("bytes_per_second_per_address", "below 10000 nothing is seen for minutes; 0 is no limit");
        }
        if self.send_window < 256 << 10 {
            return value("send_window", "below 262144 bytes the sending stalls");
        }
        Ok(())
    }

    /// The token of [`ServeConfig::token_file`].
    ///
    /// # Errors
    /// An unreadable or empty file, or a token longer than a message may carry.
    pub fn token(&self) -> Result<Option<String>, ConfigError> {
        let Some(path) = &self.token_file else { return Ok(None) };
        warn_if_open_to_all(path);
        let token = read_small(path)?.trim().to_owned();
        if token.is_empty() || token.len() > ldi_protocol::wire::MAX_TEXT {
            let reason = format!("a token has 1 to {} bytes, this one {}", ldi_protocol::wire::MAX_TEXT, token.len());
            return Err(ConfigError::Parse { path: path.clone(), reason });
        }
        Ok(Some(token))
    }
}

/// Warns of a secret that everybody on this machine can read.
fn warn_if_open_to_all(path: &Path) {
    #[cfg(unix)]
    if let Ok(about) = std::fs::metadata(path)
        && std::os::unix::fs::PermissionsExt::mode(&about.permissions()) & 0o007 != 0
    {
        let path = path.display();
        tracing::warn!("{path}: everybody on this machine may read the token; run `chmod 600 {path}`");
    }
    #[cfg(not(unix))]
    let _ = path;
}

fn read_small(path: &Path) -> Result<String, ConfigError> {
    use std::io::Read;
    let read = |source| ConfigError::Read { path: path.into(), source };
    let mut text = String::new();
    let file = std::fs::File::open(path).map_err(read)?;
    file.take(MAX_FILE_BYTES + 1).read_to_string(&mut text).map_err(read)?;
    if text.len() as u64 > MAX_FILE_BYTES {
        let reason = format!("longer than {MAX_FILE_BYTES} bytes");
        return Err(ConfigError::Parse { path: path.into(), reason });
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_sets_what_it_names_and_refuses_what_it_does_not_know() {
        let c: ServeConfig = toml::from_str("listen = '0.0.0.0:0'\ncongestion = 'bbr'").unwrap();
        assert_eq!(c.listen.port(), 0);
        assert_eq!(c.congestion, Congestion::Bbr);
        for (name, expected) in
            [("cubic", Congestion::Cubic), ("newreno", Congestion::NewReno), ("veno", Congestion::Veno)]
        {
            let c: ServeConfig = toml::from_str(&format!("congestion = '{name}'")).unwrap();
            assert_eq!(c.congestion, expected);
        }
        assert_eq!(c.http, ServeConfig::default().http);
        let http = |text: &str| toml::from_str::<ServeConfig>(text).map(|c| c.http);
        assert_eq!(http("http = 'off'").unwrap(), HttpAt(None));
        assert_eq!(http("http = '[::1]:80'").unwrap(), HttpAt(Some("[::1]:80".parse().unwrap())));
        assert!(http("http = 'on'").unwrap_err().to_string().contains("or off"));
        assert!(toml::from_str::<ServeConfig>("listne = '0.0.0.0:0'").is_err());
    }

    #[test]
    fn settings_that_cannot_work_are_refused() {
        assert!(ServeConfig::default().validate().is_ok());
        for c in [
            ServeConfig { max_connections: 0, ..Default::default() },
            ServeConfig { messages_per_second: f64::NAN, ..Default::default() },
            ServeConfig { bytes_per_second_per_address: -1.0, ..Default::default() },
            ServeConfig { send_window: 1, ..Default::default() },
            ServeConfig { key: Some("key.pem".into()), ..Default::default() },
        ] {
            assert!(c.validate().is_err(), "{c:?}");
        }
    }
}
