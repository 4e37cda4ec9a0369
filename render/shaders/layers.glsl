// One interval of the rays inside a mesh, as layer.frag wrote it, and whether its sample is met there (render/march.py).
// It is asked twice: without THOROUGH only what needs no look-up at the back is answered. Software rasterisers run both
// sides of a branch, but leave out pixels that the depth buffer rejects.
#include "march.glsl"
#include "rays.glsl"

uniform sampler2D front_place;
uniform sampler2D front_upward;
uniform sampler2D front_along;
uniform sampler2D back_place;
uniform sampler2D back_upward;
uniform sampler2D back_along;

struct Interval {
    Entry entry;
    Arc arc;
    Entry back;
    Arc back_arc;
    float start;
    float end;
    bool open;
};

Entry entry_of(vec4 place, vec4 upward, vec4 along, vec3 toward) {
    Entry entry;
    entry.uv = place.yz;
    entry.stretch = vec2(length(along.xyz), abs(upward.w));
    vec3 t = along.xyz / entry.stretch.x;
    entry.frame = mat3(t, (upward.w < 0.0 ? -1.0 : 1.0) * cross(upward.xyz, t), upward.xyz);
    entry.view = toward * entry.frame;
    entry.curvature = along.w;
    return entry;
}

Interval interval_here(vec3 toward) {
    vec2 at = gl_FragCoord.xy / vec2(textureSize(front_place, 0));
    vec4 place = textureLod(front_place, at, 0.0), back = textureLod(back_place, at, 0.0);
    Interval interval;
    interval.entry = entry_of(place, textureLod(front_upward, at, 0.0), textureLod(front_along, at, 0.0), toward);
    interval.arc = arc_of(interval.entry);
    interval.back = entry_of(back, textureLod(back_upward, at, 0.0), textureLod(back_along, at, 0.0), -toward);
    interval.back_arc = arc_of(interval.back);
    interval.start = place.x;
    interval.open = place.w < 0.0;
    interval.end = interval.open ? FAR : back.x;
    return interval;
}

// How far back from where it leaves the mesh the ray is known to meet something, or to have passed the back by.
float reach_at_back(Interval interval) {
    bool reached;
    return distance_to(interval.back_arc, interval.back_arc.scale * deepest, reached);
}

// Whether the sample is met before the ray leaves the mesh: march.meets. False is no answer without THOROUGH.
bool meets(Interval interval, bool found, float distance) {
    float length = interval.end - interval.start;
    if (interval.open) {
        return true;
    }
    if (interval.end >= FAR) {
        return false;
    }
#ifdef THOROUGH
    Meeting behind = march(interval.back, interval.back_arc);
    return (found || behind.found) && distance + behind.distance <= length;
#else
    return found && distance + reach_at_back(interval) <= length;
#endif
}
