//! Frame times while the eye moves: render times, and intervals between pictures.

use ldi_protocol::Pose;
use std::time::Instant;

/// Largest number of recorded pictures.
const MOST: usize = 216_000;

/// Collects frame times.
#[derive(Debug, Default)]
pub struct FrameTimes {
    last: Option<(Pose, Instant)>,
    /// Whether the previous picture also showed a new pose.
    moving: bool,
    drawn_ms: Vec<f64>,
    between_ms: Vec<f64>,
}

/// Summary of a walk's frame times.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize)]
pub struct Summary {
    /// Consecutive pictures of a moving eye.
    pub pictures: usize,
    /// Render times, milliseconds: median, 99th percentile, largest; null without pictures.
    pub drawn_ms: Option<[f64; 3]>,
    /// Intervals between pictures, milliseconds: median, 99th percentile, largest.
    pub between_ms: Option<[f64; 3]>,
}

impl FrameTimes {
    /// Records a picture: its pose, render time, and the time it was finished.
    pub fn picture(&mut self, pose: &Pose, drawn_ms: f64, at: Instant) {
        let moved = self.last.is_some_and(|(last, _)| last != *pose);
        if let (Some((_, last)), true) = (self.last, moved && self.moving && self.drawn_ms.len() < MOST) {
            self.drawn_ms.push(drawn_ms);
            self.between_ms.push(at.saturating_duration_since(last).as_secs_f64() * 1e3);
        }
        (self.moving, self.last) = (moved, Some((*pose, at)));
    }

    /// The summary so far.
    pub fn summary(&self) -> Summary {
        Summary {
            pictures: self.drawn_ms.len(),
            drawn_ms: quantiles(&self.drawn_ms),
            between_ms: quantiles(&self.between_ms),
        }
    }
}

/// Median, 99th percentile and largest value, by nearest rank.
fn quantiles(values: &[f64]) -> Option<[f64; 3]> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = |share: f64| sorted.get(((sorted.len() as f64 * share).ceil() as usize).saturating_sub(1)).copied();
    Some([at(0.5)?, at(0.99)?, at(1.0)?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use std::time::Duration;

    #[test]
    fn only_pictures_of_a_moving_eye_count() {
        let (mut frame_times, start) = (FrameTimes::default(), Instant::now());
        let pose = |x: f64| Pose { position: DVec3::new(x, 0.0, 0.0), yaw_deg: 0.0, pitch_deg: 0.0 };
        // At rest, a minute's pause, two steps 20 and 30 ms apart, rest.
        for (x, at_ms, drawn_ms) in [
            (0.0, 0, 99.0),
            (0.0, 100, 99.0),
            (1.0, 60_000, 99.0),
            (2.0, 60_020, 5.0),
            (3.0, 60_050, 7.0),
            (3.0, 61_000, 99.0),
        ] {
            frame_times.picture(&pose(x), drawn_ms, start + Duration::from_millis(at_ms));
        }
        let s = frame_times.summary();
        assert_eq!((s.pictures, s.drawn_ms), (2, Some([5.0, 7.0, 7.0])));
        let between = s.between_ms.unwrap();
        assert!((between[0] - 20.0).abs() < 1e-6 && (between[2] - 30.0).abs() < 1e-6, "{between:?}");
        assert_eq!(FrameTimes::default().summary(), Summary::default());
    }
}
