// Sum of eigenmaps over light times weights over view (processing.products.FactoredBtf.evaluate), times the cosine.
#include "bilinear.glsl"
#include "directions.glsl"

uniform sampler2DArray eigenmaps;   // layer k * lights + light
uniform sampler2D view_weights;     // column view, row k
uniform sampler2D light_cells;
uniform sampler2D light_regions;
uniform sampler2D view_cells;
uniform sampler2D view_regions;
uniform int rank;
uniform int lights;

struct Material {
    Taps taps;
    Corners seen;
};

Material material_at(vec2 uv, vec3 view) {
    Taps taps = bilinear_taps(uv, vec2(textureSize(eigenmaps, 0).xy), true);
    return Material(taps, direction_corners(view_cells, view_regions, view));
}

vec3 outgoing(Material here, vec3 light) {
    if (light.z <= 0.0) {
        return vec3(0.0);
    }
    Corners lit = direction_corners(light_cells, light_regions, light);
    Corners seen = here.seen;
    vec3 total = vec3(0.0);
    for (int k = 0; k < rank; ++k) {
        int layer = k * lights;
        vec3 map = lit.weights.x * bilinear(eigenmaps, layer + lit.indices.x, here.taps).rgb
                 + lit.weights.y * bilinear(eigenmaps, layer + lit.indices.y, here.taps).rgb
                 + lit.weights.z * bilinear(eigenmaps, layer + lit.indices.z, here.taps).rgb;
        float weight = seen.weights.x * texelFetch(view_weights, ivec2(seen.indices.x, k), 0).r
                     + seen.weights.y * texelFetch(view_weights, ivec2(seen.indices.y, k), 0).r
                     + seen.weights.z * texelFetch(view_weights, ivec2(seen.indices.z, k), 0).r;
        total += weight * map;
    }
    return total * light.z;
}

#include "surface.glsl"
