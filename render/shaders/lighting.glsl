// Lights and outputs that all materials share. A material's file defines `Material`, with what all lights of a pixel
// share, `outgoing` and, where KNOWS_AMBIENT is set, `ambient`, before this.
#include "frames.glsl"

uniform int light_count;
uniform vec3 light_direction[65];    // a zero vector: light from straight above the surface, everywhere
uniform vec3 light_irradiance[65];
uniform vec3 ambient_irradiance;     // where KNOWS_AMBIENT is set; else ambient light is one of the lights

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

#ifdef SHADOWS
#include "shadow.glsl"
#endif

// Row vector times matrix: the components of a world direction along t, b, n.
vec3 local_light(int i, mat3 frame) {
    vec3 local = light_direction[i] * frame;
    return local == vec3(0.0) ? vec3(0.0, 0.0, 1.0) : local;
}

// A direction along t, b, n as it is in a sample whose tiles have these lengths.
vec3 in_tiles(vec3 local, vec3 tile) {
#ifdef WRAPPED
    return unit(local / tile);
#else
    return local;
#endif
}

// Under light of unit irradiance from a direction: the cosine is that to the mesh, the material is asked in tiles.
vec3 returned(Material here, vec3 local, vec3 tile) {
#ifdef WRAPPED
    vec3 asked = in_tiles(local, tile);
    return outgoing(here, asked) * (max(local.z, 0.0) / max(asked.z, 1e-20));
#else
    return outgoing(here, local);
#endif
}

// What reaches the eye from a world point: under the first light of unit irradiance in a G-buffer, else under all lights.
vec3 radiance_of(Material here, mat3 frame, vec3 tile, vec3 point) {
#ifdef G_BUFFER
    return outgoing(here, in_tiles(local_light(0, frame), tile));
#else
    vec3 total = vec3(0.0);
    for (int i = 0; i < light_count; ++i) {
        vec3 irradiance = light_irradiance[i];
#ifdef SHADOWS
        irradiance *= lit_share(i, point);
#endif
        total += irradiance * returned(here, local_light(i, frame), tile);
    }
#ifdef KNOWS_AMBIENT
    total += ambient_irradiance * ambient(here);
#endif
    return total;
#endif
}
