// Lobes times shadow of the points seen from the top, centres of hidden ones (processing.products.SbrdfPlus.evaluate).
// LOBES is the largest number of lobes of a texel.
#include "bilinear.glsl"
#include "directions.glsl"
#include "lobe.glsl"

// A texel holds the values of four: its own, of its right neighbour, of the one below, and right below.
uniform sampler2DArray shift;      // layer 2 view: to the right, in texels, or HIDDEN + row of centres; then downward
uniform sampler2DArray shadow;     // layer light
uniform sampler2DArray lobes;      // a layer of C and n for each lobe, then all colours, of the lobes and the diffuse one
uniform sampler2D centres;         // row centre, column light
uniform sampler2D light_cells;
uniform sampler2D light_regions;
uniform sampler2D view_cells;
uniform sampler2D view_regions;

const float HIDDEN = 1048576.0;    // float32 still tells whole numbers up to 16 times as many
const int COLOURS = (3 * LOBES + 6) / 4;

struct Texel {
    vec4 colours[COLOURS];
#if LOBES > 0
    vec3 axes[LOBES];              // C times the view, component by component
    float exponents[LOBES];
#endif
};

struct Material {
    bool above;
    Corners seen;
    Taps taps;
    int hidden;                    // bit 4 i + k: texel k of measured view i
    float share;                   // weight of all that is not hidden
    Taps moved;
    Texel[4] texels;
};

vec2 texel_size() {
    return vec2(textureSize(shadow, 0).xy);
}

vec3 colour(Texel texel, int which) {
    int first = 3 * which;
    return vec3(texel.colours[first / 4][first % 4], texel.colours[(first + 1) / 4][(first + 1) % 4],
                texel.colours[(first + 2) / 4][(first + 2) % 4]);
}

Texel texel_at(vec2 place, vec3 view) {
    Texel texel;
#if LOBES > 0
    for (int j = 0; j < LOBES; ++j) {
        vec4 lobe = textureLod(lobes, vec3(place, float(j)), 0.0);
        texel.axes[j] = lobe.xyz * view;
        texel.exponents[j] = lobe.w;
    }
#endif
    for (int layer = 0; layer < COLOURS; ++layer) {
        texel.colours[layer] = textureLod(lobes, vec3(place, float(LOBES + layer)), 0.0);
    }
    return texel;
}

// Adds what one measured view sees of the four texels to the shift of those that are not hidden.
void look(inout Material here, inout vec2 way, int i) {
    float layer = float(2 * here.seen.indices[i]);
    vec4 right = textureLod(shift, vec3(here.taps.low, layer), 0.0);
    vec4 down = textureLod(shift, vec3(here.taps.low, layer + 1.0), 0.0);
    bvec4 hides = greaterThanEqual(right, vec4(0.5 * HIDDEN));
    vec4 weights = here.seen.weights[i] * mix(here.taps.weights, vec4(0.0), hides);
    ivec4 bits = ivec4(hides) << ivec4(4 * i, 4 * i + 1, 4 * i + 2, 4 * i + 3);
    here.hidden |= bits.x | bits.y | bits.z | bits.w;
    here.share += dot(weights, vec4(1.0));
    // A weight of 0 does not undo the large number that stands for a hidden point exactly enough.
    way += vec2(dot(weights, mix(right, vec4(0.0), hides)), dot(weights, down));
}

Material material_at(vec2 uv, vec3 view) {
    Material here;
    here.above = view.z > 0.0;
    here.seen = direction_corners(view_cells, view_regions, view);
    here.taps = bilinear_taps(uv, texel_size(), true);
    here.hidden = 0;
    here.share = 0.0;
    vec2 way = vec2(0.0);
    for (int i = 0; i < 3; ++i) {
        look(here, way, i);
    }
    here.moved = bilinear_taps(uv + way / (max(here.share, 1e-12) * texel_size()), texel_size(), true);
    here.texels[0] = texel_at(here.moved.low, view);
    here.texels[1] = texel_at(vec2(here.moved.high.x, here.moved.low.y), view);
    here.texels[2] = texel_at(vec2(here.moved.low.x, here.moved.high.y), view);
    here.texels[3] = texel_at(here.moved.high, view);
    return here;
}

vec3 reflected(Texel texel, vec3 light) {
    vec3 total = colour(texel, LOBES);
#if LOBES > 0
    for (int j = 0; j < LOBES; ++j) {
        total += power(dot(texel.axes[j], light), texel.exponents[j]) * colour(texel, j);
    }
#endif
    return total;
}

// What hidden points among the four texels reflect. Software rasterisers run both sides of a branch, but a loop only
// as often as one of the pixels that they shade at once asks for.
vec3 unseen(Material here, Corners lit) {
    vec3 total = vec3(0.0);
    for (int left = here.hidden; left != 0; left &= left - 1) {
        int bit = (floatBitsToInt(float(left & -left)) >> 23) - 127;
        vec4 found = textureLod(shift, vec3(here.taps.low, float(2 * here.seen.indices[bit / 4])), 0.0);
        int row = int(found[bit % 4] - HIDDEN);
        vec3 centre = lit.weights.x * texelFetch(centres, ivec2(lit.indices.x, row), 0).rgb
                    + lit.weights.y * texelFetch(centres, ivec2(lit.indices.y, row), 0).rgb
                    + lit.weights.z * texelFetch(centres, ivec2(lit.indices.z, row), 0).rgb;
        total += here.seen.weights[bit / 4] * here.taps.weights[bit % 4] * centre;
    }
    return total;
}

vec3 outgoing(Material here, vec3 light) {
    Corners lit = direction_corners(light_cells, light_regions, light);
    vec4 open = lit.weights.x * textureLod(shadow, vec3(here.moved.low, float(lit.indices.x)), 0.0)
              + lit.weights.y * textureLod(shadow, vec3(here.moved.low, float(lit.indices.y)), 0.0)
              + lit.weights.z * textureLod(shadow, vec3(here.moved.low, float(lit.indices.z)), 0.0);
    vec4 weights = open * here.moved.weights;
    vec3 total = vec3(0.0);
    for (int k = 0; k < 4; ++k) {
        total += weights[k] * reflected(here.texels[k], light);
    }
    total = here.share * total + unseen(here, lit);
    return here.above && light.z > 0.0 ? total * light.z : vec3(0.0);
}

#include "surface.glsl"
