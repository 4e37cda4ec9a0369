// Where rays enter a mesh and nothing is decided yet, a depth that tells the material, else 1: later passes draw nothing
// where the depth is not their own.
uniform sampler2D front_place;
uniform sampler2D decided;
uniform float share;

void main() {
    vec2 at = gl_FragCoord.xy / vec2(textureSize(decided, 0));
    vec4 place = textureLod(front_place, at, 0.0);
    bool waiting = place.x < 1e30 && textureLod(decided, at, 0.0).r == 0.0;
    gl_FragDepth = waiting ? share * abs(place.w) : 1.0;
}
