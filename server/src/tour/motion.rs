//! Poses along a route, as a person moves: looking ahead, slow in turns, at rest where much is
//! seen.
//!
//! In: stops with the ways between them. Out: timed poses on these ways.

use super::route::Stop;
use glam::DVec3;
use ldi_protocol::{Pose, path::TimedPose};

/// Poses per second.
pub const FPS: f64 = 60.0;
/// Walking speed, metres per second.
pub const SPEED_M_S: f64 = 1.4;
/// Change of speed, metres per second squared.
const ACCELERATION: f64 = 1.5;
/// Fastest turn, degrees per second.
const TURN_DEG_S: f64 = 90.0;
/// Share of a turn that is left after a second: smaller turns faster.
const TURN_LEFT: f64 = 0.03;
/// One looks so far ahead along the way, metres.
const AHEAD_M: f64 = 1.5;
/// One walks only while looking less than this aside of the way, degrees.
const ASIDE_DEG: f64 = 50.0;
/// Rest at a stop once the view is in sight, seconds.
const REST_S: f64 = 1.5;
/// Longest stay at a stop, seconds.
const LONGEST_STAY_S: f64 = 5.0;
/// A view is in sight when it is nearer to the middle than this, degrees.
const IN_SIGHT_DEG: f64 = 5.0;
/// Share of a slope that the eye follows up or down.
const SLOPE: f64 = 0.5;
/// Places are rounded to so many per metre, angles to so many per degree.
const PER_METRE: f64 = 1e4;
/// See [`PER_METRE`].
const PER_DEGREE: f64 = 1e3;

/// A polyline by length.
struct Way<'a> {
    points: &'a [DVec3],
    /// Length up to each point, metres.
    until_m: Vec<f64>,
}

impl<'a> Way<'a> {
    fn new(points: &'a [DVec3]) -> Self {
        let mut until_m = vec![0.0];
        for pair in points.windows(2) {
            until_m.push(until_m[until_m.len() - 1] + pair[0].distance(pair[1]));
        }
        Self { points, until_m }
    }

    fn length_m(&self) -> f64 {
        self.until_m[self.until_m.len() - 1]
    }

    fn at(&self, along_m: f64) -> DVec3 {
        let n = self.until_m.partition_point(|u| *u <= along_m);
        if n >= self.points.len() {
            return self.points[self.points.len() - 1];
        }
        let [from, to] = [self.until_m[n - 1], self.until_m[n]];
        self.points[n - 1].lerp(self.points[n], (along_m - from) / (to - from))
    }
}

/// A walker on the way.
struct Walker<'a> {
    poses: Vec<TimedPose>,
    /// Poses in all.
    most: usize,
    is_inside: &'a dyn Fn(DVec3) -> bool,
    position: DVec3,
    yaw_deg: f64,
    pitch_deg: f64,
    speed: f64,
}

/// Poses for so many seconds; a route that is shorter ends with looking around. Rounded places are
/// used where they lie inside.
pub fn poses(stops: &[Stop], seconds: f64, is_inside: &dyn Fn(DVec3) -> bool) -> Vec<TimedPose> {
    let most = (seconds * FPS).round().max(1.0) as usize;
    let position = stops[0].way[0];
    // The first look is along the first way.
    let first = stops.get(1).map_or(stops[0].look_deg, |s| heading_deg(s.way[1] - s.way[0], stops[0].look_deg));
    let mut walker = Walker {
        poses: Vec::with_capacity(most),
        most,
        is_inside,
        position,
        yaw_deg: first,
        pitch_deg: 0.0,
        speed: 0.0,
    };
    for stop in &stops[1..] {
        walker.walk(&stop.way);
        walker.rest(stop.look_deg);
    }
    let mut look_deg = walker.yaw_deg;
    while !walker.is_done() {
        look_deg += 90.0;
        walker.rest(look_deg);
    }
    walker.poses
}

impl Walker<'_> {
    fn is_done(&self) -> bool {
        self.poses.len() >= self.most
    }

    fn walk(&mut self, points: &[DVec3]) {
        let way = Way::new(points);
        let length_m = way.length_m();
        let mut along_m = 0.0;
        while along_m < length_m && !self.is_done() {
            self.position = way.at(along_m);
            let ahead = way.at((along_m + AHEAD_M).min(length_m)) - self.position;
            let level_m = ahead.with_y(0.0).length();
            let heading = heading_deg(ahead, self.yaw_deg);
            let slope_deg = if level_m > 0.3 { ahead.y.atan2(level_m).to_degrees() * SLOPE } else { 0.0 };
            self.turn(heading, slope_deg);
            let aside = turn_deg(self.yaw_deg, heading).abs();
            let rest = length_m - along_m;
            let wanted = SPEED_M_S * (1.0 - aside / ASIDE_DEG).clamp(0.0, 1.0);
            // Slow enough to end at rest.
            let wanted = wanted.min((2.0 * ACCELERATION * rest).sqrt().max(0.1));
            let change = ACCELERATION / FPS;
            self.speed += (wanted - self.speed).clamp(-2.0 * change, change);
            self.keep();
            along_m += self.speed / FPS;
        }
        if !self.is_done() {
            self.position = points[points.len() - 1];
        }
        self.speed = 0.0;
    }

    fn rest(&mut self, look_deg: f64) {
        let (mut stayed_s, mut seen_s) = (0.0, 0.0);
        while !self.is_done() && seen_s < REST_S && stayed_s < LONGEST_STAY_S {
            self.turn(look_deg, 0.0);
            self.keep();
            stayed_s += 1.0 / FPS;
            if turn_deg(self.yaw_deg, look_deg).abs() < IN_SIGHT_DEG {
                seen_s += 1.0 / FPS;
            }
        }
    }

    fn turn(&mut self, yaw_deg: f64, pitch_deg: f64) {
        let share = 1.0 - TURN_LEFT.powf(1.0 / FPS);
        let most = TURN_DEG_S / FPS;
        self.yaw_deg += (turn_deg(self.yaw_deg, yaw_deg) * share).clamp(-most, most);
        self.pitch_deg += ((pitch_deg - self.pitch_deg) * share).clamp(-most, most);
    }

    fn keep(&mut self) {
        let rounded = (self.position * PER_METRE).round() / PER_METRE;
        let position = if (self.is_inside)(rounded) { rounded } else { self.position };
        let angle = |deg: f64| (deg * PER_DEGREE).round() / PER_DEGREE;
        let yaw_deg = angle(turn_deg(0.0, self.yaw_deg));
        let pose = Pose { position, yaw_deg, pitch_deg: angle(self.pitch_deg) };
        self.poses.push(TimedPose { t_s: self.poses.len() as f64 / FPS, pose });
    }
}

/// Yaw along a direction; `otherwise` for one straight up or down.
fn heading_deg(direction: DVec3, otherwise: f64) -> f64 {
    if direction.with_y(0.0).length() < 1e-6 { otherwise } else { (-direction.x).atan2(-direction.z).to_degrees() }
}

/// Signed turn from one heading to another, in [-180, 180).
fn turn_deg(from: f64, to: f64) -> f64 {
    (to - from + 180.0).rem_euclid(360.0) - 180.0
}
