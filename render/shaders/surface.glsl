// The surface of a mesh as it is, in any material. A material's file defines `Material`, `material_at` and `outgoing`,
// then includes this.
#include "lighting.glsl"

in vec3 surface_point;
in vec3 surface_normal;
in vec4 surface_tangent;
in vec2 surface_uv;

uniform vec3 eye;
uniform mat3 map_from_world;

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
        total += max(1.0 - abs(level - float(k)), 0.0) * radiance_of(material_at(uv, view, k), frame, vec3(1.0), surface_point);
        ++k;
    } while (float(k) < level + 1.0);
    radiance = vec4(total, 1.0);
#else
    radiance = vec4(radiance_of(material_at(uv, view), frame, vec3(1.0), surface_point), 1.0);
#endif

#ifdef G_BUFFER
    material_uv = vec4(uv, 0.0, 1.0);
    light_local = vec4(local_light(0, frame), 1.0);
    view_local = vec4(view, 1.0);
    footprint = vec4(across, down);
#endif
}
