//! Small scenes and random numbers for this stage's tests.

use super::Sees;
use crate::octree::{Clusters, Octree};
use crate::render::Caster;
use crate::scene::{Instance, Mesh, Primitive, Scene};
use crate::walk_volume::{WalkOptions, walk_volume};
use glam::{DAffine3, DVec3, Vec3};
use ldi_protocol::{
    Aabb, OutputCamera,
    index::{BuildSettings, CELLS},
    volume::WalkVolume,
};
use std::sync::Arc;

/// SplitMix64 (Steele, Lea and Flood 2014): the same numbers on every machine.
pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed)
    }
    pub(crate) fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }
    /// Uniform in [0, 1).
    pub(crate) fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// The twelve triangles of a box.
pub(crate) fn block(b: &Aabb) -> Primitive {
    let positions: Vec<Vec3> = b.corners().map(|c| c.as_vec3()).to_vec();
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    Primitive {
        normals: vec![Vec3::Y; positions.len()],
        positions,
        triangles: faces.iter().flat_map(|f| [[f[0], f[1], f[2]], [f[0], f[2], f[3]]]).collect(),
        ..Primitive::default()
    }
}

/// A scene of one mesh, placed once.
pub(crate) fn scene_of(primitives: &[Primitive]) -> Scene {
    Scene {
        name: "test".into(),
        meshes: vec![Mesh { name: "blocks".into(), primitives: primitives.to_vec() }],
        instances: vec![Instance { node: 0, mesh: 0, world_from_mesh: DAffine3::from_translation(DVec3::ZERO) }],
        materials: vec![ldi_protocol::mesh::Material {
            base_colour: [1.0; 4],
            texture: None,
            alpha: ldi_protocol::mesh::Alpha::Opaque,
            unlit: false,
            double_sided: true,
            wrap: [ldi_protocol::mesh::Wrap::Repeat; 2],
        }],
        ..Scene::default()
    }
}

/// Settings for view cells with this budget; 1280 x 720 at 60 degrees, pitch 60, footprint 2.
pub(crate) fn settings(budget: u64) -> BuildSettings {
    BuildSettings {
        budget,
        optimize_budget: budget,
        camera: OutputCamera { width: 1280, height: 720, fov_deg: 60.0 },
        max_footprint_px: 2.0,
        max_deviation_px: 0.5,
        pitch_deg: 60.0,
        density: 1.0,
        colour: "high".into(),
        grid: CELLS.into(),
        eye_height_m: Some(1.6),
    }
}

/// Boxes of a metre or so, strewn over 60 x 8 x 60 metres around the origin, of 20 to 100
/// triangles each.
pub(crate) fn strewn(n: u32, seed: u64) -> (Vec<Aabb>, Vec<u32>) {
    let mut random = Random::new(seed);
    let mut bounds: Vec<Aabb> = (0..n)
        .map(|_| {
            let min = DVec3::new(random.unit(), random.unit(), random.unit()) * DVec3::new(60.0, 8.0, 60.0)
                - DVec3::new(30.0, 2.0, 30.0);
            Aabb { min, max: min + DVec3::new(random.unit(), random.unit(), random.unit()) * 2.0 }
        })
        .collect();
    // Neighbours beside each other, as Morton order gives them.
    bounds.sort_by_key(|b| ((b.min.x / 8.0) as i64, (b.min.z / 8.0) as i64));
    (bounds, (0..n).map(|i| 20 + i % 81).collect())
}

/// The walk volume of a scene for eyes at 1.6 m.
pub(crate) fn walked(scene: &Scene, clusters: &Clusters, octree: &Octree) -> WalkVolume {
    let caster = Caster::new(Arc::new(scene.clone()), clusters, octree);
    let options = WalkOptions { eye_height_m: Some(1.6), ..WalkOptions::default() };
    walk_volume(&caster, clusters, octree, &options).expect("a walk volume").0
}

/// Everything sees everything.
pub const NOTHING_BETWEEN: Sees<'static> = Sees(&|_, _| true);
