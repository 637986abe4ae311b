//! The GPU device: adapter, device, queue, and conversion of driver failures to errors.

use crate::warp::{Order, Stamp};
use std::sync::{Arc, Mutex, PoisonError};

/// The GPU cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum GpuError {
    /// There is no driver.
    #[error(
        "no driver for Vulkan, Metal or Direct3D 12 can draw ({0}); install one (on Debian: mesa-vulkan-drivers, which also draws without a graphics card), or use --renderer cpu"
    )]
    NoAdapter(String),
    /// The driver lacks a feature.
    #[error("the graphics driver {adapter} {reason}; use --renderer cpu")]
    Lacking {
        /// Its name.
        adapter: String,
        /// The missing feature.
        reason: String,
    },
    /// The driver failed.
    #[error("the graphics driver {adapter} failed: {reason}; start again, or use --renderer cpu")]
    Failed {
        /// Its name.
        adapter: String,
        /// The driver's message.
        reason: String,
    },
    /// The stamp is only implemented on the CPU.
    #[error(
        "the graphics card does not draw stamp `{0}`; use quads, 1px, 2x2, cross or 3x3 with --renderer gpu, or --renderer cpu"
    )]
    Stamp(Stamp),
    /// The order is only implemented on the CPU.
    #[error("the graphics card keeps the nearest sample: order `{}` needs --renderer cpu", .0.name())]
    Order(Order),
}

impl GpuError {
    /// The cause, without the remedy.
    pub fn reason(&self) -> String {
        match self {
            Self::NoAdapter(_) => "no driver can draw".into(),
            Self::Lacking { adapter, reason } => format!("the graphics driver {adapter} {reason}"),
            other => other.to_string(),
        }
    }
}

/// The way to keep the nearest of several samples in a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Atomics {
    /// The best supported way.
    #[default]
    Best,
    /// One pass: disparity above colour in 64 bits.
    Wide,
    /// Two passes of 32 bits: the largest disparity, then the colour of its sample.
    Narrow,
}

/// Whether a software adapter is accepted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Software {
    Too,
    No,
}

/// An open device.
pub struct GpuDevice {
    pub device: wgpu::Device,
    pub queue: wgpu::Queue,
    /// Name of the adapter and its graphics interface.
    pub name: String,
    pub software: bool,
    /// Never [`Atomics::Best`].
    pub atomics: Atomics,
    /// The driver's first error since the last check.
    last_error: Arc<Mutex<Option<String>>>,
}

/// Features that 64-bit atomics require.
const WIDE: wgpu::Features = wgpu::Features::SHADER_INT64.union(wgpu::Features::SHADER_INT64_ATOMIC_MIN_MAX);

impl GpuDevice {
    /// Opens the fastest adapter. `WGPU_BACKEND`, `WGPU_POWER_PREF` and `WGPU_ADAPTER_NAME` apply.
    pub fn open(atomics: Atomics, software: Software) -> Result<Self, GpuError> {
        let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle_from_env();
        // OpenGL does not support depth read-back and draw indices everywhere.
        descriptor.backends.remove(wgpu::Backends::GL);
        let instance = wgpu::Instance::new(descriptor);
        let wanted = wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::from_env().unwrap_or(wgpu::PowerPreference::HighPerformance),
            ..Default::default()
        };
        let adapter =
            pollster::block_on(instance.request_adapter(&wanted)).map_err(|e| GpuError::NoAdapter(e.to_string()))?;
        let info = adapter.get_info();
        let name = format!("{} ({})", info.name, info.backend);
        let lacking = |reason: &str| GpuError::Lacking { adapter: name.clone(), reason: reason.to_owned() };
        let is_software = info.device_type == wgpu::DeviceType::Cpu;
        if is_software && software == Software::No {
            return Err(lacking("is software"));
        }
        let wide = adapter.features().contains(WIDE);
        let atomics = match atomics {
            Atomics::Best if wide => Atomics::Wide,
            Atomics::Best => Atomics::Narrow,
            Atomics::Wide if !wide => return Err(lacking("has no 64-bit atomics")),
            given => given,
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("ldi-client"),
            required_features: if atomics == Atomics::Wide { WIDE } else { wgpu::Features::empty() },
            required_limits: adapter.limits(),
            ..Default::default()
        }))
        .map_err(|e| GpuError::Failed { adapter: name.clone(), reason: e.to_string() })?;
        let last_error = Arc::new(Mutex::new(None));
        let heard = last_error.clone();
        device.on_uncaptured_error(Arc::new(move |e: wgpu::Error| {
            heard.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(e.to_string());
        }));
        Ok(Self { device, queue, name, software: is_software, atomics, last_error })
    }

    /// Takes the driver's first error since the last check.
    pub fn check(&self) -> Result<(), GpuError> {
        match self.last_error.lock().unwrap_or_else(PoisonError::into_inner).take() {
            Some(reason) => Err(self.failed(reason)),
            None => Ok(()),
        }
    }

    pub fn failed(&self, reason: impl Into<String>) -> GpuError {
        GpuError::Failed { adapter: self.name.clone(), reason: reason.into() }
    }

    /// A buffer with content, in whole words.
    pub fn buffer(&self, label: &str, content: &[u8], usage: wgpu::BufferUsages) -> wgpu::Buffer {
        let buffer = self.allocate(label, content.len() as u64, usage | wgpu::BufferUsages::COPY_DST);
        self.queue.write_buffer(&buffer, 0, content);
        buffer
    }

    /// An empty buffer.
    pub fn allocate(&self, label: &str, size: u64, usage: wgpu::BufferUsages) -> wgpu::Buffer {
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size,
            usage,
            mapped_at_creation: false,
        })
    }

    pub fn shader(&self, label: &str, source: &str) -> wgpu::ShaderModule {
        self.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(label),
            source: wgpu::ShaderSource::Wgsl(source.into()),
        })
    }

    /// The compute pipeline of an entry point, whose layout follows from the shader.
    pub fn pipeline(&self, module: &wgpu::ShaderModule, entry: &str) -> wgpu::ComputePipeline {
        self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(entry),
            layout: None,
            module,
            entry_point: Some(entry),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: None,
        })
    }

    /// Submits an encoder and waits for it.
    pub fn run(&self, encoder: wgpu::CommandEncoder) -> Result<(), GpuError> {
        let submission = self.queue.submit([encoder.finish()]);
        self.check()?;
        self.wait(submission)
    }

    /// Waits for a submission.
    pub fn wait(&self, submission: wgpu::SubmissionIndex) -> Result<(), GpuError> {
        let wait = wgpu::PollType::Wait { submission_index: Some(submission), timeout: None };
        self.device.poll(wait).map(drop).map_err(|e| self.failed(e.to_string()))
    }

    /// Records a compute pass over this many workgroups.
    pub fn dispatch(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        pipeline: &wgpu::ComputePipeline,
        resources: &[(u32, wgpu::BindingResource<'_>)],
        [across, down]: [u32; 2],
    ) {
        let entries: Vec<wgpu::BindGroupEntry<'_>> = resources
            .iter()
            .map(|(binding, r)| wgpu::BindGroupEntry { binding: *binding, resource: r.clone() })
            .collect();
        let group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("join"),
            layout: &pipeline.get_bind_group_layout(0),
            entries: &entries,
        });
        let mut pass =
            encoder.begin_compute_pass(&wgpu::ComputePassDescriptor { label: Some("join"), timestamp_writes: None });
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.dispatch_workgroups(across, down, 1);
    }

    pub fn encoder(&self) -> wgpu::CommandEncoder {
        self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default())
    }
}

/// A buffer that grows as needed, written again each frame.
pub struct GrowableBuffer {
    label: &'static str,
    usage: wgpu::BufferUsages,
    buffer: Option<wgpu::Buffer>,
}

impl GrowableBuffer {
    pub fn new(label: &'static str, usage: wgpu::BufferUsages) -> Self {
        Self { label, usage, buffer: None }
    }

    /// The buffer, with room for `size` bytes.
    pub fn allocate(&mut self, card: &GpuDevice, size: u64) -> &wgpu::Buffer {
        let size = size.max(256);
        let held = self.buffer.take().filter(|b| b.size() >= size);
        self.buffer.insert(held.unwrap_or_else(|| card.allocate(self.label, size.next_power_of_two(), self.usage)))
    }

    /// The buffer, with this content.
    pub fn write(&mut self, card: &GpuDevice, content: &[u8]) -> &wgpu::Buffer {
        let buffer = self.allocate(card, content.len() as u64);
        if !content.is_empty() {
            card.queue.write_buffer(buffer, 0, content);
        }
        buffer
    }
}
