// A mesh in the world frame; what the fragment shaders need is interpolated over its triangles.
uniform mat4 clip_from_world;

in vec3 position;
in vec3 normal;
in vec4 tangent;
in vec2 uv;
#ifdef WRAPPED
in vec2 stretch;
in vec3 bending;
#endif

out vec3 surface_point;
out vec3 surface_normal;
out vec4 surface_tangent;
out vec2 surface_uv;
#ifdef WRAPPED
out vec2 surface_stretch;
out vec3 surface_bending;
#endif

void main() {
    surface_point = position;
    surface_normal = normal;
    surface_tangent = tangent;
    surface_uv = uv;
#ifdef WRAPPED
    surface_stretch = stretch;
    surface_bending = bending;
#endif
    gl_Position = clip_from_world * vec4(position, 1.0);
}
