// A mesh in the world frame; what the fragment shaders need is interpolated over its triangles.
uniform mat4 clip_from_world;

in vec3 position;
in vec3 normal;
in vec4 tangent;
in vec2 uv;

out vec3 surface_point;
out vec3 surface_normal;
out vec4 surface_tangent;
out vec2 surface_uv;

void main() {
    surface_point = position;
    surface_normal = normal;
    surface_tangent = tangent;
    surface_uv = uv;
    gl_Position = clip_from_world * vec4(position, 1.0);
}
