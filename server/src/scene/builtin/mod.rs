//! Built-in scenes: deterministic, with a triangle target, textured and varied in colour so that
//! errors show.
//!
//! In: a name, a triangle target and a seed. Out: a [`Scene`] and a walk through it. They stand in
//! for the models of the papers, which cannot be had: `pipes`, `house` and `plant` for Aliaga and
//! Lastra 1999, `house` for Rafferty et al. 1998 (19 cells, 52 portals), `island` for Shade et al.
//! 1996 (terrain and 1117 trees), `church` for Chang et al. 1999. `town` is what the demo walks
//! through.
//!
//! Tessellation is the free parameter: each scene takes a detail level, and [`build`] searches the
//! level whose triangle count comes closest to the target. Meshes are instanced, so even 40
//! million triangles stay small in memory.

mod church;
pub mod draw;
mod house;
mod island;
pub mod paint;
mod pipes;
mod plant;
mod random;
mod town;

use super::Scene;
use glam::DVec3;

/// A built-in scene with a walk through it.
#[derive(Debug, Clone)]
pub struct Builtin {
    /// The scene.
    pub scene: Scene,
    /// Eye positions of a walk, 1.6 m above the floor.
    pub waypoints: Vec<DVec3>,
}

/// Names and default triangle counts.
pub const NAMES: [(&str, u64); 6] = [
    ("pipes", 1_000_000),
    ("house", 1_750_000),
    ("plant", 2_000_000),
    ("island", 40_600_982),
    ("church", 300_000),
    ("town", 24_000_000),
];

/// Why a built-in scene cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum BuiltinError {
    /// No such scene.
    #[error("there is no built-in scene '{0}'; there are pipes, house, plant, island, church and town")]
    Unknown(String),
    /// The target is out of range.
    #[error("builtin:{name} cannot have {triangles} triangles; ask for 1,000 to 100,000,000")]
    Triangles {
        /// The scene.
        name: String,
        /// What was asked.
        triangles: u64,
    },
}

/// Builds a scene with about `triangles` triangles (instances counted; None: the default of
/// [`NAMES`]).
///
/// The count is the closest that the scene's detail levels offer, as a rule within 10%; small
/// targets may be missed where the coarsest level has more.
///
/// # Errors
/// An unknown name, or a target out of range.
pub fn build(name: &str, triangles: Option<u64>, seed: u64) -> Result<Builtin, BuiltinError> {
    let default = NAMES.iter().find(|n| n.0 == name).ok_or_else(|| BuiltinError::Unknown(name.into()))?.1;
    let target = triangles.unwrap_or(default);
    if !(1_000..=100_000_000).contains(&target) {
        return Err(BuiltinError::Triangles { name: name.into(), triangles: target });
    }
    let make: &dyn Fn(u32) -> Builtin = match name {
        "pipes" => &|d| pipes::build(d, target, seed),
        "house" => &|d| house::build(d, seed),
        "plant" => &|d| plant::build(d, target, seed),
        "island" => &|d| island::build(d, target, seed),
        "church" => &|d| church::build(d, seed),
        _ => &|d| town::build(d, target, seed),
    };
    let mut built = closest(make, target);
    built.scene.name = format!("builtin:{name}?triangles={target}&seed={seed}");
    Ok(built)
}

/// The detail level from 1 to 256 whose count is closest to the target; counts grow with the level.
fn closest(make: &dyn Fn(u32) -> Builtin, target: u64) -> Builtin {
    let (mut low, mut high) = (1, 256);
    while low < high {
        let middle = (low + high) / 2;
        if make(middle).scene.triangles() < target { low = middle + 1 } else { high = middle }
    }
    let above = make(low);
    if low == 1 {
        return above;
    }
    let below = make(low - 1);
    if above.scene.triangles().abs_diff(target) <= below.scene.triangles().abs_diff(target) { above } else { below }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_meet_their_targets() {
        for (name, default) in NAMES {
            for target in [default.min(2_000_000), default / 2] {
                let n = build(name, Some(target), 3).expect("builds").scene.triangles();
                assert!(n.abs_diff(target) * 10 <= target, "{name}: {n} for {target}");
            }
        }
    }

    #[test]
    fn the_house_has_the_papers_cells_and_portals() {
        let b = build("house", None, 0).expect("builds");
        assert_eq!((b.scene.rooms.len(), b.scene.portals.len()), (19, 52));
        let names: Vec<&str> = b.scene.rooms.iter().map(|r| r.name.as_str()).chain(["outside"]).collect();
        for p in &b.scene.portals {
            assert!(p.rooms.iter().all(|r| names.contains(&r.as_str())), "{:?}", p.rooms);
            assert_eq!(p.corners.len(), 4);
        }
    }

    #[test]
    fn the_island_has_the_papers_terrain_and_trees() {
        let b = build("island", None, 0).expect("builds");
        assert_eq!(b.scene.meshes[0].triangles(), 131_072);
        let trees =
            b.scene.instances.iter().filter(|i| b.scene.meshes[i.mesh as usize].triangles() > 30_000).count() - 1;
        assert_eq!(trees, 1117);
    }

    #[test]
    fn everything_is_finite_in_range_and_the_same_every_time() {
        for (name, _) in NAMES {
            let b = build(name, Some(60_000), 7).expect("builds");
            for p in b.scene.meshes.iter().flat_map(|m| &m.primitives) {
                let n = p.positions.len();
                assert!(p.triangles.iter().flatten().all(|i| (*i as usize) < n), "{name}");
                assert!(p.positions.iter().chain(&p.normals).all(|v| v.is_finite()), "{name}");
                assert!(p.normals.iter().all(|v| (v.length() - 1.0).abs() < 1e-3), "{name}");
                assert_eq!((p.normals.len(), p.uvs.len()), (n, n), "{name}");
                assert!((p.material as usize) < b.scene.materials.len());
            }
            assert!(b.waypoints.len() >= 2, "{name}");
            let again = build(name, Some(60_000), 7).expect("builds");
            assert!(format!("{:?}", again.scene) == format!("{:?}", b.scene), "{name}: two runs differ");
            let other = build(name, Some(60_000), 8).expect("builds");
            assert!(other.scene.instances != b.scene.instances, "{name}: the seed changes nothing");
        }
    }
}
