//! Requests by number or by name, each on its own stream: the fallback that always works, whatever
//! the planner thinks.

use super::{
    control::{SessionReadError, read_message},
    limits::{Allowance, TokenBucket},
    offer::Offer,
    push::Outlet,
    session::Shared,
};
use ldi_protocol::wire::{self, Answer, Request};
use quinn::{RecvStream, SendStream};
use std::{
    sync::Arc,
    time::{Duration, Instant},
};
use tokio::{
    sync::mpsc,
    task::JoinSet,
    time::{sleep_until, timeout},
};

/// Time for a client to say what it wants on a stream that it opened.
const PATIENCE: Duration = Duration::from_secs(10);
/// Bytes of answers per second to one client: who asks for everything must not take the line from
/// walkers, who are sent what they need and ask for nothing so.
const OWN_PER_SECOND: f64 = 2e6;
/// The same to all together.
pub(super) const ANSWERED_PER_SECOND: f64 = 20e6;
/// Time over which the bytes of either may come at once.
pub(super) const ANSWERS_BURST: Duration = Duration::from_millis(500);

/// Answers until the connection ends; tells the planner which chunks went out. How many are open
/// at once is limited by the transport; faster ones than the rate wait.
pub(super) async fn answer_all(
    shared: Arc<Shared>,
    offer: Arc<Offer>,
    outlet: Outlet,
    answered: mpsc::Sender<u32>,
    rate: f64,
) {
    let started = Instant::now();
    let mut bucket = TokenBucket::new(rate, 4.0 * rate);
    let own = Arc::new(Allowance::new(OWN_PER_SECOND, ANSWERS_BURST));
    let mut open = JoinSet::new();
    while let Ok((send, recv)) = outlet.connection.accept_bi().await {
        while !bucket.take(started.elapsed()) {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        while open.try_join_next().is_some() {}
        let (shared, offer) = (shared.clone(), offer.clone());
        let (outlet, answered, own) = (outlet.clone(), answered.clone(), own.clone());
        open.spawn(async move {
            if let Some(number) = answer(&shared, &offer, &outlet, &own, send, recv).await {
                let _ = answered.send(number).await;
            }
        });
    }
}

/// Answers one request. Returns the chunk that went out; whatever goes wrong ends this stream only.
async fn answer(
    shared: &Shared,
    offer: &Offer,
    outlet: &Outlet,
    own: &Allowance,
    mut send: SendStream,
    mut recv: RecvStream,
) -> Option<u32> {
    let request = match timeout(PATIENCE, read_message::<Request>(&mut recv)).await {
        Ok(Ok(request)) => request,
        Ok(Err(SessionReadError::Wire(e))) => return say(send, &e.to_string()).await,
        Ok(Err(SessionReadError::Ended(_))) | Err(_) => return say(send, "no request came").await,
    };
    let number = match request {
        Request::Number(n) => Some(n),
        Request::Name(name) => offer.served.number_of(&name),
    };
    let Some((number, bytes)) = number.and_then(|n| Some((n, offer.served.chunk(n)?))) else {
        return say(send, "there is no such chunk").await;
    };
    metrics::counter!("ldi_requests_total").increment(1);
    let head = wire::encode(&Answer::Chunk { number, bytes: bytes.len() as u32 }).ok()?;
    // One's own first: who asks for much waits there and keeps nothing of all from others.
    for allowance in [own, &shared.answers] {
        sleep_until((shared.epoch + allowance.take(shared.epoch.elapsed(), bytes.len())).into()).await;
    }
    outlet.turn().await;
    outlet.sent(bytes.len());
    send.write_all(&head).await.ok()?;
    send.write_chunk(bytes).await.ok()?;
    send.finish().ok()?;
    Some(number)
}

async fn say(mut send: SendStream, message: &str) -> Option<u32> {
    metrics::counter!("ldi_bad_requests_total").increment(1);
    let message = message.chars().take(wire::MAX_TEXT / 4).collect();
    let frame = wire::encode(&Answer::Error { message }).ok()?;
    send.write_all(&frame).await.ok()?;
    send.finish().ok()?;
    None
}
