//! Where simulated walkers go: one pose per frame of a sixtieth of a second.
//!
//! In: a path file or a seed, a scenario, the walk volume of the manifest. Out: one [`Track`] per
//! walker. Tracks come round again when they end; the same seed gives the same tracks.

use super::LoadError;
use ldi_protocol::{
    OutputCamera, Pose,
    index::Index,
    need::{Needed, Sight, needed},
    path::{TimedPose, Walk},
    select::draw_list,
    stroll::{self, Random, TURN_DEG_S, stroll},
    volume::WalkVolume,
};
use std::sync::{Arc, OnceLock};

/// Frames per second of every walker.
pub const FPS: f64 = stroll::FPS;
/// Turning speed of the scenario `spin`: a quick look over the shoulder.
const SPIN_DEG_S: f64 = 240.0;
/// Time between two jumps of the scenario `teleport`.
const STAY_S: f64 = 2.0;
/// Ends of a path nearer than this make it a round.
const CLOSED_M: f64 = 0.2;

/// How walkers move.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Scenario {
    /// Along the path or at random, each from another place.
    Path,
    /// All from the same place at once.
    Crowd,
    /// Each stands at another place and turns at 240 degrees per second.
    Spin,
    /// Each jumps to another place every 2 seconds.
    Teleport,
}

/// What walkers follow.
#[derive(Debug)]
pub enum Route {
    /// A path file.
    Path(Walk),
    /// Random walks from this seed.
    Random(u64),
}

/// A walker's poses, repeated for ever.
#[derive(Debug, Clone)]
pub struct Track {
    poses: Arc<[Pose]>,
    /// What each pose needs, found once. None where a pose hardly comes again: that would only
    /// fill memory.
    needs: Option<Arc<[OnceLock<Arc<Needed>>]>>,
    offset: usize,
}

impl Track {
    /// Poses that come again and again.
    fn round(poses: Vec<Pose>) -> Self {
        let needs = poses.iter().map(|_| OnceLock::new()).collect();
        Self { needs: Some(needs), ..Self::once(poses) }
    }

    fn once(poses: Vec<Pose>) -> Self {
        Self { poses: poses.into(), needs: None, offset: 0 }
    }

    fn at(&self, offset: usize) -> Self {
        Self { offset: offset % self.poses.len(), ..self.clone() }
    }

    /// The pose of a frame.
    pub fn pose(&self, frame: usize) -> Pose {
        self.poses[(self.offset + frame) % self.poses.len()]
    }

    /// What it needs, with the functions that the client renders with.
    pub fn needed(&self, frame: usize, index: &Index, camera: &OutputCamera) -> Arc<Needed> {
        let find = || {
            let pose = self.pose(frame);
            let list = draw_list(index, &pose, (camera.half_tan_x(), camera.half_tan_y()));
            Arc::new(needed(index, &list.images, &list.cells, &list.tree, &Sight::new(&pose, camera, 1)))
        };
        match &self.needs {
            Some(needs) => needs[(self.offset + frame) % self.poses.len()].get_or_init(find).clone(),
            None => find(),
        }
    }
}

/// The tracks of all walkers, each for `seconds` at least.
///
/// # Errors
/// Random walks in a dataset without a walk volume.
pub fn tracks(
    route: &Route,
    scenario: Scenario,
    walkers: usize,
    seconds: f64,
    volume: Option<&WalkVolume>,
) -> Result<Vec<Track>, LoadError> {
    let frames = (seconds * FPS).ceil() as usize + 1;
    // The walk that each would take, and where on it each begins.
    let walks: Vec<Track> = match route {
        Route::Path(walk) => {
            let round = Track::round(round(walk));
            (0..walkers).map(|i| round.at(i * round.poses.len() / walkers.max(1))).collect()
        }
        Route::Random(seed) => {
            let volume = volume.filter(|v| !v.is_empty()).ok_or(LoadError::NoVolume)?;
            (0..walkers as u64)
                .map(|i| Track::once(stroll(volume, &mut Random::new(*seed, i), frames, |_, _| true)))
                .collect()
        }
    };
    Ok(match scenario {
        Scenario::Path => walks,
        Scenario::Crowd => vec![walks[0].at(0); walkers],
        Scenario::Spin => walks.iter().map(|w| Track::round(spin(w.pose(0)))).collect(),
        Scenario::Teleport => (0..)
            .zip(&walks)
            .map(|(i, w)| {
                let mut random = Random::new(i, 1);
                let mut place = || match (route, volume) {
                    (Route::Random(_), Some(v)) => random.place(v),
                    _ => w.pose((random.uniform() * w.poses.len() as f64) as usize),
                };
                let stay = (STAY_S * FPS) as usize;
                Track::once((0..frames.div_ceil(stay)).flat_map(|_| vec![place(); stay]).collect())
            })
            .collect(),
    })
}

/// A path at 60 poses per second, closed to a round: where it does not end at its beginning the
/// walker turns and goes back.
fn round(walk: &Walk) -> Vec<Pose> {
    let (first, last) = (walk.poses[0], walk.poses[walk.poses.len() - 1]);
    let frames = ((last.t_s - first.t_s) * FPS).floor().max(0.0) as usize + 1;
    let at = |frame: usize| {
        // Half a microsecond: times are sums of fractions.
        let t = first.t_s + frame as f64 / FPS + 5e-7;
        walk.poses[walk.poses.partition_point(|p: &TimedPose| p.t_s <= t).max(1) - 1].pose
    };
    let mut there: Vec<Pose> = (0..frames).map(at).collect();
    let (a, b) = (there[0], there[there.len() - 1]);
    if a.position.distance(b.position) < CLOSED_M {
        there.extend(turning(b, a.yaw_deg));
        return there;
    }
    let about = |p: &Pose| Pose { yaw_deg: p.yaw_deg + 180.0, ..*p };
    let back: Vec<Pose> = there.iter().rev().map(about).collect();
    there.extend(turning(b, b.yaw_deg + 180.0));
    there.extend(&back);
    there.extend(turning(back[back.len() - 1], a.yaw_deg));
    there
}

/// Turns on the spot to a heading, the shorter way; without the first and last pose.
fn turning(from: Pose, to_deg: f64) -> impl Iterator<Item = Pose> {
    let by = (to_deg - from.yaw_deg + 180.0).rem_euclid(360.0) - 180.0;
    let steps = (by.abs() / (TURN_DEG_S / FPS)).ceil() as usize;
    (1..steps).map(move |i| Pose { yaw_deg: from.yaw_deg + by * i as f64 / steps as f64, ..from })
}

fn spin(at: Pose) -> Vec<Pose> {
    let steps = (360.0 * FPS / SPIN_DEG_S) as u32;
    (0..steps).map(|i| Pose { yaw_deg: at.yaw_deg + 360.0 * f64::from(i) / f64::from(steps), ..at }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use ldi_protocol::{Aabb, path};

    fn walk(json: &str) -> Route {
        Route::Path(path::parse(json).expect("a path"))
    }

    const LINE: &str = r#"{"waypoints": [[0, 1.6, 0], [0, 1.6, -7]]}"#;
    const SQUARE: &str = r#"{"fps": 30, "closed": true, "waypoints": [[0,1.6,0], [0,1.6,-3], [3,1.6,-3], [3,1.6,0]]}"#;

    /// The longest step and turn between neighbours, the end and the beginning included.
    fn largest_steps(t: &Track) -> (f64, f64) {
        let n = t.poses.len();
        (0..n).fold((0.0, 0.0), |(step, turn), i| {
            let (a, b) = (t.pose(i), t.pose(i + 1));
            let turned = (b.yaw_deg - a.yaw_deg + 180.0).rem_euclid(360.0) - 180.0;
            (a.position.distance(b.position).max(step), turned.abs().max(turn))
        })
    }

    #[test]
    fn a_path_comes_round_at_walking_speed() {
        for (json, metres, fps) in [(LINE, 14.0, 60.0), (SQUARE, 12.0, 30.0)] {
            let t = &tracks(&walk(json), Scenario::Path, 1, 10.0, None).expect("tracks")[0];
            let (step, turn) = largest_steps(t);
            assert!(step <= 1.4 / fps + 1e-9, "{json}: a step of {step} m");
            assert!(turn <= 120.0 / fps + 1e-9, "{json}: a turn of {turn} degrees");
            let walked: f64 = (0..t.poses.len()).map(|i| t.pose(i).position.distance(t.pose(i + 1).position)).sum();
            assert!((walked - metres).abs() < 0.1, "{json}: {walked} m");
        }
    }

    #[test]
    fn walkers_begin_at_different_places_and_a_crowd_at_one() {
        let at = |scenario| -> Vec<DVec3> {
            let t = tracks(&walk(LINE), scenario, 4, 10.0, None).expect("tracks");
            t.iter().map(|t| t.pose(0).position).collect()
        };
        let (spread, crowd) = (at(Scenario::Path), at(Scenario::Crowd));
        assert!(spread[0].distance(spread[1]) > 2.0 && spread[1].distance(spread[2]) > 2.0, "{spread:?}");
        assert!(crowd.iter().all(|p| *p == crowd[0]));
    }

    #[test]
    fn spinning_walkers_stand_and_jumping_ones_jump() {
        let t = &tracks(&walk(LINE), Scenario::Spin, 2, 10.0, None).expect("tracks")[1];
        let (step, turn) = largest_steps(t);
        assert_eq!((step, turn.round()), (0.0, 4.0));
        let t = &tracks(&walk(LINE), Scenario::Teleport, 2, 10.0, None).expect("tracks")[1];
        let jumps = (0..600).filter(|i| t.pose(*i).position != t.pose(i + 1).position).count();
        assert!((3..=5).contains(&jumps), "{jumps}");
    }

    #[test]
    fn random_walks_stay_in_the_volume_and_come_again_from_their_seed() {
        let room = Aabb { min: DVec3::new(-3.0, 1.1, -2.0), max: DVec3::new(3.0, 2.0, 2.0) };
        let volume = WalkVolume::of_box(&room).expect("a box");
        let make = |seed| tracks(&Route::Random(seed), Scenario::Path, 3, 60.0, Some(&volume)).expect("tracks");
        let (a, b, other) = (make(5), make(5), make(6));
        let poses = |t: &[Track]| t.iter().map(|t| t.poses.to_vec()).collect::<Vec<_>>();
        assert_eq!(poses(&a), poses(&b));
        assert_ne!(poses(&a), poses(&other));
        for t in &a {
            assert!(t.poses.iter().all(|p| volume.contains(p.position)));
            let walked: f64 = t.poses.windows(2).map(|p| p[0].position.distance(p[1].position)).sum();
            assert!(walked > 20.0, "{walked} m in a minute");
        }
        assert!(a[0].pose(0) != a[1].pose(0));
        let none = tracks(&Route::Random(1), Scenario::Path, 1, 1.0, None);
        assert!(matches!(none, Err(LoadError::NoVolume)));
    }
}
