//! Slopes over a run: whether a server's memory, descriptors or threads grow.

use super::ServerSecond;
use serde_json::{Value, json};

/// Seconds per hour.
const HOUR_S: f64 = 3600.0;

/// Growth per hour of values over time in seconds: the slope of the least-squares line. None where
/// all are of one time, or there are fewer than two.
pub fn per_hour(points: impl Iterator<Item = (f64, f64)> + Clone) -> Option<f64> {
    let n = points.clone().count() as f64;
    let mean = |of: &dyn Fn((f64, f64)) -> f64| points.clone().map(of).sum::<f64>() / n;
    let (mean_t, mean_v) = (mean(&|p| p.0), mean(&|p| p.1));
    let over = |of: &dyn Fn(f64, f64) -> f64| points.clone().map(|(t, v)| of(t - mean_t, v - mean_v)).sum::<f64>();
    let spread = over(&|t, _| t * t);
    (spread > 0.0).then(|| over(&|t, v| t * v) / spread * HOUR_S)
}

/// Slopes per hour of what the server holds, from the samples after `from_s`, when all walkers are
/// in. None with fewer than two samples.
pub fn slopes(server: &[ServerSecond], from_s: f64) -> Option<Value> {
    let samples: Vec<&ServerSecond> = server.iter().filter(|s| s.at_s >= from_s).collect();
    let slope = |of: &dyn Fn(&ServerSecond) -> u64| per_hour(samples.iter().map(|s| (s.at_s, of(s) as f64)));
    let descriptors = samples.iter().all(|s| s.descriptors.is_some());
    let seconds = samples.last()?.at_s - samples.first()?.at_s;
    Some(json!({
        "samples": samples.len(),
        "seconds": seconds,
        "rss_bytes": slope(&|s| s.rss_bytes)?,
        "anonymous_bytes": slope(&|s| s.anonymous_bytes)?,
        "descriptors": descriptors.then(|| slope(&|s| s.descriptors.unwrap_or_default())),
        "threads": slope(&|s| s.threads)?,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(found: Option<f64>, expected: f64) -> bool {
        found.is_some_and(|f| (f - expected).abs() <= 1e-9 * expected.abs().max(1.0))
    }

    #[test]
    fn a_line_has_its_slope_and_noise_around_it_little_more() {
        let line = |k: u32| (f64::from(k), 7e8 + 250.0 * f64::from(k));
        assert!(close(per_hour((0..3600).map(line)), 900_000.0));
        // Samples far apart weigh as those that are near.
        assert!(close(per_hour([0, 1, 2, 3000].into_iter().map(line)), 900_000.0));
        // A steady saw of 40 units has no slope to speak of.
        let saw = |k: u32| (f64::from(k), f64::from(k % 41));
        assert!(per_hour((0..41 * 90).map(saw)).is_some_and(|s| s.abs() < 40.0));
        // One sample per second, of the times 1 to 4 and the values 1, 2, 2, 3: 0.6 per second.
        let few = [(1.0, 1.0), (2.0, 2.0), (3.0, 2.0), (4.0, 3.0)];
        assert!(close(per_hour(few.into_iter()), 0.6 * 3600.0));
    }

    #[test]
    fn what_has_no_length_has_no_slope() {
        assert_eq!(per_hour([].into_iter()), None);
        assert_eq!(per_hour([(3.0, 9.0)].into_iter()), None);
        assert_eq!(per_hour([(3.0, 9.0), (3.0, 10.0)].into_iter()), None);
        assert!(slopes(&[], 0.0).is_none());
    }

    /// A server that fills its caches while walkers come in, and leaks one descriptor per minute.
    #[test]
    fn the_time_before_all_are_in_does_not_count() {
        let second = |k: u32| ServerSecond {
            at_s: f64::from(k),
            cpu_s: 0.0,
            rss_bytes: 1_000_000 * u64::from(k.min(30)),
            anonymous_bytes: 5_000,
            descriptors: Some(20 + u64::from(k / 60)),
            threads: 9,
        };
        let server: Vec<ServerSecond> = (1..=3630).map(second).collect();
        let found = slopes(&server, 30.0).expect("enough samples");
        assert_eq!((&found["samples"], &found["seconds"]), (&3601.into(), &3600.0.into()));
        assert_eq!((&found["rss_bytes"], &found["threads"]), (&0.0.into(), &0.0.into()));
        assert!(found["descriptors"].as_f64().is_some_and(|d| (d - 60.0).abs() < 0.5), "{found}");
        assert!(slopes(&server, 0.0).expect("enough")["rss_bytes"].as_f64().is_some_and(|b| b > 1e5));
    }
}
