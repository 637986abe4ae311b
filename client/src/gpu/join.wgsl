// Near geometry and warped images become one picture: the twins of the processor's `merge`, `fill` and `downsample`. What shows where neither reached the processor finds out
// (of `open` pixels), and it is laid there (`lay_sky`, `lay_samples`). Disparities are 1/m; row 0 is on top.

const NEAR = 1u;
const FAR = 2u;
const FILLED = 4u;
const UNPAINTED = 5u;
// As on the processor.
const REACH_PX = 48u;
const SKY_SIDES = 2u;

struct Join {
    width: u32,
    height: u32,
    faces: u32,
    // Words between a pixel of the warped picture and the next; 0: nothing was warped.
    far_stride: u32,
    // Disparity at the near plane, 1/m.
    nearest: f32,
    // The sky's colour, source and all.
    sky: u32,
    samples: u32,
    // Pixels of the frame along a pixel of the output.
    factor: u32,
}

// Images of one plane as seen from one centre: what one step of their disparity codes is on the output.
struct Face {
    // Of the direction of pixel (0, 0), per column, per row: along the plane's normal.
    first: f32,
    per_column: f32,
    per_row: f32,
    // Eye's depth, m.
    eye_depth: f32,
    step: f32,
}

// A pixel that the LDI tree gives.
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

// Whether a triangle behind the far surface is as near as the far surface's disparity is known.
fn near_wins(place: vec2f, near: f32, far: f32) -> bool {
    var largest = 0.0;
    for (var i = 0u; i < join.faces; i += 1u) {
        let face = faces[i];
        let forward = face.first + face.per_column * place.x + face.per_row * place.y;
        largest = max(largest, face.step * (far * face.eye_depth + forward));
    }
    return far - near <= largest;
}

@compute @workgroup_size(64)
fn merge(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= join.width || id.y >= join.height {
        return;
    }
    let at = id.y * join.width + id.x;
    let depth = textureLoad(near_depth, id.xy, 0);
    let near = depth * join.nearest;
    let codes = vec3u(textureLoad(near_colour, id.xy, 0).rgb * 255.0 + 0.5);
    let near_packed = codes.x | (codes.y << 8u) | (codes.z << 16u) | (NEAR << 24u);
    var far = 0.0;
    if join.far_stride > 0u {
        far = bitcast<f32>(far_disparities[at * join.far_stride + join.far_stride - 1u]);
    }
    let is_near = depth > 0.0;
    if is_near && (!(far > 0.0) || near >= far || near_wins(vec2f(id.xy), near, far)) {
        colours[at] = near_packed;
        disparities[at] = near;
    } else if far > 0.0 {
        colours[at] = far_colours[at * join.far_stride] | (FAR << 24u);
        disparities[at] = far;
    } else {
        colours[at] = (join.sky & 0xffffffu) | (UNPAINTED << 24u);
        disparities[at] = 0.0;
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

// Of the first surfaces to the left, right, above and below that with the smallest disparity, of equals the closest; sky where two sides meet it. Pixels that are being filled are no surfaces yet.
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
        atomicAdd(&filled, 1u);
    } else if found {
        let colour = atomicLoad(&shared_colours[best]) & 0xffffffu;
        atomicStore(&shared_colours[at], colour | (FILLED << 24u));
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

// Blocks of factor x factor pixels: colours in linear light, the most frequent source, of equals the more doubtful.
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
