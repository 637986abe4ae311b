// Keeps the nearest sample of a pixel in one pass: disparity above colour in 64 bits.

const COUNTS = true;

@group(2) @binding(0) var<storage, read_write> pixels: array<atomic<u64>>;

fn put(at: u32, disparity_bits: u32, colour: u32) {
    atomicMax(&pixels[at], (u64(disparity_bits) << 32u) | u64(colour));
}
