//! Geometry on the GPU: one vertex and one index buffer per chunk, uploaded when first needed.
//!
//! The memory is bounded; the least recently drawn chunks are evicted first. A chunk that the cache
//! has evicted is removed as well.

use super::{
    device::GpuDevice,
    lru::GpuLru,
    transfer::{Transfer, UploadBudget},
};
use bytemuck::{Pod, Zeroable};
use ldi_protocol::mesh::{CellGeometry, Cluster, MAX_CLUSTER_TRIANGLES};
use std::sync::{Arc, Weak};

/// Bytes of geometry that are kept without being drawn.
const KEPT_BYTES: u64 = 256 << 20;

/// A vertex in the layout of `near.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub struct Corner {
    position: [f32; 3],
    normal: [f32; 3],
    uv: [f32; 2],
    colour: [f32; 3],
}

/// The range of a cluster in its chunk's buffers.
#[derive(Clone, Copy)]
pub struct Span {
    pub first_index: u32,
    pub indices: u32,
    pub first_corner: i32,
}

/// A chunk on the GPU.
pub struct UploadedGeometry {
    pub corners: wgpu::Buffer,
    pub indices: wgpu::Buffer,
    /// Ranges by cluster number.
    pub spans: Vec<Span>,
    /// Keeps the chunk's address from being used again.
    source: Weak<CellGeometry>,
}

/// Uploaded chunks, by address.
pub struct Geometry(GpuLru<usize, UploadedGeometry>);

fn address(geometry: &Arc<CellGeometry>) -> usize {
    Arc::as_ptr(geometry) as usize
}

impl Geometry {
    pub fn new() -> Self {
        Self(GpuLru::new(KEPT_BYTES))
    }

    pub fn begin_frame(&mut self) {
        self.0.begin_frame(|u| u.source.strong_count() > 0);
    }

    /// Uploads a chunk within the budget. Returns whether it is complete.
    pub fn upload(&mut self, card: &GpuDevice, chunk: &Arc<CellGeometry>, budget: &mut UploadBudget) -> bool {
        self.0.upload(address(chunk), card, budget, || UploadedGeometry::new(card, chunk))
    }

    /// Whether a chunk is uploaded, being uploaded, or fits beside everything that the frame has
    /// used so far.
    pub fn has_room(&self, chunk: &Arc<CellGeometry>) -> bool {
        self.0.has(address(chunk)) || self.0.has_room(bytes(chunk))
    }

    /// A completely uploaded chunk.
    pub fn get(&self, chunk: &Arc<CellGeometry>) -> Option<&UploadedGeometry> {
        self.0.get(address(chunk))
    }

    /// Bytes on the GPU.
    pub fn bytes(&self) -> u64 {
        self.0.bytes()
    }

    pub fn clear(&mut self) {
        self.0.clear();
    }
}

/// Bytes of a chunk on the GPU.
fn bytes(chunk: &CellGeometry) -> u64 {
    let of = |c: &Cluster| size_of::<Corner>() * c.positions.len() + 6 * c.triangles.len().min(MAX_CLUSTER_TRIANGLES);
    chunk.clusters.iter().map(|c| of(c) as u64).sum()
}

impl UploadedGeometry {
    /// Also returns its bytes and the transfer.
    fn new(card: &GpuDevice, chunk: &Arc<CellGeometry>) -> (Self, u64, Transfer) {
        let (mut corners, mut indices, mut spans) = (Vec::<Corner>::new(), Vec::<u16>::new(), Vec::new());
        for cluster in &chunk.clusters {
            let first_index = indices.len() as u32;
            let count = cluster.positions.len();
            // Triangles with invalid corners are left out, as on the CPU.
            let whole = |t: &&[u16; 3]| t.iter().all(|c| usize::from(*c) < count);
            indices.extend(cluster.triangles.iter().take(MAX_CLUSTER_TRIANGLES).filter(whole).flatten());
            let span =
                Span { first_index, indices: indices.len() as u32 - first_index, first_corner: corners.len() as i32 };
            spans.push(span);
            corners.extend((0..count).map(|i| corner(cluster, i)));
        }
        let mut transfer = Transfer::default();
        let uploaded = Self {
            corners: transfer.array(card, "corners", corners, wgpu::BufferUsages::VERTEX),
            indices: transfer.array(card, "indices", indices, wgpu::BufferUsages::INDEX),
            spans,
            source: Arc::downgrade(chunk),
        };
        let bytes = uploaded.corners.size() + uploaded.indices.size();
        (uploaded, bytes, transfer)
    }
}

fn corner(cluster: &Cluster, i: usize) -> Corner {
    Corner {
        position: cluster.positions[i].to_array(),
        normal: cluster.normals.get(i).map_or([0.0, 1.0, 0.0], |n| n.to_array()),
        uv: cluster.uvs.get(i).map_or([0.0; 2], |t| t.to_array()),
        colour: cluster.colours.get(i).copied().unwrap_or([1.0; 3]),
    }
}
