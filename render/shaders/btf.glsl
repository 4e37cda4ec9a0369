// Sum of eigenmaps over light times weights over view (processing.products.FactoredBtf.evaluate), times the cosine.
// Four terms lie in a texel: where the maps are grey, the twelve taps of a light fetch four terms of all three channels.
#include "bilinear.glsl"
#include "directions.glsl"

uniform sampler2DArray eigenmaps;       // layer (four, channel, light)
uniform sampler2DArray ambient_maps;    // layer (four, channel)
uniform sampler2D map_coding;           // column (four, least and step), row light
uniform sampler2D view_weights;         // column view, row (four, colour)
uniform sampler2D light_cells;
uniform usampler2D light_regions;
uniform sampler2D view_cells;
uniform usampler2D view_regions;
uniform int lights;

#ifdef GREY
const int MAPS = 1;
const int COLOURS = 3;
#else
const int MAPS = 3;
const int COLOURS = 1;
#endif

struct Material {
    Taps taps;
    vec4 weights[FOURS * COLOURS];
};

Material material_at(vec2 uv, vec3 view) {
    Material here;
    here.taps = bilinear_taps(uv, vec2(textureSize(eigenmaps, 0).xy), true);
    Corners seen = direction_corners(view_cells, view_regions, view);
    vec2 size = vec2(textureSize(view_weights, 0));
    vec3 columns = (vec3(seen.indices) + 0.5) / size.x;
    for (int i = 0; i < FOURS * COLOURS; ++i) {
        float row = (float(i) + 0.5) / size.y;
        here.weights[i] = seen.weights.x * textureLod(view_weights, vec2(columns.x, row), 0.0)
                        + seen.weights.y * textureLod(view_weights, vec2(columns.y, row), 0.0)
                        + seen.weights.z * textureLod(view_weights, vec2(columns.z, row), 0.0);
    }
    return here;
}

vec4 coding_of(int column, float row) {
    return textureLod(map_coding, vec2((float(column) + 0.5) / float(2 * FOURS), row), 0.0);
}

vec3 outgoing(Material here, vec3 light) {
    if (light.z <= 0.0) {
        return vec3(0.0);
    }
    Corners lit = direction_corners(light_cells, light_regions, light);
    float total[3] = float[3](0.0, 0.0, 0.0);
    for (int q = 0; q < FOURS; ++q) {
#ifdef CODED
        vec3 rows = (vec3(lit.indices) + 0.5) / float(lights);
        vec4 least = lit.weights.x * coding_of(2 * q, rows.x) + lit.weights.y * coding_of(2 * q, rows.y)
                   + lit.weights.z * coding_of(2 * q, rows.z);
        vec4 x = lit.weights.x * coding_of(2 * q + 1, rows.x);
        vec4 y = lit.weights.y * coding_of(2 * q + 1, rows.y);
        vec4 z = lit.weights.z * coding_of(2 * q + 1, rows.z);
#else
        vec4 least = vec4(0.0);
        float x = lit.weights.x, y = lit.weights.y, z = lit.weights.z;
#endif
        vec4 maps[MAPS];
        for (int c = 0; c < MAPS; ++c) {
            int layer = (q * MAPS + c) * lights;
            maps[c] = least + x * bilinear(eigenmaps, layer + lit.indices.x, here.taps)
                            + y * bilinear(eigenmaps, layer + lit.indices.y, here.taps)
                            + z * bilinear(eigenmaps, layer + lit.indices.z, here.taps);
        }
        for (int c = 0; c < 3; ++c) {
            total[c] += dot(here.weights[q * COLOURS + c % COLOURS], maps[c % MAPS]);
        }
    }
    return vec3(total[0], total[1], total[2]) * light.z;
}

#ifdef AMBIENT
// Only where there is such light: asking for it in each pixel was measured to cost a tenth of a frame.
#define KNOWS_AMBIENT

// Radiance for unit irradiance that comes equally from everywhere.
vec3 ambient(Material here) {
    float total[3] = float[3](0.0, 0.0, 0.0);
    for (int q = 0; q < FOURS; ++q) {
        vec4 maps[MAPS];
        for (int c = 0; c < MAPS; ++c) {
            maps[c] = bilinear(ambient_maps, q * MAPS + c, here.taps);
        }
        for (int c = 0; c < 3; ++c) {
            total[c] += dot(here.weights[q * COLOURS + c % COLOURS], maps[c % MAPS]);
        }
    }
    return vec3(total[0], total[1], total[2]);
}
#endif
