//! The walker: converts keys, mouse and time to poses within the walk volume.
//!
//! In: the intent, the turn, the time that passed. Out: a pose. Pure: no window, no clock.
//!
//! - The velocity approaches the intended one exponentially ([`RESPONSE_S`]), integrated exactly:
//!   the path does not depend on the update rate.
//! - The eye never leaves the [`WalkVolume`]. At its border the walker moves as far as possible,
//!   then along x and along z: the volume's columns are upright boxes, so that this is sliding.
//! - At walls the part of a step toward the nearest surface is removed ([`CollisionGeometry`]).
//! - On foot the eye follows the floor below, within the heights of the volume. Without floor
//!   geometry the volume's heights are used: made for an eye height h, it spans h - 0.5 m to h +
//!   0.4 m above each floor.

use super::collision::{BODY_M, CollisionGeometry};
use glam::DVec3;
use ldi_protocol::{Pose, ViewBasis, volume::WalkVolume};

/// Walking speed, m/s.
pub const WALK_M_PER_S: f64 = 1.4;
/// Range of speeds, m/s.
const SPEEDS_M_PER_S: std::ops::RangeInclusive<f64> = 0.1..=60.0;
/// Speed of running, relative to walking.
const RUN_FACTOR: f64 = 2.5;
/// Change of speed per notch of the wheel.
const NOTCH_FACTOR: f64 = 1.15;
/// Time constant of starting and stopping, seconds. Smaller: jerky; larger: the walker slides.
const RESPONSE_S: f64 = 0.07;
/// Time constant of the eye's height over steps, seconds. Smaller: steps are jerky; larger: the eye
/// lags on stairs.
const RISE_S: f64 = 0.12;
/// Turn rate of keys, degrees per second.
const TURN_DEG_PER_S: f64 = 90.0;
/// Longest movement tested at once, metres: below a column's width, so that no column is skipped.
const LONGEST_STEP_M: f64 = 0.1;
/// Longest time of an update, seconds: the walker does not jump after a stall.
const LONGEST_TIME_S: f64 = 0.25;
/// Longest time of one step, seconds: bounds the lag of the eye's height.
const LONGEST_SLICE_S: f64 = 1.0 / 60.0;
/// Largest height of the eye above or below a neighbouring column's heights at which it steps over,
/// metres. The heights have a margin around the eye of their own; this one covers the lag on
/// stairs.
const STEP_OVER_M: f64 = 0.3;
/// Tolerance for touching a wall, metres: the resolution of a step.
const TOUCH_M: f64 = 1e-3;
/// Distance kept from the volume's border, metres: rounding must not move the eye outside.
const INSET_M: f64 = 1e-6;
/// Extent of the volume below the nominal eye height, metres.
const BELOW_M: f64 = 0.5;
/// Extent of the volume above the nominal eye height, metres.
const ABOVE_M: f64 = 0.4;
/// Largest rise of stairs within a column and beside it plus a layer's height, metres.
const STEPS_M: f64 = 0.65;
/// Tolerance at which the eye's height has settled, metres: a resting walker must not move.
const SETTLED_M: f64 = 5e-4;

/// The intended movement. Each component lies in -1 ..= 1.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Intent {
    /// Forward.
    pub forward: f64,
    /// To the right.
    pub right: f64,
    /// Upward, only when flying.
    pub up: f64,
    /// Turn to the left.
    pub turn: f64,
    /// Turn upward.
    pub tilt: f64,
    /// Whether to run.
    pub run: bool,
}

impl Intent {
    /// Combines two intents.
    pub fn and(self, other: Self) -> Self {
        let sum = |a: f64, b: f64| (a + b).clamp(-1.0, 1.0);
        Self {
            forward: sum(self.forward, other.forward),
            right: sum(self.right, other.right),
            up: sum(self.up, other.up),
            turn: sum(self.turn, other.turn),
            tilt: sum(self.tilt, other.tilt),
            run: self.run || other.run,
        }
    }
}

/// The surroundings of a walker.
#[derive(Debug, Clone, Copy, Default)]
pub struct WalkSpace<'a> {
    /// The walk volume.
    pub volume: Option<&'a WalkVolume>,
    /// Nearby surfaces.
    pub collision: Option<&'a CollisionGeometry>,
    /// Whether obstacles block the way.
    pub walls: bool,
}

impl<'a> From<Option<&'a WalkVolume>> for WalkSpace<'a> {
    fn from(volume: Option<&'a WalkVolume>) -> Self {
        Self { volume, ..Self::default() }
    }
}

impl WalkSpace<'_> {
    /// `to` at an allowed height, if a body may move there from `from`.
    fn admit(&self, from: DVec3, to: DVec3) -> Option<DVec3> {
        let there = self.volume.map_or(Some(to), |v| stand(v, to, STEP_OVER_M))?;
        let free = self.collision.is_none_or(|s| !self.walls || s.allows(from, there));
        free.then_some(there)
    }
}

/// A walking or flying viewer.
#[derive(Debug, Clone, PartialEq)]
pub struct Walker {
    pose: Pose,
    velocity: DVec3,
    speed_m_per_s: f64,
    flying: bool,
    pitch_limit_deg: f64,
    /// Height of the eye above the nominal one on foot, metres.
    raise_m: f64,
}

impl Walker {
    /// A walker at `pose`, moved into the volume. `flying`: vertical movement is free. The pitch is
    /// limited.
    pub fn new(pose: Pose, volume: Option<&WalkVolume>, flying: bool, pitch_limit_deg: f64) -> Self {
        let mut w =
            Self { pose, velocity: DVec3::ZERO, speed_m_per_s: WALK_M_PER_S, flying, pitch_limit_deg, raise_m: 0.0 };
        w.turn(0.0, 0.0);
        w.teleport(pose.position, volume);
        w
    }

    /// The eye's pose.
    pub fn pose(&self) -> Pose {
        self.pose
    }

    /// The chosen speed, without running.
    pub fn speed_m_per_s(&self) -> f64 {
        self.speed_m_per_s
    }

    /// Sets the speed, without running.
    pub fn set_speed(&mut self, m_per_s: f64) {
        self.speed_m_per_s = m_per_s.clamp(*SPEEDS_M_PER_S.start(), *SPEEDS_M_PER_S.end());
    }

    /// Sets the height of the eye above the nominal one on foot, metres. The eye stays within the
    /// volume.
    pub fn set_raise(&mut self, m: f64) {
        self.raise_m = m;
    }

    /// The eye's place at the nominal height above the same foot.
    pub fn nominal_eye(&self) -> DVec3 {
        let raise_m = if self.flying { 0.0 } else { self.raise_m };
        self.pose.position - DVec3::Y * raise_m
    }

    /// Whether the walker is still moving.
    pub fn is_moving(&self) -> bool {
        self.velocity.length_squared() > 1e-6
    }

    /// Turns the head, degrees: positive left and up.
    pub fn turn(&mut self, yaw_deg: f64, pitch_deg: f64) {
        self.pose.yaw_deg = (self.pose.yaw_deg + yaw_deg + 180.0).rem_euclid(360.0) - 180.0;
        let limit = self.pitch_limit_deg;
        self.pose.pitch_deg = (self.pose.pitch_deg + pitch_deg).clamp(-limit, limit);
    }

    /// Changes the speed by notches of the wheel.
    pub fn change_speed(&mut self, notches: f64) {
        let asked = self.speed_m_per_s * NOTCH_FACTOR.powf(notches.clamp(-20.0, 20.0));
        self.speed_m_per_s = asked.clamp(*SPEEDS_M_PER_S.start(), *SPEEDS_M_PER_S.end());
    }

    /// Moves the walker to the place of the volume nearest to `p`, or to `p` without a volume.
    pub fn teleport(&mut self, p: DVec3, volume: Option<&WalkVolume>) {
        self.velocity = DVec3::ZERO;
        self.pose.position = volume.and_then(|v| nearest(v, p)).unwrap_or(p);
        if let (Some(v), false) = (volume, self.flying) {
            // Sets the height above the floor at once. Twice, as the columns that count depend on
            // the height.
            let ground = WalkSpace::from(Some(v));
            let raise_m = self.raise_m;
            let at_once = |p| settle(&ground, p, raise_m, f64::INFINITY);
            self.pose.position = at_once(at_once(self.pose.position));
        }
    }

    /// Moves the walker to the place of the volume nearest to a pose, with its direction.
    pub fn place(&mut self, pose: &Pose, volume: Option<&WalkVolume>) {
        (self.pose.yaw_deg, self.pose.pitch_deg) = (pose.yaw_deg, pose.pitch_deg);
        self.turn(0.0, 0.0);
        self.teleport(pose.position, volume);
    }

    /// Sets the pose of a replayed walk, inside the volume or not.
    pub fn follow(&mut self, pose: Pose) {
        self.velocity = DVec3::ZERO;
        self.pose = pose;
    }

    /// Moves on by `dt_s` seconds.
    pub fn advance<'a>(&mut self, ground: impl Into<WalkSpace<'a>>, intent: &Intent, dt_s: f64) {
        let ground = &ground.into();
        let dt_s = dt_s.clamp(0.0, LONGEST_TIME_S);
        let fastest = self.asked(intent).length().max(self.velocity.length());
        let slices = (dt_s / LONGEST_SLICE_S).max(fastest * dt_s / LONGEST_STEP_M).ceil().max(1.0);
        let slice_s = dt_s / slices;
        let decay = (-slice_s / RESPONSE_S).exp();
        for _ in 0..slices as u32 {
            // Half of the turn before and half after the step: the way is that of the slice's
            // middle.
            let [half_turn_deg, half_tilt_deg] = [intent.turn, intent.tilt].map(|v| 0.5 * v * TURN_DEG_PER_S * slice_s);
            self.turn(half_turn_deg, half_tilt_deg);
            let asked = self.asked(intent);
            // Exact for a velocity that approaches `asked` exponentially.
            let excess = self.velocity - asked;
            let delta = asked * slice_s + excess * (RESPONSE_S * (1.0 - decay));
            self.velocity = asked + excess * decay;
            self.pose.position = match ground.volume {
                Some(v) if self.flying => fly(v, self.pose.position, delta),
                None if self.flying => self.pose.position + delta,
                _ => settle(ground, slide(ground, self.pose.position, delta), self.raise_m, slice_s),
            };
            self.turn(half_turn_deg, half_tilt_deg);
        }
        if !self.is_moving() && self.asked(intent) == DVec3::ZERO {
            self.velocity = DVec3::ZERO;
        }
    }

    /// The velocity that the keys ask for, m/s. On foot it is horizontal whatever the pitch.
    fn asked(&self, intent: &Intent) -> DVec3 {
        let pitch = if self.flying { self.pose.pitch_deg } else { 0.0 };
        let basis = ViewBasis::from_yaw_pitch(self.pose.yaw_deg, pitch);
        let up = if self.flying { DVec3::Y * intent.up } else { DVec3::ZERO };
        let direction = basis.forward * intent.forward + basis.right * intent.right + up;
        // Two keys at once are not faster than one.
        let direction = direction / direction.length().max(1.0);
        direction * self.speed_m_per_s * if intent.run { RUN_FACTOR } else { 1.0 }
    }
}

/// `p` at the nearest allowed height of its column, if within `reach_m`.
fn stand(v: &WalkVolume, p: DVec3, reach_m: f64) -> Option<DVec3> {
    let inset = |[low, high]: [f64; 2]| {
        let (low, high) = (low + INSET_M, high - INSET_M);
        DVec3::new(p.x, p.y.clamp(low.min(high), high), p.z)
    };
    v.heights(p.x, p.z)
        .map(inset)
        .filter(|q| (q.y - p.y).abs() <= reach_m && v.contains(*q))
        .min_by(|a, b| (a.y - p.y).abs().total_cmp(&(b.y - p.y).abs()))
}

/// Moves along `delta` as far as possible. Also returns the share that was possible.
fn go(ground: &WalkSpace<'_>, from: DVec3, delta: DVec3) -> (DVec3, f64) {
    if delta == DVec3::ZERO {
        return (from, 1.0);
    }
    if let Some(there) = ground.admit(from, from + delta) {
        return (there, 1.0);
    }
    let (mut free, mut blocked, mut at) = (0.0, 1.0, from);
    // Bisection to a thousandth of the step.
    for _ in 0..10 {
        let middle = 0.5 * (free + blocked);
        match ground.admit(from, from + delta * middle) {
            Some(p) => (free, at) = (middle, p),
            None => blocked = middle,
        }
    }
    (at, free)
}

/// A horizontal step that slides along walls and the volume's border.
fn slide(ground: &WalkSpace<'_>, from: DVec3, delta: DVec3) -> DVec3 {
    let (mut at, mut share) = go(ground, from, delta);
    let mut rest = delta;
    // Twice: in a corner, sliding along one wall meets the other.
    for _ in 0..2 {
        if share == 1.0 {
            return at;
        }
        rest *= 1.0 - share;
        let Some(collision) = ground.collision.filter(|_| ground.walls) else { break };
        let (distance, away) = collision.clearance(at.x, at.z);
        let away = DVec3::new(away.x, 0.0, away.y);
        if distance > BODY_M + TOUCH_M || rest.dot(away) >= 0.0 {
            break;
        }
        rest -= away * rest.dot(away);
        (at, share) = go(ground, at, rest);
    }
    if share == 1.0 {
        return at;
    }
    // Columns are upright boxes: slides along x, then z.
    let (at, _) = go(ground, at, DVec3::new(rest.x, 0.0, 0.0));
    go(ground, at, DVec3::new(0.0, 0.0, rest.z)).0
}

/// A step in the air, axis by axis.
fn fly(v: &WalkVolume, from: DVec3, delta: DVec3) -> DVec3 {
    let b = v.bounds();
    let p = (from + delta).clamp(b.min, b.max.max(b.min));
    [p, DVec3::new(p.x, p.y, from.z), DVec3::new(from.x, p.y, p.z), DVec3::new(from.x, p.y, from.z)]
        .into_iter()
        .find(|p| v.contains(*p))
        .unwrap_or(from)
}

/// The nominal eye height of a run of heights.
pub fn nominal([low, high]: [f64; 2]) -> f64 {
    // A run over steps spans several floors: the middle one counts. A run that is cut by a ceiling,
    // or spans a floor and furniture, is reliable only at its lower end.
    let flat = BELOW_M + ABOVE_M;
    if (0.95 * flat..=flat + STEPS_M).contains(&(high - low)) {
        0.5 * (low + BELOW_M + high - ABOVE_M)
    } else {
        (low + BELOW_M).min(high)
    }
}

/// The run of heights at (x, z) that belongs to an eye at height y.
fn own_run(v: &WalkVolume, x: f64, z: f64, y: f64) -> Option<[f64; 2]> {
    let off = |[low, high]: [f64; 2]| (low - y).max(y - high).max(0.0);
    v.heights(x, z).filter(|h| off(*h) <= STEP_OVER_M).min_by(|a, b| off(*a).total_cmp(&off(*b)))
}

/// Moves the eye's height toward `raise_m` above the nominal one over the floor.
fn settle(ground: &WalkSpace<'_>, p: DVec3, raise_m: f64, dt_s: f64) -> DVec3 {
    let raised = |goal: f64| goal + raise_m;
    let seen = ground.collision.and_then(|s| s.eye_above_floor(p - DVec3::Y * raise_m)).map(raised);
    let run = ground.volume.and_then(|v| own_run(v, p.x, p.z, p.y));
    let goal = match (seen, ground.volume, run) {
        (Some(goal), Some(_), Some([low, high])) => goal.clamp(low, high),
        (Some(goal), None, _) => goal,
        (None, Some(v), Some(run)) => raised(between_columns(v, p).unwrap_or_else(|| nominal(run))),
        _ => return p,
    };
    let rest = goal - p.y;
    let y = if rest.abs() < SETTLED_M { goal } else { p.y + rest * (1.0 - (-dt_s / RISE_S).exp()) };
    let y = run.map_or(y, |[low, high]| y.clamp((low + INSET_M).min(high - INSET_M), high - INSET_M));
    let settled = DVec3::new(p.x, y, p.z);
    if ground.volume.is_none_or(|v| v.contains(settled)) { settled } else { p }
}

/// The eye's nominal height, interpolated between four columns: a ramp instead of large steps.
fn between_columns(v: &WalkVolume, p: DVec3) -> Option<f64> {
    let (pitch_m, [x0, z0]) = (v.pitch_m(), v.corner());
    let split = |at: f64, corner: f64| {
        let columns = (at - corner) / pitch_m - 0.5;
        (corner + (columns.floor() + 0.5) * pitch_m, columns - columns.floor())
    };
    let ((x, u), (z, w)) = (split(p.x, x0), split(p.z, z0));
    let (mut sum, mut weight) = (0.0, 0.0);
    for (x, z, share) in [
        (x, z, (1.0 - u) * (1.0 - w)),
        (x + pitch_m, z, u * (1.0 - w)),
        (x, z + pitch_m, (1.0 - u) * w),
        (x + pitch_m, z + pitch_m, u * w),
    ] {
        if let Some(run) = own_run(v, x, z, p.y) {
            sum += share * nominal(run);
            weight += share;
        }
    }
    (weight > 1e-3).then(|| sum / weight)
}

/// The place of the volume nearest to `p`, at eye height on foot. None if the volume is empty.
pub fn nearest(v: &WalkVolume, p: DVec3) -> Option<DVec3> {
    if v.contains(p) {
        return Some(p);
    }
    let clamp = |b: &ldi_protocol::Aabb| {
        let inset = DVec3::splat(INSET_M).min(b.size() * 0.5);
        p.clamp(b.min + inset, (b.max - inset).max(b.min + inset))
    };
    let nearest = v.boxes().map(|b| clamp(&b)).filter(|q| v.contains(*q));
    nearest.min_by(|a, b| a.distance_squared(p).total_cmp(&b.distance_squared(p)))
}

/// Eye heights of the storeys at (x, z), ascending.
pub fn storeys(v: &WalkVolume, x: f64, z: f64) -> Vec<f64> {
    v.heights(x, z).map(nominal).collect()
}

/// Directions tested around a start candidate.
const LOOKS: u16 = 16;
/// Number of a level's largest boxes from which [`starts`] selects the most open. A judgement.
const PLACES: usize = 64;
/// Distance beyond which an open direction is not better, metres. A judgement.
const OPEN_M: f64 = 15.0;

/// Largest number of candidates of [`starts`]. Each costs a picture or two, and its data. A
/// judgement.
const STARTS: usize = 8;
/// Smallest distance between candidates, metres: nearer ones show the same. A judgement.
const STARTS_APART_M: f64 = 3.0;

/// Candidates for the start pose, on foot: on the level with the largest area, most open
/// surroundings first, looking in the most open direction, as far as the volume shows (it contains
/// no walls). At least one.
pub fn starts(v: &WalkVolume) -> Vec<Pose> {
    // Levels of half a metre, by floor area.
    let mut levels = std::collections::BTreeMap::<i64, (f64, DVec3, Vec<(f64, DVec3)>)>::new();
    for b in v.boxes() {
        let (size, eye) = (b.size(), nominal([b.min.y, b.max.y]));
        let place = DVec3::new(b.centre().x, eye, b.centre().z);
        let (area, level) = (size.x * size.z, levels.entry((eye * 2.0).round() as i64).or_default());
        level.0 += area;
        level.1 += place * area;
        level.2.push((area, place));
    }
    let centre = Pose { position: v.bounds().centre(), yaw_deg: 0.0, pitch_deg: 0.0 };
    let Some((area, sum, mut boxes)) = levels.into_values().max_by(|a, b| a.0.total_cmp(&b.0)) else {
        return vec![centre];
    };
    boxes.sort_by(|a, b| b.0.total_cmp(&a.0));
    let middle = sum / area.max(1e-9);
    let places = nearest(v, middle).into_iter().chain(boxes.into_iter().take(PLACES).map(|b| b.1));
    let mut open: Vec<(usize, Pose)> = places
        .map(|position| {
            let ways: Vec<(usize, f64)> = ways(v, position).collect();
            let longest = ways.iter().rev().max_by_key(|w| w.0).map_or(0.0, |w| w.1);
            (ways.iter().map(|w| w.0).sum(), Pose { position, yaw_deg: longest, pitch_deg: 0.0 })
        })
        .collect();
    open.sort_by_key(|o| std::cmp::Reverse(o.0));
    let mut out: Vec<Pose> = Vec::new();
    for (_, pose) in open {
        if out.len() < STARTS && out.iter().all(|o| o.position.distance(pose.position) > STARTS_APART_M) {
            out.push(pose);
        }
    }
    out
}

/// Free steps from a place in all directions, with the yaw of each, degrees.
fn ways(v: &WalkVolume, place: DVec3) -> impl Iterator<Item = (usize, f64)> + '_ {
    let step = v.pitch_m().min(0.5);
    let most = (OPEN_M / step).ceil() as u32;
    (0..LOOKS).map(move |look| {
        let yaw_deg = yaw_of(look);
        let ahead = ViewBasis::from_yaw_pitch(yaw_deg, 0.0).forward * step;
        let free = |n: &u32| stand(v, place + ahead * f64::from(*n), STEP_OVER_M).is_some();
        ((1..=most).take_while(free).count(), yaw_deg)
    })
}

/// Radius in which walls are considered around a start candidate, metres.
pub const OUTLOOK_M: f64 = 8.0;

/// The direction with the most room before a wall, within [`OUTLOOK_M`] and the volume, degrees.
/// Neighbouring directions count too.
pub fn outlook_deg(v: &WalkVolume, collision: &CollisionGeometry, place: DVec3) -> f64 {
    const STEP_M: f64 = 0.25;
    let ground = WalkSpace { volume: Some(v), collision: Some(collision), walls: true };
    let open: Vec<usize> = (0..LOOKS)
        .map(|look| {
            let ahead = ViewBasis::from_yaw_pitch(yaw_of(look), 0.0).forward * STEP_M;
            let mut at = place;
            (0..(OUTLOOK_M / STEP_M) as u32)
                .take_while(|_| ground.admit(at, at + ahead).map(|there| at = there).is_some())
                .count()
        })
        .collect();
    let n = open.len();
    let best = (0..n).rev().max_by_key(|i| open[(i + n - 1) % n] + 2 * open[*i] + open[(i + 1) % n]);
    yaw_of(best.unwrap_or(0) as u16)
}

fn yaw_of(look: u16) -> f64 {
    f64::from(look) * 360.0 / f64::from(LOOKS)
}

#[cfg(test)]
#[path = "walker_test.rs"]
mod tests;
