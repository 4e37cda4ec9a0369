// Where a ray that enters a wrapped sample first meets it: render/march.py, in float32.
#include "directions.glsl"

uniform sampler2DArray depths;      // layer view: codes of a texel, its right neighbour, the one below, and right below
uniform float code_255;             // depth of the highest code, in tiles
uniform float deepest;              // of all depths
uniform float lowest_depth_view;    // cosine of the lowest measured direction
uniform float plane;                // depth of the texels, in tiles
uniform sampler2D depth_cells;
uniform usampler2D depth_regions;

const int STEPS = 2;                // as in render/march.py, and so the next
const float FLATTEST = 0.3;
const float FAR = 1e30;

struct Entry {
    vec2 uv;
    mat3 frame;        // columns t, b, n in the world frame
    vec3 view;         // along them, toward where the ray comes from
    vec2 stretch;
    float curvature;
};

struct Arc {
    float cosine;
    float sine;
    float curvature;
    vec2 heading;
    float scale;
};

struct Meeting {
    bool found;
    float distance;
    vec2 uv;
    vec3 view;
    vec2 turn;         // cosine and sine of the angle by which the normal has turned
};

float depth_at(vec2 uv, vec3 view) {
    Corners seen = direction_corners(depth_cells, depth_regions, view);
    vec2 size = vec2(textureSize(depths, 0).xy);
    vec2 at = (uv - floor(uv)) * size - 0.5;
    vec2 corner = floor(at);
    vec2 f = at - corner;
    vec2 low = (corner + 0.5) / size;
    vec4 codes = seen.weights.x * textureLod(depths, vec3(low, float(seen.indices.x)), 0.0)
               + seen.weights.y * textureLod(depths, vec3(low, float(seen.indices.y)), 0.0)
               + seen.weights.z * textureLod(depths, vec3(low, float(seen.indices.z)), 0.0);
    vec2 rows = mix(codes.xz, codes.yw, f.x);
    return code_255 * mix(rows.x, rows.y, f.y);
}

Arc arc_of(Entry entry) {
    Arc arc;
    // A ray along the surface would not come down at all, and divide by nothing.
    arc.cosine = clamp(entry.view.z, 1e-4, 1.0);
    arc.sine = sqrt(1.0 - arc.cosine * arc.cosine);
    arc.curvature = entry.curvature;
    float level = length(entry.view.xy);
    arc.heading = level > 1e-9 ? -entry.view.xy / level : vec2(1.0, 0.0);
    arc.scale = sqrt(entry.stretch.x * entry.stretch.y);
    return arc;
}

// The distance to a depth under the surface, found or not; else that to the deepest point.
float distance_to(Arc arc, float depth, out bool found) {
    float drop = min(arc.curvature * depth, 1.0);
    float square = arc.cosine * arc.cosine - drop * (2.0 - drop);
    found = square >= 0.0;
    float below = arc.cosine + sqrt(max(square, 0.0));
    return found ? depth * (2.0 - drop) / below : arc.cosine / arc.curvature;
}

Meeting march(Entry entry, Arc arc) {
    Meeting meeting;
    meeting.distance = 0.0;
    vec2 tiles = arc.heading / entry.stretch;
    int step = 0;
    do {
        float up = 1.0 - arc.curvature * arc.cosine * meeting.distance;
        float aside = arc.curvature * arc.sine * meeting.distance;
        float share = max(length(vec2(up, aside)), 1e-6);
        float depth = meeting.distance * (2.0 * arc.cosine - arc.curvature * meeting.distance) / (1.0 + share);
        float foot = abs(aside) > 1e-4 ? atan(aside, up) / arc.curvature : arc.sine * meeting.distance / max(up, 1e-6);
        meeting.turn = vec2(up, aside) / share;
        float cosine = max(arc.cosine - arc.curvature * meeting.distance, 0.0) / share;
        vec3 view = vec3(-arc.sine / (share * share) * tiles, cosine / arc.scale);
        vec3 flat_view = view * inversesqrt(dot(view, view));
        meeting.view = raised(flat_view, lowest_depth_view);
        float down = plane - depth / arc.scale;
        meeting.uv = entry.uv + (foot * tiles - meeting.view.xy * (down / meeting.view.z)) * vec2(1.0, -1.0);
        float ahead = arc.scale * depth_at(meeting.uv, meeting.view) - depth;
        float slope = flat_view.z * length(meeting.view.xy) / max(meeting.view.z * length(flat_view.xy), 1e-9);
        bool lower = flat_view.z < lowest_depth_view && ahead > 0.0;
        meeting.distance = distance_to(arc, depth + (lower ? max(slope, FLATTEST) : 1.0) * ahead, meeting.found);
    } while (++step < STEPS);
    return meeting;
}

// The frame under the meeting, turned about the axis across the ray's heading.
mat3 turned_frame(Entry entry, Arc arc, Meeting meeting) {
    vec3 along = entry.frame * vec3(arc.heading, 0.0);
    vec3 up = entry.frame[2];
    vec3 turned_along = meeting.turn.x * along - meeting.turn.y * up;
    vec3 turned_up = meeting.turn.y * along + meeting.turn.x * up;
    vec3 swing = turned_along - along;
    return mat3(entry.frame[0] + arc.heading.x * swing, entry.frame[1] + arc.heading.y * swing, turned_up);
}
