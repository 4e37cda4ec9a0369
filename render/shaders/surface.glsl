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
#else
layout(location = 0) out vec4 radiance;
#endif

// Row vector times matrix: the components of a world direction along t, b, n.
vec3 local_light(int i, mat3 frame) {
    vec3 local = light_direction[i] * frame;
    return local == vec3(0.0) ? vec3(0.0, 0.0, 1.0) : local;
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
    Material here = material_at(uv, view);

#ifdef G_BUFFER
    vec3 light = local_light(0, frame);
    radiance = vec4(outgoing(here, light), 1.0);
    material_uv = vec4(uv, 0.0, 1.0);
    light_local = vec4(light, 1.0);
    view_local = vec4(view, 1.0);
#else
    vec3 total = vec3(0.0);
    for (int i = 0; i < light_count; ++i) {
        total += light_irradiance[i] * outgoing(here, local_light(i, frame));
    }
    radiance = vec4(total, 1.0);
#endif
}
