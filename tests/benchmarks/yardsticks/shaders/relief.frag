// Height fields under a surface, found per pixel: one of PARALLAX, OCCLUSION, RELIEF and CURVED is defined.
#include "../../../../render/shaders/frames.glsl"

in vec3 surface_point;
in vec3 surface_normal;
in vec4 surface_tangent;
in vec2 surface_uv;
in vec2 surface_stretch;
in vec3 surface_bending;

uniform vec3 eye;
uniform vec3 light_direction;
uniform vec3 light_irradiance;
uniform sampler2D shapes;    // normal x, normal y (both halved, plus a half), roughness, depth over the deepest
uniform sampler2D colours;   // albedo, specular
uniform float deepest;       // in tiles

layout(location = 0) out vec4 radiance;

const float PI = 3.14159265358979;
const int LINEAR_STEPS = 48;
const int BINARY_STEPS = 7;
const int SHADOW_STEPS = 24;

// A ray through the relief, x lengths of a tile along it: texture coordinates and depth. `bend` is half the surface's
// normal curvature along it, over the length of a tile.
struct Ray {
    vec2 start;
    vec2 speed;
    float depth;
    float sinking;
    float bend;
};

vec2 place(Ray ray, float x) {
    return ray.start + x * ray.speed;
}

float depth_of(Ray ray, float x) {
    return ray.depth + x * (ray.sinking - ray.bend * x);
}

float relief_depth(vec2 uv) {
    return deepest * textureLod(shapes, uv, 0.0).a;
}

float scale() {
    return sqrt(surface_stretch.x * surface_stretch.y);
}

// Along a unit vector in the tangent frame.
Ray ray_along(vec2 start, float depth, vec3 way) {
    float bend = 0.0;
#ifdef CURVED
    bend = 0.5 * scale() * (way.x * way.x * surface_bending.x + 2.0 * way.x * way.y * surface_bending.y + way.y * way.y * surface_bending.z);
#endif
    return Ray(start, scale() * vec2(way.x, -way.y) / surface_stretch, depth, -way.z, bend);
}

// Where a ray from the reference plane reaches the deepest point; negative where the surface bends away before: then it
// comes out at minus that.
float way_down(Ray ray) {
    float square = ray.sinking * ray.sinking - 4.0 * ray.bend * deepest;
    return square > 0.0 ? 2.0 * deepest / (ray.sinking + sqrt(square)) : -ray.sinking / ray.bend;
}

// Linear search, then bisection (Policarpo et al. 2005) or one secant; negative where nothing is met.
float first_meeting(Ray ray) {
    float end = way_down(ray), step = abs(end) / float(LINEAR_STEPS), x = step;
    int i = 1;
    while (i < LINEAR_STEPS && depth_of(ray, x) < relief_depth(place(ray, x))) {
        ++i;
        x = float(i) * step;
    }
    if (i == LINEAR_STEPS && end < 0.0) return -1.0;
    float before = x - step;
#ifdef OCCLUSION
    float above = relief_depth(place(ray, before)) - depth_of(ray, before);
    float below = depth_of(ray, x) - relief_depth(place(ray, x));
    return before + step * above / max(above + below, 1e-6);
#else
    for (int k = 0; k < BINARY_STEPS; ++k) {
        float middle = 0.5 * (before + x);
        if (depth_of(ray, middle) < relief_depth(place(ray, middle))) before = middle;
        else x = middle;
    }
    return x;
#endif
}

// Whether something stands between a point of the relief and the light.
bool shaded(vec2 uv, float depth, vec3 light) {
    Ray ray = ray_along(uv, depth, light);
    ray.bend = max(ray.bend, 0.0);
    float root = sqrt(light.z * light.z + 4.0 * ray.bend * depth);
    if (light.z + root < 1e-3) return true;
    float step = 2.0 * depth / (light.z + root) / float(SHADOW_STEPS);
    for (int i = 1; i < SHADOW_STEPS; ++i) {
        float x = float(i) * step;
        if (depth_of(ray, x) > relief_depth(place(ray, x)) + 0.02 * deepest) return true;
    }
    return false;
}

// Lambertian and microfacets of Trowbridge and Reitz with Smith's shadowing: reflectance times cosine.
vec3 reflected(vec3 n, vec3 light, vec3 view, vec4 colour, float roughness) {
    float n_l = dot(n, light), n_v = max(dot(n, view), 1e-3);
    if (n_l <= 0.0) return vec3(0.0);
    vec3 half_way = unit(light + view);
    float n_h = dot(n, half_way), square = roughness * roughness * roughness * roughness;
    float spread = n_h * n_h * (square - 1.0) + 1.0;
    float hidden = n_l * sqrt(square + (1.0 - square) * n_v * n_v) + n_v * sqrt(square + (1.0 - square) * n_l * n_l);
    float fresnel = colour.a + (1.0 - colour.a) * pow(1.0 - dot(half_way, view), 5.0);
    float gloss = colour.a > 0.0 ? 0.5 * square / (PI * spread * spread) * fresnel / hidden : 0.0;
    return n_l * (colour.rgb / PI + gloss);
}

// A direction of the frame where the ray came in, in that where it is: the normal has turned by `turn`.
vec3 turned(vec3 way, vec2 turn) {
    return unit(way + vec3(-turn * way.z, dot(turn, way.xy)));
}

void main() {
    mat3 frame = tangent_frame(surface_normal, surface_tangent);
    vec3 view = unit((eye - surface_point) * frame), light = light_direction * frame;
    view.z = max(view.z, 1e-3);
    Ray ray = ray_along(surface_uv, 0.0, -view);
#ifdef PARALLAX
    // Offset limiting (Welsh 2004): the depth of the point above, along the view as if that were steep.
    float x = relief_depth(surface_uv);
    float depth = x;
#else
    float x = first_meeting(ray);
    if (x < 0.0) discard;
    float depth = depth_of(ray, x);
#endif
    vec2 uv = place(ray, x);
#ifdef CURVED
    vec2 moved = -view.xy * x * scale();
    vec2 turn = vec2(dot(surface_bending.xy, moved), dot(surface_bending.yz, moved));
    view = turned(view, turn);
    light = turned(light, turn);
#else
    if (light.z <= 0.0) {
        radiance = vec4(0.0, 0.0, 0.0, 1.0);
        return;
    }
#endif
    vec4 shape = textureLod(shapes, uv, 0.0), colour = textureLod(colours, uv, 0.0);
    vec2 slant = 2.0 * shape.xy - 1.0;
    vec3 n = unit(vec3(slant / surface_stretch, sqrt(max(1.0 - dot(slant, slant), 1e-4)) / scale()));
    vec3 value = reflected(n, light, view, colour, shape.z);
#ifndef PARALLAX
    if (value != vec3(0.0) && shaded(uv, depth, light)) value = vec3(0.0);
#endif
    radiance = vec4(light_irradiance * value, 1.0);
}
