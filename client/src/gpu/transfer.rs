//! Uploads in slices: each frame sends a part within its budget, so that no frame waits for a large
//! object.

use super::device::GpuDevice;
use bytemuck::Pod;
use ldi_protocol::texture::{MipLevel, Texture};
use std::sync::Arc;

/// The upload budget of a frame.
#[derive(Debug)]
pub struct UploadBudget {
    /// Remaining bytes.
    pub left: u64,
    /// Bytes sent.
    pub spent: u64,
}

impl UploadBudget {
    pub fn new(left: u64) -> Self {
        Self { left, spent: 0 }
    }

    fn spend(&mut self, bytes: u64) {
        self.left = self.left.saturating_sub(bytes);
        self.spent += bytes;
    }

    /// Runs `f` without a limit, for objects that must be drawn now.
    pub fn without_bound<T>(&mut self, f: impl FnOnce(&mut Self) -> T) -> T {
        let (left, spent) = (std::mem::replace(&mut self.left, u64::MAX), self.spent);
        let done = f(self);
        self.left = left.saturating_sub(self.spent - spent);
        done
    }
}

/// Content of a buffer or of a texture level.
trait Content: Send + Sync {
    fn bytes(&self) -> &[u8];
}

impl<T: Pod + Send + Sync> Content for Vec<T> {
    fn bytes(&self) -> &[u8] {
        bytemuck::cast_slice(self)
    }
}

/// A level of a texture.
struct Texels(Arc<Texture>, usize);

impl Content for Texels {
    fn bytes(&self) -> &[u8] {
        self.0.levels.get(self.1).and_then(Option::as_ref).map_or(&[], |l| l.rgba.as_flattened())
    }
}

enum To {
    Buffer(wgpu::Buffer),
    /// Rows of this many texels.
    Level {
        texture: wgpu::Texture,
        level: u32,
        width: u32,
    },
}

struct Part {
    to: To,
    content: Box<dyn Content>,
}

/// The parts of an object that are still to be sent.
#[derive(Default)]
pub struct Transfer {
    /// The parts; the next one is last.
    parts: Vec<Part>,
    /// Bytes of the next part already sent.
    sent: usize,
}

impl Transfer {
    /// Adds an array. Returns its buffer, which is never empty, as bindings require.
    pub fn array<T: Pod + Send + Sync>(
        &mut self,
        card: &GpuDevice,
        label: &str,
        mut content: Vec<T>,
        usage: wgpu::BufferUsages,
    ) -> wgpu::Buffer {
        // Writes have multiples of four bytes.
        while !(content.len() * size_of::<T>()).is_multiple_of(4) {
            content.push(T::zeroed());
        }
        let size = (content.len() * size_of::<T>()).max(16) as u64;
        let buffer = card.allocate(label, size, usage | wgpu::BufferUsages::COPY_DST);
        self.parts.push(Part { to: To::Buffer(buffer.clone()), content: Box::new(content) });
        buffer
    }

    /// Adds texture level `from` as level `to` on the GPU.
    pub fn level(&mut self, texture: &Arc<Texture>, from: usize, on_card: &wgpu::Texture, to: u32) {
        let whole = |l: &&MipLevel| l.width > 0 && l.rgba.len() == l.width as usize * l.height as usize;
        let Some(level) = texture.levels.get(from).and_then(Option::as_ref).filter(whole) else { return };
        let to = To::Level { texture: on_card.clone(), level: to, width: level.width };
        self.parts.push(Part { to, content: Box::new(Texels(texture.clone(), from)) });
    }

    /// Sends parts within the budget, rounded up to words or rows. Returns whether everything was
    /// sent.
    pub fn push(&mut self, card: &GpuDevice, budget: &mut UploadBudget) -> bool {
        while let Some(part) = self.parts.last() {
            let rest = &part.content.bytes()[self.sent..];
            if rest.is_empty() {
                self.parts.pop();
                self.sent = 0;
                continue;
            }
            if budget.left == 0 {
                return false;
            }
            let unit = match &part.to {
                To::Buffer(_) => 4,
                To::Level { width, .. } => 4 * *width as usize,
            };
            let most = usize::try_from(budget.left).unwrap_or(usize::MAX).min(rest.len());
            let slice = &rest[..most.next_multiple_of(unit).min(rest.len())];
            match &part.to {
                To::Buffer(buffer) => card.queue.write_buffer(buffer, self.sent as u64, slice),
                To::Level { texture, level, width } => {
                    let origin = wgpu::Origin3d { x: 0, y: (self.sent / unit) as u32, z: 0 };
                    let to = wgpu::TexelCopyTextureInfo { mip_level: *level, origin, ..texture.as_image_copy() };
                    let layout =
                        wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(4 * width), rows_per_image: None };
                    let size =
                        wgpu::Extent3d { width: *width, height: (slice.len() / unit) as u32, depth_or_array_layers: 1 };
                    card.queue.write_texture(to, slice, layout, size);
                }
            }
            self.sent += slice.len();
            budget.spend(slice.len() as u64);
        }
        true
    }
}
