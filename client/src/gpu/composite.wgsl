// The composite of near geometry and warped images: the equivalents of the CPU's `merge`, `fill`
// and `downsample`. The CPU finds the content of `open` pixels, which `lay_sky` and `lay_samples`
// add. Disparities are 1/m; row 0 is on top.

const NEAR = 1u;
const FAR = 2u;
const FILLED = 4u;
const UNPAINTED = 5u;
// The value of the CPU's hole filling.
const REACH_PX = 48u;
const SKY_SIDES = 2u;
const SAME_SURFACE = 0.1;

struct Join {
    width: u32,
    height: u32,
    faces: u32,
    // Words from one pixel of the warped picture to the next; 0: nothing was warped.
    far_stride: u32,
    // Disparity at the near plane, 1/m.
    nearest: f32,
    // The sky's colour with its source.
    sky: u32,
    samples: u32,
    // Pixels of the frame along a pixel of the output.
    factor: u32,
}

// Images on one plane with one centre: the precision of their disparity codes on the output.
struct Face {
    // The normal's component of a pixel's direction: at pixel (0, 0), per column, per row.
    first: f32,
    per_column: f32,
    per_row: f32,
    // Eye's depth, m.
    eye_depth: f32,
    step: f32,
}

// A pixel taken from the LDI tree.
struct Sample {
    at: u32,
    colour: u32,
    disparity: f32,
}

@group(0) @binding(0) var<uniform> join: Join;
@group(0) @binding(1) var near_colour: texture_2d<f32>;
@group(0) @binding(2) var near_depth: texture_depth_2d;
@group(0) @binding(3) var<storage, read> far_colours: array<u32>;
@group(0) @binding(4) var<storage, read> far_disparities: array<u32>;
@group(0) @binding(5) var<storage, read> faces: array<Face>;
// Colours with the source in the highest byte.
@group(0) @binding(6) var<storage, read_write> colours: array<u32>;
@group(0) @binding(6) var<storage, read_write> shared_colours: array<atomic<u32>>;
@group(0) @binding(7) var<storage, read_write> disparities: array<f32>;
// A bit per pixel that nothing reached.
@group(0) @binding(8) var<storage, read_write> open: array<atomic<u32>>;
// A bit per pixel that is sky.
@group(0) @binding(9) var<storage, read> skies: array<u32>;
@group(0) @binding(10) var<storage, read> samples: array<Sample>;
@group(0) @binding(11) var<storage, read_write> averaged: array<u32>;
// Pixels that were filled.
@group(0) @binding(12) var<storage, read_write> filled: atomic<u32>;

// Whether a triangle behind the far surface lies within the precision of the far disparity.
fn near_wins(place: vec2f, near: f32, far: f32) -> bool {
    var largest = 0.0;
    for (var i = 0u; i < join.faces; i += 1u) {
        let face = faces[i];
        let forward = face.first + face.per_column * place.x + face.per_row * place.y;
        largest = max(largest, face.step * (far * face.eye_depth + forward));
    }
    return far - near <= largest;
}

// A colour with its source; disparity 0 where there is no surface.
struct Pixel {
    colour: u32,
    disparity: f32,
}

// The nearer content of a pixel.
fn by_depth(place: vec2u) -> Pixel {
    let at = place.y * join.width + place.x;
    let depth = textureLoad(near_depth, place, 0);
    let near = depth * join.nearest;
    var far = 0.0;
    if join.far_stride > 0u {
        far = bitcast<f32>(far_disparities[at * join.far_stride + join.far_stride - 1u]);
    }
    if depth > 0.0 && (!(far > 0.0) || near >= far || near_wins(vec2f(place), near, far)) {
        let codes = vec3u(textureLoad(near_colour, place, 0).rgb * 255.0 + 0.5);
        return Pixel(codes.x | (codes.y << 8u) | (codes.z << 16u) | (NEAR << 24u), near);
    }
    if far > 0.0 {
        return Pixel(far_colours[at * join.far_stride] | (FAR << 24u), far);
    }
    return Pixel((join.sky & 0xffffffu) | (UNPAINTED << 24u), 0.0);
}

// Whether both sides of a gap show the same surface, at least one of them from an image.
fn joins(a: Pixel, b: Pixel) -> bool {
    let sources = vec2u(a.colour, b.colour) >> vec2u(24u);
    return min(sources.x, sources.y) >= NEAR && max(sources.x, sources.y) == FAR
        && abs(a.disparity - b.disparity) <= SAME_SURFACE * max(a.disparity, b.disparity);
}

// The content of an open pixel: the farther side if it is a seam.
fn close_seam(place: vec2u, open_pixel: Pixel) -> Pixel {
    for (var axis = 0u; axis < 2u; axis += 1u) {
        let step = select(vec2u(0u, 1u), vec2u(1u, 0u), axis == 0u);
        if any(place < step) || any(place + step >= vec2u(join.width, join.height)) {
            continue;
        }
        let before = by_depth(place - step);
        let after = by_depth(place + step);
        if joins(before, after) {
            if before.disparity <= after.disparity {
                return before;
            }
            return after;
        }
    }
    return open_pixel;
}

@compute @workgroup_size(64)
fn merge(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= join.width || id.y >= join.height {
        return;
    }
    var pixel = by_depth(id.xy);
    if pixel.disparity == 0.0 {
        pixel = close_seam(id.xy, pixel);
    }
    let at = id.y * join.width + id.x;
    colours[at] = pixel.colour;
    disparities[at] = pixel.disparity;
    if pixel.disparity == 0.0 {
        atomicOr(&open[at / 32u], 1u << (at % 32u));
    }
}

@compute @workgroup_size(64)
fn lay_sky(@builtin(global_invocation_id) id: vec3u) {
    let at = id.y * join.width + id.x;
    if id.x < join.width && id.y < join.height && ((skies[at / 32u] >> (at % 32u)) & 1u) != 0u {
        colours[at] = join.sky;
    }
}

@compute @workgroup_size(64)
fn lay_samples(@builtin(global_invocation_id) id: vec3u) {
    if id.x < join.samples {
        let given = samples[id.x];
        colours[given.at] = given.colour;
        disparities[given.at] = given.disparity;
    }
}

// Fills a hole: of the first surfaces to the left, right, above and below, the one with the
// smallest disparity, of equals the closest; sky if two sides meet it. Pixels that are being filled
// do not count.
@compute @workgroup_size(64)
fn fill(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= join.width || id.y >= join.height {
        return;
    }
    let at = id.y * join.width + id.x;
    if (atomicLoad(&shared_colours[at]) >> 24u) != UNPAINTED {
        return;
    }
    var rooms = array<u32, 4>(id.x, join.width - 1u - id.x, id.y, join.height - 1u - id.y);
    var steps = array<i32, 4>(-1, 1, -i32(join.width), i32(join.width));
    var best = 0u;
    var best_disparity = 0.0;
    var best_distance = 0u;
    var found = false;
    var sky = 0u;
    for (var side = 0u; side < 4u; side += 1u) {
        for (var distance = 1u; distance <= min(rooms[side], REACH_PX); distance += 1u) {
            let other = u32(i32(at) + steps[side] * i32(distance));
            let colour = atomicLoad(&shared_colours[other]);
            let source = colour >> 24u;
            if source == UNPAINTED || source == FILLED {
                continue;
            }
            if source == 0u {
                sky += 1u;
            } else {
                let disparity = disparities[other];
                let closer = distance < best_distance || (distance == best_distance && other < best);
                if !found || disparity < best_disparity || (disparity == best_disparity && closer) {
                    found = true;
                    best = other;
                    best_disparity = disparity;
                    best_distance = distance;
                }
            }
            break;
        }
    }
    if sky >= SKY_SIDES {
        atomicStore(&shared_colours[at], (join.sky & 0xffffffu) | (FILLED << 24u));
        disparities[at] = 0.0;
        atomicAdd(&filled, 1u);
    } else if found {
        let colour = atomicLoad(&shared_colours[best]) & 0xffffffu;
        atomicStore(&shared_colours[at], colour | (FILLED << 24u));
        // Nobody reads the disparity of a pixel that is being filled.
        disparities[at] = best_disparity;
        atomicAdd(&filled, 1u);
    }
}

fn linear(code: u32) -> f32 {
    let c = f32(code) / 255.0;
    return select(pow((c + 0.055) / 1.055, 2.4), c / 12.92, c <= 0.04045);
}

fn encoded(light: f32) -> u32 {
    let c = select(1.055 * pow(light, 1.0 / 2.4) - 0.055, light * 12.92, light <= 0.0031308);
    return u32(clamp(c, 0.0, 1.0) * 255.0 + 0.5);
}

// Averages blocks of factor x factor pixels in linear light; the most frequent source, of equals
// the more uncertain.
@compute @workgroup_size(64)
fn downsample(@builtin(global_invocation_id) id: vec3u) {
    let width = join.width / join.factor;
    if id.x >= width || id.y >= join.height / join.factor {
        return;
    }
    let corner = (id.y * join.width + id.x) * join.factor;
    let first = colours[corner];
    var same = true;
    var votes = array<u32, 6>();
    for (var row = 0u; row < join.factor; row += 1u) {
        for (var column = 0u; column < join.factor; column += 1u) {
            let colour = colours[corner + row * join.width + column];
            same = same && (colour & 0xffffffu) == (first & 0xffffffu);
            votes[min(colour >> 24u, UNPAINTED)] += 1u;
        }
    }
    var source = 0u;
    for (var i = 1u; i <= UNPAINTED; i += 1u) {
        source = select(source, i, votes[i] >= votes[source]);
    }
    var packed = first & 0xffffffu;
    if !same {
        var sum = vec3f(0.0);
        for (var row = 0u; row < join.factor; row += 1u) {
            for (var column = 0u; column < join.factor; column += 1u) {
                let colour = colours[corner + row * join.width + column];
                sum += vec3f(linear(colour & 255u), linear((colour >> 8u) & 255u), linear((colour >> 16u) & 255u));
            }
        }
        let mean = sum / f32(join.factor * join.factor);
        packed = encoded(mean.x) | (encoded(mean.y) << 8u) | (encoded(mean.z) << 16u);
    }
    averaged[id.y * width + id.x] = packed | (source << 24u);
}
