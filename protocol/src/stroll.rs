//! Random walks through a walk volume: what load tests walk, and what builds that choose a
//! representation are judged by.

use crate::{Pose, volume::WalkVolume};
use glam::DVec3;

/// Poses per second.
pub const FPS: f64 = 60.0;
/// Walking speed, m/s: that of path files.
pub const SPEED_M_S: f64 = 1.4;
/// Turning speed, degrees per second, as along waypoints.
pub const TURN_DEG_S: f64 = 120.0;
/// Walkers change their mind once in this time on average, besides at walls; seconds.
const WHIM_S: f64 = 4.0;
/// Thresholds are climbed up to this height within one step.
const CLIMB_M: f64 = 0.05;

/// Straight on until a wall or a whim, then a turn: `poses` of them, [`FPS`] per second, from
/// somewhere in the volume, level. `free` says whether one can go straight from one place to the
/// next, a few centimetres on: a volume knows floors, but no walls.
pub fn stroll(
    volume: &WalkVolume,
    random: &mut Random,
    poses: usize,
    free: impl Fn(DVec3, DVec3) -> bool,
) -> Vec<Pose> {
    let mut pose = random.place(volume);
    let mut heading = pose.yaw_deg;
    let mut out = Vec::with_capacity(poses);
    while out.len() < poses {
        out.push(pose);
        let left = (heading - pose.yaw_deg + 180.0).rem_euclid(360.0) - 180.0;
        if left.abs() > 1.0 {
            pose.yaw_deg += left.clamp(-TURN_DEG_S / FPS, TURN_DEG_S / FPS);
            continue;
        }
        let ahead = pose.position + pose.basis().forward * (SPEED_M_S / FPS);
        let step = [0.0, CLIMB_M, -CLIMB_M]
            .map(|y| ahead + DVec3::Y * y)
            .into_iter()
            .find(|p| volume.contains(*p) && free(pose.position, *p));
        match step {
            Some(p) if random.uniform() > 1.0 / (WHIM_S * FPS) => pose.position = p,
            _ => heading = 360.0 * random.uniform(),
        }
    }
    out
}

/// Numbers from a seed: SplitMix64 (Steele, Lea and Flood 2014).
#[derive(Debug)]
pub struct Random(u64);

impl Random {
    /// The same numbers for the same seed and stream.
    pub fn new(seed: u64, stream: u64) -> Self {
        let mut r = Self(seed.wrapping_mul(0xd134_2543_de82_ef95).wrapping_add(stream));
        // Neighbouring states begin alike.
        (0..2).for_each(|_| r = Self(r.bits()));
        r
    }

    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    /// In [0, 1).
    pub fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 * (-53f64).exp2()
    }

    /// Somewhere in the volume, looking anywhere, level.
    pub fn place(&mut self, volume: &WalkVolume) -> Pose {
        let position = volume.sampler().point([self.uniform(), self.uniform(), self.uniform(), self.uniform()]);
        Pose { position: position.unwrap_or_default(), yaw_deg: 360.0 * self.uniform(), pitch_deg: 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Aabb;

    #[test]
    fn walkers_do_not_go_where_they_are_not_free_to() {
        let room = Aabb { min: DVec3::new(-3.0, 1.1, -2.0), max: DVec3::new(3.0, 2.0, 2.0) };
        let volume = WalkVolume::of_box(&room).expect("a box");
        // A wall across the room.
        let free_of_wall = |a: DVec3, b: DVec3| (a.x < 1.0) == (b.x < 1.0);
        let crossings = |free: &dyn Fn(DVec3, DVec3) -> bool| -> Vec<usize> {
            let walks = (0..20).map(|i| stroll(&volume, &mut Random::new(1, i), 3_600, free));
            walks.map(|w| w.windows(2).filter(|p| !free_of_wall(p[0].position, p[1].position)).count()).collect()
        };
        assert!(crossings(&|_, _| true).iter().sum::<usize>() > 20);
        assert_eq!(crossings(&free_of_wall).iter().sum::<usize>(), 0);
    }
}
