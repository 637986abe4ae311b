//! The interface overlay of the software presenter. Drawing the interface with a software driver is
//! slow, so it is drawn only when it changes, and blended over every picture by the CPU.
//!
//! In: the interface's shapes, drawn into [`Overlay::target`]. Out: pixels blended over others,
//! premultiplied (Porter and Duff 1984, over), in sRGB codes as egui blends them.

/// Consecutive pixels of one row that are not fully transparent.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Span {
    /// Index of the first pixel in the window.
    at: usize,
    len: usize,
}

/// The overlay, of the window's size.
pub struct Overlay {
    texture: wgpu::Texture,
    buffer: wgpu::Buffer,
    size: [u32; 2],
    spans: Vec<Span>,
    /// Pixels of all spans; alpha in the highest byte.
    codes: Vec<u32>,
}

impl Overlay {
    /// An empty overlay. `format`: four bytes, alpha last.
    pub fn new(device: &wgpu::Device, format: wgpu::TextureFormat, size: [u32; 2]) -> Self {
        let texture = device.create_texture(&wgpu::TextureDescriptor {
            label: Some("interface"),
            size: wgpu::Extent3d { width: size[0], height: size[1], depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        let buffer = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("interface"),
            size: u64::from(row_bytes(size[0])) * u64::from(size[1]),
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        Self { texture, buffer, size, spans: Vec::new(), codes: Vec::new() }
    }

    /// Columns and rows.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// The render target of the interface.
    pub fn target(&self) -> wgpu::TextureView {
        self.texture.create_view(&wgpu::TextureViewDescriptor::default())
    }

    /// Records the copy to the CPU, after the interface was drawn.
    pub fn fetch(&self, encoder: &mut wgpu::CommandEncoder) {
        let layout = wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(row_bytes(self.size[0])),
            rows_per_image: None,
        };
        let to = wgpu::TexelCopyBufferInfo { buffer: &self.buffer, layout };
        encoder.copy_texture_to_buffer(self.texture.as_image_copy(), to, self.texture.size());
    }

    /// Waits for the copy and takes it over. If the driver fails, the previous overlay stays.
    pub fn take(&mut self, device: &wgpu::Device) {
        let (sent, done) = std::sync::mpsc::channel();
        self.buffer.slice(..).map_async(wgpu::MapMode::Read, move |result| {
            // Nobody waits after polling has failed.
            let _ = sent.send(result);
        });
        let polled = device.poll(wgpu::PollType::wait_indefinitely());
        if polled.is_err() || !matches!(done.try_recv(), Ok(Ok(()))) {
            tracing::warn!("the interface could not be drawn");
            return;
        }
        let mapped = self.buffer.slice(..).get_mapped_range();
        if let Ok(bytes) = &mapped {
            self.keep(bytes);
        }
        drop(mapped);
        self.buffer.unmap();
    }

    /// Finds the spans in rows of [`row_bytes`] each.
    fn keep(&mut self, bytes: &[u8]) {
        let width = self.size[0] as usize;
        (self.spans, self.codes) = spans(bytes.chunks_exact(row_bytes(self.size[0]) as usize), width);
    }

    /// Blends the overlay over the window's pixels.
    pub fn over(&self, pixels: &mut [u32]) {
        lay_over(&self.spans, &self.codes, pixels);
    }
}

/// Bytes of a buffer row: graphics interfaces require multiples of 256.
fn row_bytes(width: u32) -> u32 {
    (4 * width).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT)
}

fn spans<'a>(rows: impl Iterator<Item = &'a [u8]>, width: usize) -> (Vec<Span>, Vec<u32>) {
    let (mut spans, mut codes): (Vec<Span>, Vec<u32>) = (Vec::new(), Vec::new());
    for (y, row) in rows.enumerate() {
        let mut open: Option<Span> = None;
        for (x, pixel) in row.chunks_exact(4).take(width).enumerate() {
            let code = u32::from_le_bytes([pixel[0], pixel[1], pixel[2], pixel[3]]);
            if code == 0 {
                spans.extend(open.take());
                continue;
            }
            open.get_or_insert(Span { at: y * width + x, len: 0 }).len += 1;
            codes.push(code);
        }
        spans.extend(open);
    }
    (spans, codes)
}

fn lay_over(spans: &[Span], mut codes: &[u32], pixels: &mut [u32]) {
    for span in spans {
        let (these, rest) = codes.split_at(span.len);
        codes = rest;
        let Some(below) = pixels.get_mut(span.at..span.at + span.len) else { return };
        for (below, above) in below.iter_mut().zip(these) {
            *below = over(*above, *below);
        }
    }
}

/// Blends two channels at a time; the result is opaque.
fn over(above: u32, below: u32) -> u32 {
    const PAIR: u32 = 0x00ff_00ff;
    let open = 255 - (above >> 24);
    // Division by 255, rounded, of numbers up to 255 * 255.
    let pair = |c: u32| {
        let scaled = (c & PAIR) * open + 0x0080_0080;
        (scaled + (scaled >> 8 & PAIR)) >> 8 & PAIR
    };
    // Premultiplied colours: no sum exceeds a byte.
    let rest = pair(below) | pair(below >> 8) << 8 & 0x0000_ff00;
    (above + rest) | 0xff00_0000
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_over_hides_by_its_alpha() {
        let channels = |c: u32| c.to_le_bytes().map(f64::from);
        for alpha in 0..=255u32 {
            for (level, below) in
                [(0, 0xff00_ff80u32), (alpha / 2, 0xff12_3456), (alpha, 0xffff_ffff), (alpha, 0xff01_fe7f)]
            {
                let above = alpha << 24 | level << 16 | (alpha - level) << 8 | level;
                let (got, a, b) = (channels(over(above, below)), channels(above), channels(below));
                for i in 0..3 {
                    let want = a[i] + b[i] * f64::from(255 - alpha) / 255.0;
                    assert!((got[i] - want).abs() <= 0.5 + 1e-9, "{above:08x} over {below:08x}: {got:?}, not {want}");
                }
                assert_eq!(got[3], 255.0);
            }
        }
    }

    #[test]
    fn only_what_is_drawn_is_kept_and_it_comes_to_its_place() {
        // Three columns in rows of four, of which the last is padding; two rows.
        let rows: [[u32; 4]; 2] = [[0xff00_0001, 0, 0xff00_0002, 9], [0, 0xff00_0003, 0xff00_0004, 9]];
        let bytes: Vec<u8> = rows.iter().flatten().flat_map(|c| c.to_le_bytes()).collect();
        let (spans, codes) = spans(bytes.chunks_exact(16), 3);
        assert_eq!(codes, [0xff00_0001, 0xff00_0002, 0xff00_0003, 0xff00_0004]);
        assert_eq!(spans, [Span { at: 0, len: 1 }, Span { at: 2, len: 1 }, Span { at: 4, len: 2 }]);
        let mut pixels = [0xff77_7777; 6];
        lay_over(&spans, &codes, &mut pixels);
        assert_eq!(pixels, [0xff00_0001, 0xff77_7777, 0xff00_0002, 0xff77_7777, 0xff00_0003, 0xff00_0004]);
        // The window has become smaller.
        lay_over(&spans, &codes, &mut pixels[..2]);
    }
}
