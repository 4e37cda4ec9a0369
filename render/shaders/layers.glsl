// One interval of the rays inside a mesh, as layer.frag wrote it, and whether its sample is met there (render/march.py).
#include "march.glsl"
#include "rays.glsl"

uniform sampler2D front_place;
uniform sampler2D front_upward;
uniform sampler2D front_along;
uniform sampler2D back_place;
uniform sampler2D back_upward;
uniform sampler2D back_along;
uniform float number;

struct Hit {
    bool found;
    float distance;    // from the ray's start
    float passed;      // how far the ray is known to meet nothing, if it does not
    vec2 uv;
    vec3 view;
    mat3 frame;
    vec3 tile;         // lengths of a tile along the frame
    float entry;       // distance at which the ray enters, and by which it has come to the lowest depth or left again
    float base;
    float cosine;      // to the normal where it enters
};

Entry entry_of(vec4 place, vec4 upward, vec4 along, vec3 toward) {
    Entry entry;
    entry.uv = place.yz;
    entry.stretch = vec2(length(along.xyz), abs(upward.w));
    vec3 t = along.xyz / entry.stretch.x;
    entry.frame = mat3(t, (upward.w < 0.0 ? -1.0 : 1.0) * cross(upward.xyz, t), upward.xyz);
    entry.view = toward * entry.frame;
    entry.curvature = place.w;
    return entry;
}

// Whether the sample is met before the ray leaves the mesh: march.meets.
bool meets(Meeting front, vec4 back_face, float length, vec3 toward) {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    Entry back = entry_of(back_face, texelFetch(back_upward, pixel, 0), texelFetch(back_along, pixel, 0), -toward);
    Arc arc = arc_of(back);
    bool reached;
    bool met = front.found && front.distance + distance_to(arc, arc.scale * deepest, reached) <= length;
    // Else what is at the back may lie so deep that it matters.
    if (!met) {
        Meeting behind = march(back, arc);
        met = (front.found || behind.found) && front.distance + behind.distance <= length;
    }
    return met;
}

// Discards pixels that no front face of the material's meshes covers.
Hit hit_here(Ray ray) {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 along = texelFetch(front_along, pixel, 0);
    if (abs(along.w) != number) {
        discard;
    }
    vec4 place = texelFetch(front_place, pixel, 0);
    Entry entry = entry_of(place, texelFetch(front_upward, pixel, 0), along, ray.toward);
    Arc arc = arc_of(entry);
    Meeting meeting = march(entry, arc);
    Hit hit;
    hit.found = true;
    hit.distance = place.x + meeting.distance;
    hit.uv = meeting.uv;
    hit.view = meeting.view;
    hit.frame = turned_frame(entry, arc, meeting);
    hit.tile = vec3(entry.stretch, arc.scale);
    hit.entry = place.x;
    hit.cosine = entry.view.z;
    bool reached;
    float base = distance_to(arc, arc.scale * deepest, reached);
    hit.base = reached ? place.x + base : FAR;
    hit.passed = FAR;
    if (along.w > 0.0) {
        vec4 back = texelFetch(back_place, pixel, 0);
        hit.passed = back.x > place.x ? back.x : FAR;
        hit.found = back.x > place.x && meets(meeting, back, back.x - place.x, ray.toward);
    }
    return hit;
}
