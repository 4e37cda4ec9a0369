// Depth 0 where rays enter a mesh and nothing is decided yet, else 1: what later passes leave out.
uniform sampler2D front_place;
uniform sampler2D decided;

void main() {
    vec2 at = gl_FragCoord.xy / vec2(textureSize(decided, 0));
    bool waiting = textureLod(front_place, at, 0.0).r < 1e30 && textureLod(decided, at, 0.0).r == 0.0;
    gl_FragDepth = waiting ? 0.0 : 1.0;
}
