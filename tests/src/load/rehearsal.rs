//! A walk over a link as arithmetic: the server's planner, the client's cache, and between them a
//! link and a decoder in virtual time.
//!
//! In: what each frame of a walk needs ([`Script`]) and what it meets ([`Setting`]). Out: frames
//! that lacked something, bytes that none needed ([`Score`]). Nothing here depends on the machine
//! or its clock: the same script and setting give the same score, so that ways to send ahead can
//! be compared to the frame. [`Policy::Clairvoyant`] knows the walk in advance: earliest deadline
//! first is late for no chunk if any order is, so what it misses nobody brings in time.
//!
//! The planner and the cache's accounts are those of the real programs, the link is
//! [`SimulatedLink`]. What is simple here: congestion control is perfect (a window of bandwidth
//! times round trip and [`QUEUE`]), acknowledgements are not lost, a lost packet is sent again
//! after a round trip.

use super::hindsight::{Everything, Hindsight};
use ldi_client::{
    cache::Cache,
    stream::{Direction, Fate, HEADER_BYTES, LinkSpec, PoseClock, SimulatedLink},
};
use ldi_protocol::{
    Pose,
    index::Index,
    need::Needed,
    wire::{PoseDatagram, Urgency},
};
use ldi_server::serve::{
    FINISH_BELOW, Meter,
    planner::{Capacity, Order, Planner, PlannerConfig, Turn, Views},
    send_window,
};
use std::{
    cmp::Reverse,
    collections::{BTreeMap, BinaryHeap, VecDeque},
    sync::Arc,
    time::{Duration, Instant},
};

/// Step of virtual time.
const STEP: Duration = Duration::from_millis(1);
/// Payload of a packet, bytes.
const PACKET: usize = 1200;
/// What congestion control lets stand in the link's queue.
const QUEUE: Duration = Duration::from_millis(10);
/// How often the client says what it dropped and how far behind it is.
const TICK: Duration = Duration::from_millis(100);

/// What each frame of a walk needs.
#[derive(Debug, Clone)]
pub struct Script {
    /// Of the dataset.
    pub index: Arc<Index>,
    /// Poses with their times, seconds, ascending.
    pub poses: Vec<(f64, Pose)>,
    /// What each of them needs.
    pub needs: Vec<Arc<Needed>>,
}

impl Script {
    /// Finds what each pose needs.
    pub fn new(index: Arc<Index>, poses: Vec<(f64, Pose)>, views: &dyn Views) -> Self {
        let needs = poses.iter().map(|(_, p)| Arc::new(views.needed(p))).collect();
        Self { index, poses, needs }
    }

    /// The same walk, another time, directly after.
    pub fn twice(mut self) -> Self {
        let lasts = self.poses.last().map_or(0.0, |p| p.0) + 1.0 / 60.0;
        let again: Vec<_> = self.poses.iter().map(|(t, p)| (t + lasts, *p)).collect();
        self.poses.extend(again);
        self.needs.extend(self.needs.clone());
        self
    }
}

/// Who decides what is sent ahead of need.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Policy {
    /// Nothing is.
    Nothing,
    /// Whatever fits into three quarters of the cache, as the server did before it knew the link:
    /// the poses in 0.4 and 1 s, a turn on the spot, then near to far within 10 m.
    Everything,
    /// The server's.
    Forecast,
    /// What the walk will need, in that order, at once.
    Clairvoyant,
}

/// What a walk meets.
#[derive(Debug, Clone, Copy)]
pub struct Setting {
    /// Between server and client, the same both ways.
    pub link: LinkSpec,
    /// Stored bytes that the client decodes per second.
    pub decoded_per_s: f64,
    /// Decoded bytes that the client's cache holds.
    pub cache_bytes: u64,
    /// See [`PlannerConfig::ahead_worth`]; for [`Policy::Forecast`].
    pub ahead_worth: u64,
    /// What is sent ahead.
    pub policy: Policy,
}

/// What became of a walk.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Score {
    /// Frames.
    pub frames: usize,
    /// Those that lacked something.
    pub incomplete: usize,
    /// Those of them after the first second.
    pub settled_incomplete: usize,
    /// Those that had a gap, not only less detail, after the first second.
    pub settled_gaps: usize,
    /// Payload of packets that arrived.
    pub received: u64,
    /// Received, and used by no frame.
    pub wasted: u64,
    /// Poses that went to the server.
    pub poses: usize,
    /// Streams that were broken off.
    pub stale: usize,
    /// Received in the second half of the time.
    pub second_half: u64,
}

/// A chunk on its way to the transport.
#[derive(Debug)]
struct Push {
    urgency: Urgency,
    stream: u64,
    /// Not yet taken by the transport.
    left: usize,
}

/// A chunk on its way from there.
#[derive(Debug)]
struct Stream {
    chunk: u32,
    /// As it was when the stream began.
    urgency: Urgency,
    /// Not yet arrived.
    left: usize,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Event {
    Arrives { stream: u64, bytes: usize },
    Acknowledged { bytes: usize, had_less: bool },
    Lost { stream: u64, bytes: usize },
    Seen { frame: usize, sequence: u32, sent_us: u64 },
    Told { waiting: u64 },
    Dropped { chunk: u32 },
}

struct Rehearsal<'a> {
    script: &'a Script,
    setting: &'a Setting,
    planner: Planner,
    cache: Cache,
    clock: PoseClock,
    epoch: Instant,
    now: Duration,
    link: SimulatedLink,
    pushes: BTreeMap<u32, Push>,
    streams: BTreeMap<u64, Stream>,
    opened: u64,
    /// Taken by the transport and not sent, in order: stream and bytes.
    unsent: VecDeque<(u64, usize)>,
    /// Taken by the transport and not acknowledged.
    unacked: usize,
    events: BinaryHeap<Reverse<(Duration, u64, Event)>>,
    event_number: u64,
    in_flight: usize,
    window: usize,
    meter: Meter,
    waiting_known: u64,
    pressing: VecDeque<(u32, Urgency)>,
    ahead: VecDeque<(u32, Urgency)>,
    /// Being decoded, and the stored bytes left of it.
    decoding: Option<(u32, f64)>,
    score: Score,
}

/// Walks.
pub fn rehearse(script: &Script, setting: &Setting, views: Arc<dyn Views>) -> Score {
    let index = script.index.clone();
    let config = PlannerConfig {
        cache_bytes: setting.cache_bytes,
        prefetch_m: if setting.policy == Policy::Nothing { 0.0 } else { 10.0 },
        ahead_worth: if setting.policy == Policy::Forecast { setting.ahead_worth } else { u64::MAX },
        ..PlannerConfig::default()
    };
    let planner = match setting.policy {
        Policy::Nothing | Policy::Forecast => Planner::new(index.clone(), views, config),
        Policy::Everything => {
            let all = Everything { index: index.clone(), views: views.clone(), cache_bytes: setting.cache_bytes };
            Planner::with_foresight(index.clone(), views, Box::new(all), config)
        }
        Policy::Clairvoyant => {
            let hindsight = Box::new(Hindsight::new(script));
            Planner::with_foresight(index.clone(), views, hindsight, config)
        }
    };
    let rate = setting.link.rate_bit_s.unwrap_or(1e9) / 8.0;
    let round_trip = 2 * setting.link.delay;
    let mut rehearsal = Rehearsal {
        script,
        setting,
        planner,
        cache: Cache::without_decoding(index, setting.cache_bytes),
        clock: PoseClock::default(),
        epoch: Instant::now(),
        now: Duration::ZERO,
        link: SimulatedLink::new(LinkSpec { queue: Duration::from_secs(10), ..setting.link }, Direction::Down),
        pushes: BTreeMap::new(),
        streams: BTreeMap::new(),
        opened: 0,
        unsent: VecDeque::new(),
        unacked: 0,
        events: BinaryHeap::new(),
        event_number: 0,
        in_flight: 0,
        window: (rate * (round_trip + QUEUE).as_secs_f64()).max(15e3) as usize,
        meter: Meter::default(),
        waiting_known: 0,
        pressing: VecDeque::new(),
        ahead: VecDeque::new(),
        decoding: None,
        score: Score::default(),
    };
    rehearsal.run();
    rehearsal.score
}

impl Rehearsal<'_> {
    fn run(&mut self) {
        let (start, end) = (self.script.poses[0].0, self.script.poses[self.script.poses.len() - 1].0);
        let mut frame = 0;
        let mut tick = TICK;
        let mut half = 0;
        while frame < self.script.poses.len() {
            while let Some(Reverse((at, _, event))) = self.events.peek().copied()
                && at <= self.now
            {
                self.events.pop();
                self.happen(event);
            }
            self.decode();
            while let Some((t, _)) = self.script.poses.get(frame)
                && t - start <= self.now.as_secs_f64()
            {
                self.draw(frame, t - start);
                frame += 1;
            }
            self.tell(frame.saturating_sub(1));
            if self.now >= tick {
                tick += TICK;
                self.report();
            }
            self.plan();
            self.fill();
            self.transmit();
            self.now += STEP;
            if self.now.as_secs_f64() < (end - start) / 2.0 {
                half = self.score.received;
            }
        }
        self.score.second_half = self.score.received - half;
        self.score.wasted = self.score.received.saturating_sub(self.cache.usage().useful_bytes);
    }

    fn at(&mut self, at: Duration, event: Event) {
        self.events.push(Reverse((at, self.event_number, event)));
        self.event_number += 1;
    }

    fn happen(&mut self, event: Event) {
        match event {
            Event::Arrives { stream, bytes } => {
                self.score.received += bytes as u64;
                let Some(s) = self.streams.get_mut(&stream) else { return };
                s.left -= bytes;
                if s.left == 0 {
                    let (chunk, urgency) = (s.chunk, s.urgency);
                    self.streams.remove(&stream);
                    if urgency.is_pressing() { &mut self.pressing } else { &mut self.ahead }
                        .push_back((chunk, urgency));
                }
            }
            Event::Acknowledged { bytes, had_less } => {
                self.in_flight -= bytes;
                self.unacked -= bytes;
                self.meter.acknowledged(self.now, bytes as u64, had_less, 2 * self.setting.link.delay);
            }
            Event::Lost { stream, bytes } => {
                self.in_flight -= bytes;
                match self.streams.contains_key(&stream) {
                    true => self.unsent.push_back((stream, bytes)),
                    false => self.unacked -= bytes,
                }
            }
            Event::Seen { frame, sequence, sent_us } => {
                let pose = self.script.poses[frame].1;
                self.planner.pose(PoseDatagram { sequence, sent_us, pose });
            }
            Event::Told { waiting } => self.waiting_known = waiting,
            Event::Dropped { chunk } => self.planner.dropped(&[chunk]),
        }
    }

    /// One step of the client's decoding thread: what the view waits for first.
    fn decode(&mut self) {
        let mut budget = self.setting.decoded_per_s * STEP.as_secs_f64();
        while budget > 0.0 {
            let Some((chunk, left)) = self.decoding.take() else {
                let needed = self.ahead.iter().position(|(c, _)| self.cache.is_pinned(*c));
                let most = (0..self.pressing.len()).min_by_key(|i| self.pressing[*i].1);
                let next = match most {
                    Some(at) => self.pressing.remove(at),
                    None => self.ahead.remove(needed.unwrap_or(0)),
                };
                let Some((chunk, _)) = next else { return };
                self.decoding = Some((chunk, f64::from(self.script.index.chunks[chunk as usize].stored_bytes)));
                continue;
            };
            if left > budget {
                self.decoding = Some((chunk, left - budget));
                return;
            }
            budget -= left;
            // Nothing is decoded, so nothing can be wrong with it.
            let _ = self.cache.insert(chunk, &[]);
        }
    }

    fn draw(&mut self, frame: usize, t_s: f64) {
        let needed = &self.script.needs[frame];
        self.cache.pin(needed.all());
        let lacks = |chunks: &[u32]| !self.cache.missing(chunks.iter().copied()).is_empty();
        let gap = lacks(&needed.base) || lacks(&needed.now);
        let incomplete = gap || lacks(&needed.fine);
        self.cache.count_used(needed.all());
        self.score.frames += 1;
        self.score.incomplete += usize::from(incomplete);
        if t_s >= 1.0 {
            self.score.settled_incomplete += usize::from(incomplete);
            self.score.settled_gaps += usize::from(gap);
        }
        self.clock.update_view(&self.script.poses[frame].1, self.now);
    }

    /// The newest pose, that of frame number `newest`, goes if its time has come.
    fn tell(&mut self, newest: usize) {
        if self.clock.take(self.now).is_some() {
            self.score.poses += 1;
            let (sequence, sent_us) = (self.score.poses as u32, self.now.as_micros() as u64);
            self.at(self.now + self.setting.link.delay, Event::Seen { frame: newest, sequence, sent_us });
        }
    }

    fn report(&mut self) {
        let arrives = self.now + self.setting.link.delay;
        let stored = |c: u32| u64::from(self.script.index.chunks[c as usize].stored_bytes);
        let queued: u64 = self.pressing.iter().chain(&self.ahead).map(|(c, _)| stored(*c)).sum();
        let waiting = queued + self.decoding.map_or(0, |d| d.1 as u64);
        self.at(arrives, Event::Told { waiting });
        for chunk in self.cache.take_evicted(self.epoch + self.now) {
            self.at(arrives, Event::Dropped { chunk });
        }
    }

    fn plan(&mut self) {
        self.planner.capacity(Capacity {
            bytes_per_s: self.meter.bytes_per_s(),
            round_trip: 2 * self.setting.link.delay,
            decoded_per_s: Some(self.setting.decoded_per_s),
            waiting_bytes: self.waiting_known,
        });
        while let Some(Order { chunk, urgency }) = self.planner.next(self.now) {
            let bytes = self.script.index.chunks[chunk as usize].stored_bytes as usize;
            self.opened += 1;
            self.pushes.insert(chunk, Push { urgency, stream: self.opened, left: bytes });
        }
        for turn in self.planner.turns() {
            match turn {
                Turn::Reprioritize(order) => {
                    if let Some(p) = self.pushes.get_mut(&order.chunk) {
                        p.urgency = order.urgency;
                    }
                }
                Turn::Stale(chunk) => self.stop(chunk),
            }
        }
    }

    /// As the server's: what began and is nearly there is finished.
    fn stop(&mut self, chunk: u32) {
        let Some(p) = self.pushes.get(&chunk) else { return };
        let (stream, left) = (p.stream, p.left);
        if self.streams.contains_key(&stream) && left <= FINISH_BELOW {
            return;
        }
        self.pushes.remove(&chunk);
        self.streams.remove(&stream);
        let of_it = self.unsent.iter().filter(|(s, _)| *s == stream);
        self.unacked -= of_it.map(|(_, bytes)| bytes).sum::<usize>();
        self.unsent.retain(|(s, _)| *s != stream);
        self.planner.aborted(chunk);
        self.score.stale += 1;
    }

    /// Hands bytes to the transport, most urgent first, as far as its window goes.
    fn fill(&mut self) {
        let window = send_window(self.window as u64, self.meter.bytes_per_s()) as usize;
        while let Some(room) = window.checked_sub(self.unacked).filter(|r| *r > 0) {
            let first = self.pushes.iter_mut().min_by_key(|(_, p)| (p.urgency, p.stream));
            let Some((&chunk, p)) = first else { return };
            let all = self.script.index.chunks[chunk as usize].stored_bytes as usize;
            self.streams.entry(p.stream).or_insert(Stream { chunk, urgency: p.urgency, left: all });
            let taken = p.left.min(room);
            p.left -= taken;
            self.unacked += taken;
            self.unsent.push_back((p.stream, taken));
            if p.left == 0 {
                self.pushes.remove(&chunk);
                self.planner.sent(chunk);
            }
        }
    }

    fn transmit(&mut self) {
        while self.in_flight < self.window {
            let Some((stream, waiting)) = self.unsent.front_mut() else { return };
            let (stream, bytes) = (*stream, PACKET.min(*waiting));
            *waiting -= bytes;
            if *waiting == 0 {
                self.unsent.pop_front();
            }
            self.in_flight += bytes;
            let had_less = self.unsent.is_empty();
            match self.link.send(self.now, bytes + HEADER_BYTES) {
                Fate::Arrives(at) | Fate::ArrivesTwice(at, _) => {
                    self.at(at, Event::Arrives { stream, bytes });
                    let back = at + self.setting.link.delay;
                    self.at(back, Event::Acknowledged { bytes, had_less });
                }
                Fate::Lost | Fate::Dropped => {
                    let noticed = self.now + 2 * self.setting.link.delay + QUEUE;
                    self.at(noticed, Event::Lost { stream, bytes });
                }
            }
        }
    }
}

#[cfg(test)]
#[path = "rehearsal_test.rs"]
pub(super) mod tests;
