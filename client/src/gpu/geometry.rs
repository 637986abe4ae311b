//! Clusters on the card: one vertex and one index buffer per chunk of geometry, made when it is first drawn.
//!
//! What is kept is bounded in bytes; the chunks that were drawn longest ago go first. A chunk that the cache has let go goes as well.

use super::device::Card;
use bytemuck::{Pod, Zeroable};
use ldi_protocol::mesh::{CellGeometry, Cluster, MAX_CLUSTER_TRIANGLES};
use std::{
    collections::HashMap,
    sync::{Arc, Weak},
};

/// Bytes of geometry that stay on the card when they are not drawn: some five million vertices.
const KEPT_BYTES: u64 = 256 << 20;

/// A corner of triangles, as `near.wgsl` reads it.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub struct Corner {
    position: [f32; 3],
    normal: [f32; 3],
    uv: [f32; 2],
    colour: [f32; 3],
}

/// Where a cluster lies in its chunk's buffers.
#[derive(Clone, Copy)]
pub struct Span {
    pub first_index: u32,
    pub indices: u32,
    pub first_corner: i32,
}

/// A chunk on the card.
pub struct Uploaded {
    pub corners: wgpu::Buffer,
    pub indices: wgpu::Buffer,
    /// By number of the cluster.
    pub spans: Vec<Span>,
    /// Held so that the address stays this chunk's.
    source: Weak<CellGeometry>,
    used: u64,
}

/// See the module.
#[derive(Default)]
pub struct Geometry {
    /// By address.
    held: HashMap<usize, Uploaded>,
    bytes: u64,
    frame: u64,
}

fn address(geometry: &Arc<CellGeometry>) -> usize {
    Arc::as_ptr(geometry) as usize
}

impl Geometry {
    /// Puts the chunks of a frame onto the card and makes room for them.
    pub fn hold(&mut self, card: &Card, chunks: &[Arc<CellGeometry>]) {
        self.frame += 1;
        for chunk in chunks {
            let frame = self.frame;
            let known = self.held.get_mut(&address(chunk)).map(|u| u.used = frame).is_some();
            if !known {
                let uploaded = Uploaded::new(card, chunk, frame);
                self.bytes += uploaded.bytes();
                self.held.insert(address(chunk), uploaded);
            }
        }
        self.make_room();
    }

    /// A chunk that [`Self::hold`] was given.
    pub fn get(&self, chunk: &Arc<CellGeometry>) -> Option<&Uploaded> {
        self.held.get(&address(chunk))
    }

    /// Bytes on the card.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    pub fn clear(&mut self) {
        (self.held, self.bytes) = (HashMap::new(), 0);
    }

    fn make_room(&mut self) {
        self.held.retain(|_, u| u.source.strong_count() > 0);
        self.bytes = self.held.values().map(Uploaded::bytes).sum();
        if self.bytes <= KEPT_BYTES {
            return;
        }
        let mut oldest: Vec<(u64, usize)> =
            self.held.iter().filter(|(_, u)| u.used < self.frame).map(|(at, u)| (u.used, *at)).collect();
        oldest.sort_unstable();
        for (_, at) in oldest {
            if self.bytes <= KEPT_BYTES {
                break;
            }
            if let Some(gone) = self.held.remove(&at) {
                self.bytes -= gone.bytes();
            }
        }
    }
}

impl Uploaded {
    fn new(card: &Card, chunk: &Arc<CellGeometry>, used: u64) -> Self {
        let (mut corners, mut indices, mut spans) = (Vec::<Corner>::new(), Vec::<u16>::new(), Vec::new());
        for cluster in &chunk.clusters {
            let first_index = indices.len() as u32;
            let count = cluster.positions.len();
            // Triangles that name corners which are not there are left out, as on the processor.
            let whole = |t: &&[u16; 3]| t.iter().all(|c| usize::from(*c) < count);
            indices.extend(cluster.triangles.iter().take(MAX_CLUSTER_TRIANGLES).filter(whole).flatten());
            let span =
                Span { first_index, indices: indices.len() as u32 - first_index, first_corner: corners.len() as i32 };
            spans.push(span);
            corners.extend((0..count).map(|i| corner(cluster, i)));
        }
        Self {
            corners: card.buffer("corners", bytemuck::cast_slice(&corners), wgpu::BufferUsages::VERTEX),
            indices: card.buffer("indices", bytemuck::cast_slice(&indices), wgpu::BufferUsages::INDEX),
            spans,
            source: Arc::downgrade(chunk),
            used,
        }
    }

    fn bytes(&self) -> u64 {
        self.corners.size() + self.indices.size()
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
