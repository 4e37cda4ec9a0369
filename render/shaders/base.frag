// How far light comes over a wrapped sample: to its base, for what stands on the base is shaded by the BTF itself (Wang
// et al. 2005, 4.2), but no farther than where the ray leaves the mesh.
#include "frames.glsl"
#include "layers.glsl"
#include "room.glsl"

layout(location = 0) out vec4 reach;
layout(location = 1) out vec4 decided;

void main() {
    Interval interval = interval_here(ray_here().toward);
    bool reached;
    float base = distance_to(interval.arc, interval.arc.scale * deepest, reached);
#ifdef THOROUGH
    Meeting meeting = march(interval.entry, interval.arc);
    bool met = meets(interval, meeting.found, meeting.distance);
#else
    // Whatever stands on the base is met no later: nothing need be looked up.
    bool met = meets(interval, reached, base);
#endif
    if (!met) {
        discard;
    }
    reach = vec4(min(reached ? interval.start + base + room(interval.entry.view.z) : FAR, interval.end));
    decided = vec4(1.0);
}
