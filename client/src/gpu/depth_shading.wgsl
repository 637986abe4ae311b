// Shading of a finished picture by its depths: the equivalent of the CPU's `DepthShading`, with the
// same constants. Disparities are 1/m; row 0 is on top.

const STEEPEST = 2.5;
const CUT = 2.2;
const BIAS = 0.04;
const GAIN = 1.2;
const DARKEST = 0.42;
const RADIUS_M = 0.5;
const CREASE = vec2f(0.25, 0.75);
const BORDER = 6.0;
const LINE = 0.38;
const FADE_M = 25.0;
const NOTHING = 1e-6;

struct Shading {
    // Of the finished picture.
    width: u32,
    height: u32,
    // Pixels of the frame along a pixel of the picture.
    factor: u32,
    frame_width: u32,
    // Distances of the pairs, pixels at half resolution; 0: none.
    reach: vec4i,
    focal_px: f32,
    noise: f32,
    noise_per_disparity: f32,
}

@group(0) @binding(0) var<uniform> shading: Shading;
// Of the frame.
@group(0) @binding(1) var<storage, read> frame_disparities: array<f32>;
// Of the picture.
@group(0) @binding(2) var<storage, read_write> nearest: array<f32>;
// At every second pixel of every second row.
@group(0) @binding(3) var<storage, read_write> darkness: array<f32>;
// Colours with the source in the highest byte.
@group(0) @binding(4) var<storage, read_write> colours: array<u32>;

// The largest disparity of each block.
@compute @workgroup_size(64)
fn shrink(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= shading.width || id.y >= shading.height {
        return;
    }
    let corner = (id.y * shading.frame_width + id.x) * shading.factor;
    var largest = 0.0;
    for (var row = 0u; row < shading.factor; row += 1u) {
        for (var column = 0u; column < shading.factor; column += 1u) {
            largest = max(largest, frame_disparities[corner + row * shading.frame_width + column]);
        }
    }
    nearest[id.y * shading.width + id.x] = largest;
}

fn half_size() -> vec2i {
    return vec2i(i32(shading.width) + 1, i32(shading.height) + 1) / 2;
}

fn half_at(x: i32, y: i32) -> f32 {
    return nearest[u32(2 * y) * shading.width + u32(2 * x)];
}

// A disparity of a row, continued beyond the borders by a point reflection.
fn across(x: i32, y: i32) -> f32 {
    let last = half_size().x - 1;
    if x < 0 {
        return 2.0 * half_at(0, y) - half_at(-x, y);
    }
    if x > last {
        return 2.0 * half_at(last, y) - half_at(2 * last - x, y);
    }
    return half_at(x, y);
}

fn continued(place: vec2i) -> f32 {
    let last = half_size().y - 1;
    if place.y < 0 {
        return 2.0 * across(place.x, 0) - across(place.x, -place.y);
    }
    if place.y > last {
        return 2.0 * across(place.x, last) - across(place.x, 2 * last - place.y);
    }
    return across(place.x, place.y);
}

fn side(slope: f32) -> f32 {
    return min(slope, max((CUT * STEEPEST - slope) / (CUT - 1.0), 0.0));
}

fn occlusion_by_pair(here: vec2i, offset: vec2i, d: f32, slope: f32, lost: f32) -> f32 {
    let sides = side((continued(here - offset) - d) * slope) + side((continued(here + offset) - d) * slope);
    return clamp(0.5 * (sides - lost), 0.0, 1.0);
}

@compute @workgroup_size(64)
fn occlude(@builtin(global_invocation_id) id: vec3u) {
    let here = vec2i(id.xy);
    let size = half_size();
    if any(here >= size) {
        return;
    }
    let d = half_at(here.x, here.y);
    let depth = select(0.0, 1.0 / max(d, NOTHING), d > NOTHING);
    var occlusion = 0.0;
    var weight = 0.0;
    for (var i = 0u; i < 4u; i += 1u) {
        let o = shading.reach[i];
        if o == 0 {
            continue;
        }
        let diagonal = i32(max(round(f32(o) * 0.70710678), 1.0));
        let straight = 0.5 * shading.focal_px / f32(o);
        let slanted = 0.5 * shading.focal_px / (f32(diagonal) * 1.41421356);
        let lost = BIAS + 6.0 * straight * (shading.noise * depth + shading.noise_per_disparity);
        let sum = occlusion_by_pair(here, vec2i(o, 0), d, depth * straight, lost)
            + occlusion_by_pair(here, vec2i(0, o), d, depth * straight, lost)
            + occlusion_by_pair(here, vec2i(diagonal, diagonal), d, depth * slanted, lost)
            + occlusion_by_pair(here, vec2i(diagonal, -diagonal), d, depth * slanted, lost);
        let w = clamp(1.5 * RADIUS_M * d * straight - 0.5, 0.0, 1.0);
        occlusion += w * sum;
        weight += w;
    }
    darkness[id.y * u32(size.x) + id.x] = min(GAIN * 0.25 * occlusion / max(weight, 1.0), 1.0) * DARKEST;
}

// The darkness between the samples at half resolution: pixel 2i lies on sample i.
fn enlarged(place: vec2u) -> f32 {
    let size = vec2u(half_size());
    let first = place / 2u;
    let second = min((place + 1u) / 2u, size - 1u);
    let above = darkness[first.y * size.x + first.x] + darkness[first.y * size.x + second.x];
    let below = darkness[second.y * size.x + first.x] + darkness[second.y * size.x + second.x];
    return 0.25 * (above + below);
}

// The second difference along a row or a column, whichever is larger.
fn change(place: vec2u, d: f32) -> f32 {
    let at = place.y * shading.width + place.x;
    var along = 0.0;
    if place.x > 0u && place.x + 1u < shading.width {
        along = nearest[at - 1u] + nearest[at + 1u] - 2.0 * d;
    }
    if place.y > 0u && place.y + 1u < shading.height {
        let down = nearest[at - shading.width] + nearest[at + shading.width] - 2.0 * d;
        along = select(along, down, abs(down) > abs(along));
    }
    return along;
}

@compute @workgroup_size(64)
fn shade(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= shading.width || id.y >= shading.height {
        return;
    }
    let at = id.y * shading.width + id.x;
    var dark = enlarged(id.xy);
    let d = max(nearest[at], NOTHING);
    let slope = change(id.xy, nearest[at]) * shading.focal_px / d;
    let lost = CREASE.x + 4.0 * shading.focal_px * (shading.noise / d + shading.noise_per_disparity);
    let convex = -slope - lost;
    let concave = min(slope, 2.0 * BORDER - slope) - lost;
    let line = clamp(max(convex, concave) / CREASE.y, 0.0, 1.0);
    let faded = (d - NOTHING) / (d + 1.0 / FADE_M);
    dark += LINE * faded * line * (1.0 - dark);
    let kept = 256u - u32(256.0 * dark);
    let colour = colours[at];
    let red_blue = (((colour & 0xff00ffu) * kept) >> 8u) & 0xff00ffu;
    let green = (((colour >> 8u) & 0xffu) * kept) & 0xff00u;
    colours[at] = (colour & 0xff000000u) | red_blue | green;
}
