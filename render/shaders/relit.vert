// Bodies whose vertices bring their radiance along.
uniform mat4 clip_from_body;

in vec3 position;
in vec3 radiance;

out vec3 vertex_radiance;

invariant gl_Position;

void main() {
    vertex_radiance = radiance;
    gl_Position = clip_from_body * vec4(position, 1.0);
}
