//! One connection from its first to its last byte: who is it, what does it hold, what comes next.
//!
//! All state belongs to one task. Others only carry: one reads control frames, one answers
//! requests by number or name, one hands chunks to the transport. A client that sends garbage ends
//! its own connection and nobody else's.

use super::{
    admission::{Admission, Candidate, Peer, Place},
    control::{self, SessionError, admit, read_message, refuse, tell},
    limits::{Allowance, TokenBucket},
    meter::Metered,
    offer::{Offer, Offers},
    planner::{Capacity, Order, Planner, PlannerConfig, Turn},
    push::{Ended, Outlet, Task, carry, push_beside, push_through},
    requests,
    views::{Known, SelectViews},
    walkers::{Entry, Walkers},
};
use ldi_protocol::{
    index::ChunkHash,
    said::escaped,
    select::Show,
    wire::{
        self, ClientMessage, Hello, Other, PoseDatagram, RefusalCode, ServerMessage, StreamHeader, StreamKind, Urgency,
        Welcome, code,
    },
};
use quinn::{Connection, RecvStream, SendStream, VarInt};
use std::{
    collections::BTreeSet,
    sync::{Arc, PoisonError, RwLock},
    time::{Duration, Instant},
};
use tokio::{
    sync::{OwnedSemaphorePermit, mpsc, watch},
    task::JoinSet,
    time::{MissedTickBehavior, error::Elapsed, timeout, timeout_at},
};

/// Time for TLS and the first message together. Longer: whoever proves nothing stays longer;
/// shorter: slow links that lose packets do not get through.
const INTRODUCTION: Duration = Duration::from_secs(6);
/// Time for the manifest to reach the client: 256 kB of root and a few MB of pages on a slow link.
const WELCOME: Duration = Duration::from_secs(120);
/// How often the planner learns what the link delivers.
const LINK_INTERVAL: Duration = Duration::from_millis(100);
/// A wrong token is answered after this time, so that guessing is slow.
const WRONG_TOKEN_DELAY: Duration = Duration::from_millis(300);
/// Control messages that wait for the session; more and the reader waits, and with it the client.
const CONTROL_QUEUE: usize = 64;
/// How often a client that shows others is told where they are: a step of a walk.
const OTHERS_EVERY: Duration = Duration::from_millis(500);
/// Poses per second beyond which a client is thrown out: a client sends at most 100.
const POSES_PER_SECOND: f64 = 250.0;

/// Reports of damaged chunks that are checked and logged per walker: each reads and hashes a chunk.
/// More: a hostile client fills the log; fewer: some damage is found by `verify` only. A judgement.
const CHECKED_REPORTS: usize = 64;

/// Longest reason in a closing frame, bytes. QUIC cuts what does not fit one packet.
const MAX_REASON: usize = 256;

/// Target of the access log: who came, left, or was not let in, and why. Shown by default.
pub const ACCESS: &str = "access";

/// What all sessions share.
#[derive(Debug)]
pub struct Shared {
    /// The offers to newcomers; replaced by a reload.
    pub offers: RwLock<Arc<Offers>>,
    /// Changes with each reload.
    pub reloads: watch::Sender<()>,
    /// Who is connected.
    pub walkers: Arc<Walkers>,
    /// Who is let in.
    pub admission: Arc<Admission>,
    /// Bytes of all answers to requests.
    pub answers: Allowance,
    /// See [`super::ServeConfig::send_window`].
    pub send_window: u64,
    /// See [`super::ServeConfig::ahead_worth`].
    pub ahead_worth: u64,
    /// See [`super::ServeConfig::messages_per_second`].
    pub messages_per_second: f64,
    /// See [`super::ServeConfig::show_walkers`].
    pub show_walkers: bool,
    /// When the server's time began.
    pub epoch: Instant,
    /// Turns true when the server stops.
    pub stop: watch::Receiver<bool>,
}

impl Shared {
    /// The offers to newcomers.
    pub fn offers(&self) -> Arc<Offers> {
        self.offers.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Replaces the offers to newcomers.
    pub fn set_offers(&self, offers: Offers) {
        *self.offers.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(offers);
        self.reloads.send_replace(());
    }
}

/// What is known of a connection before its handshake.
pub enum Entrance {
    /// Nothing: the address may be forged.
    Unproven(OwnedSemaphorePermit),
    /// It comes from its address.
    Proven(Candidate),
}

/// Serves one client until it leaves, breaks a rule, or the server stops.
pub async fn run(shared: Arc<Shared>, incoming: quinn::Incoming, entrance: Entrance) {
    let address = incoming.remote_address();
    let deadline = tokio::time::Instant::now() + INTRODUCTION;
    let (connection, candidate) = match shake_hands(&shared, incoming, entrance, deadline).await {
        Ok(proven) => proven,
        Err(reason) => return tracing::debug!(%address, "{}", escaped(&reason)),
    };
    metrics::counter!("ldi_connections_total").increment(1);
    let end = match introduce(&shared, &connection, candidate, deadline).await {
        Ok(introduced) => converse(&shared, &connection, introduced).await,
        Err(e) => {
            tracing::info!(target: ACCESS, %address, reason = &*escaped(&e.to_string()), "not let in");
            Err(e)
        }
    };
    match &end {
        Ok(()) => connection.close(VarInt::from_u32(code::BYE), b"bye"),
        Err(SessionError::Refused { code, message }) => {
            metrics::counter!("ldi_refused_total").increment(1);
            connection.close(VarInt::from_u32(*code as u32), escaped(message).as_bytes());
        }
        Err(e) => connection.close(VarInt::from_u32(code::BYE), close_reason(e).as_bytes()),
    }
}

/// Why a session ended, for the frame that closes the connection: one line of at most
/// [`MAX_REASON`] bytes.
fn close_reason(end: &SessionError) -> String {
    let text = end.to_string();
    let mut reason = escaped(&text).into_owned();
    reason.truncate(reason.floor_char_boundary(MAX_REASON));
    reason
}

/// The handshake, which proves the address.
async fn shake_hands(
    shared: &Shared,
    incoming: quinn::Incoming,
    entrance: Entrance,
    deadline: tokio::time::Instant,
) -> Result<(Connection, Candidate), String> {
    let peer = Peer::from(incoming.remote_address().ip());
    let connecting = incoming.accept().map_err(|e| format!("not accepted: {e}"))?;
    let connecting = async {
        match timeout_at(deadline, connecting).await {
            Ok(connection) => connection.map_err(|e| format!("handshake failed: {e}")),
            Err(_) => Err("handshake took too long".into()),
        }
    };
    match entrance {
        Entrance::Proven(candidate) => {
            let connection = tokio::select! {
                connection = connecting => connection,
                () = candidate.displaced() => Err("gave way to a newcomer".into()),
            };
            if connection.is_err() {
                candidate.failed(shared.epoch.elapsed());
            }
            Ok((connection?, candidate))
        }
        Entrance::Unproven(permit) => {
            let connection = connecting.await?;
            drop(permit);
            let candidate = shared.admission.candidate(peer, shared.epoch.elapsed()).map_err(|refusal| {
                metrics::counter!("ldi_refused_total").increment(1);
                connection.close(VarInt::from_u32(RefusalCode::Busy as u32), b"");
                refusal.closed.to_string()
            })?;
            Ok((connection, candidate))
        }
    }
}

/// A walker that was let in, with its control stream.
struct Introduced {
    offer: Arc<Offer>,
    next_certificate: Option<ChunkHash>,
    hello: Hello,
    place: Place,
    send: SendStream,
    recv: RecvStream,
}

/// Reads the first message and lets the candidate in, or says why not.
async fn introduce(
    shared: &Shared,
    connection: &Connection,
    candidate: Candidate,
    deadline: tokio::time::Instant,
) -> Result<Introduced, SessionError> {
    let offers = shared.offers();
    let opening = async {
        let (mut send, mut recv) = connection.accept_bi().await?;
        let first = read_message::<ClientMessage>(&mut recv).await;
        let admitted = first.map_err(SessionError::from).and_then(|m| admit(&offers, m));
        if let Err(SessionError::Refused { code, message }) = &admitted {
            if !matches!(code, RefusalCode::Version | RefusalCode::Dataset) {
                candidate.failed(shared.epoch.elapsed());
            }
            if *code == RefusalCode::Token {
                tokio::time::sleep(WRONG_TOKEN_DELAY).await;
            }
            refuse(&mut send, *code, message).await;
        }
        Ok((admitted?, send, recv))
    };
    let opened = tokio::select! {
        opened = timeout_at(deadline, opening) => opened.unwrap_or_else(|_| {
            candidate.failed(shared.epoch.elapsed());
            Err(SessionError::Silent)
        }),
        () = candidate.displaced() => Err(SessionError::Refused {
            code: RefusalCode::Busy,
            message: "gave way to a newcomer before the first message came".into(),
        }),
    };
    let ((hello, offer), mut send, recv) = opened?;
    match candidate.admit(shared.epoch.elapsed()) {
        Ok(place) => {
            let next_certificate = offers.next_certificate;
            Ok(Introduced { offer, next_certificate, hello, place, send, recv })
        }
        Err(closed) => {
            let (code, message) = (RefusalCode::Busy, closed.to_string());
            refuse(&mut send, code, &message).await;
            Err(SessionError::Refused { code, message })
        }
    }
}

/// A walk, from the welcome to its end.
async fn converse(
    shared: &Arc<Shared>,
    connection: &Connection,
    Introduced { offer, next_certificate, hello, place, mut send, recv }: Introduced,
) -> Result<(), SessionError> {
    let allowance = place.allowance.clone();
    let outlet = Outlet { connection: connection.clone(), allowance, epoch: shared.epoch };
    let walker = shared.walkers.enter(&hello.name, &offer.name);
    let (address, began) = (connection.remote_address(), Instant::now());
    let (id, name, counters) = (walker.id, walker.name.clone(), walker.counters.clone());
    tracing::info!(target: ACCESS, %address, walker = id, name = name.as_str(), dataset = offer.name.as_str(), "came in");
    let (tasks, given) = mpsc::unbounded_channel();
    let (ended, done) = mpsc::unbounded_channel();
    let mut carrier = JoinSet::new();
    carrier.spawn(carry(outlet.clone(), shared.send_window, given, ended, walker.counters.clone()));
    let session = Session::new(shared.clone(), (offer, next_certificate), outlet, &hello, walker, tasks);
    let end = session.run(&mut send, recv, done).await;
    if let Err(SessionError::Refused { code, message }) = &end {
        if place.strike(shared.epoch.elapsed()) {
            tracing::warn!(target: ACCESS, %address, "broke rules too often: few are let in from there for a while");
        }
        refuse(&mut send, *code, message).await;
    }
    let reason = end.as_ref().map_or_else(ToString::to_string, |()| "goodbye".into());
    let (seconds, (chunks, bytes)) = (began.elapsed().as_secs(), counters.sent());
    tracing::info!(
        target: ACCESS, %address, walker = id, name = name.as_str(), seconds, chunks, bytes, reason = &*escaped(&reason), "left"
    );
    end
}

struct Session {
    shared: Arc<Shared>,
    /// As it was when the walker came in.
    offer: Arc<Offer>,
    /// The same.
    next_certificate: Option<ChunkHash>,
    outlet: Outlet,
    walker: Entry,
    planner: Planner,
    started: Instant,
    /// To the task that carries chunks. Unbounded, but no more is on its way than the planner
    /// allows.
    tasks: mpsc::UnboundedSender<Task>,
    /// Chunks that exist but cannot be read, to be told.
    unreadable: Vec<u32>,
    /// Chunks that the client reported as damaged, at most [`CHECKED_REPORTS`].
    reported: BTreeSet<u32>,
    link_at: Duration,
    /// As the client said it last.
    capacity: Capacity,
    /// Datasets whose manifest the client has.
    manifests: Vec<ChunkHash>,
    /// The walk begins before the whole manifest is there.
    early: bool,
    views: Arc<SelectViews>,
    poses: TokenBucket,
    /// The client shows where the others are.
    others: Option<Told>,
    /// The client is told once when its dataset was replaced.
    tells_replacement: bool,
}

/// What a client knows of the others.
struct Told {
    walkers: Vec<Other>,
    again: tokio::time::Interval,
}

impl Session {
    fn new(
        shared: Arc<Shared>,
        (offer, next_certificate): (Arc<Offer>, Option<ChunkHash>),
        outlet: Outlet,
        hello: &Hello,
        walker: Entry,
        tasks: mpsc::UnboundedSender<Task>,
    ) -> Self {
        let index = offer.served.index().clone();
        let config = PlannerConfig {
            cache_bytes: hello.cache_bytes,
            prefetch_m: hello.prefetch_m,
            ahead_worth: shared.ahead_worth,
            ..PlannerConfig::default()
        };
        let (groups, camera) = (offer.served.groups().clone(), hello.picture.camera(&index.settings));
        let show = Show { far: hello.far, portals: hello.portals };
        let views = SelectViews::showing(index.clone(), groups, &camera, show).cached_in(hello.cache_bytes);
        let views = Arc::new(views);
        Self {
            planner: Planner::new(index, views.clone(), config),
            views,
            early: hello.early,
            shared,
            offer,
            next_certificate,
            outlet,
            walker,
            started: Instant::now(),
            tasks,
            unreadable: Vec::new(),
            reported: BTreeSet::new(),
            link_at: Duration::ZERO,
            capacity: Capacity::default(),
            manifests: hello.manifests.clone(),
            poses: TokenBucket::new(POSES_PER_SECOND, POSES_PER_SECOND),
            others: None,
            tells_replacement: hello.replacements,
        }
    }

    async fn run(
        mut self,
        send: &mut SendStream,
        recv: RecvStream,
        mut carried: mpsc::UnboundedReceiver<(u32, Ended)>,
    ) -> Result<(), SessionError> {
        // A client that reads nothing of it would keep its place for ever.
        let mut pages = JoinSet::new();
        timeout(WELCOME, self.welcome(send, &mut pages)).await.map_err(|_| SessionError::Silent)??;
        let (heard, mut messages) = mpsc::channel(CONTROL_QUEUE);
        let (answered, mut answers) = mpsc::channel(CONTROL_QUEUE);
        let mut helpers = JoinSet::new();
        let rate = self.shared.messages_per_second;
        helpers.spawn(control::read_all(recv, heard, rate));
        helpers.spawn(requests::answer_all(
            self.shared.clone(),
            self.offer.clone(),
            self.outlet.clone(),
            answered,
            rate,
        ));
        let mut stop = self.shared.stop.clone();
        let mut reloads = self.shared.reloads.subscribe();
        // What was reloaded since the walker came in counts, too.
        reloads.mark_changed();
        loop {
            self.push_next();
            if !self.unreadable.is_empty() {
                let chunks = std::mem::take(&mut self.unreadable);
                tell(send, &ServerMessage::Unavailable { chunks }).await?;
            }
            let wake = self.planner.wake_at().map(|t| tokio::time::Instant::from_std(self.started + t));
            tokio::select! {
                message = messages.recv() => match message {
                    Some(Ok(ClientMessage::Bye)) | None => return Ok(()),
                    Some(Ok(message)) => self.hear(message, send).await?,
                    Some(Err(e)) => return Err(e),
                },
                Some(number) = answers.recv() => self.planner.sent_elsewhere(number),
                datagram = self.outlet.connection.read_datagram() => self.see(&datagram?)?,
                Some(done) = carried.recv() => self.land(done),
                Some(Ok(sent)) = pages.join_next() => sent.map_err(|_| SessionError::Silent)??,
                () = due(&mut self.others) => self.tell_others(send).await?,
                Ok(()) = reloads.changed() => self.tell_replacement(send).await?,
                () = sleep_until(wake) => {}
                () = stopped(&mut stop) => {
                    self.outlet.connection.close(VarInt::from_u32(code::SHUTDOWN), b"the server stops");
                    return Ok(());
                }
            }
        }
    }

    /// Sends the manifest; to a client that begins early its first pages, and `pages` goes on with
    /// the rest.
    async fn welcome(
        &mut self,
        send: &mut SendStream,
        pages: &mut JoinSet<Result<Result<(), SessionError>, Elapsed>>,
    ) -> Result<(), SessionError> {
        let served = &self.offer.served;
        let known = self.manifests.contains(&served.hash());
        let root = if known { &[][..] } else { served.root() };
        let (first, rest) = if known { (&[][..], &[][..]) } else { served.pages() };
        let welcome = ServerMessage::Welcome(Welcome {
            version: wire::VERSION,
            dataset: served.hash(),
            root_bytes: root.len() as u32,
            pages: (first.len() + rest.len()) as u32,
            walker: self.walker.id,
            others: self.shared.show_walkers,
            next_certificate: self.next_certificate,
        });
        let mut opening = wire::encode(&welcome)?;
        if !known {
            opening.extend(wire::frame(root, wire::MAX_ROOT_BYTES)?);
        }
        let ended = |e: quinn::WriteError| SessionError::Control(e.to_string());
        send.set_priority(1).map_err(|e| SessionError::Control(e.to_string()))?;
        send.write_all(&opening).await.map_err(ended)?;
        let first = self.push_pages(first.to_vec());
        let rest = self.push_pages(rest.to_vec());
        first.await?;
        if known {
            self.views.know(Known::Unsaid);
        }
        if self.early && !known {
            // Beside the coarse levels of the tree, which need no more of the manifest than is
            // there.
            self.views.know(Known::Tree);
            let picture = self.push_first_picture();
            pages.spawn(timeout(WELCOME, async {
                picture.await;
                rest.await
            }));
            return Ok(());
        }
        rest.await
    }

    /// The root of the LDI tree, which is a picture. The pages wait until it is there: they would
    /// fill the link's queues, and what is lost there comes late.
    fn push_first_picture(&mut self) -> impl Future<Output = ()> + Send + use<> {
        let root = self.offer.served.index().tree.as_ref().map(|t| t.root_chunk);
        root.into_iter().for_each(|c| self.planner.sent_elsewhere(c));
        let bytes = root.and_then(|c| Some((c, self.offer.served.chunk(c)?)));
        let (outlet, counters) = (self.outlet.clone(), self.walker.counters.clone());
        async move {
            let Some((number, bytes)) = bytes else { return };
            let urgency = Urgency::Asked;
            let header = StreamHeader { kind: StreamKind::Chunk, urgency, number, bytes: bytes.len() as u32 };
            push_through(&outlet, header, bytes, &counters).await;
        }
    }

    /// Pages one after another, as the client can do nothing with a part of them.
    fn push_pages(&self, numbers: Vec<u32>) -> impl Future<Output = Result<(), SessionError>> + Send + use<> {
        let (offer, outlet, counters) = (self.offer.clone(), self.outlet.clone(), self.walker.counters.clone());
        async move {
            for number in numbers {
                let Some(bytes) = offer.served.page(number) else {
                    return Err(SessionError::Page(number));
                };
                let header =
                    StreamHeader { kind: StreamKind::Page, urgency: Urgency::Now, number, bytes: bytes.len() as u32 };
                push_beside(&outlet, header, bytes, &counters).await;
            }
            Ok(())
        }
    }

    async fn hear(&mut self, message: ClientMessage, send: &mut SendStream) -> Result<(), SessionError> {
        match message {
            ClientMessage::Want { chunks } => {
                let unknown = self.planner.want(&chunks);
                if !unknown.is_empty() {
                    tell(send, &ServerMessage::Unavailable { chunks: unknown }).await?;
                }
            }
            ClientMessage::Drop { chunks } => self.planner.dropped(&chunks),
            ClientMessage::Damaged { chunks } => chunks.into_iter().for_each(|chunk| self.check_reported(chunk)),
            ClientMessage::Have { chunks } => self.planner.have(&chunks),
            ClientMessage::Decoding { waiting_bytes, bytes_per_s } => {
                self.capacity.waiting_bytes = u64::from(waiting_bytes);
                self.capacity.decoded_per_s = (bytes_per_s > 0).then_some(f64::from(bytes_per_s));
                self.planner.capacity(self.capacity);
            }
            ClientMessage::Hello(_) => {
                return Err(SessionError::Refused { code: RefusalCode::Protocol, message: "Hello twice".into() });
            }
            ClientMessage::Whole => {
                self.views.know(Known::Whole);
                self.planner.views_changed();
            }
            ClientMessage::Others { shown } => {
                let mut again = tokio::time::interval(OTHERS_EVERY);
                again.set_missed_tick_behavior(MissedTickBehavior::Delay);
                self.others = (shown && self.shared.show_walkers).then(|| Told { walkers: Vec::new(), again });
                if self.others.is_some() {
                    // That nobody else is there is news, too.
                    tell(send, &ServerMessage::Others { walkers: Vec::new() }).await?;
                }
            }
            ClientMessage::Bye => {}
        }
        Ok(())
    }

    /// Checks a chunk that the client reported as damaged, and logs where the damage is.
    fn check_reported(&mut self, chunk: u32) {
        let exists = (chunk as usize) < self.offer.served.index().chunks.len();
        if !exists || self.reported.len() >= CHECKED_REPORTS || !self.reported.insert(chunk) {
            return;
        }
        metrics::counter!("ldi_reported_damaged_total").increment(1);
        let found = match self.offer.served.is_intact(chunk) {
            true => "its bytes are intact here: the client cannot decode them, or they change on the way",
            false => "it is damaged here, too: run `ldi-server verify` and build the dataset again",
        };
        let (walker, name) = (self.walker.id, self.walker.name.as_str());
        tracing::warn!(target: ACCESS, walker, name, chunk, found, "reported a damaged chunk");
    }

    /// Where the others are, if that changed.
    async fn tell_others(&mut self, send: &mut SendStream) -> Result<(), SessionError> {
        let Some(told) = &mut self.others else { return Ok(()) };
        let walkers = self.shared.walkers.others(self.walker.id);
        if walkers == told.walkers {
            return Ok(());
        }
        told.walkers.clone_from(&walkers);
        tell(send, &ServerMessage::Others { walkers }).await
    }

    /// That newcomers get another build of the dataset, once.
    async fn tell_replacement(&mut self, send: &mut SendStream) -> Result<(), SessionError> {
        let offered = self.shared.offers().of(Some(&self.offer.name));
        let is_replaced = offered.is_ok_and(|offer| offer.served.hash() != self.offer.served.hash());
        if !is_replaced || !std::mem::take(&mut self.tells_replacement) {
            return Ok(());
        }
        tell(send, &ServerMessage::Replaced).await
    }

    /// A datagram that is no pose is ignored: they may be damaged or from a later version.
    fn see(&mut self, datagram: &[u8]) -> Result<(), SessionError> {
        if !self.poses.take(self.started.elapsed()) {
            let message = format!("more than {POSES_PER_SECOND} poses per second");
            return Err(SessionError::Refused { code: RefusalCode::Rate, message });
        }
        match PoseDatagram::decode(datagram) {
            Ok(pose) => {
                if self.planner.pose(pose) {
                    self.walker.moved(pose.pose, self.outlet.connection.rtt().as_secs_f64() * 1e3);
                }
            }
            Err(e) => {
                metrics::counter!("ldi_bad_datagrams_total").increment(1);
                tracing::debug!(walker = self.walker.id, "datagram: {e}");
            }
        }
        Ok(())
    }

    fn follow_link(&mut self) {
        let now = self.started.elapsed();
        if now - self.link_at >= LINK_INTERVAL {
            self.link_at = now;
            self.capacity.round_trip = self.outlet.connection.rtt();
            self.capacity.bytes_per_s = Metered::rate_of(&self.outlet.connection);
            self.planner.capacity(self.capacity);
        }
    }

    fn push_next(&mut self) {
        self.follow_link();
        let now = self.started.elapsed();
        while let Some(order) = self.planner.next(now) {
            self.push_one(order);
        }
        metrics::histogram!("ldi_plan_seconds").record((self.started.elapsed() - now).as_secs_f64());
        for turn in self.planner.turns() {
            self.task(match turn {
                Turn::Reprioritize(order) => Task::Reprioritize(order.chunk, order.urgency),
                Turn::Stale(chunk) => Task::Stop(chunk),
            });
        }
    }

    /// The task that carries chunks ends with the connection, and the session with it.
    fn task(&self, task: Task) {
        let _ = self.tasks.send(task);
    }

    fn push_one(&mut self, order: Order) {
        let Some(bytes) = self.offer.served.chunk(order.chunk) else {
            self.unreadable.push(order.chunk);
            return self.planner.sent(order.chunk);
        };
        let header = StreamHeader {
            kind: StreamKind::Chunk,
            urgency: order.urgency,
            number: order.chunk,
            bytes: bytes.len() as u32,
        };
        self.task(Task::Send(header, bytes));
    }

    fn land(&mut self, (chunk, ended): (u32, Ended)) {
        match ended {
            Ended::Sent | Ended::Refused => self.planner.sent(chunk),
            Ended::Stale | Ended::Failed => self.planner.aborted(chunk),
        }
    }
}

/// The server stops, or is gone.
pub(super) async fn stopped(stop: &mut watch::Receiver<bool>) {
    let _ = stop.wait_for(|s| *s).await;
}

/// Time to look where the others are.
async fn due(others: &mut Option<Told>) {
    match others {
        Some(told) => drop(told.again.tick().await),
        None => std::future::pending().await,
    }
}

async fn sleep_until(at: Option<tokio::time::Instant>) {
    match at {
        Some(t) => tokio::time::sleep_until(t).await,
        None => std::future::pending().await,
    }
}
