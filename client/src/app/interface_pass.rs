//! The render pass of a window, and the interface shapes that it draws.

/// The interface's shapes, ready to be drawn.
pub struct Interface {
    /// Triangles.
    pub primitives: Vec<egui::ClippedPrimitive>,
    /// New and removed textures.
    pub textures: egui::TexturesDelta,
    /// Pixels per point.
    pub scale: f32,
}

/// Shapes, and the screen that they are tessellated for.
pub(super) struct PreparedInterface {
    pub primitives: Vec<egui::ClippedPrimitive>,
    pub descriptor: egui_wgpu::ScreenDescriptor,
}

pub(super) fn begin<'e>(
    encoder: &'e mut wgpu::CommandEncoder,
    view: &wgpu::TextureView,
    empty: wgpu::Color,
) -> wgpu::RenderPass<'e> {
    encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some("window"),
        color_attachments: &[Some(wgpu::RenderPassColorAttachment {
            view,
            resolve_target: None,
            ops: wgpu::Operations { load: wgpu::LoadOp::Clear(empty), store: wgpu::StoreOp::Store },
            depth_slice: None,
        })],
        depth_stencil_attachment: None,
        timestamp_writes: None,
        occlusion_query_set: None,
        multiview_mask: None,
    })
}
