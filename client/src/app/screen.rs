//! The screen: a window's surface, and the pass that draws the picture and the interface.
//!
//! In: finished pictures and the interface's shapes. Out: a frame on the display. The picture is
//! filtered in linear light (`picture.wgsl`). With a software adapter the CPU presents pictures
//! itself ([`SoftwarePresenter`]).

use super::{
    interface_pass::{Interface, PreparedInterface, begin},
    software_present::SoftwarePresenter,
};
use crate::frame::Frame;
use std::sync::{Arc, Mutex, PoisonError};
use winit::{event_loop::OwnedDisplayHandle, window::Window};

/// Pictures cannot be presented.
#[derive(Debug, thiserror::Error)]
pub enum ScreenError {
    /// There is no driver.
    #[error(
        "no graphics driver can draw into a window ({0}); install one (on Debian: mesa-vulkan-drivers or libgl1-mesa-dri; both also draw \
         without a graphics card), or walk without a window: `ldi-client walk --help`"
    )]
    NoAdapter(String),
    /// The driver gives no device or surface.
    #[error(
        "the graphics driver {adapter} cannot draw into a window: {reason}; try another one with WGPU_BACKEND=gl or vulkan"
    )]
    Driver {
        /// Its name.
        adapter: String,
        /// The driver's message.
        reason: String,
    },
}

/// Colour without a picture: dark, but not black.
pub(super) const EMPTY: wgpu::Color = wgpu::Color { r: 0.17, g: 0.19, b: 0.22, a: 1.0 };

/// A picture on the GPU.
struct PictureTexture {
    texture: wgpu::Texture,
    group: wgpu::BindGroup,
    size: [u32; 2],
}

/// The window's surface, and the presenter that fills it.
pub struct Screen {
    surface: wgpu::Surface<'static>,
    config: wgpu::SurfaceConfiguration,
    device: wgpu::Device,
    queue: wgpu::Queue,
    adapter: String,
    /// The driver's first error since the last check.
    last_error: Arc<Mutex<Option<String>>>,
    presenter: Presenter,
}

/// The way pictures get to the surface.
enum Presenter {
    /// A GPU scales them and draws the interface over them.
    Gpu(Box<GpuPresenter>),
    /// The CPU does both.
    Software(Box<SoftwarePresenter>),
}

/// GPU resources of a presenter.
struct GpuPresenter {
    stretch: UpscalePass,
    texture: Option<PictureTexture>,
    interface: egui_wgpu::Renderer,
}

impl Screen {
    /// Opens the surface of a window on the best adapter.
    ///
    /// # Errors
    /// If no driver can draw into it.
    pub fn open(window: Arc<Window>, display: OwnedDisplayHandle) -> Result<Self, ScreenError> {
        let size = window.inner_size();
        let instance =
            wgpu::Instance::new(wgpu::InstanceDescriptor::new_with_display_handle_from_env(Box::new(display)));
        let surface = instance.create_surface(window).map_err(|e| ScreenError::NoAdapter(e.to_string()))?;
        let wanted = wgpu::RequestAdapterOptions {
            // One texture is drawn: an integrated adapter is fast enough.
            power_preference: wgpu::PowerPreference::from_env().unwrap_or(wgpu::PowerPreference::LowPower),
            compatible_surface: Some(&surface),
            ..Default::default()
        };
        let adapter =
            pollster::block_on(instance.request_adapter(&wanted)).map_err(|e| ScreenError::NoAdapter(e.to_string()))?;
        let info = adapter.get_info();
        let name = format!("{} ({})", info.name, info.backend);
        let failed = |reason: String| ScreenError::Driver { adapter: name.clone(), reason };
        let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("ldi-client"),
            required_limits: wgpu::Limits::downlevel_webgl2_defaults().using_resolution(adapter.limits()),
            ..Default::default()
        }))
        .map_err(|e| failed(e.to_string()))?;
        // Without these handlers a driver error ends the process.
        let last_error = Arc::new(Mutex::new(None));
        let record_error = |last_error: &Arc<Mutex<Option<String>>>| {
            let last_error = last_error.clone();
            move |what: String| {
                last_error.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(what);
            }
        };
        let (wrong, lost) = (record_error(&last_error), record_error(&last_error));
        device.on_uncaptured_error(Arc::new(move |e: wgpu::Error| wrong(one_line(&e.to_string()))));
        device.set_device_lost_callback(move |_, reason| lost(format!("the device is lost: {}", one_line(&reason))));
        let mut config = surface
            .get_default_config(&adapter, size.width.max(1), size.height.max(1))
            .ok_or_else(|| failed("it supports no surface of this window".into()))?;
        let able = surface.get_capabilities(&adapter);
        let software = info.device_type == wgpu::DeviceType::Cpu && cfg!(target_endian = "little");
        let fillable =
            able.usages.contains(wgpu::TextureUsages::COPY_DST) && able.formats.contains(&SoftwarePresenter::FORMAT);
        let software = software && fillable;
        if software {
            config.format = SoftwarePresenter::FORMAT;
            config.usage |= wgpu::TextureUsages::COPY_DST;
        } else {
            let preferred = egui_wgpu::preferred_framebuffer_format(&able.formats);
            config.format = preferred.map_err(|e| failed(e.to_string()))?;
        }
        config.present_mode = wgpu::PresentMode::AutoVsync;
        // The shortest queue, for low latency.
        config.desired_maximum_frame_latency = 1;
        surface.configure(&device, &config);
        let presenter = match software {
            true => Presenter::Software(Box::new(SoftwarePresenter::new(&device, [config.width, config.height]))),
            false => {
                let stretch = UpscalePass::new(&device, config.format);
                let interface = egui_wgpu::Renderer::new(&device, config.format, egui_wgpu::RendererOptions::default());
                Presenter::Gpu(Box::new(GpuPresenter { stretch, texture: None, interface }))
            }
        };
        let screen = Self { surface, config, device, queue, adapter: name, last_error, presenter };
        screen.check()?;
        Ok(screen)
    }

    /// Takes the driver's first error since the last check.
    fn check(&self) -> Result<(), ScreenError> {
        match self.last_error.lock().unwrap_or_else(PoisonError::into_inner).take() {
            Some(reason) => Err(ScreenError::Driver { adapter: self.adapter.clone(), reason }),
            None => Ok(()),
        }
    }

    /// Name of the adapter and its graphics interface.
    pub fn adapter(&self) -> &str {
        &self.adapter
    }

    /// Longest side of a texture, pixels.
    pub fn max_side_px(&self) -> u32 {
        self.device.limits().max_texture_dimension_2d
    }

    /// Adapts to a new size of the window.
    pub fn resize(&mut self, [width, height]: [u32; 2]) {
        let most = self.max_side_px();
        let size = [width.clamp(1, most), height.clamp(1, most)];
        if size != [self.config.width, self.config.height] {
            [self.config.width, self.config.height] = size;
            self.surface.configure(&self.device, &self.config);
        }
    }

    /// Uploads a new picture, which is presented from now on.
    pub fn upload(&mut self, frame: &Frame) {
        let most = self.max_side_px();
        if let Presenter::Gpu(card) = &mut self.presenter
            && [frame.width, frame.height].iter().all(|n| (1..=most).contains(n))
        {
            card.upload(&self.device, &self.queue, frame);
        }
    }

    /// Whether the interface stays on screen until it is drawn again.
    pub fn keeps_interface(&self) -> bool {
        matches!(self.presenter, Presenter::Software(_))
    }

    /// Presents the picture that was uploaded last, and the interface. Without an interface the
    /// previous one is kept, if the presenter keeps it.
    ///
    /// # Errors
    /// If the driver fails, also in an earlier operation. The screen must be opened again.
    pub fn present(&mut self, picture: Option<&Frame>, interface: Option<Interface>) -> Result<(), ScreenError> {
        let size = [self.config.width, self.config.height];
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let (mut before, mut unused, mut drawn) = (Vec::new(), Vec::new(), None);
        if let Some(Interface { primitives, mut textures, scale }) = interface {
            let renderer = self.presenter.renderer();
            for (id, deltas) in textures.set.drain() {
                for delta in deltas {
                    renderer.update_texture(&self.device, &self.queue, id, &delta);
                }
            }
            let descriptor = egui_wgpu::ScreenDescriptor { size_in_pixels: size, pixels_per_point: scale };
            before = renderer.update_buffers(&self.device, &self.queue, &mut encoder, &primitives, &descriptor);
            unused.extend(textures.free.drain());
            drawn = Some(PreparedInterface { primitives, descriptor });
        }
        let target = self.acquire();
        match &mut self.presenter {
            Presenter::Gpu(card) => {
                if let Some(target) = &target {
                    card.draw(&mut encoder, &target.texture, drawn.as_ref());
                }
                self.queue.submit(before.into_iter().chain([encoder.finish()]));
            }
            Presenter::Software(software) => {
                if let Some(drawn) = &drawn {
                    software.draw_interface(&self.device, &self.queue, encoder, before, drawn);
                }
                if let Some(target) = &target {
                    write(&self.queue, &target.texture, software.compose(picture, size));
                    self.queue.submit([]);
                }
            }
        }
        unused.iter().for_each(|id| self.presenter.renderer().free_texture(id));
        target.into_iter().for_each(|t| self.queue.present(t));
        self.check()
    }

    /// The surface's next texture. Reconfigures the surface if it has changed.
    fn acquire(&mut self) -> Option<wgpu::SurfaceTexture> {
        use wgpu::CurrentSurfaceTexture as Current;
        for _ in 0..2 {
            match self.surface.get_current_texture() {
                Current::Success(texture) | Current::Suboptimal(texture) => return Some(texture),
                Current::Outdated | Current::Lost => self.surface.configure(&self.device, &self.config),
                Current::Timeout | Current::Occluded | Current::Validation => return None,
            }
        }
        None
    }
}

impl Presenter {
    /// The renderer of the interface.
    fn renderer(&mut self) -> &mut egui_wgpu::Renderer {
        match self {
            Self::Gpu(card) => &mut card.interface,
            Self::Software(software) => software.renderer(),
        }
    }
}

impl GpuPresenter {
    fn upload(&mut self, device: &wgpu::Device, queue: &wgpu::Queue, frame: &Frame) {
        let size = [frame.width, frame.height];
        if self.texture.as_ref().is_none_or(|s| s.size != size) {
            self.texture = Some(self.stretch.picture(device, size));
        }
        if let Some(texture) = &self.texture {
            write(queue, &texture.texture, &frame.colour);
        }
    }

    fn draw(&mut self, encoder: &mut wgpu::CommandEncoder, target: &wgpu::Texture, drawn: Option<&PreparedInterface>) {
        let view = target.create_view(&wgpu::TextureViewDescriptor::default());
        let mut pass = begin(encoder, &view, EMPTY).forget_lifetime();
        if let Some(texture) = &self.texture {
            self.stretch.draw(&mut pass, texture);
        }
        if let Some(PreparedInterface { primitives, descriptor }) = drawn {
            self.interface.render(&mut pass, primitives, descriptor);
        }
    }
}

/// A driver's message, in one line.
fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Writes rows of pixels, lowest byte first.
fn write(queue: &wgpu::Queue, texture: &wgpu::Texture, codes: &[u32]) {
    let little: Vec<u32>;
    let bytes = match cfg!(target_endian = "little") {
        true => bytemuck::cast_slice(codes),
        false => {
            little = codes.iter().map(|c| c.to_le()).collect();
            bytemuck::cast_slice(&little)
        }
    };
    let layout =
        wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(4 * texture.width()), rows_per_image: None };
    queue.write_texture(texture.as_image_copy(), bytes, layout, texture.size());
}

/// Scales a picture to the target.
struct UpscalePass {
    pipeline: wgpu::RenderPipeline,
    layout: wgpu::BindGroupLayout,
    sampler: wgpu::Sampler,
}

impl UpscalePass {
    fn new(device: &wgpu::Device, target: wgpu::TextureFormat) -> Self {
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("picture"),
            source: wgpu::ShaderSource::Wgsl(include_str!("picture.wgsl").into()),
        });
        let entry = |binding, ty| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::FRAGMENT,
            ty,
            count: None,
        };
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("picture"),
            entries: &[
                entry(
                    0,
                    wgpu::BindingType::Texture {
                        multisampled: false,
                        sample_type: wgpu::TextureSampleType::Float { filterable: true },
                        view_dimension: wgpu::TextureViewDimension::D2,
                    },
                ),
                entry(1, wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering)),
            ],
        });
        let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("picture"),
            bind_group_layouts: &[Some(&layout)],
            immediate_size: 0,
        });
        let pipeline = device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("picture"),
            layout: Some(&pipeline_layout),
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: Some("vertex"),
                buffers: &[],
                compilation_options: wgpu::PipelineCompilationOptions::default(),
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: None,
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: &module,
                // A target that encodes sRGB itself must be given linear values.
                entry_point: Some(if target.is_srgb() { "linear" } else { "encoded" }),
                targets: &[Some(target.into())],
                compilation_options: wgpu::PipelineCompilationOptions::default(),
            }),
            multiview_mask: None,
            cache: None,
        });
        let sampler = device.create_sampler(&wgpu::SamplerDescriptor {
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..Default::default()
        });
        Self { pipeline, layout, sampler }
    }

    /// Creates a texture for a picture.
    fn picture(&self, device: &wgpu::Device, size: [u32; 2]) -> PictureTexture {
        let texture = device.create_texture(&wgpu::TextureDescriptor {
            label: Some("picture"),
            size: wgpu::Extent3d { width: size[0], height: size[1], depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::Rgba8UnormSrgb,
            usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
            view_formats: &[],
        });
        let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("picture"),
            layout: &self.layout,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::TextureView(&view) },
                wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::Sampler(&self.sampler) },
            ],
        });
        PictureTexture { texture, group, size }
    }

    fn draw(&self, pass: &mut wgpu::RenderPass<'_>, texture: &PictureTexture) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &texture.group, &[]);
        pass.draw(0..3, 0..1);
    }
}

#[cfg(test)]
#[path = "screen_test.rs"]
mod tests;
