// Scales the picture to the target. Sampling decodes sRGB, so that filtering happens in linear
// light.

@group(0) @binding(0) var picture: texture_2d<f32>;
@group(0) @binding(1) var smooth_sampler: sampler;

struct Corner {
    @builtin(position) clip: vec4<f32>,
    @location(0) uv: vec2<f32>,
}

// One triangle that covers the target: (-1, -1), (3, -1), (-1, 3).
@vertex
fn vertex(@builtin(vertex_index) index: u32) -> Corner {
    let corner = vec2<f32>(f32((index << 1u) & 2u), f32(index & 2u));
    // Row 0 of the picture is on top.
    return Corner(vec4<f32>(corner * 2.0 - 1.0, 0.0, 1.0), vec2<f32>(corner.x, 1.0 - corner.y));
}

fn light(uv: vec2<f32>) -> vec3<f32> {
    return textureSampleLevel(picture, smooth_sampler, uv, 0.0).rgb;
}

// For targets that encode sRGB themselves.
@fragment
fn linear(corner: Corner) -> @location(0) vec4<f32> {
    return vec4<f32>(light(corner.uv), 1.0);
}

// For targets that take sRGB codes as they are.
@fragment
fn encoded(corner: Corner) -> @location(0) vec4<f32> {
    let l = light(corner.uv);
    let low = l * 12.92;
    let high = 1.055 * pow(max(l, vec3<f32>(0.0)), vec3<f32>(1.0 / 2.4)) - 0.055;
    return vec4<f32>(select(high, low, l <= vec3<f32>(0.0031308)), 1.0);
}
