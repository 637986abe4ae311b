// Near geometry: clusters in mesh space to shaded pixels. Colours in linear light; the target encodes them.

struct View {
    // Clip x and y per eye-space x and y: focal length over half the picture.
    scale: vec2f,
    // Near plane, metres: with it depth is disparity times this, 1 at the near plane, 0 at infinity.
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
@group(2) @binding(0) var texel_sampler: sampler;

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
    // 1 or 0: unlit, textured; alpha cutoff.
    @location(11) kind: vec3f,
}

struct Between {
    @builtin(position) position: vec4f,
    @location(0) normal: vec3f,
    @location(1) uv: vec2f,
    @location(2) colour: vec3f,
    @location(3) @interpolate(flat) kind: vec3f,
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

fn shade(in: Between, lod: f32) -> vec4f {
    var colour = in.colour;
    if in.kind.y > 0.5 {
        colour *= textureSampleLevel(texels, texel_sampler, in.uv, lod).rgb;
    }
    var amount = 1.0;
    if in.kind.x < 0.5 {
        let length2 = dot(in.normal, in.normal);
        amount = light(in.normal * select(0.0, inverseSqrt(length2), length2 > 0.0));
    }
    return vec4f(colour * amount, 1.0);
}

// Level of detail by the longer of the steps to the next pixel across and down, relative to the finest level here.
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
    if textureSampleLevel(texels, texel_sampler, in.uv, 0.0).a * in.alpha < in.kind.z {
        discard;
    }
    return shade(in, lod);
}
