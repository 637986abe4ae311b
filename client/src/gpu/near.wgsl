// Near geometry: clusters in mesh space to shaded pixels. Colours in linear light; the target
// encodes them.

struct View {
    // Clip x and y per eye-space x and y: focal length over half the picture.
    scale: vec2f,
    // Near plane, metres: with it depth is disparity times this, 1 at the near plane, 0 at
    // infinity.
    near_m: f32,
    unused: f32,
}

struct Image {
    // Columns and rows of the finest level there could be.
    size: vec2f,
    // Number of the finest level that is here.
    first_level: f32,
    unused: f32,
}

@group(0) @binding(0) var<uniform> view: View;
@group(1) @binding(0) var<uniform> image: Image;
@group(1) @binding(1) var texels: texture_2d<f32>;

// How a material continues its texture along an axis.
const REPEAT = 0u;
const MIRROR = 1u;
const CLAMP = 2u;

struct Corner {
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) uv: vec2f,
    @location(3) colour: vec3f,
}

struct Draw {
    // Rows of eye space (right, up, forward) from positions relative to the cluster's origin.
    @location(4) right: vec4f,
    @location(5) up: vec4f,
    @location(6) forward: vec4f,
    // Columns of the turn of normals.
    @location(7) normal_x: vec3f,
    @location(8) normal_y: vec3f,
    @location(9) normal_z: vec3f,
    // Linear base colour and alpha.
    @location(10) factor: vec4f,
    // 1 or 0: unlit, textured; alpha cutoff; wrap mode across, and three times that down.
    @location(11) kind: vec4f,
}

struct Between {
    @builtin(position) position: vec4f,
    @location(0) normal: vec3f,
    @location(1) uv: vec2f,
    @location(2) colour: vec3f,
    @location(3) @interpolate(flat) kind: vec4f,
    @location(4) @interpolate(flat) alpha: f32,
}

@vertex
fn vertex(corner: Corner, draw: Draw) -> Between {
    let p = vec4f(corner.position, 1.0);
    let eye = vec3f(dot(draw.right, p), dot(draw.up, p), dot(draw.forward, p));
    var out: Between;
    out.position = vec4f(eye.xy * view.scale, view.near_m, eye.z);
    out.normal = mat3x3f(draw.normal_x, draw.normal_y, draw.normal_z) * corner.normal;
    out.uv = corner.uv;
    out.colour = draw.factor.rgb * corner.colour;
    out.kind = draw.kind;
    out.alpha = draw.factor.a;
    return out;
}

// Light on a unit normal: `light` of the protocol's shading.
fn light(n: vec3f) -> f32 {
    let l = vec3f(0.39966794, 0.7993359, 0.44962643);
    return 0.35 + 0.25 * (0.5 + 0.5 * n.y) + 0.40 * abs(dot(n, l));
}

// The two texels that a coordinate lies between along an axis.
struct Tap {
    first: i32,
    second: i32,
    second_weight: f32,
}

fn tap(u: f32, n: i32, wrap: u32) -> Tap {
    var folded = u - floor(u);
    if wrap == MIRROR {
        let t = u - 2.0 * floor(u * 0.5);
        folded = min(t, 2.0 - t);
    } else if wrap == CLAMP {
        folded = clamp(u, 0.0, 1.0);
    }
    let x = folded * f32(n) - 0.5;
    let below = floor(x);
    let last = n - 1;
    var first = i32(below);
    var second = first + 1;
    if wrap == REPEAT {
        first = select(first, last, first < 0);
        second = select(second, 0, second > last);
    }
    return Tap(clamp(first, 0, last), clamp(second, 0, last), x - below);
}

// The twin of the processor's sampler. Samplers of cards know places between texels to a 256th
// only, which beside bright texels shows by several codes in dark ones.
fn bilinear(uv: vec2f, level: u32, wrap: u32) -> vec4f {
    // Not asked for by level: Mesa's software driver would answer all pixels that it draws at once
    // for the level of the first.
    let size = max(vec2i(textureDimensions(texels) >> vec2u(level)), vec2i(1));
    let x = tap(uv.x, size.x, wrap % 3u);
    let y = tap(uv.y, size.y, wrap / 3u);
    let top = mix(
        textureLoad(texels, vec2i(x.first, y.first), level),
        textureLoad(texels, vec2i(x.second, y.first), level),
        x.second_weight,
    );
    let bottom = mix(
        textureLoad(texels, vec2i(x.first, y.second), level),
        textureLoad(texels, vec2i(x.second, y.second), level),
        x.second_weight,
    );
    return mix(top, bottom, y.second_weight);
}

fn trilinear(uv: vec2f, lod: f32, wrap: u32) -> vec3f {
    let last = textureNumLevels(texels) - 1u;
    let fine = min(u32(lod), last);
    let colour = bilinear(uv, fine, wrap).rgb;
    let blend = fract(lod);
    if blend == 0.0 || fine == last {
        return colour;
    }
    return mix(colour, bilinear(uv, fine + 1u, wrap).rgb, blend);
}

fn shade(in: Between, lod: f32) -> vec4f {
    var colour = in.colour;
    if in.kind.y > 0.5 {
        colour *= trilinear(in.uv, lod, u32(in.kind.w));
    }
    var amount = 1.0;
    if in.kind.x < 0.5 {
        let length2 = dot(in.normal, in.normal);
        amount = light(in.normal * select(0.0, inverseSqrt(length2), length2 > 0.0));
    }
    return vec4f(colour * amount, 1.0);
}

// Level of detail by the longer of the steps to the next pixel across and down, relative to the
// finest level here.
fn level(across: vec2f, down: vec2f) -> f32 {
    let longest2 = max(dot(across, across), dot(down, down));
    return max(clamp(0.5 * log2(max(longest2, 1e-30)), 0.0, 32.0) - image.first_level, 0.0);
}

@fragment
fn solid(in: Between) -> @location(0) vec4f {
    let lod = level(dpdx(in.uv) * image.size, dpdy(in.uv) * image.size);
    return shade(in, lod);
}

@fragment
fn masked(in: Between) -> @location(0) vec4f {
    let lod = level(dpdx(in.uv) * image.size, dpdy(in.uv) * image.size);
    // The finest level that is here, whatever the level of the colour.
    if bilinear(in.uv, 0u, u32(in.kind.w)).a * in.alpha < in.kind.z {
        discard;
    }
    return shade(in, lod);
}
