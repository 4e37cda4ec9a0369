// A mesh in the world frame, with how it wraps the sample.
uniform mat4 clip_from_world;

in vec3 position;
in vec3 normal;
in vec4 tangent;
in vec2 uv;
in vec2 stretch;
in vec3 bending;

out vec3 surface_point;
out vec3 surface_normal;
out vec4 surface_tangent;
out vec2 surface_uv;
out vec2 surface_stretch;
out vec3 surface_bending;

void main() {
    surface_point = position;
    surface_normal = normal;
    surface_tangent = tangent;
    surface_uv = uv;
    surface_stretch = stretch;
    surface_bending = bending;
    gl_Position = clip_from_world * vec4(position, 1.0);
}
