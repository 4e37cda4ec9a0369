// Bilinear lookup by hand: the same taps and weights as processing.products.bilinear_taps, in float32.
// The sampler takes the nearest texel, and repeats or ends as the texture does: a lookup at a texel's middle is exact,
// and costs Mesa's software rasteriser half of a texelFetch, which tests its bounds in every lane.

struct Taps {
    vec2 low;       // middle of the texel left above
    vec2 high;      // of the one right below
    vec4 weights;   // left above, right above, left below, right below
};

Taps bilinear_taps(vec2 uv, vec2 size, bool wrap) {
    // The whole turns go first: float32 would lose the fraction of a texel in a large coordinate.
    vec2 at = (wrap ? uv - floor(uv) : uv) * size - 0.5;
    vec2 corner = floor(at);
    vec2 f = at - corner;
    Taps taps;
    taps.low = (corner + 0.5) / size;
    taps.high = (corner + 1.5) / size;
    taps.weights = vec4((1.0 - f.x) * (1.0 - f.y), f.x * (1.0 - f.y), (1.0 - f.x) * f.y, f.x * f.y);
    return taps;
}

vec4 bilinear(sampler2DArray map, int layer, Taps taps) {
    float z = float(layer);
    return taps.weights.x * textureLod(map, vec3(taps.low, z), 0.0)
         + taps.weights.y * textureLod(map, vec3(taps.high.x, taps.low.y, z), 0.0)
         + taps.weights.z * textureLod(map, vec3(taps.low.x, taps.high.y, z), 0.0)
         + taps.weights.w * textureLod(map, vec3(taps.high, z), 0.0);
}
