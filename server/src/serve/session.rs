//! One connection from its first to its last byte: who is it, what does it hold, what comes next.
//!
//! All state belongs to one task. Others only carry: one reads control frames, one answers requests by number or name, one hands
//! chunks to the transport. A client that sends garbage ends its own connection and nobody else's.

use super::{
    control::{self, SessionError, admit, read_message, refuse, tell},
    limits::{Allowance, Door, Place, TokenBucket},
    meter::Metered,
    planner::{Capacity, Order, Planner, PlannerConfig, Turn},
    push::{Ended, Outlet, Task, carry, push_beside, push_through},
    requests,
    source::Served,
    views::{Known, SelectViews},
    walkers::{Entry, Walkers},
};
use ldi_protocol::{
    index::ChunkHash,
    select::Show,
    wire::{
        self, ClientMessage, Hello, Other, PoseDatagram, RefusalCode, ServerMessage, StreamHeader, StreamKind, Urgency,
        Welcome, code,
    },
};
use quinn::{RecvStream, SendStream, VarInt};
use std::{
    sync::Arc,
    time::{Duration, Instant},
};
use tokio::{
    sync::{mpsc, watch},
    task::JoinSet,
    time::{MissedTickBehavior, error::Elapsed, timeout},
};

/// Time for TLS and the first message. Longer: strangers hold places for nothing.
const HANDSHAKE: Duration = Duration::from_secs(10);
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

/// What all sessions share.
#[derive(Debug)]
pub struct Shared {
    /// What is served.
    pub served: Served,
    /// Who is connected.
    pub walkers: Arc<Walkers>,
    /// Hash of the token that clients must show.
    pub token: Option<blake3::Hash>,
    /// Room for connections.
    pub door: Arc<Door>,
    /// Bytes of all answers to requests.
    pub answers: Allowance,
    /// See [`super::ServeConfig::max_connections`].
    pub max_connections: usize,
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

/// Serves one client until it leaves, breaks a rule, or the server stops.
pub async fn run(shared: Arc<Shared>, incoming: quinn::Incoming, place: Place) {
    let address = incoming.remote_address();
    let connection = match incoming.accept() {
        Ok(connecting) => timeout(HANDSHAKE, connecting).await,
        Err(e) => return tracing::debug!(%address, "not accepted: {e}"),
    };
    let connection = match connection {
        Ok(Ok(c)) => c,
        Ok(Err(e)) => return tracing::debug!(%address, "handshake failed: {e}"),
        Err(_) => return tracing::debug!(%address, "handshake took too long"),
    };
    metrics::counter!("ldi_connections_total").increment(1);
    let outlet = Outlet { connection: connection.clone(), allowance: place.allowance.clone(), epoch: shared.epoch };
    let end = converse(&shared, &outlet).await;
    match &end {
        Ok(()) => connection.close(VarInt::from_u32(code::BYE), b"bye"),
        Err(SessionError::Refused { code, message }) => {
            metrics::counter!("ldi_refused_total").increment(1);
            // An older program breaks no rule.
            if *code != RefusalCode::Version && place.strike(shared.epoch.elapsed()) {
                tracing::warn!(address = %address.ip(), "broke rules too often: few are let in from there for a while");
            }
            connection.close(VarInt::from_u32(*code as u32), message.as_bytes());
        }
        Err(_) => connection.close(VarInt::from_u32(code::BYE), b""),
    }
    match end {
        Ok(()) => tracing::info!(%address, "left"),
        Err(e) => tracing::info!(%address, "{e}"),
    }
}

async fn converse(shared: &Arc<Shared>, outlet: &Outlet) -> Result<(), SessionError> {
    let connection = &outlet.connection;
    let opening = async {
        let (send, mut recv) = connection.accept_bi().await?;
        let first = read_message::<ClientMessage>(&mut recv).await;
        Ok::<_, SessionError>((send, recv, first))
    };
    let (mut send, recv, first) = timeout(HANDSHAKE, opening).await.map_err(|_| SessionError::Silent)??;
    let hello = match first.map_err(SessionError::from).and_then(|m| admit(shared, m)) {
        Ok(hello) => hello,
        Err(SessionError::Refused { code, message }) => {
            if code == RefusalCode::Token {
                tokio::time::sleep(WRONG_TOKEN_DELAY).await;
            }
            refuse(&mut send, code, &message).await;
            return Err(SessionError::Refused { code, message });
        }
        Err(e) => return Err(e),
    };
    let walker = shared.walkers.enter(&hello.name);
    tracing::info!(address = %connection.remote_address(), walker = walker.id, name = %hello.name, "came in");
    let (tasks, given) = mpsc::unbounded_channel();
    let (ended, done) = mpsc::unbounded_channel();
    let mut carrier = JoinSet::new();
    carrier.spawn(carry(outlet.clone(), shared.send_window, given, ended, walker.counters.clone()));
    let session = Session::new(shared.clone(), outlet.clone(), &hello, walker, tasks);
    let end = session.run(&mut send, recv, done).await;
    if let Err(SessionError::Refused { code, message }) = &end {
        refuse(&mut send, *code, message).await;
    }
    end
}

struct Session {
    shared: Arc<Shared>,
    outlet: Outlet,
    walker: Entry,
    planner: Planner,
    started: Instant,
    /// To the task that carries chunks. Unbounded, but no more is on its way than the planner allows.
    tasks: mpsc::UnboundedSender<Task>,
    /// Chunks that exist but cannot be read, to be told.
    unreadable: Vec<u32>,
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
}

/// What a client knows of the others.
struct Told {
    walkers: Vec<Other>,
    again: tokio::time::Interval,
}

impl Session {
    fn new(
        shared: Arc<Shared>,
        outlet: Outlet,
        hello: &Hello,
        walker: Entry,
        tasks: mpsc::UnboundedSender<Task>,
    ) -> Self {
        let index = shared.served.index().clone();
        let config = PlannerConfig {
            cache_bytes: hello.cache_bytes,
            prefetch_m: hello.prefetch_m,
            ahead_worth: shared.ahead_worth,
            ..PlannerConfig::default()
        };
        let (groups, camera) = (shared.served.groups().clone(), hello.picture.camera(&index.settings));
        let show = Show { far: hello.far, portals: hello.portals };
        let views = SelectViews::showing(index.clone(), groups, &camera, show).cached_in(hello.cache_bytes);
        let views = Arc::new(views);
        Self {
            planner: Planner::new(index, views.clone(), config),
            views,
            early: hello.early,
            shared,
            outlet,
            walker,
            started: Instant::now(),
            tasks,
            unreadable: Vec::new(),
            link_at: Duration::ZERO,
            capacity: Capacity::default(),
            manifests: hello.manifests.clone(),
            poses: TokenBucket::new(POSES_PER_SECOND, POSES_PER_SECOND),
            others: None,
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
        helpers.spawn(requests::answer_all(self.shared.clone(), self.outlet.clone(), answered, rate));
        let mut stop = self.shared.stop.clone();
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
                () = sleep_until(wake) => {}
                () = stopped(&mut stop) => {
                    self.outlet.connection.close(VarInt::from_u32(code::SHUTDOWN), b"the server stops");
                    return Ok(());
                }
            }
        }
    }

    /// Sends the manifest; to a client that begins early its first pages, and `pages` goes on with the rest.
    async fn welcome(
        &mut self,
        send: &mut SendStream,
        pages: &mut JoinSet<Result<Result<(), SessionError>, Elapsed>>,
    ) -> Result<(), SessionError> {
        let served = &self.shared.served;
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
            // Beside the coarse levels of the tree, which need no more of the manifest than is there.
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

    /// The root of the LDI tree, which is a picture. The pages wait until it is there: they would fill the link's queues, and what is lost there comes late.
    fn push_first_picture(&mut self) -> impl Future<Output = ()> + Send + use<> {
        let root = self.shared.served.index().tree.as_ref().map(|t| t.root_chunk);
        root.into_iter().for_each(|c| self.planner.sent_elsewhere(c));
        let bytes = root.and_then(|c| Some((c, self.shared.served.chunk(c)?)));
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
        let (shared, outlet, counters) = (self.shared.clone(), self.outlet.clone(), self.walker.counters.clone());
        async move {
            for number in numbers {
                let Some(bytes) = shared.served.page(number) else {
                    return Err(SessionError::Control(format!("page {number} of the manifest cannot be read")));
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
        let Some(bytes) = self.shared.served.chunk(order.chunk) else {
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
async fn stopped(stop: &mut watch::Receiver<bool>) {
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
