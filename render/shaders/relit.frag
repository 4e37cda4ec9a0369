// Radiance between vertices.
in vec3 vertex_radiance;

layout(location = 0) out vec4 radiance;

void main() {
    radiance = vec4(vertex_radiance, 1.0);
}
