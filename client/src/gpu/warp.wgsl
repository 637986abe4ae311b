// The warp of tiles, one workgroup each: transform the tile's samples, then draw its micro-quads
// and border pieces, or its samples' stamps. The twin of the processor's `transform` and `quads`,
// whose names it keeps. What keeps the nearest sample of a pixel, `put`, comes with one of the
// files keep_*.wgsl.

const TILE_ROWS = 16u;
const TILE_COLUMNS = 64u;
const TILE_SAMPLES = 1105u;
const THREADS = 64u;
const LANES = 8u;
// As on the processor.
const SLACK = 1.0 / 512.0;
const BOX_SLACK = 1.0 / 256.0;

const QUADS = 0u;
const ONE_PIXEL = 1u;
const TWO_BY_TWO = 2u;
const CROSS = 3u;
const THREE_BY_THREE = 4u;

const STRETCH_BINS = 257u;
const STRETCH_PER_PIXEL = 8.0;

struct Picture {
    width: u32,
    height: u32,
    stamp: u32,
    unused: u32,
}

// What one dispatch draws: tiles of one image.
struct Batch {
    first_job: u32,
    jobs: u32,
    // Workgroups along x.
    across: u32,
    unused: u32,
}

struct Tile {
    first_sample: u32,
    samples: u32,
    first_quad: u32,
    quads: u32,
    first_group: u32,
    pieces: u32,
}

// A tile that reaches the picture: X, Y and W as functions of (u, v, 1, d), relative to its upper
// left corner.
struct Job {
    x: vec4f,
    y: vec4f,
    w: vec4f,
    tile: vec4u,
}

struct Sample {
    // Column and row in the tile.
    place: u32,
    disparity: f32,
    colour: u32,
}

@group(0) @binding(0) var<uniform> picture: Picture;
@group(0) @binding(1) var<storage, read> jobs: array<Job>;
// The largest squared footprint, then how many quads have which longest side.
@group(0) @binding(2) var<storage, read_write> figures: array<atomic<u32>>;

@group(1) @binding(0) var<storage, read> tiles: array<Tile>;
@group(1) @binding(1) var<storage, read> samples: array<Sample>;
// Numbers of the upper left and the lower left sample, 11 bits each; the highest bit: counts for
// the figures.
@group(1) @binding(2) var<storage, read> quads: array<u32>;
// Groups of eight border pieces: u, v, disparity and colour, each by corner, then by piece.
@group(1) @binding(3) var<storage, read> groups: array<u32>;
@group(1) @binding(4) var<uniform> batch: Batch;

// The tile's samples on the output: column, row, disparity (-1 at or behind the eye's plane).
var<workgroup> warped_x: array<f32, TILE_SAMPLES>;
var<workgroup> warped_y: array<f32, TILE_SAMPLES>;
var<workgroup> warped_disparity: array<f32, TILE_SAMPLES>;
var<workgroup> footprint2: atomic<u32>;

struct Corner {
    x: f32,
    y: f32,
    disparity: f32,
    // Squared sRGB codes.
    light: vec3f,
}

// Column, row and disparity on the output of image coordinates relative to the tile.
fn warp(job: Job, u: f32, v: f32, d: f32) -> vec4f {
    let at = vec4f(u, v, 1.0, d);
    let inverse = 1.0 / dot(job.w, at);
    let ahead = inverse > 0.0;
    return vec4f(dot(job.x, at) * inverse, dot(job.y, at) * inverse, select(-1.0, d * inverse, ahead), inverse);
}

// The larger singular value of d(x, y)/d(u, v) at fixed disparity, squared.
fn footprint_squared(job: Job, p: vec4f) -> f32 {
    let a = (job.x.x - p.x * job.w.x) * p.w;
    let b = (job.x.y - p.x * job.w.y) * p.w;
    let c = (job.y.x - p.y * job.w.x) * p.w;
    let d = (job.y.y - p.y * job.w.y) * p.w;
    let trace = a * a + b * b + c * c + d * d;
    let det = a * d - b * c;
    return 0.5 * (trace + sqrt(max(trace * trace - 4.0 * det * det, 0.0)));
}

fn light(colour: u32) -> vec3f {
    let code = vec3f(vec3u(colour & 255u, (colour >> 8u) & 255u, (colour >> 16u) & 255u));
    return code * code;
}

fn sample_corner(tile: Tile, i: u32) -> Corner {
    return Corner(warped_x[i], warped_y[i], warped_disparity[i], light(samples[tile.first_sample + i].colour));
}

fn piece_corner(job: Job, group: u32, lane: u32, corner: u32) -> Corner {
    let at = group * 128u + corner * LANES + lane;
    let u = bitcast<f32>(groups[at]);
    let v = bitcast<f32>(groups[at + 32u]);
    let d = bitcast<f32>(groups[at + 64u]);
    let p = warp(job, u, v, d);
    return Corner(p.x, p.y, p.z, light(groups[at + 96u]));
}

// Where a pixel centre lies in a quad, as affine functions of its offset from a corner.
struct Half {
    at: vec2f,
    s: vec2f,
    t: vec2f,
}

fn half_of(at: Corner, across: Corner, down: Corner) -> Half {
    let a = vec2f(across.x - at.x, across.y - at.y);
    let d = vec2f(down.x - at.x, down.y - at.y);
    let inverse = 1.0 / (a.x * d.y - a.y * d.x);
    return Half(vec2f(at.x, at.y), vec2f(d.y, -d.x) * inverse, vec2f(-a.y, a.x) * inverse);
}

fn bilinear(a: f32, b: f32, e: f32, f: f32, s: f32, t: f32) -> f32 {
    let top = a + (b - a) * s;
    let bottom = e + (f - e) * s;
    return top + (bottom - top) * t;
}

fn bilinear3(a: vec3f, b: vec3f, e: vec3f, f: vec3f, s: f32, t: f32) -> vec3f {
    let top = a + (b - a) * s;
    let bottom = e + (f - e) * s;
    return top + (bottom - top) * t;
}

fn packed(light: vec3f) -> u32 {
    let code = vec3u(sqrt(max(light, vec3f(0.0))) + 0.5);
    return code.x | (code.y << 8u) | (code.z << 16u);
}

// Paints the pixel centres of a quad.
fn draw(a: Corner, b: Corner, e: Corner, f: Corner) {
    if !(min(min(a.disparity, b.disparity), min(e.disparity, f.disparity)) > 0.0) {
        return;
    }
    let low = min(min(vec2f(a.x, a.y), vec2f(b.x, b.y)), min(vec2f(e.x, e.y), vec2f(f.x, f.y)));
    let high = max(max(vec2f(a.x, a.y), vec2f(b.x, b.y)), max(vec2f(e.x, e.y), vec2f(f.x, f.y)));
    let size = vec2f(f32(picture.width), f32(picture.height));
    let first = max(floor(low + (0.5 - BOX_SLACK)), vec2f(0.0));
    let last = min(floor(high + (BOX_SLACK - 0.5)), size - 1.0);
    if !(first.x <= last.x && first.y <= last.y) {
        return;
    }
    let upper = half_of(a, b, e);
    let lower = half_of(f, e, b);
    for (var row = first.y; row <= last.y; row += 1.0) {
        for (var column = first.x; column <= last.x; column += 1.0) {
            let centre = vec2f(column + 0.5, row + 0.5);
            let s1 = dot(centre - upper.at, upper.s);
            let t1 = dot(centre - upper.at, upper.t);
            let s2 = dot(centre - lower.at, lower.s);
            let t2 = dot(centre - lower.at, lower.t);
            let inside1 = s1 >= -SLACK && t1 >= -SLACK && 1.0 - (s1 + t1) >= -SLACK;
            let inside2 = s2 >= -SLACK && t2 >= -SLACK && 1.0 - (s2 + t2) >= -SLACK;
            if !(inside1 || inside2) {
                continue;
            }
            let s = clamp(select(1.0 - s2, s1, inside1), 0.0, 1.0);
            let t = clamp(select(1.0 - t2, t1, inside1), 0.0, 1.0);
            let colour = packed(bilinear3(a.light, b.light, e.light, f.light, s, t));
            let disparity = bilinear(a.disparity, b.disparity, e.disparity, f.disparity, s, t);
            put(u32(row) * picture.width + u32(column), bitcast<u32>(disparity), colour);
        }
    }
}

// Paints fixed pixels around a sample.
fn stamp(tile: Tile, i: u32) {
    let disparity = warped_disparity[i];
    let value = samples[tile.first_sample + i];
    // A halo sample is its own tile's.
    let own = (value.place & 255u) < TILE_COLUMNS && (value.place >> 8u) < TILE_ROWS;
    if !own || !(disparity > 0.0) {
        return;
    }
    let shift = select(0.0, 0.5, picture.stamp == TWO_BY_TWO);
    let home = floor(vec2f(warped_x[i], warped_y[i]) - shift);
    var first = vec2f(0.0);
    var last = vec2f(0.0);
    if picture.stamp == TWO_BY_TWO {
        last = vec2f(1.0);
    } else if picture.stamp != ONE_PIXEL {
        first = vec2f(-1.0);
        last = vec2f(1.0);
    }
    for (var dy = first.y; dy <= last.y; dy += 1.0) {
        for (var dx = first.x; dx <= last.x; dx += 1.0) {
            if picture.stamp == CROSS && dx * dy != 0.0 {
                continue;
            }
            let at = home + vec2f(dx, dy);
            if at.x >= 0.0 && at.y >= 0.0 && at.x < f32(picture.width) && at.y < f32(picture.height) {
                put(u32(at.y) * picture.width + u32(at.x), bitcast<u32>(disparity), value.colour);
            }
        }
    }
}

fn count_stretch(top: u32, bottom: u32) {
    var longest2 = 0.0;
    if warped_disparity[top] > 0.0 {
        let at = vec2f(warped_x[top], warped_y[top]);
        if warped_disparity[top + 1u] > 0.0 {
            let side = vec2f(warped_x[top + 1u], warped_y[top + 1u]) - at;
            longest2 = dot(side, side);
        }
        if warped_disparity[bottom] > 0.0 {
            let side = vec2f(warped_x[bottom], warped_y[bottom]) - at;
            longest2 = max(longest2, dot(side, side));
        }
    }
    let bin = min(u32(min(sqrt(longest2) * STRETCH_PER_PIXEL, 1e6)), STRETCH_BINS - 1u);
    atomicAdd(&figures[1u + bin], 1u);
}

@compute @workgroup_size(64)
fn warp_tile(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let number = group.y * batch.across + group.x;
    if number >= batch.jobs {
        return;
    }
    let job = jobs[batch.first_job + number];
    let tile = tiles[job.tile.x];

    var largest2 = 0.0;
    for (var i = lane; i < tile.samples; i += THREADS) {
        let value = samples[tile.first_sample + i];
        let u = f32(value.place & 255u) + 0.5;
        let v = f32(value.place >> 8u) + 0.5;
        let p = warp(job, u, v, value.disparity);
        warped_x[i] = p.x;
        warped_y[i] = p.y;
        warped_disparity[i] = p.z;
        let on_picture = p.x >= 0.0 && p.y >= 0.0 && p.x < f32(picture.width) && p.y < f32(picture.height);
        if on_picture && p.z > 0.0 {
            largest2 = max(largest2, footprint_squared(job, p));
        }
    }
    atomicMax(&footprint2, bitcast<u32>(largest2));
    workgroupBarrier();

    if picture.stamp == QUADS {
        for (var i = lane; i < tile.quads; i += THREADS) {
            let quad = quads[tile.first_quad + i];
            let top = quad & 2047u;
            let bottom = (quad >> 11u) & 2047u;
            draw(sample_corner(tile, top), sample_corner(tile, top + 1u), sample_corner(tile, bottom), sample_corner(tile, bottom + 1u));
            if (quad >> 31u) != 0u && COUNTS {
                count_stretch(top, bottom);
            }
        }
        for (var i = lane; i < tile.pieces; i += THREADS) {
            let at = tile.first_group + i / LANES;
            let piece = i % LANES;
            draw(piece_corner(job, at, piece, 0u), piece_corner(job, at, piece, 1u), piece_corner(job, at, piece, 2u), piece_corner(job, at, piece, 3u));
        }
    } else {
        for (var i = lane; i < tile.samples; i += THREADS) {
            stamp(tile, i);
        }
    }
    if lane == 0u && COUNTS {
        atomicMax(&figures[0], atomicLoad(&footprint2));
    }
}
