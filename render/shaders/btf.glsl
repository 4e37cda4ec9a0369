// Sum of eigenmaps over light times weights over view (processing.products.FactoredBtf.evaluate), times the cosine.
#include "bilinear.glsl"
#include "directions.glsl"

uniform sampler2DArray eigenmaps;   // layer k * lights + light; then for each k its ambient map
uniform sampler2D view_weights;     // column view, row k
uniform sampler2D light_cells;
uniform usampler2D light_regions;
uniform sampler2D view_cells;
uniform usampler2D view_regions;
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
    vec2 size = vec2(textureSize(view_weights, 0));
    vec3 columns = (vec3(seen.indices) + 0.5) / size.x;
    for (int k = 0; k < rank; ++k) {
        float row = (float(k) + 0.5) / size.y;
        int layer = k * lights;
        vec3 map = lit.weights.x * bilinear(eigenmaps, layer + lit.indices.x, here.taps).rgb
                 + lit.weights.y * bilinear(eigenmaps, layer + lit.indices.y, here.taps).rgb
                 + lit.weights.z * bilinear(eigenmaps, layer + lit.indices.z, here.taps).rgb;
        float weight = seen.weights.x * textureLod(view_weights, vec2(columns.x, row), 0.0).r
                     + seen.weights.y * textureLod(view_weights, vec2(columns.y, row), 0.0).r
                     + seen.weights.z * textureLod(view_weights, vec2(columns.z, row), 0.0).r;
        total += weight * map;
    }
    return total * light.z;
}

// Radiance for unit irradiance that comes equally from everywhere.
vec3 ambient(Material here) {
    vec3 total = vec3(0.0);
    vec2 size = vec2(textureSize(view_weights, 0));
    vec3 columns = (vec3(here.seen.indices) + 0.5) / size.x;
    for (int k = 0; k < rank; ++k) {
        float row = (float(k) + 0.5) / size.y;
        float weight = here.seen.weights.x * textureLod(view_weights, vec2(columns.x, row), 0.0).r
                     + here.seen.weights.y * textureLod(view_weights, vec2(columns.y, row), 0.0).r
                     + here.seen.weights.z * textureLod(view_weights, vec2(columns.z, row), 0.0).r;
        total += weight * bilinear(eigenmaps, rank * lights + k, here.taps).rgb;
    }
    return total;
}
