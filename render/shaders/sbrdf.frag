// Lobes times shadow of the points seen from the top, centres of hidden ones (processing.products.SbrdfPlus.evaluate).
// LEVELS, where set, tells how many levels there are from fine to coarse, of which two are blended by what a pixel covers;
// LOBES is the largest number of lobes of a texel.
#include "directions.glsl"
#include "lobe.glsl"

// A texel holds the values of four: its own, of its right neighbour, of the one below, and right below.
uniform usampler2DArray shift;     // layer view: 15 bits to the right, 15 downward, or HIDDEN and the row of a centre
uniform sampler2DArray shadow;     // layer light
uniform sampler2DArray lobes;      // a layer of C and n for each lobe, then all colours, of the lobes and the diffuse one
uniform sampler2D centres;         // row centre, column light
#ifdef LEVELS
const int AREAS = LEVELS;
#else
const int AREAS = 1;
#endif
uniform vec4 areas[AREAS];         // of each level in the textures: left, top, width, height
uniform vec2 shift_units[AREAS];   // in texels
uniform vec2 lowest;               // cosines of the lowest measured light and view
uniform sampler2D light_cells;
uniform usampler2D light_regions;
uniform sampler2D view_cells;
uniform usampler2D view_regions;

const uint HIDDEN = 0x80000000u;
const float ANISOTROPY = 2.0;      // as in render/sbrdf.py
const int COLOURS = (3 * LOBES + 6) / 4;

// The texel left above a point, and weights of the four around it as in bilinear.glsl.
struct Place {
    vec2 low;
    vec4 weights;
};

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
    Place place;
    int hidden;                    // bit 4 i + k: texel k of measured view i
    float share;                   // weight of all that is not hidden
    Place moved;
    Texel[4] texels;
};

// Each area has its first column and row again at its end.
Place place_at(vec2 uv, vec4 area) {
    vec2 at = (uv - floor(uv)) * area.zw - 0.5;
    vec2 corner = floor(at);
    vec2 f = at - corner;
    corner += area.zw * vec2(lessThan(corner, vec2(0.0)));
    Place place;
    place.low = (area.xy + corner + 0.5) / vec2(textureSize(shadow, 0).xy);
    place.weights = vec4((1.0 - f.x) * (1.0 - f.y), f.x * (1.0 - f.y), (1.0 - f.x) * f.y, f.x * f.y);
    return place;
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
    uvec4 codes = textureLod(shift, vec3(here.place.low, float(here.seen.indices[i])), 0.0);
    vec4 right = vec4(ivec4(codes >> 15u) - 16384);
    vec4 down = vec4(ivec4(codes & 32767u) - 16384);
    uvec4 hides = codes >> 31u;
    vec4 weights = here.seen.weights[i] * here.place.weights * vec4(1u - hides);
    uvec4 bits = hides << uvec4(4 * i, 4 * i + 1, 4 * i + 2, 4 * i + 3);
    here.hidden |= int(bits.x | bits.y | bits.z | bits.w);
    here.share += dot(weights, vec4(1.0));
    way += vec2(dot(weights, right), dot(weights, down));
}

Material material_at(vec2 uv, vec3 view, int level) {
    Material here;
    vec4 area = areas[level];
    here.above = view.z > 0.0;
    here.seen = direction_corners(view_cells, view_regions, view);
    here.place = place_at(uv, area);
    here.hidden = 0;
    here.share = 0.0;
    vec2 way = vec2(0.0);
    for (int i = 0; i < 3; ++i) {
        look(here, way, i);
    }
    // Without its whole turns, of which float32 would lose digits where the shift is added.
    here.moved = place_at(uv - floor(uv) + way * shift_units[level] / (max(here.share, 1e-12) * area.zw), area);
    vec2 low = here.moved.low;
    vec2 high = low + 1.0 / vec2(textureSize(shadow, 0).xy);
    vec3 asked = raised(view, lowest.y);
    here.texels[0] = texel_at(low, asked);
    here.texels[1] = texel_at(vec2(high.x, low.y), asked);
    here.texels[2] = texel_at(vec2(low.x, high.y), asked);
    here.texels[3] = texel_at(high, asked);
    return here;
}

#ifdef LEVELS
// Between which levels to blend: the logarithm of what render/sbrdf.py calls side_texels.
float level_of(vec2 across, vec2 down) {
    across *= areas[0].zw;
    down *= areas[0].zw;
    float total = 0.5 * (dot(across, across) + dot(down, down));
    float area = across.x * down.y - across.y * down.x;
    float longer = sqrt(total + sqrt(max(total * total - area * area, 0.0)));
    float side = max(max(abs(area) / max(longer, 1e-30), longer / ANISOTROPY), 1.0);
    return min(log2_exact(side), float(LEVELS - 1));
}
#else
Material material_at(vec2 uv, vec3 view) {
    return material_at(uv, view, 0);
}
#endif

vec3 reflected(Texel texel, vec3 light) {
    vec3 total = colour(texel, LOBES);
#if LOBES > 0
    for (int j = 0; j < LOBES; ++j) {
        total += power_exact(dot(texel.axes[j], light), texel.exponents[j]) * colour(texel, j);
    }
#endif
    return total;
}

// What hidden points among the four texels reflect. Software rasterisers run both sides of a branch, but a loop only
// as often as one of the pixels that they shade at once asks for: once at least, here with nothing to add.
vec3 unseen(Material here, Corners lit) {
    vec3 total = vec3(0.0);
    vec2 size = vec2(textureSize(centres, 0));
    vec3 columns = (vec3(lit.indices) + 0.5) / size.x;
    int left = here.hidden;
    do {
        int bit = max(floatBitsToInt(float(left & -left)) >> 23, 127) - 127;
        uvec4 codes = textureLod(shift, vec3(here.place.low, float(here.seen.indices[bit / 4])), 0.0);
        float row = (float(codes[bit % 4] & ~HIDDEN) + 0.5) / size.y;
        vec3 centre = lit.weights.x * textureLod(centres, vec2(columns.x, row), 0.0).rgb
                    + lit.weights.y * textureLod(centres, vec2(columns.y, row), 0.0).rgb
                    + lit.weights.z * textureLod(centres, vec2(columns.z, row), 0.0).rgb;
        total += (left == 0 ? 0.0 : here.seen.weights[bit / 4] * here.place.weights[bit % 4]) * centre;
        left &= left - 1;
    } while (left != 0);
    return total;
}

vec3 outgoing(Material here, vec3 light) {
    Corners lit = direction_corners(light_cells, light_regions, light);
    vec4 open = lit.weights.x * textureLod(shadow, vec3(here.moved.low, float(lit.indices.x)), 0.0)
              + lit.weights.y * textureLod(shadow, vec3(here.moved.low, float(lit.indices.y)), 0.0)
              + lit.weights.z * textureLod(shadow, vec3(here.moved.low, float(lit.indices.z)), 0.0);
    vec4 weights = open * here.moved.weights;
    vec3 asked = raised(light, lowest.x), total = vec3(0.0);
    for (int k = 0; k < 4; ++k) {
        total += weights[k] * reflected(here.texels[k], asked);
    }
    total = here.share * total + unseen(here, lit);
    return here.above && light.z > 0.0 ? total * light.z : vec3(0.0);
}

#include "surface.glsl"
