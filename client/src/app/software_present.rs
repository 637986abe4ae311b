//! Presentation by the CPU, for software adapters: the CPU fills the window's pixels, and the
//! software driver draws only the interface, when it changes.
//!
//! In: finished pictures and the interface's shapes. Out: a window's pixels. A software driver
//! would be slower, as it scales the picture and blends the interface in floating point with a
//! power function per pixel.

use super::{interface_pass::PreparedInterface, overlay::Overlay, software_upscale::SoftwareUpscaler};
use crate::frame::Frame;

/// Colour without a picture, as [`super::screen::EMPTY`].
const EMPTY_CODE: u32 = 0xff2b_3038;

/// The window's pixels, and the resources they are composed from.
pub struct SoftwarePresenter {
    stretcher: SoftwareUpscaler,
    interface: Overlay,
    renderer: egui_wgpu::Renderer,
    pixels: Vec<u32>,
}

impl SoftwarePresenter {
    /// Required format of the window's pixels: blue in the lowest byte, sRGB codes.
    pub const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Bgra8Unorm;

    /// `device` draws the interface; `size` is the window's.
    pub fn new(device: &wgpu::Device, size: [u32; 2]) -> Self {
        Self {
            stretcher: SoftwareUpscaler::default(),
            interface: Overlay::new(device, Self::FORMAT, size),
            renderer: egui_wgpu::Renderer::new(device, Self::FORMAT, egui_wgpu::RendererOptions::default()),
            pixels: Vec::new(),
        }
    }

    /// The renderer of the interface.
    pub fn renderer(&mut self) -> &mut egui_wgpu::Renderer {
        &mut self.renderer
    }

    /// Draws the interface into its overlay. `before`: command buffers to submit first.
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
        let mut pass = super::interface_pass::begin(&mut encoder, &target, wgpu::Color::TRANSPARENT).forget_lifetime();
        self.renderer.render(&mut pass, primitives, descriptor);
        drop(pass);
        self.interface.fetch(&mut encoder);
        queue.submit(before.into_iter().chain([encoder.finish()]));
        self.interface.take(device);
    }

    /// Composes the window's pixels from a picture and the interface.
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
