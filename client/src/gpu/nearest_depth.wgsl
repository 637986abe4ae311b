// The first of two passes: the largest disparity of a pixel.

const COUNTS = true;

@group(2) @binding(0) var<storage, read_write> depths: array<atomic<u32>>;
@group(2) @binding(1) var<storage, read_write> colours: array<atomic<u32>>;

fn put(at: u32, disparity_bits: u32, colour: u32) {
    atomicMax(&depths[at], disparity_bits);
}
