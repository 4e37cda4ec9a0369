// How far light comes over a wrapped sample: to its base, for what stands on the base is shaded by the BTF itself (Wang
// et al. 2005, 4.2), but no farther than where the ray leaves the mesh.
#include "frames.glsl"
#include "layers.glsl"
#include "room.glsl"

layout(location = 0) out vec4 reach;
layout(location = 1) out vec4 passed;

void main() {
    Hit hit = hit_here(ray_here());
    reach = vec4(hit.found ? min(hit.base + room(hit.cosine), hit.passed) : FAR);
    passed = vec4(hit.found ? FAR : hit.passed);
}
