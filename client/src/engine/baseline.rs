//! Measures the same poses with all geometry, for comparison with the images.
//!
//! The same rasterizer draws every cell in the frustum, with the same supersampling. The data comes
//! over the same connection, after the walk, and is counted separately.

use super::{
    data_source::{DataSource, PATIENCE},
    frame_renderer::FrameRenderer,
    options::{Method, WalkOptions},
    view::view_of,
    walk_error::WalkError,
};
use crate::{
    cache::Incomplete,
    frame::Frame,
    report::{FrameReport, StageMs},
};
use glam::DVec3;
use ldi_protocol::{OutputCamera, Pose, need::Sight};
use std::{collections::BTreeSet, time::Duration};

/// Frame times with all geometry, at some of the walk's poses.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Baseline {
    /// Milliseconds of each complete frame.
    pub all_geometry_ms: Vec<f64>,
    /// Milliseconds of the walk's frames at the same poses.
    pub ours_ms: Vec<f64>,
    /// Stored bytes of all chunks that these frames needed.
    pub bytes: u64,
}

/// Longest time that the comparison waits for a lost connection. The report must not be delayed by
/// it.
const LOST_FOR: Duration = Duration::from_secs(10);

/// Waits for chunks. Returns the reason if the connection is lost.
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

/// Draws up to `options.baseline_frames` of the kept frames again with all geometry. Incomplete
/// frames (the cache is too small for them) are left out, as their times would be too short.
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
        // The server plans images for this pose, so that geometry must be requested by number.
        let absent: Vec<u32> = needed.iter().copied().filter(|c| !data.holds(*c)).collect();
        data.request(&absent);
        // The walk is complete: its report is written even without this comparison.
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
