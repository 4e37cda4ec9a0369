// Lights, frames and outputs that all materials share. A material's file defines `Material`, with what
// all lights of a pixel share, `material_at` and `outgoing`, then includes this.
#include "frames.glsl"

in vec3 surface_point;
in vec3 surface_normal;
in vec4 surface_tangent;
in vec2 surface_uv;

uniform vec3 eye;
uniform mat3 map_from_world;
uniform int light_count;
uniform vec3 light_direction[65];    // a zero vector: light from straight above the surface, everywhere
uniform vec3 light_irradiance[65];

#ifdef G_BUFFER
// One light of unit irradiance, and exactly what its radiance was computed from.
layout(location = 0) out vec4 radiance;
layout(location = 1) out vec4 material_uv;
layout(location = 2) out vec4 light_local;
layout(location = 3) out vec4 view_local;
layout(location = 4) out vec4 footprint;    // change of texture coordinates to the next pixel right, then below
#else
layout(location = 0) out vec4 radiance;
#endif

// Row vector times matrix: the components of a world direction along t, b, n.
vec3 local_light(int i, mat3 frame) {
    vec3 local = light_direction[i] * frame;
    return local == vec3(0.0) ? vec3(0.0, 0.0, 1.0) : local;
}

// What reaches the eye: under the first light of unit irradiance in a G-buffer, else under all lights.
vec3 radiance_of(Material here, mat3 frame) {
#ifdef G_BUFFER
    return outgoing(here, local_light(0, frame));
#else
    vec3 total = vec3(0.0);
    for (int i = 0; i < light_count; ++i) {
        total += light_irradiance[i] * outgoing(here, local_light(i, frame));
    }
    return total;
#endif
}

void main() {
#ifdef GRADIENT_MAP
    vec2 uv;
    mat3 frame = gradient_frame(surface_normal, map_from_world, uv);
#else
    vec2 uv = surface_uv;
    mat3 frame = tangent_frame(surface_normal, surface_tangent);
#endif
    vec3 view = unit((eye - surface_point) * frame);
    vec2 across = dFdx(uv), down = -dFdy(uv);

#ifdef LEVELS
    // A material of several levels: the two nearest are blended, one of them alone where nothing is minified.
    float level = level_of(across, down);
    int k = int(level);
    vec3 total = vec3(0.0);
    // Software rasterisers look at a condition for all their pixels only where a loop ends: asked first, it costs a turn.
    do {
        total += max(1.0 - abs(level - float(k)), 0.0) * radiance_of(material_at(uv, view, k), frame);
        ++k;
    } while (float(k) < level + 1.0);
    radiance = vec4(total, 1.0);
#else
    radiance = vec4(radiance_of(material_at(uv, view), frame), 1.0);
#endif

#ifdef G_BUFFER
    material_uv = vec4(uv, 0.0, 1.0);
    light_local = vec4(local_light(0, frame), 1.0);
    view_local = vec4(view, 1.0);
    footprint = vec4(across, down);
#endif
}
