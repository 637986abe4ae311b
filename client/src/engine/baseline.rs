//! All geometry at the poses of the walk: what the images are measured against.
//!
//! The same rasterizer draws every cell in the frustum, with the same supersampling. Its data comes over the same
//! connection, after the walk, and is counted apart.

use super::{
    data_source::DataSource,
    frame_renderer::{FrameRenderer, view_of},
    options::{Method, WalkOptions},
    walk_loop::{PATIENCE, WalkError},
};
use crate::{
    cache::Incomplete,
    frame::Frame,
    report::{FrameReport, StageMs},
};
use glam::DVec3;
use ldi_protocol::{OutputCamera, Pose, need::Sight};
use std::{collections::BTreeSet, time::Duration};

/// All-geometry frames of some of the walk's poses.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Baseline {
    /// Milliseconds of each complete frame.
    pub all_geometry_ms: Vec<f64>,
    /// Milliseconds of our frames at the same poses.
    pub ours_ms: Vec<f64>,
    /// Stored bytes of all chunks that the frames needed.
    pub bytes: u64,
}

/// A line that is down for so long is not waited for: the report is.
const LOST_FOR: Duration = Duration::from_secs(10);

/// Waits for chunks, or until the line is lost: then why.
fn lost_while_waiting(data: &dyn DataSource, needed: &[u32]) -> Option<String> {
    for _ in 0..PATIENCE.as_secs() / LOST_FOR.as_secs() {
        match data.wait_for(needed, LOST_FOR) {
            Err(Incomplete::Disconnected(reason)) => return Some(reason),
            Err(Incomplete::Timeout(_)) => {}
            _ => return None,
        }
    }
    None
}

/// Draws up to `options.baseline_frames` of the kept frames again with all geometry. Frames that stay incomplete (a cache too
/// small for them) are left out: they would look fast.
pub(super) fn measure(
    data: &dyn DataSource,
    renderer: &mut FrameRenderer,
    kept: &[FrameReport],
    camera: &OutputCamera,
    options: &WalkOptions,
) -> Result<Baseline, WalkError> {
    let mut out = Baseline::default();
    let (mut picture, mut chunks) = (Frame::default(), BTreeSet::new());
    let options = &WalkOptions { method: Method::Geometry, ..options.clone() };
    let n = options.baseline_frames.min(kept.len());
    for i in 0..n {
        let frame = &kept[i * kept.len() / n];
        let pose =
            Pose { position: DVec3::from_array(frame.position), yaw_deg: frame.yaw_deg, pitch_deg: frame.pitch_deg };
        let mut ms = StageMs::default();
        let view = view_of(data.index(), &pose, camera, Method::Geometry, &mut ms);
        let view_needs = view.needed(data.index(), &Sight::new(&pose, camera, options.supersample));
        let needed: Vec<u32> = view_needs.all().collect();
        chunks.extend(needed.iter().copied());
        data.update_view(&pose, &view_needs);
        // The server knows nothing of this detour: it would push images.
        let absent: Vec<u32> = needed.iter().copied().filter(|c| !data.holds(*c)).collect();
        data.request(&absent);
        // The walk itself is done, and its report is worth more than this comparison.
        if let Some(reason) = lost_while_waiting(data, &needed) {
            tracing::warn!("the comparison with all geometry ends early: {reason}");
            break;
        }
        let frame_stats = renderer.render(data.index(), data, &view, &pose, camera, options, ms, &mut picture)?;
        if frame_stats.missing_chunks.is_empty() {
            out.all_geometry_ms.push(frame_stats.ms.total);
            out.ours_ms.push(frame.ms.total);
        }
    }
    out.bytes =
        chunks.iter().filter_map(|c| data.index().chunks.get(*c as usize)).map(|c| u64::from(c.stored_bytes)).sum();
    Ok(out)
}
