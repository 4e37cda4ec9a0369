// Reflectance models of processing/lighting/brdfs.py: KIND is the number there, light and view in the tangent frame,
// above the horizon. Written so that float32 keeps the digits near a lobe's peak.

#define LAMBERT 0
#define BLINN_PHONG 1
#define WARD 2
#define GGX 3
#define TABLE 4
#define LAFORTUNE 5
#define SRF 6

layout(std430, binding = 6) readonly buffer Table { float table[]; };            // (half, difference, azimuth, 3)

uniform float parameters[24];
uniform ivec3 table_shape;

const float PI = 3.14159265358979;

vec3 diffuse() {
    return vec3(parameters[0], parameters[1], parameters[2]);
}

vec3 specular() {
    return vec3(parameters[3], parameters[4], parameters[5]);
}

// log(1 - x): where x is small, by its series.
float log_of_rest(float x) {
    return x < 0.05 ? -x * (1.0 + x * (1.0 / 2.0 + x * (1.0 / 3.0 + x * (1.0 / 4.0 + x * (1.0 / 5.0)))))
                    : log(1.0 - x);
}

// A power of the cosine to the normal of a half vector of any length.
float cosine_power(vec3 between, float exponent) {
    return exp(0.5 * exponent * log_of_rest(min(dot(between.xy, between.xy) / dot(between, between), 1.0 - 1e-7)));
}

#if KIND == BLINN_PHONG

vec3 reflectance(vec3 light, vec3 view) {
    return diffuse() + cosine_power(light + view, parameters[6]) * specular();
}

#elif KIND == WARD

vec3 reflectance(vec3 light, vec3 view) {
    vec3 between = light + view;
    vec2 slope = between.xy / (vec2(parameters[6], parameters[7]) * between.z);
    float height = between.z * between.z;
    float scale = dot(between, between) / (PI * parameters[6] * parameters[7] * height * height);
    return diffuse() + exp(-dot(slope, slope)) * scale * specular();
}

#elif KIND == GGX

vec3 reflectance(vec3 light, vec3 view) {
    vec3 between = light + view;
    float square = dot(between, between);
    float a2 = parameters[6] * parameters[6];
    float slope = (dot(between.xy, between.xy) + a2 * between.z * between.z) / square;
    float shadowing = light.z * sqrt(a2 + (1.0 - a2) * view.z * view.z)
                    + view.z * sqrt(a2 + (1.0 - a2) * light.z * light.z);
    float lobe = a2 / (PI * slope * slope) * 0.5 / shadowing;
    float grazing = pow(1.0 - min(0.5 * sqrt(square), 1.0), 5.0);
    return diffuse() + lobe * (specular() + (1.0 - specular()) * grazing);
}

#elif KIND == TABLE

// The two cells whose middles are around a place 0 to 1, and how far it is from the first to the second.
void between_cells(float share, int cells, out ivec2 pair, out float part) {
    float place = clamp(share * float(cells) - 0.5, 0.0, float(cells) - 1.0);
    int first = min(int(place), max(cells - 2, 0));
    pair = ivec2(first, min(first + 1, cells - 1));
    part = place - float(first);
}

vec3 reflectance(vec3 light, vec3 view) {
    vec3 between = light + view;
    float sine_of_half = length(between.xy) / length(between);
    // 1 - |between|^2 / 4 of unit vectors is |light - view|^2 / 4; those lifted to the horizon are shorter.
    float lifted = 1.0 - 0.5 * (dot(light, light) + dot(view, view));
    float sine_of_difference = 0.5 * sqrt(dot(light - view, light - view) + (lifted > 1e-6 ? 4.0 * lifted : 0.0));
    float sines = sine_of_half * sine_of_difference;
    float turn = sines > 1e-9 ? min(0.5 * abs(light.z - view.z) / sines, 1.0) : 0.0;
    ivec2 rows, columns, layers;
    vec3 part;
    between_cells(sqrt(atan(length(between.xy), between.z) * 2.0 / PI), table_shape.x, rows, part.x);
    between_cells(atan(2.0 * sine_of_difference, length(between)) * 2.0 / PI, table_shape.y, columns, part.y);
    between_cells(acos(turn) * 2.0 / PI, table_shape.z, layers, part.z);
    vec3 found = vec3(0.0);
    for (int corner = 0; corner < 8; ++corner) {
        bvec3 second = bvec3((corner & 1) != 0, (corner & 2) != 0, (corner & 4) != 0);
        vec3 weight = mix(1.0 - part, part, second);
        int row = second.x ? rows.y : rows.x, column = second.y ? columns.y : columns.x;
        int at = 3 * ((row * table_shape.y + column) * table_shape.z + (second.z ? layers.y : layers.x));
        found += weight.x * weight.y * weight.z * vec3(table[at], table[at + 1], table[at + 2]);
    }
    return found;
}

#elif KIND == LAFORTUNE

vec3 reflectance(vec3 light, vec3 view) {
    vec3 found = diffuse();
    for (int lobe = 0; lobe < 3; ++lobe) {
        int k = 3 + 7 * lobe;
        float base = dot(vec3(parameters[k], parameters[k + 1], parameters[k + 2]), light * view);
        if (base > 0.0) {
            found += pow(base, parameters[k + 3]) * vec3(parameters[k + 4], parameters[k + 5], parameters[k + 6]);
        }
    }
    return found;
}

#elif KIND == SRF

vec3 reflectance(vec3 light, vec3 view) {
    vec3 between = light + view;
    float c = cos(parameters[8]), s = sin(parameters[8]);
    vec2 along = vec2(c * between.x + s * between.y, c * between.y - s * between.x);
    along *= along;
    float level = along.x + along.y;
    float exponent = level > 0.0 ? (parameters[6] * along.x + parameters[7] * along.y) / level : 0.0;
    float cosine = max(light.z, 0.02);
    return light.z / cosine * diffuse() + cosine_power(between, exponent) / cosine * specular();
}

#endif
