//! Health, metrics and the page. Self-contained: nothing is loaded from elsewhere.

use super::{plan, session::Shared};
use axum::{
    Json, Router,
    extract::State,
    http::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE},
    response::{Html, IntoResponse},
    routing::get,
};
use bytes::Bytes;
use metrics_exporter_prometheus::{Matcher, PrometheusBuilder, PrometheusHandle};
use std::{
    sync::{Arc, OnceLock},
    time::Duration,
};
use tokio::{net::TcpListener, sync::watch};

const PAGE: &str = include_str!("page.html");
/// How often the recorder folds what it has gathered, so that it stays small while nobody asks.
const UPKEEP: Duration = Duration::from_secs(5);
/// Borders of the planning time's histogram, seconds.
const PLAN_BUCKETS: [f64; 8] = [0.000_01, 0.000_03, 0.000_1, 0.000_3, 0.001, 0.003, 0.01, 0.03];

struct Site {
    shared: Arc<Shared>,
    plan: OnceLock<Bytes>,
    metrics: Option<PrometheusHandle>,
}

/// The recorder is one per process; servers started in the same process share it. None when another one is installed.
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

/// Says what is counted, and that it is 0 so far: who watches a server wants to see it before the first walker comes.
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

/// Answers until `stop` turns true.
pub(super) async fn answer(listener: TcpListener, shared: Arc<Shared>, mut stop: watch::Receiver<bool>) {
    let site = Arc::new(Site { shared, plan: OnceLock::new(), metrics: recorder() });
    let upkeep = site.metrics.clone().map(|m| {
        tokio::spawn(async move {
            loop {
                tokio::time::sleep(UPKEEP).await;
                m.run_upkeep();
            }
        })
    });
    let router = Router::new()
        .route("/", get(page))
        .route("/plan.json", get(plan_json))
        .route("/walkers.json", get(walkers))
        .route("/healthz", get(|| async { "ok\n" }))
        .route("/readyz", get(|| async { "ready\n" }))
        .route("/metrics", get(metrics_text))
        .with_state(site);
    let stopped = async move {
        let _ = stop.wait_for(|s| *s).await;
    };
    if let Err(e) = axum::serve(listener, router).with_graceful_shutdown(stopped).await {
        tracing::error!("HTTP ended: {e}");
    }
    if let Some(task) = upkeep {
        task.abort();
    }
}

async fn page() -> impl IntoResponse {
    let policy = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; connect-src 'self'";
    ([(CONTENT_SECURITY_POLICY, policy)], Html(PAGE))
}

async fn plan_json(State(site): State<Arc<Site>>) -> impl IntoResponse {
    let bytes = match site.plan.get() {
        Some(b) => b.clone(),
        None => {
            let from = site.clone();
            // Large scenes have thousands of placements: not on a thread that serves walkers.
            let made = tokio::task::spawn_blocking(move || {
                from.plan.get_or_init(|| plan::to_json(&from.shared.served).into()).clone()
            });
            made.await.unwrap_or_default()
        }
    };
    ([(CONTENT_TYPE, "application/json")], bytes)
}

async fn walkers(State(site): State<Arc<Site>>) -> impl IntoResponse {
    ([(CACHE_CONTROL, "no-store")], Json(site.shared.walkers.views()))
}

async fn metrics_text(State(site): State<Arc<Site>>) -> impl IntoResponse {
    let text = site.metrics.as_ref().map(PrometheusHandle::render).unwrap_or_default();
    ([(CONTENT_TYPE, "text/plain; version=0.0.4")], text)
}
