//! Ways to send ahead of need, compared on one walk over virtual links: frames that lack
//! something, bytes that no frame needed.
//!
//! The walk is replayed in virtual time ([`rehearsal`](crate::load::rehearsal)), so the rows
//! differ by the policy alone, whatever else the machine does. Only the client's decoding rate is
//! measured here, unless it is given.

use crate::load::{
    eviction::{Eviction, replay},
    rehearsal::{Policy, Score, Script, Setting, rehearse},
};
use anyhow::Result;
use ldi_client::{cache::Cache, stream::LinkSpec};
use ldi_protocol::{OutputCamera, index::Index, path::Walk};
use ldi_server::{serve::SelectViews, store::Dataset};
use serde::Serialize;
use std::{fmt::Write as _, path::Path, sync::Arc, time::Instant};

/// What to compare.
#[derive(Debug)]
pub struct Study<'a> {
    /// Directory of the dataset.
    pub dataset: &'a Path,
    /// The walk.
    pub walk: &'a Walk,
    /// Picture size.
    pub size: (u32, u32),
    /// Links.
    pub links: &'a [LinkSpec],
    /// Stored bytes that the client decodes per second; None: as measured here with one thread.
    pub decoded_per_s: Option<f64>,
    /// Decoded bytes of the client's cache.
    pub cache_bytes: u64,
    /// What sending ahead is worth, as in the server's settings.
    pub ahead_worth: u64,
    /// Walk twice.
    pub twice: bool,
}

/// One policy over one link.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// As it can be read again.
    pub link: String,
    /// See [`Policy`].
    pub policy: String,
    /// Frames.
    pub frames: usize,
    /// Share of frames that lacked something.
    pub incomplete: f64,
    /// After the first second.
    pub settled_incomplete: f64,
    /// Those that had a gap, not only less detail, after the first second.
    pub settled_gaps: f64,
    /// Payload of chunks.
    pub received: u64,
    /// Share of it that no frame used.
    pub waste: f64,
    /// Mean.
    pub mbit_per_s: f64,
    /// Poses that were sent.
    pub poses: usize,
    /// Streams broken off.
    pub stale: usize,
    /// Received in the second half: of a walk done twice, in the second lap.
    pub second_half: u64,
}

/// What was found.
#[derive(Debug, Serialize)]
pub struct Found {
    /// Stored bytes that were decoded per second of one thread, or what was given.
    pub decoded_per_s: f64,
    /// Stored bytes of all that the walk needs.
    pub needed_bytes: u64,
    /// Milliseconds that finding the needs of a pose takes here.
    pub needs_ms: f64,
    /// All of them.
    pub rows: Vec<Row>,
    /// What leaves a full cache.
    pub evictions: Vec<EvictionRow>,
}

/// One way to evict with one cap, over the walk done twice.
#[derive(Debug, Clone, Serialize)]
pub struct EvictionRow {
    /// Cap as a share of the decoded bytes that the walk needs.
    pub cap_share: f64,
    /// Decoded bytes.
    pub cap_bytes: u64,
    /// See [`Eviction`].
    pub policy: String,
    /// Stored bytes that came a second time or more often.
    pub again: u64,
    /// Frames that need more than the cap.
    pub too_large: usize,
}

/// Compares.
///
/// # Errors
/// A dataset that cannot be read or decoded.
pub fn run(study: &Study<'_>, mut progress: impl FnMut(&Row)) -> Result<Found> {
    let dataset = Dataset::open(study.dataset)?;
    let index = dataset.index().clone();
    let fov_deg = index.settings.camera.fov_deg;
    let camera = OutputCamera { width: study.size.0, height: study.size.1, fov_deg };
    let views = Arc::new(SelectViews::new(index.clone(), &camera));
    let poses: Vec<_> = study.walk.poses.iter().map(|p| (p.t_s, p.pose)).collect();
    let begin = Instant::now();
    let script = Script::new(index.clone(), poses, &*views);
    let needs_ms = begin.elapsed().as_secs_f64() * 1e3 / script.poses.len() as f64;
    let (needed_bytes, measured) = decode_all(&index, &dataset, &script, study.decoded_per_s.is_none())?;
    let decoded_per_s = study.decoded_per_s.unwrap_or(measured);
    let evictions = evict(&script);
    let script = if study.twice { script.twice() } else { script };
    let lasts = script.poses[script.poses.len() - 1].0 - script.poses[0].0;
    let mut rows = Vec::new();
    for link in study.links {
        for policy in [Policy::Nothing, Policy::Everything, Policy::Forecast, Policy::Clairvoyant] {
            let setting = Setting {
                link: *link,
                decoded_per_s,
                cache_bytes: study.cache_bytes,
                ahead_worth: study.ahead_worth,
                policy,
            };
            let score = rehearse(&script, &setting, views.clone());
            let row = row(&setting, &score, lasts);
            progress(&row);
            rows.push(row);
        }
    }
    Ok(Found { decoded_per_s, needed_bytes, needs_ms, rows, evictions })
}

fn row(setting: &Setting, s: &Score, lasts_s: f64) -> Row {
    let share = |n: usize| n as f64 / s.frames.max(1) as f64;
    Row {
        link: setting.link.to_string(),
        policy: format!("{:?}", setting.policy).to_lowercase(),
        frames: s.frames,
        incomplete: share(s.incomplete),
        settled_incomplete: share(s.settled_incomplete),
        settled_gaps: share(s.settled_gaps),
        received: s.received,
        waste: s.wasted as f64 / s.received.max(1) as f64,
        mbit_per_s: s.received as f64 * 8e-6 / lasts_s,
        poses: s.poses,
        stale: s.stale,
        second_half: s.second_half,
    }
}

/// Ways to evict, over the walk done twice, with caches of parts of what it needs.
fn evict(script: &Script) -> Vec<EvictionRow> {
    let mut needed = vec![false; script.index.chunks.len()];
    script.needs.iter().flat_map(|n| n.all()).for_each(|c| needed[c as usize] = true);
    let decoded = script.index.chunks.iter().zip(&needed).filter(|(_, n)| **n).map(|(c, _)| u64::from(c.decoded_bytes));
    let all: u64 = decoded.sum();
    // Frames that need the same as the one before change nothing.
    let mut twice = script.clone().twice();
    let mut last = None;
    let keep: Vec<bool> = twice.needs.iter().map(|n| last.replace(n.clone()).is_none_or(|l| l != *n)).collect();
    let mut kept = keep.iter();
    twice.needs.retain(|_| *kept.next().unwrap_or(&true));
    let mut out = Vec::new();
    for cap_share in [0.15, 0.25, 0.5, 0.75, 0.9] {
        let cap_bytes = (all as f64 * cap_share) as u64;
        for policy in Eviction::ALL {
            let f = replay(&twice, cap_bytes, policy);
            let policy = format!("{policy:?}").to_lowercase();
            out.push(EvictionRow { cap_share, cap_bytes, policy, again: f.again, too_large: f.too_large });
        }
    }
    out
}

/// Stored bytes of all that the walk needs; decoded once, if asked for, stored bytes per second.
fn decode_all(index: &Arc<Index>, dataset: &Dataset, script: &Script, decode: bool) -> Result<(u64, f64)> {
    let mut needed = vec![false; index.chunks.len()];
    script.needs.iter().flat_map(|n| n.all()).for_each(|c| needed[c as usize] = true);
    let cache = Cache::new(index.clone(), u64::MAX);
    let (mut bytes, mut seconds) = (0u64, 0.0);
    for chunk in (0..needed.len()).filter(|c| needed[*c]).map(|c| c as u32) {
        bytes += u64::from(index.chunks[chunk as usize].stored_bytes);
        if decode {
            let stored = dataset.chunk(chunk)?;
            let begin = Instant::now();
            cache.insert(chunk, &stored)?;
            seconds += begin.elapsed().as_secs_f64();
        }
    }
    Ok((bytes, bytes as f64 / f64::max(seconds, 1e-9)))
}

/// A table for the terminal.
pub fn table(found: &Found) -> String {
    let mut out = format!(
        "the walk needs {:.1} MB; one thread decodes {:.1} MB/s; the needs of a pose take {:.2} ms to find\n",
        found.needed_bytes as f64 * 1e-6,
        found.decoded_per_s * 1e-6,
        found.needs_ms
    );
    for r in &found.rows {
        let _ = writeln!(out, "{}", line(r));
    }
    for r in &found.evictions {
        let _ = writeln!(
            out,
            "cache of {:3.0}% ({:6.1} MB decoded)  {:12} {:7.2} MB again over two laps, {} frames too large",
            r.cap_share * 100.0,
            r.cap_bytes as f64 * 1e-6,
            r.policy,
            r.again as f64 * 1e-6,
            r.too_large
        );
    }
    out
}

/// One row.
pub fn line(r: &Row) -> String {
    format!(
        "{:58} {:12} incomplete {:6.2}%  after 1 s {:6.2}%  gaps {:6.2}%  {:7.1} MB  {:5.1} Mbit/s  waste {:5.1}%  poses {:6}  stale {:4}  second half {:7.2} MB",
        r.link,
        r.policy,
        r.incomplete * 100.0,
        r.settled_incomplete * 100.0,
        r.settled_gaps * 100.0,
        r.received as f64 * 1e-6,
        r.mbit_per_s,
        r.waste * 100.0,
        r.poses,
        r.stale,
        r.second_half as f64 * 1e-6,
    )
}
