// A wrapped sample with its silhouettes: where a ray meets it, and what the BTF says of that place.
#include "btf.glsl"
#include "lighting.glsl"
#include "layers.glsl"

#ifdef G_BUFFER
layout(location = 5) out vec4 decided;
#else
layout(location = 1) out vec4 decided;
#endif

void main() {
    Ray ray = ray_here();
    Interval interval = interval_here(ray.toward);
    Meeting meeting = march(interval.entry, interval.arc);
    if (!meets(interval, meeting.found, meeting.distance)) {
        discard;
    }
    mat3 frame = turned_frame(interval.entry, interval.arc, meeting);
    vec3 tile = vec3(interval.entry.stretch, interval.arc.scale);
    vec3 point = ray.start - (interval.start + meeting.distance) * ray.toward;
    radiance = vec4(radiance_of(material_at(meeting.uv, meeting.view), frame, tile, point), 1.0);
    decided = vec4(1.0);
#ifdef G_BUFFER
    material_uv = vec4(meeting.uv, 0.0, 1.0);
    light_local = vec4(in_tiles(local_light(0, frame), tile), 1.0);
    view_local = vec4(meeting.view, 1.0);
    footprint = vec4(0.0);
#endif
}
