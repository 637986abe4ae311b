//! The control stream: frames in and out, the first message, refusals.

use super::{
    limits::{Allowance, TokenBucket},
    offer::{Offer, Offers},
};
use ldi_protocol::wire::{self, ClientMessage, Hello, Message, RefusalCode, ServerMessage, WireError};
use quinn::{RecvStream, SendStream};
use std::{
    sync::Arc,
    time::{Duration, Instant},
};
use tokio::{
    sync::mpsc,
    time::{sleep_until, timeout},
};

/// Time for a refused client to read why.
const LAST_WORDS: Duration = Duration::from_secs(1);

/// Why a session ended, when it was not the client's wish.
#[derive(Debug, thiserror::Error)]
pub(super) enum SessionError {
    #[error("the connection ended: {0}")]
    Connection(#[from] quinn::ConnectionError),
    #[error("refused ({code:?}): {message}")]
    Refused { code: RefusalCode, message: String },
    #[error("the client was silent for too long")]
    Silent,
    #[error("the control stream ended: {0}")]
    Control(String),
    #[error("page {0} of the manifest cannot be read; tell whoever runs the server")]
    Page(u32),
}

impl From<WireError> for SessionError {
    fn from(e: WireError) -> Self {
        Self::Refused { code: RefusalCode::Protocol, message: e.to_string() }
    }
}

/// Checks version and token, and finds the dataset.
pub(super) fn admit(offers: &Offers, first: ClientMessage) -> Result<(Hello, Arc<Offer>), SessionError> {
    let refused = |code, message: String| Err(SessionError::Refused { code, message });
    let ClientMessage::Hello(hello) = first else {
        return refused(RefusalCode::Protocol, "the first message must be Hello".into());
    };
    if hello.version != wire::VERSION {
        let message = format!(
            "the server speaks version {}, the client {}; install the same release on both",
            wire::VERSION,
            hello.version
        );
        return refused(RefusalCode::Version, message);
    }
    if !offers.admits(hello.token.as_ref().map(String::as_bytes)) {
        return refused(RefusalCode::Token, "wrong or missing token; pass the server's with --token-file".into());
    }
    match offers.of(hello.dataset.as_deref()) {
        Ok(offer) => Ok((hello, offer)),
        Err(e) => refused(RefusalCode::Dataset, e.to_string()),
    }
}

/// Says why, and gives the client a moment to read it.
pub(super) async fn refuse(send: &mut SendStream, code: RefusalCode, message: &str) {
    let message = ServerMessage::Refused { code, message: message.chars().take(wire::MAX_TEXT / 4).collect() };
    if let Ok(frame) = wire::encode(&message)
        && send.write_all(&frame).await.is_ok()
        && send.finish().is_ok()
    {
        let _ = timeout(LAST_WORDS, send.stopped()).await;
    }
}

/// Sends one message.
pub(super) async fn tell(send: &mut SendStream, message: &ServerMessage) -> Result<(), SessionError> {
    let frame = wire::encode(message)?;
    send.write_all(&frame).await.map_err(|e| SessionError::Control(e.to_string()))
}

/// Reads one frame and decodes it.
pub(super) async fn read_message<M: Message>(recv: &mut RecvStream) -> Result<M, SessionReadError> {
    let ended = |e: quinn::ReadExactError| SessionReadError::Ended(e.to_string());
    let mut prefix = [0; 4];
    recv.read_exact(&mut prefix).await.map_err(ended)?;
    let length = wire::frame_length(prefix, M::LIMIT)?;
    let mut body = vec![0; length];
    recv.read_exact(&mut body).await.map_err(ended)?;
    Ok(wire::decode(&body)?)
}

/// Why no message could be read.
#[derive(Debug, thiserror::Error)]
pub(super) enum SessionReadError {
    #[error("{0}")]
    Ended(String),
    #[error(transparent)]
    Wire(#[from] WireError),
}

impl From<SessionReadError> for SessionError {
    fn from(e: SessionReadError) -> Self {
        match e {
            SessionReadError::Ended(reason) => Self::Control(reason),
            SessionReadError::Wire(e) => e.into(),
        }
    }
}

/// Numbers of chunks that one client may list per second; who lists more is read no faster.
const LISTED_PER_SECOND: f64 = 20_000.0;
/// Time over which these may come at once: a client that comes again lists all that it holds,
/// twice, if it begins early.
const LISTS_BURST: Duration = Duration::from_secs(100);

/// Reads until the stream ends, breaks the protocol, or comes too fast.
pub(super) async fn read_all(mut recv: RecvStream, out: mpsc::Sender<Result<ClientMessage, SessionError>>, rate: f64) {
    let started = Instant::now();
    let mut bucket = TokenBucket::new(rate, 4.0 * rate);
    let lists = Allowance::new(LISTED_PER_SECOND, LISTS_BURST);
    loop {
        let mut message = read_message(&mut recv).await.map_err(SessionError::from);
        if message.is_ok() && !bucket.take(started.elapsed()) {
            let text = format!("more than {rate} messages per second");
            message = Err(SessionError::Refused { code: RefusalCode::Rate, message: text });
        }
        let listed = message.as_ref().map_or(0, ClientMessage::listed);
        sleep_until((started + lists.take(started.elapsed(), listed)).into()).await;
        let last = message.is_err();
        if out.send(message).await.is_err() || last {
            return;
        }
    }
}
