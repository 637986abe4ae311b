//! Starts and stops a server: endpoint, accept loop, HTTP.

use super::{
    addresses::addresses_to_type,
    admission::{Admission, Peer},
    config::ServeConfig,
    error::ServeError,
    http,
    identity::Identity,
    limits::Allowance,
    offer::{NamedSources, Offers},
    requests::{ANSWERED_PER_SECOND, ANSWERS_BURST},
    session::{self, ACCESS, Entrance, Shared},
    transport,
};
use ldi_protocol::{index::ChunkHash, wire::MAX_ROOT_BYTES};
use quinn::{Endpoint, VarInt};
use std::{
    io::Write,
    net::SocketAddr,
    sync::{Arc, RwLock},
    time::{Duration, Instant, SystemTime},
};
use tokio::{sync::watch, task::JoinHandle};

/// Time for clients to hear that the server stops.
const GOODBYE: Duration = Duration::from_secs(2);

/// All that a server needs before it opens a socket.
struct Prepared {
    offers: Offers,
    settings: quinn::ServerConfig,
    fingerprint: String,
}

impl Prepared {
    fn new(datasets: NamedSources, config: &ServeConfig) -> Result<Self, ServeError> {
        config.validate()?;
        let token = config.token()?;
        for (name, dataset) in &datasets {
            let bytes = dataset.root().len();
            if bytes > MAX_ROOT_BYTES {
                return Err(ServeError::RootTooLong { name: name.clone(), bytes, limit: MAX_ROOT_BYTES });
            }
        }
        let identity = match (&config.certificate, &config.key) {
            (Some(certificate), Some(key)) => Identity::from_files(certificate, key)?,
            _ => Identity::open(config.identity.as_deref())?,
        };
        identity.warn_of_its_end(SystemTime::now());
        let settings = transport::settings(config, &identity)?;
        let offers = Offers::new(datasets, token.as_deref(), identity.next);
        Ok(Self { offers, settings, fingerprint: identity.fingerprint() })
    }
}

/// Checks everything that a start would, but for the addresses. Returns the certificate's
/// fingerprint.
///
/// # Errors
/// As [`Server::start`].
pub fn check(datasets: NamedSources, config: &ServeConfig) -> Result<String, ServeError> {
    Ok(Prepared::new(datasets, config)?.fingerprint)
}

/// A running server. Dropping it without [`Server::shutdown`] stops it without a goodbye.
#[derive(Debug)]
pub struct Server {
    quic: SocketAddr,
    http: Option<SocketAddr>,
    fingerprint: String,
    endpoint: Endpoint,
    shared: Arc<Shared>,
    stop: watch::Sender<bool>,
    accepting: JoinHandle<()>,
    answering: Option<JoinHandle<()>>,
}

impl Server {
    /// Opens both sockets and begins to accept. Call within a tokio runtime.
    ///
    /// # Errors
    /// Settings, identity or addresses that cannot be used, or a manifest root longer than the
    /// protocol allows.
    pub async fn start(datasets: NamedSources, config: &ServeConfig) -> Result<Self, ServeError> {
        let Prepared { offers, settings, fingerprint } = Prepared::new(datasets, config)?;
        let (stop, stopping) = watch::channel(false);
        let shared = Arc::new(Shared {
            offers: RwLock::new(Arc::new(offers)),
            reloads: watch::Sender::new(()),
            walkers: Arc::default(),
            admission: Admission::new(
                config.max_connections,
                config.max_connections_per_address,
                config.bytes_per_second_per_address,
            ),
            epoch: Instant::now(),
            answers: Allowance::new(ANSWERED_PER_SECOND, ANSWERS_BURST),
            send_window: config.send_window,
            ahead_worth: config.ahead_worth,
            messages_per_second: config.messages_per_second,
            show_walkers: config.show_walkers,
            stop: stopping.clone(),
        });
        // HTTP first: when QUIC cannot be bound nothing has been accepted yet.
        let listener = match config.http.0 {
            Some(address) => {
                let bind = |source| ServeError::Bind { what: "HTTP", address, source };
                let listener = tokio::net::TcpListener::bind(address).await.map_err(bind)?;
                Some((listener.local_addr().map_err(bind)?, listener))
            }
            None => None,
        };
        let http = listener.as_ref().map(|(address, _)| *address);
        let (endpoint, quic) = transport::open(config, settings)?;
        let answering = listener.map(|(_, listener)| {
            let (shared, names) = (shared.clone(), config.http_names.clone());
            tokio::spawn(http::answer(listener, (shared, quic), names, stopping))
        });
        let accepting = tokio::spawn(accept(endpoint.clone(), shared.clone()));
        Ok(Self { quic, http, fingerprint, endpoint, shared, stop, accepting, answering })
    }

    /// Offers newcomers these datasets, and the token and certificate as they lie on disk now.
    /// Walkers inside keep theirs.
    ///
    /// # Errors
    /// As [`Server::start`]; then everything stays as it was.
    pub fn reload(&mut self, datasets: NamedSources, config: &ServeConfig) -> Result<(), ServeError> {
        let Prepared { offers, settings, fingerprint } = Prepared::new(datasets, config)?;
        self.endpoint.set_server_config(Some(settings));
        self.shared.set_offers(offers);
        self.fingerprint = fingerprint;
        Ok(())
    }

    /// UDP address of QUIC.
    pub fn quic(&self) -> SocketAddr {
        self.quic
    }
    /// TCP address of HTTP; None when it is off.
    pub fn http(&self) -> Option<SocketAddr> {
        self.http
    }
    /// BLAKE3 of the certificate, 64 hexadecimal digits.
    pub fn fingerprint(&self) -> &str {
        &self.fingerprint
    }
    /// Names and hashes of the datasets that newcomers are offered.
    pub fn datasets(&self) -> Vec<(String, ChunkHash)> {
        self.shared.offers().all().map(|offer| (offer.name.clone(), offer.served.hash())).collect()
    }

    /// Logs what is served, and how to walk in it.
    fn log(&self, what: &str) {
        let datasets = self.datasets();
        for (name, hash) in &datasets {
            let fingerprint = self.fingerprint();
            tracing::info!(target: ACCESS, name = name.as_str(), dataset = %hash, %fingerprint, "{what}");
            let name = if datasets.len() == 1 { String::new() } else { format!("/{name}") };
            for address in addresses_to_type(self.quic) {
                tracing::info!(target: ACCESS, "walk in it with: ldi-client connect {address}{name}");
            }
        }
    }

    /// Tells every client, then closes; takes at most a few seconds.
    pub async fn shutdown(self) {
        let _ = self.stop.send(true);
        self.accepting.abort();
        self.endpoint.close(VarInt::from_u32(ldi_protocol::wire::code::SHUTDOWN), b"the server stops");
        let _ = tokio::time::timeout(GOODBYE, self.endpoint.wait_idle()).await;
        if let Some(answering) = self.answering {
            let _ = tokio::time::timeout(GOODBYE, answering).await;
        }
    }
}

async fn accept(endpoint: Endpoint, shared: Arc<Shared>) {
    while let Some(incoming) = endpoint.accept().await {
        let address = incoming.remote_address();
        let (peer, now) = (Peer::from(address.ip()), shared.epoch.elapsed());
        let entrance = if incoming.remote_address_validated() {
            match shared.admission.candidate(peer, now) {
                Ok(candidate) => Entrance::Proven(candidate),
                Err(refusal) => {
                    metrics::counter!("ldi_refused_total").increment(1);
                    if refusal.said {
                        tracing::info!(target: ACCESS, %address, reason = %refusal.closed, "not let in");
                        incoming.refuse();
                    } else {
                        incoming.ignore();
                    }
                    continue;
                }
            }
        } else if let Some(permit) = shared.admission.unproven(peer, now) {
            Entrance::Unproven(permit)
        } else {
            // Costs the client a round trip, and the server no memory.
            let _ = incoming.retry();
            continue;
        };
        tokio::spawn(session::run(shared.clone(), incoming, entrance));
    }
}

/// The datasets that are served, as they lie on disk.
pub trait Datasets: Send + Sync + 'static {
    /// Opens them: for each reload, and when they changed.
    ///
    /// # Errors
    /// None can be opened, in words.
    fn open(&self) -> Result<NamedSources, String>;
    /// A value that changes when a dataset was replaced, came or went; cheap.
    fn stamp(&self) -> u64;
}

/// How often datasets are looked at for changes.
const CHANGES_EVERY: Duration = Duration::from_secs(2);

/// Serves what was opened, with its stamp, until SIGINT or SIGTERM; SIGHUP reloads datasets, token
/// and certificate, and so does a change of the datasets. Prints `listening quic=ADDR http=ADDR
/// fingerprint=HEX` to standard output when ready, and calls `page` with the address of the page
/// and those that others type.
///
/// # Errors
/// As [`Server::start`].
pub async fn serve(
    datasets: Arc<dyn Datasets>,
    (mut served, opened): (u64, NamedSources),
    config: ServeConfig,
    page: &(dyn Fn(SocketAddr, &[SocketAddr]) + Sync),
) -> Result<(), ServeError> {
    // Before the ready line: whoever reads it may send a signal at once.
    let asked_to_stop = stop_signal();
    let mut hangup = Hangup::new();
    let mut server = Server::start(opened, &config).await?;
    let http = server.http().map_or("off".into(), |a| a.to_string());
    let (quic, fingerprint) = (server.quic(), server.fingerprint());
    let line = format!("listening quic={quic} http={http} fingerprint={fingerprint}\n");
    print_at_once(&line).map_err(ServeError::Stdout)?;
    server.log("serving");
    if let Some(http) = server.http() {
        page(http, &addresses_to_type(http));
    }
    let mut asked_to_stop = std::pin::pin!(asked_to_stop);
    let mut changes = tokio::time::interval(CHANGES_EVERY);
    changes.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    // While a dataset is written it changes again and again.
    let mut changing = served;
    loop {
        tokio::select! {
            () = &mut asked_to_stop => break,
            () = hangup.next() => {}
            _ = changes.tick() => {
                let now = datasets.stamp();
                let is_settled = now == std::mem::replace(&mut changing, now);
                if now == served || !is_settled {
                    continue;
                }
            }
        }
        served = datasets.stamp();
        let opening = datasets.clone();
        let opened = tokio::task::spawn_blocking(move || opening.open()).await;
        let opened = opened.unwrap_or_else(|e| Err(e.to_string())).map_err(ServeError::Dataset);
        match opened.and_then(|datasets| server.reload(datasets, &config)) {
            Ok(()) => server.log("reloaded"),
            Err(e) => tracing::error!("not reloaded, everything stays as it was: {e}"),
        }
    }
    tracing::info!(target: ACCESS, "stopping");
    server.shutdown().await;
    Ok(())
}

fn print_at_once(line: &str) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    out.write_all(line.as_bytes())?;
    out.flush()
}

/// SIGHUPs; there are none where the system has no such signal.
struct Hangup {
    #[cfg(unix)]
    signals: Option<tokio::signal::unix::Signal>,
}

impl Hangup {
    #[cfg(unix)]
    fn new() -> Self {
        Self { signals: tokio::signal::unix::signal(tokio::signal::unix::SignalKind::hangup()).ok() }
    }
    #[cfg(not(unix))]
    fn new() -> Self {
        Self {}
    }

    async fn next(&mut self) {
        #[cfg(unix)]
        if let Some(signals) = &mut self.signals
            && signals.recv().await.is_some()
        {
            return;
        }
        std::future::pending().await
    }
}

/// Completes on SIGINT or SIGTERM; listens from the moment it is called.
fn stop_signal() -> impl Future<Output = ()> {
    #[cfg(unix)]
    let terminate = tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate());
    #[cfg(unix)]
    let interrupt = tokio::signal::unix::signal(tokio::signal::unix::SignalKind::interrupt());
    async move {
        #[cfg(unix)]
        if let (Ok(mut terminate), Ok(mut interrupt)) = (terminate, interrupt) {
            tokio::select! {
                _ = terminate.recv() => {}
                _ = interrupt.recv() => {}
            }
            return;
        }
        let _ = tokio::signal::ctrl_c().await;
    }
}
