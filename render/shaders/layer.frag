// Where rays enter or leave a wrapped mesh: of what lies beyond the last layer, with all that a march starts from.
#include "frames.glsl"
#include "rays.glsl"

in vec3 surface_point;
in vec3 surface_normal;
in vec4 surface_tangent;
in vec2 surface_uv;
in vec2 surface_stretch;
in vec3 surface_bending;

uniform float number;        // of the material, negative where the mesh is open
uniform sampler2D beyond;    // red: the distance beyond which to look

layout(location = 0) out vec4 place;     // distance along the ray, texture coordinates, then the number
layout(location = 1) out vec4 upward;    // n, then the length of a tile along b, negative where b = t x n
layout(location = 2) out vec4 along;     // t times the length of a tile along it, then the curvature along the ray

void main() {
    Ray ray = ray_here();
    float distance = dot(ray.start - surface_point, ray.toward);
    if (distance <= textureLod(beyond, gl_FragCoord.xy / vec2(textureSize(beyond, 0)), 0.0).r) {
        discard;
    }
    mat3 frame = tangent_frame(surface_normal, surface_tangent);
    vec2 level = (ray.toward * frame).xy;
    vec2 heading = dot(level, level) > 1e-18 ? level * inversesqrt(dot(level, level)) : vec2(1.0, 0.0);
    float curvature = dot(surface_bending, vec3(heading.x * heading.x, 2.0 * heading.x * heading.y, heading.y * heading.y));
    place = vec4(distance, surface_uv, number);
    upward = vec4(frame[2], surface_tangent.w < 0.0 ? -surface_stretch.y : surface_stretch.y);
    along = vec4(frame[0] * surface_stretch.x, curvature);
}
