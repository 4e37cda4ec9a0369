// Depth 0 where all is decided, so that no face is drawn there, else 1.
uniform sampler2D decided;

void main() {
    vec2 at = gl_FragCoord.xy / vec2(textureSize(decided, 0));
    gl_FragDepth = 1.0 - textureLod(decided, at, 0.0).r;
}
