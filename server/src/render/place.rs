//! Where an instance stands, as the traversal kernels take it.
//!
//! Rays stay in the world: boxes and triangles of a mesh are placed as rays meet them. So one
//! packet of rays goes through the whole scene, t and depth mean the same everywhere, and single
//! rays and packets see the same numbers.
//!
//! No closures here: they would be compiled without the widest vectors.

use super::{
    bvh::{Block, Node},
    lanes::Lanes,
    triangles::{Vec3L, load3, splat3},
};
use crate::scene::Instance;
use glam::{DVec3, Mat3};
use ldi_protocol::Aabb;

/// Room for rounding in placed boxes, as a share of the largest coordinate: f32 products and sums
/// err by some 4e-7 of it.
const BOX_SLACK: f64 = 1e-6;

/// A placement of a mesh, relative to the middle of the scene.
pub(super) struct Place {
    /// Position in [`Scene::instances`](crate::scene::Scene::instances).
    pub instance: u32,
    /// World from mesh, row by row.
    rows: [[f32; 3]; 3],
    shift: [f32; 3],
    /// Turns normals, row by row; their length changes.
    normal_rows: [[f32; 3]; 3],
    /// Room for rounding on each side of a box, metres.
    slack: f32,
}

impl Place {
    /// `bounds`: of the mesh, in its own space; `origin`: the middle of the scene.
    pub fn new(number: u32, instance: &Instance, normal_matrix: &Mat3, bounds: &Aabb, origin: DVec3) -> Self {
        let m = instance.world_from_mesh;
        let shift = m.translation - origin;
        let row = |k: usize| m.matrix3.row(k).as_vec3().to_array();
        let largest = |k: usize| {
            let reach = bounds.min.abs().max(bounds.max.abs());
            m.matrix3.row(k).abs().dot(reach) + shift[k].abs()
        };
        Self {
            instance: number,
            rows: [row(0), row(1), row(2)],
            shift: shift.as_vec3().to_array(),
            normal_rows: [0, 1, 2].map(|k| normal_matrix.row(k).to_array()),
            slack: ((0..3).map(largest).fold(0.0, f64::max) * BOX_SLACK) as f32,
        }
    }

    /// Room for rounding on each side of a box, metres.
    pub fn slack(&self) -> f32 {
        self.slack
    }

    /// World boxes around a node's children: min x, y, z, max x, y, z. Of children that are not
    /// there they are NaN.
    #[inline(always)]
    pub fn boxes<F8: Lanes<8>>(&self, node: &Node) -> [F8; 6] {
        let half = F8::splat(0.5);
        let [low, high]: [Vec3L<F8>; 2] = [sides(node, 0), sides(node, 3)];
        let centre = [low[0].add(high[0]).mul(half), low[1].add(high[1]).mul(half), low[2].add(high[2]).mul(half)];
        let reach = [high[0].sub(low[0]).mul(half), high[1].sub(low[1]).mul(half), high[2].sub(low[2]).mul(half)];
        let mut out = [half; 6];
        for k in 0..3 {
            let r = self.rows[k];
            let at = dot(r, centre).add(F8::splat(self.shift[k]));
            let wide = dot([r[0].abs(), r[1].abs(), r[2].abs()], reach).add(F8::splat(self.slack));
            (out[k], out[k + 3]) = (at.sub(wide), at.add(wide));
        }
        out
    }

    /// World corners of a block's triangles relative to a ray's origin.
    #[inline(always)]
    pub fn relative_corners<F: Lanes<4>>(&self, block: &Block, origin: [f32; 3]) -> [Vec3L<F>; 3] {
        let shift: Vec3L<F> = splat3([self.shift[0] - origin[0], self.shift[1] - origin[1], self.shift[2] - origin[2]]);
        [
            self.placed(load3(&block.corners[0]), shift),
            self.placed(load3(&block.corners[1]), shift),
            self.placed(load3(&block.corners[2]), shift),
        ]
    }

    #[inline(always)]
    fn placed<F: Lanes<4>>(&self, p: Vec3L<F>, shift: Vec3L<F>) -> Vec3L<F> {
        [dot(self.rows[0], p).add(shift[0]), dot(self.rows[1], p).add(shift[1]), dot(self.rows[2], p).add(shift[2])]
    }

    /// World normals of a block's triangles, not of unit length.
    #[inline(always)]
    pub fn normals<F: Lanes<4>>(&self, block: &Block) -> Vec3L<F> {
        let n: Vec3L<F> = load3(&block.normal);
        [dot(self.normal_rows[0], n), dot(self.normal_rows[1], n), dot(self.normal_rows[2], n)]
    }
}

/// Three sides of a node's boxes from the `first` on.
#[inline(always)]
fn sides<F8: Lanes<8>>(node: &Node, first: usize) -> Vec3L<F8> {
    [F8::load(&node.bounds[first]), F8::load(&node.bounds[first + 1]), F8::load(&node.bounds[first + 2])]
}

#[inline(always)]
fn dot<const N: usize, F: Lanes<N>>(row: [f32; 3], v: Vec3L<F>) -> F {
    F::splat(row[0]).mul(v[0]).add(F::splat(row[1]).mul(v[1])).add(F::splat(row[2]).mul(v[2]))
}
