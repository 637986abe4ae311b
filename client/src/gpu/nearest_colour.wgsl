// The second of two passes: the largest colour among the samples that have a pixel's largest
// disparity.

const COUNTS = false;

@group(2) @binding(0) var<storage, read_write> depths: array<atomic<u32>>;
@group(2) @binding(1) var<storage, read_write> colours: array<atomic<u32>>;

fn put(at: u32, disparity_bits: u32, colour: u32) {
    if atomicLoad(&depths[at]) == disparity_bits {
        atomicMax(&colours[at], colour);
    }
}
