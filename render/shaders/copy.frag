// An image into a part of another one.
uniform sampler2D source;
uniform ivec2 corner;

layout(location = 0) out vec4 copy;

void main() {
    copy = texelFetch(source, ivec2(gl_FragCoord.xy) - corner, 0);
}
