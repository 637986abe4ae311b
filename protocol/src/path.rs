//! Path files: what `ldi-client walk`, `ldi-server render` and `plan` walk along.
//!
//! In: the JSON text of a path file (`docs/user/guide.md`). Out: a [`Walk`], one pose per frame,
//! the same on every machine.
//!
//! A file holds `poses`, taken as they are, or `waypoints`, walked like this:
//!
//! - Frame 0 stands at the first waypoint and looks along the first segment. Every frame goes
//!   `speed / fps` metres farther along the polyline and looks along its segment, level (pitch 0).
//! - A waypoint whose next heading differs by more than 1 degree is a stop: the frame that would
//!   pass it stands on it instead, still looking along the old segment; the following frames turn
//!   the shorter way by `120 / fps` degrees each (left when both are 180 degrees) until within 1
//!   degree; the next frame walks on along the new segment. Other waypoints are passed without a
//!   stop.
//! - Segments of no length are dropped. A segment straight up or down has no heading and keeps the
//!   one before it.
//! - The last frame stands on the last waypoint; a closed path goes on from there to the first one.
//! - t = index / fps.
//!
//! Same on every machine: only +, -, *, / and square roots, which IEEE 754 rounds alike
//! everywhere, decide positions; headings come from `atan2`, whose last bits differ between
//! systems, and are therefore rounded to 2^-30 degrees.

mod units;

pub use units::misfit;

use crate::Pose;
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::{collections::BTreeMap, io::Read};

/// Longest text that is parsed.
pub const MAX_TEXT_BYTES: usize = 256 << 20;
/// Most poses of a walk: nine hours at 60 frames per second. More is taken for a mistake in
/// `speed` or `fps`.
pub const MAX_POSES: usize = 2_000_000;
/// Largest coordinate, metres: beyond it f64 no longer resolves a nanometre and the file is surely
/// not in metres.
const MAX_COORDINATE_M: f64 = 1e7;
/// The walker turns this fast.
const TURN_DEG_PER_S: f64 = 120.0;
/// ... until the heading is this near.
const ALIGNED_DEG: f64 = 1.0;

/// A pose at its time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimedPose {
    /// Seconds since the start.
    pub t_s: f64,
    /// Eye.
    pub pose: Pose,
}

/// A walk: one pose per frame, at least one.
#[derive(Debug, Clone, PartialEq)]
pub struct Walk {
    /// Frames per second.
    pub fps: f64,
    /// Walking speed, m/s.
    pub speed: f64,
    /// Eye height above the floor that the file states, metres.
    pub eye_height: Option<f64>,
    /// The poses, in order of time.
    pub poses: Vec<TimedPose>,
}

/// What is wrong with a path file.
#[derive(Debug, thiserror::Error)]
pub enum PathError {
    /// Not JSON, or a field of the wrong type.
    #[error(
        "path file: {0}; expected {{\"waypoints\": [[x,y,z], ...]}} or {{\"poses\": [{{\"t\",\"position\",\"yaw\",\"pitch\"}}, ...]}}"
    )]
    Json(#[from] serde_json::Error),
    /// No file that can be read.
    #[error("it cannot be read: {0}")]
    Read(#[from] std::io::Error),
    /// A value outside its range.
    #[error("path file: `{field}` is {value}; {expected}")]
    Value {
        /// The field, with its position in a list.
        field: String,
        /// What it holds.
        value: f64,
        /// What it may hold.
        expected: &'static str,
    },
    /// Neither or both of the two lists.
    #[error("path file: {0} `waypoints` and `poses`; give exactly one of them, with at least one entry")]
    OneList(&'static str),
    /// Too much of something.
    #[error("path file: {what} exceeds {limit}; shorten the path or raise `speed`")]
    TooLong {
        /// What.
        what: &'static str,
        /// The limit.
        limit: usize,
    },
    /// The waypoints are too far apart for the speed.
    #[error(
        "path file: {metres:.0} m at `speed` {speed} m/s are more than {MAX_POSES} poses; shorten the path or raise `speed`; if its coordinates are millimetres or centimetres, multiply them by 0.001 or 0.01"
    )]
    TooFar {
        /// Length of the way, metres.
        metres: f64,
        /// Speed, metres per second.
        speed: f64,
        /// The waypoints.
        places: Vec<DVec3>,
    },
}

#[derive(Deserialize, Serialize)]
struct PathFile {
    fps: Option<f64>,
    speed: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    eye_height: Option<f64>,
    #[serde(default)]
    closed: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    waypoints: Option<Vec<[f64; 3]>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    poses: Option<Vec<FilePose>>,
}

#[derive(Deserialize, Serialize)]
struct FilePose {
    t: Option<f64>,
    position: [f64; 3],
    yaw: f64,
    #[serde(default)]
    pitch: f64,
}

/// Reads a path file, of bounded size, and walks it. `tell` gets what is no error but should be
/// told.
///
/// # Errors
/// If the file cannot be read, or as [`parse`].
pub fn read(file: impl Read, tell: impl FnOnce(&str)) -> Result<Walk, PathError> {
    let mut text = String::new();
    file.take(MAX_TEXT_BYTES as u64 + 1).read_to_string(&mut text)?;
    // Before what it may have led to: a list whose name is misspelt is missing.
    if let Some(unknown) = unknown_fields(&text) {
        tell(&unknown);
    }
    parse(&text)
}

/// Fields of a [`PathFile`].
const FIELDS: [&str; 6] = ["fps", "speed", "eye_height", "closed", "waypoints", "poses"];

/// What says that fields of a path file mean nothing here, if some do: a slip of the pen in an
/// optional one would else walk at the usual speed unnoticed. No error, as other programs may keep
/// something of theirs in it.
fn unknown_fields(json: &str) -> Option<String> {
    let fields: BTreeMap<String, serde::de::IgnoredAny> = serde_json::from_str(without_mark(json)).ok()?;
    let unknown: Vec<_> = fields.into_keys().filter(|k| !FIELDS.contains(&&**k)).map(|k| format!("`{k}`")).collect();
    let known = FIELDS.map(|k| format!("`{k}`")).join(", ");
    (!unknown.is_empty()).then(|| format!("{} ignored: a path file has {known}", unknown.join(", ")))
}

/// Some editors mark text as UTF-8 by a first character.
fn without_mark(text: &str) -> &str {
    text.strip_prefix('\u{feff}').unwrap_or(text)
}

/// Parses a path file and walks it.
pub fn parse(json: &str) -> Result<Walk, PathError> {
    if json.len() > MAX_TEXT_BYTES {
        return Err(PathError::TooLong { what: "the text's length in bytes", limit: MAX_TEXT_BYTES });
    }
    let file: PathFile = serde_json::from_str(without_mark(json))?;
    let fps = file.fps.unwrap_or(60.0);
    let speed = file.speed.unwrap_or(1.4);
    in_range("fps", fps, 0.01, 1000.0, "frames per second lie in [0.01, 1000]")?;
    in_range("speed", speed, 1e-4, 1000.0, "metres per second lie in [0.0001, 1000]")?;
    if let Some(h) = file.eye_height {
        in_range("eye_height", h, 0.0, 1000.0, "metres above the floor lie in [0, 1000]")?;
    }
    let poses = match (file.waypoints, file.poses) {
        (Some(waypoints), None) if !waypoints.is_empty() => walk(&waypoints, file.closed, fps, speed)?,
        (None, Some(poses)) if !poses.is_empty() => explicit(&poses, fps)?,
        (Some(_), Some(_)) => return Err(PathError::OneList("both")),
        _ => return Err(PathError::OneList("none of")),
    };
    Ok(Walk { fps, speed, eye_height: file.eye_height, poses })
}

impl Walk {
    /// `n` pose numbers evenly spaced over the walk, from the first on (all of them if there are
    /// no more than `n`).
    pub fn evenly_spaced(&self, n: usize) -> Vec<usize> {
        let n = n.min(self.poses.len());
        (0..n).map(|i| i * self.poses.len() / n).collect()
    }

    /// The text of a path file with explicit poses that parses to this walk.
    pub fn to_json(&self) -> String {
        let poses = self.poses.iter().map(|p| FilePose {
            t: Some(p.t_s),
            position: p.pose.position.to_array(),
            yaw: p.pose.yaw_deg,
            pitch: p.pose.pitch_deg,
        });
        let file = PathFile {
            fps: Some(self.fps),
            speed: Some(self.speed),
            eye_height: self.eye_height,
            closed: false,
            waypoints: None,
            poses: Some(poses.collect()),
        };
        // Plain numbers and lists: there is no value here that JSON cannot hold.
        serde_json::to_string(&file).unwrap_or_default()
    }
}

/// NaN fails as well.
fn in_range(field: &str, value: f64, min: f64, max: f64, expected: &'static str) -> Result<(), PathError> {
    if value >= min && value <= max {
        Ok(())
    } else {
        Err(PathError::Value { field: field.to_owned(), value, expected })
    }
}

fn position(list: &str, i: usize, p: [f64; 3]) -> Result<DVec3, PathError> {
    for (value, axis) in p.into_iter().zip(["x", "y", "z"]) {
        let (min, max) = (-MAX_COORDINATE_M, MAX_COORDINATE_M);
        if !(value >= min && value <= max) {
            in_range(&format!("{list}[{i}].{axis}"), value, min, max, "coordinates are metres within +-10,000 km")?;
        }
    }
    Ok(DVec3::from_array(p))
}

/// Poses as the file gives them.
fn explicit(poses: &[FilePose], fps: f64) -> Result<Vec<TimedPose>, PathError> {
    if poses.len() > MAX_POSES {
        return Err(PathError::TooLong { what: "the number of poses", limit: MAX_POSES });
    }
    let mut walk: Vec<TimedPose> = Vec::with_capacity(poses.len());
    for (i, p) in poses.iter().enumerate() {
        let t_s = p.t.unwrap_or(i as f64 / fps);
        let earliest = walk.last().map_or(0.0, |last| last.t_s);
        in_range(&format!("poses[{i}].t"), t_s, earliest, 1e9, "seconds must not be negative nor go back")?;
        in_range(&format!("poses[{i}].yaw"), p.yaw, -1e6, 1e6, "degrees lie within +-1,000,000")?;
        in_range(&format!("poses[{i}].pitch"), p.pitch, -90.0, 90.0, "degrees lie in [-90, 90]")?;
        let position = position("poses", i, p.position)?;
        walk.push(TimedPose { t_s, pose: Pose { position, yaw_deg: p.yaw, pitch_deg: p.pitch } });
    }
    Ok(walk)
}

/// A straight piece of the polyline, of positive length.
struct Segment {
    from: DVec3,
    to: DVec3,
    length_m: f64,
    heading_deg: f64,
}

fn walk(waypoints: &[[f64; 3]], closed: bool, fps: f64, speed: f64) -> Result<Vec<TimedPose>, PathError> {
    if waypoints.len() > MAX_POSES {
        return Err(PathError::TooLong { what: "the number of waypoints", limit: MAX_POSES });
    }
    let mut points = Vec::with_capacity(waypoints.len() + 1);
    for (i, w) in waypoints.iter().enumerate() {
        points.push(position("waypoints", i, *w)?);
    }
    if closed {
        points.push(points[0]);
    }
    let segments = segments(&points);
    let metres: f64 = segments.iter().map(|s| s.length_m).sum();
    if metres * fps / speed > MAX_POSES as f64 {
        return Err(PathError::TooFar { metres, speed, places: points });
    }
    let mut walker = Walker { fps, poses: Vec::new() };
    if segments.is_empty() {
        walker.stand(points[0], 0.0)?;
        return Ok(walker.poses);
    }
    let step_m = speed / fps;
    let mut along_m = 0.0;
    for (i, segment) in segments.iter().enumerate() {
        while along_m < segment.length_m {
            let position = segment.from + (segment.to - segment.from) * (along_m / segment.length_m);
            walker.stand(position, segment.heading_deg)?;
            along_m += step_m;
        }
        let Some(next) = segments.get(i + 1) else {
            walker.stand(segment.to, segment.heading_deg)?;
            break;
        };
        let mut yaw_deg = segment.heading_deg;
        if turn(yaw_deg, next.heading_deg).abs() <= ALIGNED_DEG {
            along_m -= segment.length_m;
            continue;
        }
        walker.stand(segment.to, yaw_deg)?;
        loop {
            let rest_deg = turn(yaw_deg, next.heading_deg);
            if rest_deg.abs() <= ALIGNED_DEG {
                break;
            }
            let most_deg = TURN_DEG_PER_S / fps;
            yaw_deg = normalized(yaw_deg + rest_deg.clamp(-most_deg, most_deg));
            walker.stand(segment.to, yaw_deg)?;
        }
        along_m = step_m;
    }
    Ok(walker.poses)
}

/// Collects poses up to the limit.
struct Walker {
    fps: f64,
    poses: Vec<TimedPose>,
}

impl Walker {
    fn stand(&mut self, position: DVec3, yaw_deg: f64) -> Result<(), PathError> {
        if self.poses.len() >= MAX_POSES {
            return Err(PathError::TooLong { what: "the number of poses", limit: MAX_POSES });
        }
        let t_s = self.poses.len() as f64 / self.fps;
        self.poses.push(TimedPose { t_s, pose: Pose { position, yaw_deg, pitch_deg: 0.0 } });
        Ok(())
    }
}

fn segments(points: &[DVec3]) -> Vec<Segment> {
    let mut segments: Vec<Segment> = Vec::new();
    let mut level = 0;
    for pair in points.windows(2) {
        let (from, to) = (pair[0], pair[1]);
        let d = to - from;
        let length_m = d.length();
        if length_m == 0.0 {
            continue;
        }
        let heading_deg = if d.x == 0.0 && d.z == 0.0 {
            segments.last().map_or(0.0, |s| s.heading_deg)
        } else {
            // Leading vertical segments look where the first level one will.
            let heading_deg = heading_deg(d);
            if level == 0 {
                segments.iter_mut().for_each(|s| s.heading_deg = heading_deg);
            }
            level += 1;
            heading_deg
        };
        segments.push(Segment { from, to, length_m, heading_deg });
    }
    segments
}

/// Yaw that looks along `d`, in (-180, 180], rounded to 2^-30 degrees.
fn heading_deg(d: DVec3) -> f64 {
    const STEPS: f64 = (1u64 << 30) as f64;
    normalized(((-d.x).atan2(-d.z).to_degrees() * STEPS).round() / STEPS)
}

/// Signed way from one heading to another, in (-180, 180].
fn turn(from_deg: f64, to_deg: f64) -> f64 {
    normalized(to_deg - from_deg)
}

/// The same angle in (-180, 180].
fn normalized(deg: f64) -> f64 {
    let d = deg.rem_euclid(360.0);
    if d > 180.0 { d - 360.0 } else { d }
}

#[cfg(test)]
#[path = "path_test.rs"]
mod tests;
