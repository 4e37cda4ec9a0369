// One triangle over the whole window, at one depth.
uniform float depth;

void main() {
    vec2 corner = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
    gl_Position = vec4(corner, 2.0 * depth - 1.0, 1.0);
}
