// A wrapped sample with its silhouettes: where a ray meets it, and what the BTF says of that place.
#include "btf.glsl"
#include "lighting.glsl"
#include "layers.glsl"

#ifdef G_BUFFER
layout(location = 5) out vec4 passed;
#else
layout(location = 1) out vec4 passed;
#endif

void main() {
    Ray ray = ray_here();
    Hit hit = hit_here(ray);
    passed = vec4(hit.found ? FAR : hit.passed);
    radiance = vec4(0.0);
#ifdef G_BUFFER
    material_uv = vec4(hit.uv, 0.0, 1.0);
    light_local = vec4(in_tiles(local_light(0, hit.frame), hit.tile), 1.0);
    view_local = vec4(hit.view, 1.0);
    footprint = vec4(0.0);
#endif
    if (hit.found) {
        vec3 point = ray.start - hit.distance * ray.toward;
        radiance = vec4(radiance_of(material_at(hit.uv, hit.view), hit.frame, hit.tile, point), 1.0);
    }
}
