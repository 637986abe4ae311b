//! Starts and stops a server: endpoint, accept loop, HTTP.

use super::{
    config::ServeConfig,
    error::ServeError,
    http,
    identity::Identity,
    limits::{Allowance, Door},
    requests::{ANSWERED_PER_SECOND, ANSWERS_BURST},
    session::{self, Shared},
    source::{ChunkSource, Served},
    transport,
};
use ldi_protocol::wire::MAX_ROOT_BYTES;
use quinn::{Endpoint, VarInt};
use std::{
    io::Write,
    net::SocketAddr,
    sync::Arc,
    time::{Duration, Instant},
};
use tokio::{sync::watch, task::JoinHandle};

/// Time for clients to hear that the server stops.
const GOODBYE: Duration = Duration::from_secs(2);

/// A running server. Dropping it without [`Server::shutdown`] stops it without a goodbye.
#[derive(Debug)]
pub struct Server {
    quic: SocketAddr,
    http: SocketAddr,
    fingerprint: String,
    endpoint: Endpoint,
    stop: watch::Sender<bool>,
    accepting: JoinHandle<()>,
    answering: JoinHandle<()>,
}

impl Server {
    /// Opens both sockets and begins to accept. Call within a tokio runtime.
    ///
    /// # Errors
    /// Settings, identity or addresses that cannot be used, or a manifest root longer than the protocol allows.
    pub async fn start(dataset: Arc<dyn ChunkSource>, config: &ServeConfig) -> Result<Self, ServeError> {
        config.validate()?;
        let token = config.token()?.map(|t| blake3::hash(t.as_bytes()));
        let bytes = dataset.root().len();
        if bytes > MAX_ROOT_BYTES {
            return Err(ServeError::RootTooLong { bytes, limit: MAX_ROOT_BYTES });
        }
        let identity = Identity::open(config.identity.as_deref())?;
        let (stop, stopping) = watch::channel(false);
        let shared = Arc::new(Shared {
            served: Served::new(dataset),
            walkers: Arc::default(),
            token,
            door: Door::new(
                config.max_connections,
                config.max_connections_per_address,
                config.bytes_per_second_per_address,
            ),
            epoch: Instant::now(),
            answers: Allowance::new(ANSWERED_PER_SECOND, ANSWERS_BURST),
            max_connections: config.max_connections,
            send_window: config.send_window,
            ahead_worth: config.ahead_worth,
            messages_per_second: config.messages_per_second,
            show_walkers: config.show_walkers,
            stop: stopping.clone(),
        });
        // HTTP first: when QUIC cannot be bound nothing has been accepted yet.
        let bind = |source| ServeError::Bind { what: "HTTP", address: config.http, source };
        let listener = tokio::net::TcpListener::bind(config.http).await.map_err(bind)?;
        let http = listener.local_addr().map_err(bind)?;
        let (endpoint, quic) = transport::open(config, &identity)?;
        let answering = tokio::spawn(http::answer(listener, shared.clone(), stopping));
        let accepting = tokio::spawn(accept(endpoint.clone(), shared));
        Ok(Self { quic, http, fingerprint: identity.fingerprint(), endpoint, stop, accepting, answering })
    }

    /// UDP address of QUIC.
    pub fn quic(&self) -> SocketAddr {
        self.quic
    }
    /// TCP address of HTTP.
    pub fn http(&self) -> SocketAddr {
        self.http
    }
    /// BLAKE3 of the certificate, 64 hexadecimal digits.
    pub fn fingerprint(&self) -> &str {
        &self.fingerprint
    }

    /// Tells every client, then closes; takes at most a few seconds.
    pub async fn shutdown(self) {
        let _ = self.stop.send(true);
        self.accepting.abort();
        self.endpoint.close(VarInt::from_u32(ldi_protocol::wire::code::SHUTDOWN), b"the server stops");
        let _ = tokio::time::timeout(GOODBYE, self.endpoint.wait_idle()).await;
        let _ = tokio::time::timeout(GOODBYE, self.answering).await;
    }
}

async fn accept(endpoint: Endpoint, shared: Arc<Shared>) {
    while let Some(incoming) = endpoint.accept().await {
        let address = incoming.remote_address();
        let place = match shared.door.enter(address.ip().to_canonical(), shared.epoch.elapsed()) {
            Ok(place) => place,
            Err(refusal) => {
                metrics::counter!("ldi_refused_total").increment(1);
                if refusal.said {
                    tracing::warn!(%address, "refused: {}", refusal.closed);
                    incoming.refuse();
                } else {
                    incoming.ignore();
                }
                continue;
            }
        };
        // Getting full: who comes in must first prove that the address is theirs, which costs them a round trip.
        if 2 * shared.door.inside() > shared.max_connections && !incoming.remote_address_validated() {
            let _ = incoming.retry();
            continue;
        }
        tokio::spawn(session::run(shared.clone(), incoming, place));
    }
}

/// Serves until SIGINT or SIGTERM. Prints `listening quic=ADDR http=ADDR fingerprint=HEX` to standard output when ready.
///
/// # Errors
/// As [`Server::start`].
pub async fn serve(dataset: Arc<dyn ChunkSource>, config: ServeConfig) -> Result<(), ServeError> {
    // Before the ready line: whoever reads it may send a signal at once.
    let asked_to_stop = stop_signal();
    let server = Server::start(dataset, &config).await?;
    let line =
        format!("listening quic={} http={} fingerprint={}\n", server.quic(), server.http(), server.fingerprint());
    let mut out = std::io::stdout().lock();
    out.write_all(line.as_bytes()).and_then(|()| out.flush()).map_err(ServeError::Stdout)?;
    drop(out);
    asked_to_stop.await;
    tracing::info!("stopping");
    server.shutdown().await;
    Ok(())
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
