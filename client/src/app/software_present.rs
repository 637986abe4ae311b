//! Showing without a graphics card: the processor fills the window's pixels, and the software driver draws the interface alone, when it changes.
//!
//! In: finished pictures and egui's shapes. Out: a window's pixels. Mesa's software driver takes two thirds more than the drawing of the picture for stretching it and for the interface over
//! it, as it does both in floating point with a power per pixel.

use super::{overlay::Overlay, screen::PreparedInterface, software_upscale::SoftwareUpscaler};
use crate::frame::Frame;

/// Where there is no picture yet: that of [`super::screen::EMPTY`].
const EMPTY_CODE: u32 = 0xff2b_3038;

/// The window's pixels and what they are made of.
pub struct SoftwarePresenter {
    stretcher: SoftwareUpscaler,
    interface: Overlay,
    renderer: egui_wgpu::Renderer,
    pixels: Vec<u32>,
}

impl SoftwarePresenter {
    /// What the window's pixels have to be: blue in the lowest byte, codes as they are.
    pub const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Bgra8Unorm;

    /// With the device that draws the interface, for a window of this size.
    pub fn new(device: &wgpu::Device, size: [u32; 2]) -> Self {
        Self {
            stretcher: SoftwareUpscaler::default(),
            interface: Overlay::new(device, Self::FORMAT, size),
            renderer: egui_wgpu::Renderer::new(device, Self::FORMAT, egui_wgpu::RendererOptions::default()),
            pixels: Vec::new(),
        }
    }

    /// What draws the interface.
    pub fn renderer(&mut self) -> &mut egui_wgpu::Renderer {
        &mut self.renderer
    }

    /// Draws the interface into a picture of its own. `before`: what has to be submitted before.
    pub fn draw_interface(
        &mut self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        mut encoder: wgpu::CommandEncoder,
        before: Vec<wgpu::CommandBuffer>,
        PreparedInterface { primitives, descriptor }: &PreparedInterface,
    ) {
        if self.interface.size() != descriptor.size_in_pixels {
            self.interface = Overlay::new(device, Self::FORMAT, descriptor.size_in_pixels);
        }
        let target = self.interface.target();
        let mut pass = super::screen::begin(&mut encoder, &target, wgpu::Color::TRANSPARENT).forget_lifetime();
        self.renderer.render(&mut pass, primitives, descriptor);
        drop(pass);
        self.interface.fetch(&mut encoder);
        queue.submit(before.into_iter().chain([encoder.finish()]));
        self.interface.take(device);
    }

    /// The pixels of a window of this size that shows a picture with the interface over it.
    pub fn compose(&mut self, picture: Option<&Frame>, size: [u32; 2]) -> &[u32] {
        self.pixels.resize(size[0] as usize * size[1] as usize, 0);
        match picture.filter(|p| p.width > 0 && p.height > 0) {
            Some(p) => self.stretcher.stretch(&p.colour, [p.width, p.height], &mut self.pixels, size),
            None => self.pixels.fill(EMPTY_CODE),
        }
        if self.interface.size() == size {
            self.interface.over(&mut self.pixels);
        }
        &self.pixels
    }
}
