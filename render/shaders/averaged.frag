// The mean of factor x factor pixels.
uniform sampler2D image;
uniform int factor;

layout(location = 0) out vec4 mean;

void main() {
    ivec2 first = factor * ivec2(gl_FragCoord.xy);
    vec4 sum = vec4(0.0);
    for (int row = 0; row < factor; ++row) {
        for (int column = 0; column < factor; ++column) {
            sum += texelFetch(image, first + ivec2(column, row), 0);
        }
    }
    mean = sum / float(factor * factor);
}
