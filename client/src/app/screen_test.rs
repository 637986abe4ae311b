use super::*;
use crate::frame::{pack_rgb, unpack_rgb};

#[test]
fn the_shader_is_valid() {
    let source = include_str!("picture.wgsl");
    let validate = |source: &str| {
        let module = naga::front::wgsl::parse_str(source).map_err(|e| e.to_string())?;
        let mut validator =
            naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty());
        validator.validate(&module).map(|_| module.entry_points.len()).map_err(|e| e.to_string())
    };
    assert_eq!(validate(source), Ok(3));
    assert!(validate(&source.replace("vec4<f32>(light(corner.uv), 1.0)", "light(corner.uv)")).is_err());
}

/// A device without a window, or the reason why there is none.
fn device() -> Result<(wgpu::Device, wgpu::Queue), String> {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
    let adapter = pollster::block_on(instance.request_adapter(&wgpu::RequestAdapterOptions::default()))
        .map_err(|e| e.to_string())?;
    let descriptor =
        wgpu::DeviceDescriptor { required_limits: wgpu::Limits::downlevel_webgl2_defaults(), ..Default::default() };
    pollster::block_on(adapter.request_device(&descriptor)).map_err(|e| e.to_string())
}

/// What a target of this format holds after the picture was stretched over it: red, green, blue of
/// each pixel.
fn stretched(device: &wgpu::Device, queue: &wgpu::Queue, frame: &Frame, format: wgpu::TextureFormat) -> Vec<[u8; 3]> {
    let (width, height) = (64, 4);
    let stretch = UpscalePass::new(device, format);
    let shown = stretch.picture(device, [frame.width, frame.height]);
    write(queue, &shown.texture, &frame.colour);
    let target = device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
        view_formats: &[],
    });
    let buffer = device.create_buffer(&wgpu::BufferDescriptor {
        label: None,
        size: u64::from(width * height * 4),
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    {
        let view = target.create_view(&wgpu::TextureViewDescriptor::default());
        let mut pass = begin(&mut encoder, &view, EMPTY);
        stretch.draw(&mut pass, &shown);
    }
    let layout =
        wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(4 * width), rows_per_image: Some(height) };
    encoder.copy_texture_to_buffer(
        target.as_image_copy(),
        wgpu::TexelCopyBufferInfo { buffer: &buffer, layout },
        target.size(),
    );
    queue.submit([encoder.finish()]);
    buffer.slice(..).map_async(wgpu::MapMode::Read, |done| done.expect("mapped"));
    device.poll(wgpu::PollType::wait_indefinitely()).expect("done");
    let bytes = buffer.slice(..).get_mapped_range().expect("mapped").to_vec();
    bytes.chunks_exact(4).map(|p| [p[0], p[1], p[2]]).collect()
}

#[test]
fn pictures_arrive_upright_with_their_colours_and_are_filtered_in_linear_light() {
    let (device, queue) = match device() {
        Ok(d) => d,
        Err(reason) => {
            eprintln!("SKIPPED: no graphics driver on this machine: {reason}");
            return;
        }
    };
    // Two columns by two rows: red, black over white, blue.
    let mut frame = Frame::new(2, 2);
    frame.colour = [[200, 10, 0], [0, 0, 0], [255, 255, 255], [0, 60, 255]].map(pack_rgb).to_vec();
    for format in [wgpu::TextureFormat::Rgba8Unorm, wgpu::TextureFormat::Rgba8UnormSrgb] {
        let got = stretched(&device, &queue, &frame, format);
        let near = |a: [u8; 3], b: [u8; 3]| a.iter().zip(b).all(|(a, b)| a.abs_diff(b) <= 2);
        let corners = [got[0], got[63], got[3 * 64], got[3 * 64 + 63]];
        for (corner, colour) in corners.iter().zip(&frame.colour) {
            assert!(near(*corner, unpack_rgb(*colour)), "{format:?}: {corners:?}");
        }
        // Halfway between 200 and black there is half of the light, which is code 147 and not 100.
        // Pixel 31 lies 31/64 on the way.
        assert!((143..=153).contains(&got[31][0]), "{format:?}: {:?}", got[31]);
    }
}
