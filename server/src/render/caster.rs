//! The ray caster: which kernel runs, f64 outside and f32 inside.
//!
//! Traversal finds the nearest triangle in f32, relative to the middle of the scene; its t, u and
//! v are then computed anew in f64 from the corners as the hierarchy stores them. So a hit's depth
//! is as exact as those corners: within about 1e-7 of the scene's size.

use super::{
    alpha::AlphaMasks,
    bvh::{Block, Bvh, MOST_EXPANDED},
    cell_set::CellSet,
    geometry::{Geometry, TriangleSource},
    lanes::{Array, Lanes},
    packet::{PACKET, Packet, PacketRay},
    ray::{Hit, Ray, RayFootprint},
    shading::{self, SurfacePoint, Textures},
    single::{self, NO_ITEM, Nearest, ShortRay},
};
use crate::{
    octree::{Clusters, Octree},
    scene::Scene,
};
use glam::DVec3;
use ldi_protocol::CellRuns;
use std::sync::Arc;

/// Casts rays at a scene.
pub struct Caster {
    geometry: Geometry,
    textures: Textures,
    bvh: Bvh,
    masks: AlphaMasks,
    isa: Isa,
}

/// Which instructions the kernels use. All give the same hits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Isa {
    /// Plain Rust.
    Portable,
    /// SSE2 and AVX2.
    #[cfg(target_arch = "x86_64")]
    Avx2,
}

impl Isa {
    /// The best that this machine has.
    fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            return Self::Avx2;
        }
        Self::Portable
    }
}

impl Caster {
    /// A caster whose rays can be limited to cells of the octree.
    pub fn new(scene: Arc<Scene>, clusters: &Clusters, octree: &Octree) -> Self {
        let geometry = Geometry::new(scene, Some((clusters, octree)));
        Self::from_geometry(geometry, Some(clusters), false, MOST_EXPANDED)
    }

    /// A caster of the whole scene, in one cell with number 0; `mips` prepares textures for
    /// footprints.
    pub fn of_scene(scene: Arc<Scene>, mips: bool) -> Self {
        Self::from_geometry(Geometry::new(scene, None), None, mips, MOST_EXPANDED)
    }

    /// The same caster with all mip levels of its textures, for [`Caster::shade`] with footprints.
    #[must_use]
    pub fn with_mips(mut self) -> Self {
        self.textures = Textures::new(&self.geometry, true);
        self
    }

    fn from_geometry(geometry: Geometry, clusters: Option<&Clusters>, mips: bool, most_expanded: u64) -> Self {
        let textures = Textures::new(&geometry, mips);
        let solid: Vec<bool> = geometry.scene.materials.iter().map(shading::is_solid).collect();
        let bvh = Bvh::new(&geometry, clusters, |p| !solid[p.material as usize], most_expanded);
        let masks = AlphaMasks::new(&geometry, &textures, &bvh);
        Self { geometry, textures, bvh, masks, isa: Isa::detect() }
    }

    /// The same caster on other instructions, to compare.
    #[cfg(test)]
    pub(super) fn on(mut self, isa: Isa) -> Self {
        self.isa = isa;
        self
    }

    /// A set of these cells for [`Caster::trace`] and its kin; see [`CellSet`].
    pub fn cell_set(&self, cells: &CellRuns) -> CellSet {
        CellSet::of(cells, &self.geometry, &self.bvh)
    }

    /// All cells that are not in a set.
    pub fn cells_besides(&self, cells: &CellSet) -> CellSet {
        CellSet::besides(cells, &self.geometry, &self.bvh)
    }

    /// The closest hit among triangles of `cells`; of hits at the same t, the triangle with the
    /// smallest number. Alpha-masked texels are transparent, both faces are hit. The ray's limits
    /// hold to f32 precision.
    pub fn trace(&self, ray: &Ray, cells: &CellSet) -> Option<Hit> {
        self.trace_one(ray, cells, false)
    }

    /// Whether anything in `cells` lies on the ray between its t_min and t_max; faster than
    /// [`Caster::trace`].
    pub fn occluded(&self, ray: &Ray, cells: &CellSet) -> bool {
        self.trace_one(ray, cells, true).is_some()
    }

    /// [`Caster::trace`] of every ray, with the same results. Fast where neighbours in the slice
    /// are alike and share their origin: 64 consecutive rays that lie within some pixels of each
    /// other cost little more than a few single ones. Runs on the calling thread.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn trace_batch(&self, rays: &[Ray], cells: &CellSet, hits: &mut [Option<Hit>]) {
        assert_eq!(rays.len(), hits.len(), "one hit per ray");
        for (rays, hits) in rays.chunks(PACKET).zip(hits.chunks_mut(PACKET)) {
            self.trace_chunk(rays, cells, hits, false);
        }
    }

    /// Of every ray some hit if there is one, not always the nearest; faster than
    /// [`Caster::trace_batch`].
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn trace_any(&self, rays: &[Ray], cells: &CellSet, hits: &mut [Option<Hit>]) {
        assert_eq!(rays.len(), hits.len(), "one hit per ray");
        for (rays, hits) in rays.chunks(PACKET).zip(hits.chunks_mut(PACKET)) {
            self.trace_chunk(rays, cells, hits, true);
        }
    }

    /// The octree cell of a triangle.
    #[inline]
    pub fn cell_of(&self, triangle: u32) -> u32 {
        self.geometry.cell_of(triangle)
    }

    /// Where a triangle comes from.
    pub fn source(&self, triangle: u32) -> TriangleSource {
        self.geometry.source(triangle)
    }

    /// Number of triangles, instances counted.
    pub fn triangle_count(&self) -> u32 {
        self.geometry.triangle_count
    }

    /// The scene.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.geometry.scene
    }

    /// World corners of a triangle.
    pub fn corners_world(&self, triangle: u32) -> [DVec3; 3] {
        self.geometry.corners_world(triangle)
    }

    /// Point, normals and source of a hit.
    pub fn surface(&self, hit: &Hit, ray: &Ray) -> SurfacePoint {
        shading::surface(&self.geometry, hit, ray)
    }

    /// Colour of a hit in linear light. Textures are read bilinearly in level 0, or, with a
    /// footprint and a caster with mips, trilinearly.
    pub fn shade(&self, hit: &Hit, ray: &Ray, footprint: Option<&RayFootprint>) -> [f32; 3] {
        shading::shade(&self.geometry, &self.textures, hit, ray, footprint)
    }

    fn short(&self, ray: &Ray) -> ShortRay {
        ShortRay {
            origin: (ray.origin - self.geometry.origin).as_vec3().to_array(),
            direction: ray.direction.as_vec3().to_array(),
            t_min: ray.t_min as f32,
            t_max: ray.t_max as f32,
        }
    }

    fn trace_one(&self, ray: &Ray, cells: &CellSet, any: bool) -> Option<Hit> {
        let nearest = match self.isa {
            Isa::Portable => self.one::<Array<8>, Array<4>>(ray, cells, any),
            // SAFETY: AVX2 was detected when the value was made.
            #[cfg(target_arch = "x86_64")]
            Isa::Avx2 => unsafe { self.one_avx2(ray, cells, any) },
        };
        nearest.map(|n| self.refined(ray, &n))
    }

    fn trace_chunk(&self, rays: &[Ray], cells: &CellSet, hits: &mut [Option<Hit>], any: bool) {
        let done = match self.isa {
            Isa::Portable => self.packet::<Array<8>, Array<4>>(rays, cells, hits, any),
            // SAFETY: AVX2 was detected when the value was made.
            #[cfg(target_arch = "x86_64")]
            Isa::Avx2 => unsafe { self.packet_avx2(rays, cells, hits, any) },
        };
        if done {
            return;
        }
        // Halves may be alike where the whole is not: a row of pixels, the two sides of a gap.
        if rays.len() >= 16 {
            let half = (rays.len() / 2).next_multiple_of(8);
            let (first, second) = hits.split_at_mut(half);
            self.trace_chunk(&rays[..half], cells, first, any);
            self.trace_chunk(&rays[half..], cells, second, any);
        } else {
            for (ray, hit) in rays.iter().zip(hits) {
                *hit = self.trace_one(ray, cells, any);
            }
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn one_avx2(&self, ray: &Ray, cells: &CellSet, any: bool) -> Option<Nearest> {
        self.one::<super::lanes::x86::F8, super::lanes::x86::F4>(ray, cells, any)
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn packet_avx2(&self, rays: &[Ray], cells: &CellSet, hits: &mut [Option<Hit>], any: bool) -> bool {
        self.packet::<super::lanes::x86::F8, super::lanes::x86::F4>(rays, cells, hits, any)
    }

    #[inline(always)]
    fn one<F8: Lanes<8>, F4: Lanes<4>>(&self, ray: &Ray, cells: &CellSet, any: bool) -> Option<Nearest> {
        let is_there = |found: &Nearest| self.is_there(ray, found);
        single::trace::<F8, F4>(&self.bvh, &self.short(ray), cells.masks(), any, &is_there)
    }

    /// Traces up to 64 rays at once; false if they do not make a packet.
    #[inline(always)]
    fn packet<F8: Lanes<8>, F4: Lanes<4>>(
        &self,
        rays: &[Ray],
        cells: &CellSet,
        hits: &mut [Option<Hit>],
        any: bool,
    ) -> bool {
        let Some(first) = rays.first() else { return true };
        if rays.iter().any(|r| r.origin != first.origin) {
            return false;
        }
        let mut short: [PacketRay; PACKET] = [([0.0; 3], 0.0, 0.0); PACKET];
        let Some(short) = short.get_mut(..rays.len()) else { return false };
        for (s, r) in short.iter_mut().zip(rays) {
            *s = (r.direction.as_vec3().to_array(), r.t_min as f32, r.t_max as f32);
        }
        let Some(mut packet) = Packet::new(self.short(first).origin, short, any) else { return false };
        // Groups that are not full repeat the last ray.
        let is_there = |ray: usize, found: &Nearest| self.is_there(&rays[ray.min(rays.len() - 1)], found);
        packet.trace::<F8, F4>(&self.bvh, cells.masks(), &is_there);
        for (i, (ray, hit)) in rays.iter().zip(hits).enumerate() {
            *hit = packet.nearest(i).map(|n| self.refined(ray, &n));
        }
        true
    }

    fn block(&self, found: &Nearest) -> &Block {
        let branches = if found.item == NO_ITEM { &self.bvh.world } else { &self.bvh.local };
        &branches.blocks[found.slot as usize / 4]
    }

    /// Whether a hit of an alpha-masked triangle counts.
    fn is_there(&self, ray: &Ray, found: &Nearest) -> bool {
        let hit = self.refined(ray, found);
        !self.masks.is_cut_out(&self.textures, self.block(found), found.slot % 4, hit.u, hit.v)
    }

    /// Corners of a hit's triangle relative to the middle of the scene, as the hierarchy stores
    /// them.
    fn corners_of(&self, found: &Nearest) -> [DVec3; 3] {
        let corners = self.block(found).corners_of(found.slot as usize % 4);
        match self.bvh.items.get(found.item as usize) {
            Some(item) => {
                let place = &self.bvh.places[item.place as usize];
                let world_from_mesh = &self.scene().instances[place.instance as usize].world_from_mesh;
                corners.map(|c| world_from_mesh.transform_point3(c) - self.geometry.origin)
            }
            None => corners,
        }
    }

    /// The hit of a ray with a triangle's plane, in f64 (Moeller and Trumbore 1997), from the
    /// corners that the hierarchy stores.
    #[inline]
    fn refined(&self, ray: &Ray, nearest: &Nearest) -> Hit {
        let [a, b, c] = self.corners_of(nearest);
        let (ab, ac, ao) = (b - a, c - a, ray.origin - self.geometry.origin - a);
        let n = ab.cross(ac);
        let scale = -1.0 / n.dot(ray.direction);
        let q = ao.cross(ray.direction);
        let (t, u, v) = (n.dot(ao) * scale, ac.dot(q) * scale, -ab.dot(q) * scale);
        let t = if t.is_finite() { t } else { f64::from(nearest.t) };
        // Rounding may put a hit on an edge a hair outside.
        let u = if u.is_finite() { u.clamp(0.0, 1.0) } else { 0.0 };
        let v = if v.is_finite() { v.clamp(0.0, 1.0 - u) } else { 0.0 };
        Hit { t, triangle: nearest.triangle, u: u as f32, v: v as f32 }
    }
}

impl Block {
    /// Corners of one triangle, in the space of the block.
    fn corners_of(&self, lane: usize) -> [DVec3; 3] {
        self.corners.each_ref().map(|c| DVec3::new(c[0][lane].into(), c[1][lane].into(), c[2][lane].into()))
    }
}

#[cfg(test)]
#[path = "caster_test.rs"]
mod tests;
