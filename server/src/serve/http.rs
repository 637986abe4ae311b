//! Health, metrics and the page. Self-contained: nothing is loaded from elsewhere.
//!
//! Browsers visit other pages too, and strangers reach the port where it is open to a network. So
//! requests without a name of this server are not answered (DNS rebinding), no page may frame or
//! read this one, the token is asked for where walking asks for it, requests carry no bodies, and
//! every connection has a time to live and a place to take.

use super::{
    addresses::addresses_to_type,
    admission::Peer,
    offer::{Offer, Offers},
    session::{ACCESS, Shared, stopped},
};
use axum::{
    Extension, Json, Router,
    extract::{Path, Request, State},
    http::{
        HeaderMap, HeaderValue, StatusCode,
        header::{self, CACHE_CONTROL, CONTENT_TYPE},
        uri::{Authority, Uri},
    },
    middleware::{self, Next},
    response::{Html, IntoResponse, Redirect, Response},
    routing::get,
};
use base64::Engine as _;
use hyper::server::conn::http1;
use hyper_util::{
    rt::{TokioIo, TokioTimer},
    service::TowerToHyperService,
};
use metrics_exporter_prometheus::{Matcher, PrometheusBuilder, PrometheusHandle};
use std::{
    collections::HashMap,
    net::{IpAddr, SocketAddr},
    sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError},
    time::Duration,
};
use tokio::{
    net::{TcpListener, TcpStream},
    sync::watch,
    task::JoinSet,
    time::{sleep, timeout},
};

/// The page of a dataset.
const PAGE: &str = include_str!("page.html");
/// The page that lists several.
const DATASETS_PAGE: &str = include_str!("datasets.html");
/// How often the recorder folds what it has gathered, so that it stays small while nobody asks.
const UPKEEP: Duration = Duration::from_secs(5);
/// Borders of the planning time's histogram, seconds.
const PLAN_BUCKETS: [f64; 8] = [0.000_01, 0.000_03, 0.000_1, 0.000_3, 0.001, 0.003, 0.01, 0.03];

/// Time for the head of a request, and between two requests. Longer: idle connections hold places
/// for longer; shorter: the page, which asks twice a second, connects anew.
const HEAD: Duration = Duration::from_secs(5);
/// Time to answer. Longer than a large scene's plan takes to make.
const ANSWER: Duration = Duration::from_secs(60);
/// Time after which a connection takes no more requests, and after that for its last answer.
const LIFE: Duration = Duration::from_secs(60);
/// Connections at a time, and those of one peer. More: slow peers hold more memory; fewer: people
/// behind one address wait for each other.
const CONNECTIONS: usize = 128;
const CONNECTIONS_OF_PEER: usize = 32;
/// A wrong token is answered after this time, so that guessing is slow.
const WRONG_TOKEN_DELAY: Duration = Duration::from_millis(300);
/// After an error of the listener, as when no descriptors are left.
const PAUSE: Duration = Duration::from_millis(100);

/// Sent with every answer.
const HEADERS: [(header::HeaderName, &str); 5] = [
    (
        header::CONTENT_SECURITY_POLICY,
        "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; connect-src 'self'; img-src data:; \
         base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::X_FRAME_OPTIONS, "DENY"),
    (header::REFERRER_POLICY, "no-referrer"),
    (header::HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
];

struct Site {
    shared: Arc<Shared>,
    /// Where QUIC listens.
    quic: SocketAddr,
    names: Vec<String>,
    metrics: Option<PrometheusHandle>,
}

/// The recorder is one per process; servers started in the same process share it. None when
/// another one is installed.
fn recorder() -> Option<PrometheusHandle> {
    static HANDLE: OnceLock<Option<PrometheusHandle>> = OnceLock::new();
    HANDLE
        .get_or_init(|| {
            let buckets = Matcher::Full("ldi_plan_seconds".into());
            let builder = PrometheusBuilder::new().set_buckets_for_metric(buckets, &PLAN_BUCKETS).ok()?;
            let recorder = builder.build_recorder();
            let handle = recorder.handle();
            metrics::set_global_recorder(recorder).ok()?;
            describe();
            Some(handle)
        })
        .clone()
}

/// Says what is counted, and that it is 0 so far: who watches a server wants to see it before the
/// first walker comes.
fn describe() {
    use metrics::{counter, describe_counter, describe_gauge, describe_histogram, gauge};
    describe_gauge!("ldi_walkers", "Connected walkers");
    gauge!("ldi_walkers").increment(0.0);
    for (name, what) in [
        ("ldi_connections_total", "Connections accepted"),
        ("ldi_refused_total", "Connections refused, for any reason"),
        ("ldi_chunks_total", "Chunks sent"),
        ("ldi_chunk_bytes_total", "Bytes of chunks and pages sent, without QUIC's own"),
        ("ldi_stale_streams_total", "Streams given up because the walker moved on"),
        ("ldi_requests_total", "Requests by number or name answered"),
        ("ldi_bad_requests_total", "Requests for nothing that exists"),
        ("ldi_bad_datagrams_total", "Datagrams that were no pose"),
    ] {
        describe_counter!(name, what);
        counter!(name).increment(0);
    }
    describe_histogram!("ldi_plan_seconds", "Time to decide what to send next");
}

/// Answers until `stop` turns true. `quic`: where QUIC listens; `names`: those of the server,
/// beside `localhost` and addresses.
pub(super) async fn answer(
    listener: TcpListener,
    (shared, quic): (Arc<Shared>, SocketAddr),
    names: Vec<String>,
    mut stop: watch::Receiver<bool>,
) {
    let site = Arc::new(Site { shared, quic, names, metrics: recorder() });
    let upkeep = site.metrics.clone().map(|m| {
        tokio::spawn(async move {
            loop {
                sleep(UPKEEP).await;
                m.run_upkeep();
            }
        })
    });
    let router = Router::new()
        .route("/", get(front_page))
        .route("/datasets.json", get(datasets))
        .route("/plan.json", get(only_plan))
        .route("/walkers.json", get(walkers))
        .route("/connect.json", get(connect))
        .route("/{dataset}", get(to_dataset_page))
        .route("/{dataset}/", get(dataset_page))
        .route("/{dataset}/plan.json", get(plan_of))
        .route("/{dataset}/walkers.json", get(walkers_of))
        .route("/{dataset}/connect.json", get(connect_of))
        .route("/healthz", get(|| async { "ok\n" }))
        .route("/readyz", get(ready))
        .route("/metrics", get(metrics_text))
        .layer(middleware::from_fn_with_state(site.clone(), guard))
        .with_state(site);
    let places = Arc::new(Places::default());
    let mut connections = JoinSet::new();
    loop {
        tokio::select! {
            accepted = listener.accept() => match accepted {
                Ok((stream, from)) => {
                    // Closed unanswered when there is no place.
                    if let Some(place) = Places::take(&places, from.ip()) {
                        connections.spawn(converse(stream, router.clone().layer(Extension(from)), place, stop.clone()));
                    }
                }
                Err(e) => {
                    tracing::debug!("HTTP: {e}");
                    sleep(PAUSE).await;
                }
            },
            Some(_) = connections.join_next() => {}
            () = stopped(&mut stop) => break,
        }
    }
    drop(listener);
    while connections.join_next().await.is_some() {}
    if let Some(task) = upkeep {
        task.abort();
    }
}

/// One connection, until it ends, is idle, or has lived long enough.
async fn converse(stream: TcpStream, router: Router, _place: Place, mut stop: watch::Receiver<bool>) {
    let service = TowerToHyperService::new(router);
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(HEAD);
    let mut connection = std::pin::pin!(http.serve_connection(TokioIo::new(stream), service));
    tokio::select! {
        _ = connection.as_mut() => return,
        () = sleep(LIFE) => {}
        () = stopped(&mut stop) => {}
    }
    connection.as_mut().graceful_shutdown();
    let _ = timeout(LIFE, connection).await;
}

/// Open connections by peer.
#[derive(Debug, Default)]
struct Places(Mutex<HashMap<Peer, usize>>);

/// A connection's place; given back when dropped.
struct Place {
    places: Arc<Places>,
    peer: Peer,
}

impl Places {
    fn take(places: &Arc<Self>, address: IpAddr) -> Option<Place> {
        let peer = Peer::from(address);
        let mut taken = places.taken();
        let all: usize = taken.values().sum();
        let of_peer = taken.get(&peer).copied().unwrap_or(0);
        if all >= CONNECTIONS || of_peer >= CONNECTIONS_OF_PEER {
            return None;
        }
        taken.insert(peer, of_peer + 1);
        Some(Place { places: places.clone(), peer })
    }

    fn taken(&self) -> MutexGuard<'_, HashMap<Peer, usize>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut taken = self.places.taken();
        let left = taken.get(&self.peer).map_or(0, |n| n - 1);
        match left {
            0 => taken.remove(&self.peer),
            left => taken.insert(self.peer, left),
        };
    }
}

/// Answers only what may be answered, within its time, and adds [`HEADERS`].
async fn guard(
    State(site): State<Arc<Site>>,
    Extension(from): Extension<SocketAddr>,
    request: Request,
    next: Next,
) -> Response {
    let mut response = match refusal(&site, from, request.uri().path(), request.headers()).await {
        Some(refusal) => refusal,
        None => match timeout(ANSWER, next.run(request)).await {
            Ok(response) => response,
            Err(_) => (StatusCode::SERVICE_UNAVAILABLE, "took too long; ask again\n").into_response(),
        },
    };
    for (name, value) in HEADERS {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    response
}

async fn refusal(site: &Site, address: SocketAddr, path: &str, headers: &HeaderMap) -> Option<Response> {
    let has_body = headers.contains_key(header::TRANSFER_ENCODING)
        || headers.get(header::CONTENT_LENGTH).is_some_and(|length| length != "0");
    if has_body {
        let close = [(header::CONNECTION, "close")];
        return Some((StatusCode::PAYLOAD_TOO_LARGE, close, "requests have no body\n").into_response());
    }
    if !headers.get(header::HOST).is_none_or(|host| is_own_name(host, &site.names)) {
        let host = headers.get(header::HOST);
        tracing::info!(target: ACCESS, %address, ?host, "HTTP: not a name of this server");
        let text = "this server is not known by that name; add it to `http_names` in the --config file\n";
        return Some((StatusCode::MISDIRECTED_REQUEST, text).into_response());
    }
    let is_for_all = matches!(path, "/healthz" | "/readyz");
    if is_for_all || is_admitted(&site.shared.offers(), headers) {
        return None;
    }
    if headers.contains_key(header::AUTHORIZATION) {
        tracing::info!(target: ACCESS, %address, "HTTP: wrong token");
        sleep(WRONG_TOKEN_DELAY).await;
    }
    let ask = [(header::WWW_AUTHENTICATE, "Basic realm=\"ldi-server: any user, the token as password\"")];
    let text = "the server's token is needed, as the password of any user or as a bearer token\n";
    Some((StatusCode::UNAUTHORIZED, ask, text).into_response())
}

/// Whether a Host header names this server: an address, `localhost`, or one of `names`. A name of
/// somebody else that leads here comes from a page of theirs.
fn is_own_name(host: &HeaderValue, names: &[String]) -> bool {
    let Some(authority) = host.to_str().ok().and_then(|h| h.parse::<Authority>().ok()) else { return false };
    let name = authority.host().trim_start_matches('[').trim_end_matches(']');
    name.eq_ignore_ascii_case("localhost")
        || name.parse::<IpAddr>().is_ok()
        || names.iter().any(|n| n.eq_ignore_ascii_case(name))
}

/// Whether the token is shown: `Bearer TOKEN`, or `Basic` with any user and the token as password.
fn is_admitted(offers: &Offers, headers: &HeaderMap) -> bool {
    let shown = headers.get(header::AUTHORIZATION).and_then(|value| {
        let (scheme, value) = value.to_str().ok()?.split_once(' ')?;
        if scheme.eq_ignore_ascii_case("bearer") {
            return Some(value.trim().as_bytes().to_vec());
        }
        let pair = base64::engine::general_purpose::STANDARD.decode(value.trim()).ok()?;
        let colon = pair.iter().position(|b| *b == b':')?;
        scheme.eq_ignore_ascii_case("basic").then(|| pair[colon + 1..].to_vec())
    });
    offers.admits(shown.as_deref())
}

/// The datasets that newcomers get, and since when; of the only one, if it is, also beside the
/// list. Without names: no token is asked for.
async fn ready(State(site): State<Arc<Site>>) -> impl IntoResponse {
    let offers = site.shared.offers();
    let state = |offer: &Arc<Offer>| {
        let dataset = offer.served.hash().to_string();
        serde_json::json!({ "ready": offer.is_readable(), "dataset": dataset, "age_s": offer.age_s() })
    };
    let datasets: Vec<serde_json::Value> = offers.all().map(state).collect();
    let ready = datasets.iter().all(|d| d["ready"] == true);
    let status = if ready { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    let only = if let [only] = &datasets[..] { only.clone() } else { serde_json::json!({}) };
    let (dataset, age_s) = (&only["dataset"], &only["age_s"]);
    (status, Json(serde_json::json!({ "ready": ready, "dataset": dataset, "age_s": age_s, "datasets": datasets })))
}

/// The page of the only dataset, or the list.
async fn front_page(State(site): State<Arc<Site>>) -> Html<&'static str> {
    Html(if site.shared.offers().only().is_some() { PAGE } else { DATASETS_PAGE })
}

/// What the list shows.
async fn datasets(State(site): State<Arc<Site>>) -> impl IntoResponse {
    let of = |offer: &Arc<Offer>| {
        let index = offer.served.index();
        serde_json::json!({
            "name": offer.name,
            "triangles": index.scene.triangles,
            "bytes": index.chunks.iter().map(|c| u64::from(c.stored_bytes)).sum::<u64>(),
            "walkers": site.shared.walkers.views(Some(&offer.name)).len(),
            "port": site.quic.port(),
        })
    };
    let all: Vec<serde_json::Value> = site.shared.offers().all().map(of).collect();
    ([(CACHE_CONTROL, "no-store")], Json(all))
}

/// The dataset of a name, or an answer that says what there is.
fn offer_of(site: &Site, name: Option<&str>) -> Result<Arc<Offer>, (StatusCode, String)> {
    site.shared.offers().of(name).map_err(|e| (StatusCode::NOT_FOUND, format!("{e}\n")))
}

/// The page asks for files beside it, so its address ends with a slash.
async fn to_dataset_page(
    State(site): State<Arc<Site>>,
    Path(name): Path<String>,
    uri: Uri,
) -> Result<Redirect, (StatusCode, String)> {
    offer_of(&site, Some(&name)).map(|_| Redirect::permanent(&format!("{}/", uri.path())))
}

async fn dataset_page(
    State(site): State<Arc<Site>>,
    Path(name): Path<String>,
) -> Result<Html<&'static str>, (StatusCode, String)> {
    offer_of(&site, Some(&name)).map(|_| Html(PAGE))
}

async fn only_plan(State(site): State<Arc<Site>>) -> Result<Response, (StatusCode, String)> {
    Ok(plan(offer_of(&site, None)?).await)
}

async fn plan_of(State(site): State<Arc<Site>>, Path(name): Path<String>) -> Result<Response, (StatusCode, String)> {
    Ok(plan(offer_of(&site, Some(&name))?).await)
}

async fn plan(offer: Arc<Offer>) -> Response {
    // Large scenes have thousands of placements: not on a thread that serves walkers.
    let made = tokio::task::spawn_blocking(move || offer.plan()).await;
    ([(CONTENT_TYPE, "application/json")], made.unwrap_or_default()).into_response()
}

async fn walkers(State(site): State<Arc<Site>>) -> impl IntoResponse {
    ([(CACHE_CONTROL, "no-store")], Json(site.shared.walkers.views(None)))
}

async fn walkers_of(State(site): State<Arc<Site>>, Path(name): Path<String>) -> impl IntoResponse {
    ([(CACHE_CONTROL, "no-store")], Json(site.shared.walkers.views(Some(&name))))
}

async fn connect(State(site): State<Arc<Site>>) -> impl IntoResponse {
    Json(how_to_connect(&site, None))
}

async fn connect_of(
    State(site): State<Arc<Site>>,
    Path(name): Path<String>,
) -> Result<impl IntoResponse, (StatusCode, String)> {
    offer_of(&site, Some(&name)).map(|_| Json(how_to_connect(&site, Some(&name))))
}

/// What the page shows of how to walk in a dataset.
fn how_to_connect(site: &Site, name: Option<&str>) -> serde_json::Value {
    let offers = site.shared.offers();
    // The only dataset needs no name.
    let name = name.filter(|_| offers.only().is_none());
    let addresses = addresses_to_type(site.quic);
    let addresses: Vec<String> = addresses.iter().map(|a| a.ip().to_string()).collect();
    serde_json::json!({
        "addresses": addresses,
        "any_address": site.quic.ip().is_unspecified(),
        "port": site.quic.port(),
        "name": name,
        "token": offers.ask_for_token(),
    })
}

async fn metrics_text(State(site): State<Arc<Site>>) -> impl IntoResponse {
    let text = site.metrics.as_ref().map(PrometheusHandle::render).unwrap_or_default();
    ([(CONTENT_TYPE, "text/plain; version=0.0.4")], text)
}
