//! The report of a walk, written with `--report`.
//!
//! In: one [`FrameReport`] per kept frame and the totals of the walk. Out: [`Report`]. Unknown
//! values are null. Percentiles are by nearest rank: the smallest value that at least the given
//! share of the values does not exceed.

use crate::stream::LinkCounts;
use serde::Serialize;

/// Milliseconds per stage of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct StageMs {
    /// Pose to grid point to placement.
    pub select: f64,
    /// Cells against the frusta.
    pub cull: f64,
    /// Near geometry.
    pub near: f64,
    /// Layout of new images for the warp; part of the frame only if the walk does not wait.
    pub prepare: f64,
    /// Warp of the image.
    pub warp: f64,
    /// Merging near and far, sky, filling, averaging of supersampled pixels.
    pub composite: f64,
    /// The frame.
    pub total: f64,
}

/// One kept frame.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct FrameReport {
    /// Position in the path's poses.
    pub index: usize,
    /// Time of the pose, seconds.
    pub t_s: f64,
    /// Eye, metres.
    pub position: [f64; 3],
    /// Degrees, positive left.
    pub yaw_deg: f64,
    /// Degrees, positive up.
    pub pitch_deg: f64,
    /// `cache` with cached images, `grid` or `portals` with a warped image, `tree` if only the tree
    /// shows distant parts, otherwise `geometry`.
    pub method: &'static str,
    /// Selected grid point.
    pub grid_point: Option<u32>,
    /// Selected placement.
    pub placement: Option<u32>,
    /// Near triangles submitted.
    pub triangles: u64,
    /// Near triangles of cells that are not drawn in full.
    pub level_triangles: u64,
    /// Largest deviation that a level of detail may show, output pixels.
    pub deviation_px: f64,
    /// Cells left out because they exceed the budget; 0 within the walk volume and the built range
    /// of pitch.
    pub dropped_cells: u32,
    /// Triangles of all cells in the frustum, from the index.
    pub triangles_in_frustum: u64,
    /// Rooms that the pose sees as geometry; 0 in a dataset without rooms.
    pub rooms: usize,
    /// Portals beyond which it sees images.
    pub portal_images: usize,
    /// Samples drawn.
    pub samples_warped: u64,
    /// Samples rejected by groups.
    pub samples_culled: u64,
    /// Micro-quads or stamps.
    pub warp_primitives: u64,
    /// Largest footprint of a sample, output pixels; null without a warp.
    pub footprint_max_px: Option<f64>,
    /// Time by stage.
    pub ms: StageMs,
    /// Bytes received since the start of the connection, when the frame was drawn.
    pub bytes_received: u64,
    /// Absent chunks that the frame needed.
    pub missing_chunks: usize,
    /// Whether the pose lies in the walk volume; null if the dataset has none.
    pub in_volume: Option<bool>,
    /// Whether the dataset has images but none for this eye position: geometry and the LDI tree are
    /// shown.
    pub unplanned: bool,
    /// Share of pixels that nothing known reached.
    pub unpainted_fraction: f64,
    /// Share of pixels extrapolated from neighbours.
    pub filled_fraction: f64,
    /// Share of pixels whose colour came from an image.
    pub far_fraction: f64,
    /// Share of pixels whose colour came from the LDI tree.
    pub tree_fraction: f64,
    /// Cached images drawn, with `--method cache`.
    pub cached_images: u32,
    /// Cached images made.
    pub cached_images_made: u32,
    /// Milliseconds of the frame for choosing and making cached images.
    pub ms_cached_images_made: f64,
    /// Visited samples of the LDI tree.
    pub tree_samples: u64,
    /// Share of hole pixels; null without truth.
    pub hole_fraction: Option<f64>,
    /// The same before averaging and filling.
    pub hole_before_fill: Option<f64>,
    /// Against the truth.
    pub psnr_db: Option<f64>,
    /// Against the truth.
    pub ssim: Option<f64>,
    /// Mean over all pixels.
    pub flip: Option<f64>,
    /// Mean over pixels whose colour came from a warp.
    pub flip_far: Option<f64>,
    /// Of the baseline's frame; null without one.
    pub flip_baseline: Option<f64>,
    /// The same over the pixels that we warped.
    pub flip_baseline_far: Option<f64>,
}

/// FLIP relative to the baseline's, over frames with warped pixels and both values.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FlipRatio {
    /// Number of those frames.
    pub frames: usize,
    /// Mean over mean.
    pub mean: f64,
    /// Largest over largest.
    pub worst: f64,
    /// Ratio of means over warped pixels; every frame has the same weight.
    pub far: f64,
    /// The same, every pixel counting alike.
    pub far_by_pixel: f64,
}

impl FlipRatio {
    fn new(frames: &[FrameReport]) -> Option<Self> {
        let both = |f: &FrameReport| {
            let far = f.flip_far.zip(f.flip_baseline_far)?;
            Some([f.flip.zip(f.flip_baseline)?, far, (far.0 * f.far_fraction, far.1 * f.far_fraction)])
        };
        let pairs: Vec<[(f64, f64); 3]> = frames.iter().filter_map(both).collect();
        let ratio = |reduce: &dyn Fn(Vec<f64>) -> Option<f64>, which: usize| {
            let side = |pick: fn(&(f64, f64)) -> f64| reduce(pairs.iter().map(|p| pick(&p[which])).collect());
            Some(side(|p| p.0)? / side(|p| p.1)?)
        };
        Some(Self {
            frames: pairs.len(),
            mean: ratio(&mean, 0)?,
            worst: ratio(&largest, 0)?,
            far: ratio(&mean, 1)?,
            far_by_pixel: ratio(&mean, 2)?,
        })
    }
}

/// Percentiles of frame times.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct FrameMs {
    /// Median.
    pub p50: f64,
    /// 90 of 100.
    pub p90: f64,
    /// 99 of 100.
    pub p99: f64,
    /// Largest.
    pub max: f64,
}

/// Percentiles of a stage.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct P50P99 {
    /// Median.
    pub p50: f64,
    /// 99 of 100.
    pub p99: f64,
}

/// Percentiles by stage.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct StageSummary {
    /// See [`StageMs::select`].
    pub select: P50P99,
    /// See [`StageMs::cull`].
    pub cull: P50P99,
    /// See [`StageMs::near`].
    pub near: P50P99,
    /// See [`StageMs::prepare`]; over the frames that laid out an image.
    pub prepare: P50P99,
    /// See [`StageMs::warp`]; over the frames that warped.
    pub warp: P50P99,
    /// See [`StageMs::composite`].
    pub composite: P50P99,
}

/// Totals of a walk.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WalkTotals {
    /// Triangles and milliseconds of every drawn frame, kept or not.
    pub drawn: Vec<(u64, f64)>,
    /// Geometry budget of the dataset.
    pub budget_triangles: u64,
    /// Triangles of the scene.
    pub scene_triangles: u64,
    /// Metres between the first pose and the last drawn one, along the path.
    pub metres: f64,
    /// Seconds from connecting to the end of the walk.
    pub elapsed_s: f64,
    /// Bytes received, the index included.
    pub bytes_total: u64,
    /// Largest share of unpainted pixels of a frame, kept or not.
    pub unpainted_fraction_max: f64,
    /// Milliseconds from connecting to the first frame.
    pub ms_first_frame: Option<f64>,
    /// Bytes received when the first useful frame was drawn.
    pub bytes_first_useful_frame: Option<u64>,
    /// Milliseconds from connecting to the first useful frame.
    pub ms_first_useful_frame: Option<f64>,
    /// Milliseconds from connecting to the first complete frame.
    pub ms_full_quality: Option<f64>,
    /// 99th percentile of the rate over windows of one second, Mbit/s.
    pub mbit_per_s_p99_1s: Option<f64>,
    /// Stored bytes of needed chunks that had been resident before and were fetched again.
    pub revisit_bytes: u64,
    /// Bytes that no frame used.
    pub wasted_bytes: u64,
    /// Largest sum of decoded bytes held.
    pub cache_peak_bytes: u64,
    /// Incomplete frames, drawn or kept.
    pub frames_incomplete: usize,
    /// Chunks given up because they arrived damaged.
    pub damaged_chunks: usize,
    /// Reason for an early end of the walk, if the connection was lost.
    pub lost: Option<String>,
    /// Largest resident set of the process.
    pub process_peak_rss_bytes: Option<u64>,
    /// 99th percentile of the longest sides of micro-quads, output pixels.
    pub stretch_p99_px: Option<f64>,
    /// Times of all-geometry frames, milliseconds.
    pub all_geometry_ms: Vec<f64>,
    /// Our times at the same poses.
    pub ours_at_same_poses_ms: Vec<f64>,
    /// Stored bytes of all chunks that those frames needed.
    pub all_geometry_bytes: Option<u64>,
}

/// The summary of a walk.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    pub frames: usize,
    pub frames_drawn: usize,
    pub damaged_chunks: usize,
    pub lost: Option<String>,
    pub budget_triangles: u64,
    pub max_triangles: u64,
    pub budget_violations: usize,
    pub mean_triangles: f64,
    pub scene_triangles: u64,
    pub triangles_in_frustum_mean: f64,
    pub mean_psnr_db: Option<f64>,
    pub min_psnr_db: Option<f64>,
    pub mean_ssim: Option<f64>,
    pub mean_flip: Option<f64>,
    pub max_flip: Option<f64>,
    pub mean_flip_far: Option<f64>,
    pub max_flip_far: Option<f64>,
    pub flip_over_baseline: Option<FlipRatio>,
    pub far_fraction_mean: f64,
    pub unpainted_fraction_max: f64,
    pub hole_fraction_mean: Option<f64>,
    pub hole_fraction_max: Option<f64>,
    pub hole_before_fill_mean: Option<f64>,
    pub filled_fraction_mean: f64,
    pub tree_fraction_mean: f64,
    pub all_geometry_frame_ms: Option<P50P99>,
    pub speedup: Option<f64>,
    pub all_geometry_bytes: Option<u64>,
    pub frames_outside_volume: Option<usize>,
    /// Frames at eye positions without images although the dataset has images.
    pub frames_unplanned: usize,
    /// Mean share of near triangles that are of coarser levels of detail.
    pub levels_fraction_mean: f64,
    /// Largest deviation that a level of detail may have shown, output pixels.
    pub deviation_max_px: f64,
    pub frame_ms: FrameMs,
    pub stage_ms: StageSummary,
    pub samples_warped_mean: f64,
    pub samples_culled_mean: f64,
    pub warp_primitives_mean: f64,
    pub warp_msamples_per_s: Option<f64>,
    pub stretch_p99_px: Option<f64>,
    pub bytes_total: u64,
    pub ms_first_frame: Option<f64>,
    pub bytes_first_useful_frame: Option<u64>,
    pub ms_first_useful_frame: Option<f64>,
    pub ms_full_quality: Option<f64>,
    pub mbit_per_s_mean: Option<f64>,
    pub mbit_per_s_p99_1s: Option<f64>,
    pub bytes_per_metre: Option<f64>,
    pub revisit_bytes: u64,
    pub frames_incomplete: usize,
    pub cache_peak_bytes: u64,
    pub process_peak_rss_bytes: Option<u64>,
    pub wasted_bytes: u64,
}

/// What was walked through.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SceneReport {
    pub name: String,
    pub triangles: u64,
    pub unique_triangles: u64,
    pub instances: u64,
    pub bounds: [[f64; 3]; 2],
}

/// The dataset that was served.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DatasetReport {
    /// BLAKE3 of the manifest, hexadecimal.
    pub hash: String,
    /// Geometry budget, triangles per frame.
    pub budget: u64,
    /// What it holds: `geometry`, `grid`.
    pub representations: Vec<&'static str>,
}

/// Where the walk ran.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MachineReport {
    /// Processor model, as the system names it.
    pub cpu: String,
    /// Cores that this process may use.
    pub cores: usize,
    /// Operating system and architecture.
    pub os: String,
}

impl MachineReport {
    /// This machine.
    pub fn here() -> Self {
        let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
        let cpu = info
            .lines()
            .find_map(|l| l.strip_prefix("model name")?.split_once(':'))
            .map(|(_, name)| name.trim().to_owned());
        Self {
            cpu: cpu.unwrap_or_else(|| "unknown".to_owned()),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            os: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
        }
    }
}

/// Everything.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// The source scene.
    pub scene: SceneReport,
    /// The dataset.
    pub dataset: DatasetReport,
    /// The machine.
    pub machine: MachineReport,
    /// The command's options.
    pub options: serde_json::Value,
    /// Packet counts of the simulated link of `--link`; None without one.
    pub link: Option<LinkReport>,
    /// Data read from the disk cache; None without one.
    pub disk: Option<DiskReport>,
    /// Over all frames.
    pub summary: Summary,
    /// Each kept frame.
    pub frames: Vec<FrameReport>,
}

/// Chunks read from the disk cache, and their stored bytes.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct DiskReport {
    /// How many were read.
    pub chunks: u64,
    /// Their stored bytes.
    pub bytes: u64,
}

/// Packets of both directions.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct LinkReport {
    /// From the client.
    pub up: LinkCounts,
    /// To the client.
    pub down: LinkCounts,
}

/// The value that a share `q` of the values does not exceed, by nearest rank; 0 for no values.
pub fn percentile(values: &[f64], q: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = (q * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.max(1) - 1).copied().unwrap_or(0.0)
}

fn mean(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let (sum, n) = values.into_iter().fold((0.0, 0u64), |(s, n), v| (s + v, n + 1));
    (n > 0).then(|| sum / n as f64)
}

fn largest(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    values.into_iter().max_by(f64::total_cmp)
}

fn p50_p99(values: &[f64]) -> P50P99 {
    P50P99 { p50: percentile(values, 0.5), p99: percentile(values, 0.99) }
}

impl Summary {
    /// Draws the sums.
    pub fn new(frames: &[FrameReport], totals: &WalkTotals) -> Self {
        let over = |f: &dyn Fn(&FrameReport) -> f64| mean(frames.iter().map(f)).unwrap_or(0.0);
        let stage = |f: &dyn Fn(&StageMs) -> f64| frames.iter().map(|x| f(&x.ms)).collect::<Vec<_>>();
        let nonzero = |v: Vec<f64>| v.into_iter().filter(|x| *x > 0.0).collect::<Vec<_>>();
        let times: Vec<f64> = totals.drawn.iter().map(|d| d.1).collect();
        let triangles = || totals.drawn.iter().map(|d| d.0);
        let warp_ms: f64 = frames.iter().map(|f| f.ms.warp).sum();
        let samples: u64 = frames.iter().map(|f| f.samples_warped).sum();
        let known_volume: Vec<bool> = frames.iter().filter_map(|f| f.in_volume).collect();
        let ours = percentile(&totals.ours_at_same_poses_ms, 0.5);
        let all_geometry = (!totals.all_geometry_ms.is_empty()).then(|| p50_p99(&totals.all_geometry_ms));
        Self {
            frames: frames.len(),
            frames_drawn: totals.drawn.len(),
            damaged_chunks: totals.damaged_chunks,
            lost: totals.lost.clone(),
            budget_triangles: totals.budget_triangles,
            max_triangles: triangles().max().unwrap_or(0),
            budget_violations: triangles().filter(|n| *n > totals.budget_triangles).count(),
            mean_triangles: mean(triangles().map(|n| n as f64)).unwrap_or(0.0),
            scene_triangles: totals.scene_triangles,
            triangles_in_frustum_mean: over(&|f| f.triangles_in_frustum as f64),
            mean_psnr_db: mean(frames.iter().filter_map(|f| f.psnr_db)),
            min_psnr_db: frames.iter().filter_map(|f| f.psnr_db).min_by(f64::total_cmp),
            mean_ssim: mean(frames.iter().filter_map(|f| f.ssim)),
            mean_flip: mean(frames.iter().filter_map(|f| f.flip)),
            max_flip: largest(frames.iter().filter_map(|f| f.flip)),
            mean_flip_far: mean(frames.iter().filter_map(|f| f.flip_far)),
            max_flip_far: largest(frames.iter().filter_map(|f| f.flip_far)),
            flip_over_baseline: FlipRatio::new(frames),
            far_fraction_mean: over(&|f| f.far_fraction),
            unpainted_fraction_max: totals.unpainted_fraction_max,
            hole_fraction_mean: mean(frames.iter().filter_map(|f| f.hole_fraction)),
            hole_fraction_max: largest(frames.iter().filter_map(|f| f.hole_fraction)),
            hole_before_fill_mean: mean(frames.iter().filter_map(|f| f.hole_before_fill)),
            filled_fraction_mean: over(&|f| f.filled_fraction),
            tree_fraction_mean: mean(frames.iter().map(|f| f.tree_fraction)).unwrap_or(0.0),
            all_geometry_frame_ms: all_geometry,
            speedup: all_geometry.filter(|_| ours > 0.0).map(|g| g.p50 / ours),
            all_geometry_bytes: totals.all_geometry_bytes,
            frames_outside_volume: (!known_volume.is_empty())
                .then(|| known_volume.iter().filter(|inside| !**inside).count()),
            frames_unplanned: frames.iter().filter(|f| f.unplanned).count(),
            levels_fraction_mean: mean(frames.iter().map(|f| f.level_triangles as f64 / f.triangles.max(1) as f64))
                .unwrap_or(0.0),
            deviation_max_px: frames.iter().map(|f| f.deviation_px).fold(0.0, f64::max),
            frame_ms: FrameMs {
                p50: percentile(&times, 0.5),
                p90: percentile(&times, 0.9),
                p99: percentile(&times, 0.99),
                max: percentile(&times, 1.0),
            },
            stage_ms: StageSummary {
                select: p50_p99(&stage(&|m| m.select)),
                cull: p50_p99(&stage(&|m| m.cull)),
                near: p50_p99(&stage(&|m| m.near)),
                prepare: p50_p99(&nonzero(stage(&|m| m.prepare))),
                warp: p50_p99(&nonzero(stage(&|m| m.warp))),
                composite: p50_p99(&stage(&|m| m.composite)),
            },
            samples_warped_mean: over(&|f| f.samples_warped as f64),
            samples_culled_mean: over(&|f| f.samples_culled as f64),
            warp_primitives_mean: over(&|f| f.warp_primitives as f64),
            warp_msamples_per_s: (warp_ms > 0.0).then(|| samples as f64 / warp_ms / 1e3),
            stretch_p99_px: totals.stretch_p99_px,
            bytes_total: totals.bytes_total,
            ms_first_frame: totals.ms_first_frame,
            bytes_first_useful_frame: totals.bytes_first_useful_frame,
            ms_first_useful_frame: totals.ms_first_useful_frame,
            ms_full_quality: totals.ms_full_quality,
            mbit_per_s_mean: (totals.elapsed_s > 0.0).then(|| totals.bytes_total as f64 * 8e-6 / totals.elapsed_s),
            mbit_per_s_p99_1s: totals.mbit_per_s_p99_1s,
            bytes_per_metre: (totals.metres > 0.0).then(|| totals.bytes_total as f64 / totals.metres),
            revisit_bytes: totals.revisit_bytes,
            frames_incomplete: totals.frames_incomplete,
            cache_peak_bytes: totals.cache_peak_bytes,
            process_peak_rss_bytes: totals.process_peak_rss_bytes,
            wasted_bytes: totals.wasted_bytes,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_by_nearest_rank() {
        let v: Vec<f64> = (1..=200).rev().map(f64::from).collect();
        assert_eq!([0.0, 0.5, 0.9, 0.99, 1.0].map(|q| percentile(&v, q)), [1.0, 100.0, 180.0, 198.0, 200.0]);
        assert_eq!(percentile(&[], 0.5), 0.0);
        assert_eq!(percentile(&[7.0], 0.99), 7.0);
    }

    #[test]
    fn the_ratio_to_the_baseline_is_over_frames_that_warped() {
        let frame = |flip: Option<f64>, far: Option<f64>, far_fraction: f64, baseline: [f64; 2]| FrameReport {
            flip,
            flip_far: far,
            flip_baseline: Some(baseline[0]),
            flip_baseline_far: far.map(|_| baseline[1]),
            far_fraction,
            ..FrameReport::default()
        };
        let frames = [
            frame(Some(0.02), Some(0.04), 0.1, [0.02, 0.01]),
            // Geometry alone, and one without truth.
            frame(Some(0.9), None, 0.0, [0.1, 0.1]),
            frame(None, None, 0.0, [0.1, 0.1]),
            frame(Some(0.04), Some(0.06), 0.4, [0.01, 0.03]),
        ];
        let got = FlipRatio::new(&frames).expect("two frames");
        assert_eq!(got.frames, 2);
        let want = [0.06 / 0.03, 0.04 / 0.02, 0.1 / 0.04, 0.028 / 0.013];
        assert!(
            [got.mean, got.worst, got.far, got.far_by_pixel].iter().zip(want).all(|(a, b)| (a - b).abs() < 1e-12),
            "{got:?}"
        );
        assert_eq!(FlipRatio::new(&frames[1..3]), None);
    }

    #[test]
    fn a_summary_without_truth_has_nulls_and_all_fields() {
        let totals = WalkTotals {
            budget_triangles: 10,
            elapsed_s: 2.0,
            bytes_total: 1_000_000,
            metres: 4.0,
            // None of them kept.
            drawn: vec![(8, 5.0), (12, 9.0)],
            ..WalkTotals::default()
        };
        let json = serde_json::to_value(Summary::new(&[], &totals)).expect("plain data");
        for field in [
            "flip_over_baseline",
            "mean_psnr_db",
            "mean_flip_far",
            "hole_fraction_max",
            "speedup",
            "all_geometry_frame_ms",
        ] {
            assert_eq!(json.get(field), Some(&serde_json::Value::Null), "{field}");
        }
        assert_eq!(json["mbit_per_s_mean"], 4.0);
        assert_eq!((&json["frames"], &json["frames_drawn"]), (&0.into(), &2.into()));
        assert_eq!((&json["max_triangles"], &json["budget_violations"]), (&12.into(), &1.into()));
        assert_eq!((&json["mean_triangles"], &json["frame_ms"]["max"]), (&10.0.into(), &9.0.into()));
        assert_eq!(json["bytes_per_metre"], 250_000.0);
        assert_eq!(json["stage_ms"]["composite"]["p99"], 0.0);
    }
}
