//! The loop over the poses of a path.
//!
//! `--pace wait`: for poses 0, N, 2N, ... request everything that the view needs, wait, draw,
//! evaluate. `--pace realtime`: draw every pose when it is due, or at once if it is overdue, from
//! resident data. Every Nth frame is kept and evaluated after the walk, so that evaluation does not
//! slow it. Pictures are written by their own thread.

use super::{
    baseline,
    data_source::{DataSource, LOST_FOR, PATIENCE, Traffic},
    evaluation::{EvaluationError, Scores, Truth},
    frame_renderer::{FrameRenderer, FrameStats},
    options::{Pace, WalkOptions},
    save::{save_debug_views, save_frame},
    view::{View, view_of},
    walk_error::WalkError,
};
use crate::{
    cache::Incomplete,
    frame::{Frame, Source},
    report::{FrameReport, StageMs, Summary, WalkTotals},
    warp::WarpStats,
};
use ldi_protocol::{OutputCamera, index::Index, need::Sight, path::Walk, room_index::PortalImages};
use std::{
    path::Path,
    sync::{
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    time::{Duration, Instant},
};

/// A frame is useful with a smaller share of holes and a FLIP of at most [`USEFUL_FLIP`].
const USEFUL_HOLES: f64 = 0.01;
/// See [`USEFUL_HOLES`].
const USEFUL_FLIP: f64 = 0.25;

/// The input and output of a walk.
#[derive(Debug, Clone, Copy)]
pub struct WalkJob<'a> {
    /// The poses.
    pub path: &'a Walk,
    /// The options.
    pub options: &'a WalkOptions,
    /// Folder of the frames, created if absent.
    pub folder: &'a Path,
    /// Folder of the ground truth.
    pub truth: Option<&'a Path>,
    /// Folder of another renderer's frames, evaluated over the same pixels.
    pub baseline: Option<&'a Path>,
    /// Set to end the walk: the frames so far are evaluated and reported, and waits for data end.
    pub stop: Option<&'a AtomicBool>,
}

impl WalkJob<'_> {
    fn stopped(&self) -> bool {
        self.stop.is_some_and(|stop| stop.load(Ordering::Relaxed))
    }

    /// Evaluates the frame of a pose; `full` as in [`Truth::evaluate`].
    fn evaluate(&self, pose: usize, frame: &Frame, full: &Frame) -> Result<Scores, EvaluationError> {
        let load = |folder: Option<&Path>| folder.map_or(Ok(None), |f| Truth::load(f, pose));
        match load(self.truth)? {
            Some(truth) => truth.evaluate(frame, full, load(self.baseline)?.as_ref()),
            None => Ok(Scores::default()),
        }
    }
}

/// Progress of a walk.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Progress {
    /// Frames drawn.
    pub done: usize,
    /// Frames to draw.
    pub total: usize,
    /// Bytes received.
    pub bytes: u64,
    /// Milliseconds of the last frame.
    pub frame_ms: f64,
}

/// A kept frame, with the values that the totals need.
struct KeptFrame {
    report: FrameReport,
    complete: bool,
    elapsed_ms: f64,
    /// Set if the frame is evaluated after the walk.
    source: Option<Vec<Source>>,
}

/// A picture that waits to be written.
struct PendingSave {
    index: usize,
    frame: Frame,
}

/// The state of a walk.
struct WalkRun<'a> {
    data: &'a dyn DataSource,
    job: &'a WalkJob<'a>,
    camera: OutputCamera,
    renderer: FrameRenderer,
    kept: Vec<KeptFrame>,
    warp_totals: WarpStats,
    totals: WalkTotals,
    /// Chunks that were resident for a frame that needed them.
    held_before: Vec<bool>,
    /// Number of received chunks, and the time of the last arrival or complete frame.
    last_arrival: (u64, Instant),
}

/// Walks along a path. Returns the summary and the kept frames.
///
/// # Errors
///
/// If the connection is lost, a picture cannot be written, or the ground truth does not fit.
/// Missing chunks are no error.
pub fn run(
    data: &dyn DataSource,
    job: &WalkJob<'_>,
    renderer: FrameRenderer,
    progress: &mut dyn FnMut(Progress),
) -> Result<(Summary, Vec<FrameReport>), WalkError> {
    let folder = job.folder;
    std::fs::create_dir_all(folder).map_err(|source| WalkError::Folder { path: folder.to_owned(), source })?;
    let others = frames_in(folder);
    if others > 0 {
        tracing::warn!("{} holds {others} frames of an earlier walk; those of other poses stay", folder.display());
    }
    let index = data.index();
    let mut walker = WalkRun {
        data,
        job,
        camera: OutputCamera {
            width: job.options.width,
            height: job.options.height,
            fov_deg: index.settings.camera.fov_deg,
        },
        renderer,
        kept: Vec::new(),
        warp_totals: WarpStats::default(),
        totals: WalkTotals {
            budget_triangles: index.settings.budget,
            scene_triangles: index.scene.triangles,
            metres: job.path.poses.windows(2).map(|p| p[0].pose.position.distance(p[1].pose.position)).sum(),
            ..WalkTotals::default()
        },
        held_before: vec![false; index.chunks.len()],
        last_arrival: (0, Instant::now()),
    };
    std::thread::scope(|scope| {
        // Bounded: a slow disk must not let memory grow.
        let (pictures, queue) = mpsc::sync_channel::<PendingSave>(4);
        let writer = scope.spawn(move || write_pictures(&queue, folder, job.options.debug_views));
        let walked = walker.walk(&pictures, progress);
        drop(pictures);
        // A failed write ends the walk; the cause is the write error.
        writer.join().unwrap_or(Ok(())).and(walked)
    })?;
    let traffic = data.traffic();
    let totals = &mut walker.totals;
    totals.elapsed_s = traffic.elapsed_s;
    totals.bytes_total = traffic.bytes;
    totals.wasted_bytes = traffic.wasted_bytes;
    totals.cache_peak_bytes = traffic.cache_peak_bytes;
    totals.damaged_chunks = traffic.damaged_chunks;
    totals.mbit_per_s_p99_1s = Some(traffic.mbit_per_s_p99_1s);
    totals.process_peak_rss_bytes = peak_rss_bytes();
    let stretch = walker.warp_totals.stretch.quantile_px(0.99);
    totals.stretch_p99_px =
        (walker.warp_totals.samples_warped > 0).then(|| f64::from(stretch) / f64::from(job.options.supersample));
    walker.evaluate_rest();
    walker.first_useful();
    let frames: Vec<FrameReport> = walker.kept.into_iter().map(|k| k.report).collect();
    // A stopped walk is not compared with all geometry.
    let options = WalkOptions {
        baseline_frames: if job.stopped() || walker.totals.lost.is_some() { 0 } else { job.options.baseline_frames },
        ..job.options.clone()
    };
    let baseline = baseline::measure(data, &mut walker.renderer, &frames, &walker.camera, &options)?;
    let mut totals = walker.totals;
    totals.all_geometry_bytes = (options.baseline_frames > 0).then_some(baseline.bytes);
    (totals.all_geometry_ms, totals.ours_at_same_poses_ms) = (baseline.all_geometry_ms, baseline.ours_ms);
    Ok((Summary::new(&frames, &totals), frames))
}

/// Number of frame pictures in a folder.
fn frames_in(folder: &Path) -> usize {
    let is_frame = |name: &str| name.starts_with("frame_") && name.ends_with(".png") && name.matches('.').count() == 1;
    let names = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.file_name());
    names.filter(|name| name.to_str().is_some_and(is_frame)).count()
}

impl WalkRun<'_> {
    fn walk(
        &mut self,
        pictures: &mpsc::SyncSender<PendingSave>,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<(), WalkError> {
        let options = self.job.options;
        let every = options.every.max(1);
        let step = if options.pace == Pace::Wait { every } else { 1 };
        let poses = &self.job.path.poses;
        let total = poses.len().div_ceil(step);
        self.wait_for_a_picture()?;
        let start = Instant::now();
        self.last_arrival.1 = start;
        let mut lacks = false;
        let mut frame = Frame::default();
        for (done, at) in (0..poses.len()).step_by(step).enumerate() {
            let (t_s, pose) = (poses[at].t_s, poses[at].pose);
            if options.pace == Pace::Realtime {
                let due = Duration::from_secs_f64((t_s - poses[0].t_s).max(0.0));
                std::thread::sleep(due.saturating_sub(start.elapsed()));
            }
            let mut ms = StageMs::default();
            let index = self.data.index();
            let view = view_of(index, &pose, &self.camera, options.method, &mut ms);
            self.request(index, &view, at)?;
            if let Some(lost) = &self.totals.lost {
                tracing::warn!("{lost}; the report covers the frames until then");
                break;
            }
            if self.job.stopped() {
                tracing::warn!("stopped before pose {at} of {}: the report covers the frames until then", poses.len());
                break;
            }
            let mut frame_stats =
                self.renderer.render(index, self.data, &view, &pose, &self.camera, options, ms, &mut frame)?;
            if options.pace == Pace::Realtime {
                frame_stats.ms.total += frame_stats.ms.prepare;
            }
            self.totals.drawn.push((frame_stats.triangles, frame_stats.ms.total));
            let (unpainted, _) = self.renderer.unknown_fractions();
            self.totals.unpainted_fraction_max = self.totals.unpainted_fraction_max.max(unpainted);
            let traffic = self.data.traffic();
            let complete = frame_stats.is_complete();
            lacks = !complete;
            self.totals.ms_first_frame.get_or_insert(traffic.elapsed_s * 1e3);
            if complete && self.totals.ms_full_quality.is_none() {
                self.totals.ms_full_quality = Some(traffic.elapsed_s * 1e3);
            }
            self.totals.frames_incomplete += usize::from(!complete);
            progress(Progress { done: done + 1, total, bytes: traffic.bytes, frame_ms: frame_stats.ms.total });
            if at % every == 0 {
                self.keep(at, &view, &frame_stats, &frame, traffic)?;
                let picture = PendingSave { index: at, frame: frame.clone() };
                if pictures.send(picture).is_err() {
                    // The writer has failed and returns the error.
                    break;
                }
            }
        }
        // Reports a connection that was lost near the end of a walk.
        if lacks && options.pace == Pace::Realtime && self.totals.lost.is_none() && !self.job.stopped() {
            let none = || (self.data.traffic().chunks == 0).then(|| "no chunk has come".to_owned());
            if let Some(reason) = self.data.lost_reason(Duration::ZERO).or_else(none) {
                self.end_walk(poses.len() - 1, reason)?;
            }
        }
        Ok(())
    }

    /// Ends the walk at this pose because no more data will arrive.
    fn end_walk(&mut self, at: usize, reason: String) -> Result<(), WalkError> {
        if self.kept.is_empty() {
            // Without frames there is no report.
            return Err(WalkError::Disconnected { pose: at, reason });
        }
        self.totals.lost = Some(format!("the connection was lost at pose {at}: {reason}"));
        Ok(())
    }

    /// Waits for the first picture (the root of the LDI tree) even if later frames do not wait.
    /// Time counts from the connection.
    fn wait_for_a_picture(&mut self) -> Result<(), WalkError> {
        let index = self.data.index();
        if let (Some(tree), Some(first)) = (&index.tree, self.job.path.poses.first()) {
            let view = view_of(index, &first.pose, &self.camera, self.job.options.method, &mut StageMs::default());
            let sight = Sight::new(&first.pose, &self.camera, self.job.options.supersample);
            self.data.update_view(&first.pose, &view.needed_within(index, &sight, self.data.cap_bytes()));
            match self.data.wait_for(&[tree.root_chunk], PATIENCE) {
                Err(Incomplete::Timeout(_)) if self.data.traffic().chunks == 0 && !self.job.stopped() => {
                    return Err(WalkError::Disconnected { pose: 0, reason: no_chunk_reason() });
                }
                Err(e) => tracing::warn!("the first picture: {e}"),
                Ok(()) => {}
            }
        }
        Ok(())
    }

    /// Requests the chunks that a view needs; with `--pace wait` also waits for them.
    fn request(&mut self, index: &Index, view: &View, at: usize) -> Result<(), WalkError> {
        let sight = Sight::new(&self.job.path.poses[at].pose, &self.camera, self.job.options.supersample);
        let view_needs = view.needed_within(index, &sight, self.data.cap_bytes());
        let needed: Vec<u32> = view_needs.all().collect();
        for chunk in &needed {
            let absent = !self.data.holds(*chunk);
            if let (true, Some(true), Some(entry)) =
                (absent, self.held_before.get(*chunk as usize), index.chunks.get(*chunk as usize))
            {
                self.totals.revisit_bytes += u64::from(entry.stored_bytes);
                // Each loss is counted once, even if several frames wait for the chunk.
                self.held_before[*chunk as usize] = false;
            }
        }
        self.data.update_view(&self.job.path.poses[at].pose, &view_needs);
        if let Some(reason) = self.lost_while_waiting(&needed, at)
            && !self.job.stopped()
        {
            self.end_walk(at, reason)?;
        }
        for chunk in &needed {
            if self.data.holds(*chunk)
                && let Some(held) = self.held_before.get_mut(*chunk as usize)
            {
                *held = true;
            }
        }
        Ok(())
    }

    /// The reason why missing chunks will not arrive; with `--pace wait` after waiting for them.
    fn lost_while_waiting(&mut self, needed: &[u32], at: usize) -> Option<String> {
        let before = self.data.traffic().chunks;
        if self.job.options.pace == Pace::Wait {
            return match self.data.wait_for(needed, PATIENCE) {
                Ok(()) => None,
                Err(Incomplete::Disconnected(reason)) => Some(reason),
                Err(Incomplete::Timeout(_)) if self.data.traffic().chunks == before => Some(no_chunk_reason()),
                // The frame is drawn without the chunks, and the report says so. A stopped walk
                // does not wait.
                Err(_) if self.job.stopped() => None,
                Err(incomplete) => {
                    tracing::warn!("pose {at}: {incomplete}");
                    None
                }
            };
        }
        let lacks = needed.iter().any(|c| !self.data.holds(*c));
        if !lacks || before != self.last_arrival.0 {
            self.last_arrival = (before, Instant::now());
        }
        let starved = || (lacks && self.last_arrival.1.elapsed() > PATIENCE).then(no_chunk_reason);
        self.data.lost_reason(LOST_FOR).filter(|_| lacks).or_else(starved)
    }

    fn keep(
        &mut self,
        at: usize,
        view: &View,
        frame_stats: &FrameStats,
        frame: &Frame,
        traffic: Traffic,
    ) -> Result<(), WalkError> {
        let pose = &self.job.path.poses[at];
        let scale = f64::from(self.job.options.supersample);
        let scores = match self.job.options.pace {
            Pace::Wait => self.job.evaluate(at, frame, self.renderer.full())?,
            Pace::Realtime => Scores::default(),
        };
        if let Some(warp) = &frame_stats.warp {
            self.warp_totals.add(warp);
        }
        let (unpainted_fraction, _) = self.renderer.unknown_fractions();
        let share = |source| frame.count(source) as f64 / frame.len().max(1) as f64;
        let warp = frame_stats.warp.as_ref();
        let mut report = FrameReport {
            index: at,
            t_s: pose.t_s,
            position: pose.pose.position.to_array(),
            yaw_deg: pose.pose.yaw_deg,
            pitch_deg: pose.pose.pitch_deg,
            method: match (view.by_tree, warp.is_some()) {
                (true, _) if frame_stats.tree.is_some() => "tree",
                (_, true) if !view.portals.is_empty() => portal_method(view.portal_images),
                (_, true) => "grid",
                _ if frame_stats.cached.is_some_and(|c| c.images > 0) => "cache",
                _ => "geometry",
            },
            grid_point: view.selection.grid_point,
            placement: frame_stats.fallback.or(view.selection.placement),
            triangles: frame_stats.triangles,
            level_triangles: frame_stats.levels.triangles,
            deviation_px: frame_stats.levels.deviation_px,
            dropped_cells: view.dropped,
            triangles_in_frustum: view.triangles_in_frustum,
            rooms: view.rooms.len(),
            portal_images: view.portals.len(),
            samples_warped: warp.map_or(0, |w| w.samples_warped),
            samples_culled: warp.map_or(0, |w| w.samples_culled),
            warp_primitives: warp.map_or(0, |w| w.primitives),
            footprint_max_px: warp.map(|w| f64::from(w.footprint_max_px) / scale),
            ms: frame_stats.ms,
            bytes_received: traffic.bytes,
            missing_chunks: frame_stats.missing_chunks.len(),
            in_volume: self.data.index().volume.as_ref().map(|v| v.contains(pose.pose.position)),
            unplanned: view.is_unplanned(self.data.index(), &pose.pose),
            unpainted_fraction,
            filled_fraction: share(Source::Filled),
            far_fraction: share(Source::Far),
            tree_fraction: share(Source::Tree),
            cached_images: frame_stats.cached.map_or(0, |c| c.images),
            cached_images_made: frame_stats.cached.map_or(0, |c| c.made),
            ms_cached_images_made: frame_stats.cached.map_or(0.0, |c| c.made_ms),
            tree_samples: frame_stats.tree.as_ref().map_or(0, |t| t.samples),
            hole_fraction: None,
            hole_before_fill: None,
            psnr_db: None,
            ssim: None,
            flip: None,
            flip_far: None,
            flip_baseline: None,
            flip_baseline_far: None,
        };
        report.set_scores(&scores);
        let later = self.job.truth.is_some() && self.job.options.pace == Pace::Realtime;
        self.kept.push(KeptFrame {
            report,
            complete: frame_stats.is_complete(),
            elapsed_ms: traffic.elapsed_s * 1e3,
            source: later.then(|| frame.source.clone()),
        });
        Ok(())
    }

    /// Evaluates the frames of a realtime walk from the pictures it wrote. Errors leave the scores
    /// null.
    fn evaluate_rest(&mut self) {
        for kept in &mut self.kept {
            let Some(source) = kept.source.take() else { continue };
            let index = kept.report.index;
            let scores = Truth::load(self.job.folder, index).and_then(|ours| {
                ours.map_or(Ok(Scores::default()), |ours| {
                    let frame = ours.into_frame(source);
                    self.job.evaluate(index, &frame, &frame)
                })
            });
            match scores {
                Ok(scores) => kept.report.set_scores(&scores),
                Err(e) => tracing::warn!("pose {index} is not judged: {e}"),
            }
        }
    }

    /// Records the first useful frame among the kept ones. Without ground truth: the first complete
    /// frame.
    fn first_useful(&mut self) {
        let useful = |k: &&KeptFrame| match k.report.flip {
            Some(flip) => flip <= USEFUL_FLIP && k.report.hole_fraction.is_none_or(|h| h < USEFUL_HOLES),
            None => k.complete,
        };
        if let Some(first) = self.kept.iter().find(useful) {
            self.totals.ms_first_useful_frame = Some(first.elapsed_ms);
            self.totals.bytes_first_useful_frame = Some(first.report.bytes_received);
        }
    }
}

/// The reason for ending a walk although the connection is up.
fn no_chunk_reason() -> String {
    format!("no chunk has come for {} s", PATIENCE.as_secs())
}

/// The report's name of a kind of portal images.
fn portal_method(images: PortalImages) -> &'static str {
    match images {
        PortalImages::Offered | PortalImages::Zones => "portals",
        PortalImages::Texture | PortalImages::Textures => "texture",
        PortalImages::Reference => "warp1",
        PortalImages::TwoReferences => "warp2",
        PortalImages::Layered => "ldi",
    }
}

impl FrameReport {
    fn set_scores(&mut self, scores: &Scores) {
        (self.psnr_db, self.ssim) = (scores.psnr_db, scores.ssim);
        (self.flip, self.flip_far) = (scores.flip, scores.flip_far);
        (self.flip_baseline, self.flip_baseline_far) = (scores.flip_baseline, scores.flip_baseline_far);
        (self.hole_fraction, self.hole_before_fill) = (scores.hole_fraction, scores.hole_before_fill);
    }
}

/// Writes pictures until the walk closes the queue, or until the first error.
fn write_pictures(queue: &mpsc::Receiver<PendingSave>, folder: &Path, debug_views: bool) -> Result<(), WalkError> {
    for PendingSave { index, frame } in queue {
        save_frame(folder, index, &frame)?;
        if debug_views {
            save_debug_views(folder, index, &frame)?;
        }
    }
    Ok(())
}

/// Peak resident set of this process, if the system reports it (`VmHWM` of Linux).
fn peak_rss_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let kib: u64 =
        status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?.trim().trim_end_matches("kB").trim().parse().ok()?;
    Some(kib * 1024)
}
