//! Poses of a path that stand for the whole of it.

use anyhow::{Context as _, Result};
use serde_json::{Value, json};
use std::path::Path;

/// Writes `frames` poses, evenly spaced over a path file, as a path file; returns how many: no more
/// than the path has.
///
/// # Errors
/// A path that cannot be read, or a file that cannot be written.
pub fn spread(path: &Path, frames: u64, to: &Path) -> Result<usize> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let walk = ldi_protocol::path::parse(&text).with_context(|| path.display().to_string())?;
    let all = walk.poses.len();
    let count = (frames as usize).min(all);
    let picked: Vec<Value> = (0..count)
        .map(|i| &walk.poses[i * all / count])
        .map(|p| json!({ "t": p.t_s, "position": p.pose.position.to_array(), "yaw": p.pose.yaw_deg, "pitch": p.pose.pitch_deg }))
        .collect();
    let file = json!({ "fps": walk.fps, "speed": walk.speed, "poses": picked });
    std::fs::write(to, file.to_string()).with_context(|| format!("cannot write {}", to.display()))?;
    Ok(picked.len())
}
