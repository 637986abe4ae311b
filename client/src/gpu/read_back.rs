//! Reading buffers of the GPU.

use super::device::{GpuDevice, GpuError, GrowableBuffer};
use std::sync::mpsc;

/// Alignment of texture rows in buffers.
pub const ROW_ALIGNMENT: u32 = wgpu::COPY_BYTES_PER_ROW_ALIGNMENT;

/// A buffer for reading back, reused every frame.
pub struct ReadBack {
    staging: GrowableBuffer,
}

impl ReadBack {
    pub fn new() -> Self {
        Self { staging: GrowableBuffer::new("read back", wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ) }
    }

    /// Submits `encoder` after `fill` has copied `size` bytes into the given buffer, waits, and
    /// passes them to `see`.
    pub fn run<T>(
        &mut self,
        card: &GpuDevice,
        mut encoder: wgpu::CommandEncoder,
        size: u64,
        fill: impl FnOnce(&mut wgpu::CommandEncoder, &wgpu::Buffer),
        see: impl FnOnce(&[u8]) -> T,
    ) -> Result<T, GpuError> {
        let staging = self.staging.allocate(card, size);
        fill(&mut encoder, staging);
        let submission = card.queue.submit([encoder.finish()]);
        card.check()?;
        let (told, done) = mpsc::channel();
        // The receiver waits below.
        staging.map_async(wgpu::MapMode::Read, 0..size, move |mapped| drop(told.send(mapped)));
        card.wait(submission)?;
        done.recv().map_err(|e| card.failed(e.to_string()))?.map_err(|e| card.failed(e.to_string()))?;
        let seen = {
            let view = staging.get_mapped_range(0..size).map_err(|e| card.failed(e.to_string()))?;
            see(&view)
        };
        staging.unmap();
        card.check()?;
        Ok(seen)
    }
}
