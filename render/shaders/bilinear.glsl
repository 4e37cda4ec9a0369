// Bilinear lookup by hand: the same taps and weights as processing.products.bilinear_taps.

struct Taps {
    ivec2 low;      // texel left above
    ivec2 high;     // texel right below
    vec4 weights;   // left above, right above, left below, right below
};

Taps bilinear_taps(vec2 uv, ivec2 size, bool wrap) {
    // The whole turns go first: float32 would lose the fraction of a texel in a large coordinate.
    vec2 at = (wrap ? uv - floor(uv) : clamp(uv, -1.0, 2.0)) * vec2(size) - 0.5;
    vec2 corner = floor(at);
    vec2 f = at - corner;
    ivec2 low = ivec2(corner);
    ivec2 high = low + 1;
    Taps taps;
    // After the turns are gone low is -1 at least and high the size at most.
    taps.low = wrap ? low + size * ivec2(lessThan(low, ivec2(0))) : clamp(low, ivec2(0), size - 1);
    taps.high = wrap ? high - size * ivec2(greaterThanEqual(high, size)) : clamp(high, ivec2(0), size - 1);
    taps.weights = vec4((1.0 - f.x) * (1.0 - f.y), f.x * (1.0 - f.y), (1.0 - f.x) * f.y, f.x * f.y);
    return taps;
}

vec3 bilinear(sampler2DArray map, int layer, Taps taps) {
    return taps.weights.x * texelFetch(map, ivec3(taps.low, layer), 0).rgb
         + taps.weights.y * texelFetch(map, ivec3(taps.high.x, taps.low.y, layer), 0).rgb
         + taps.weights.z * texelFetch(map, ivec3(taps.low.x, taps.high.y, layer), 0).rgb
         + taps.weights.w * texelFetch(map, ivec3(taps.high, layer), 0).rgb;
}
