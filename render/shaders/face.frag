// How far light comes over the mesh as it is.
#include "frames.glsl"
#include "rays.glsl"
#include "room.glsl"

in vec3 surface_point;
in vec3 surface_normal;

layout(location = 0) out vec4 reach;

void main() {
    Ray ray = ray_here();
    reach = vec4(dot(ray.start - surface_point, ray.toward) + room(dot(unit(surface_normal), ray.toward)));
}
