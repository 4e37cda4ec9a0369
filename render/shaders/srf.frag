// A lobe plus s(P) . basis(L, V) (processing.products.Srf.evaluate; Ma et al. 2004, eq. 6).
#include "bilinear.glsl"
#include "lobe.glsl"
#include "residual_basis.glsl"

uniform sampler2DArray residual;   // four numbers a layer: all colours of the first function, of the second, ...
uniform vec3 diffuse;
uniform vec3 specular;
uniform vec2 exponents;            // along lobe_axis and across it
uniform vec2 lobe_axis;            // unit vector in the plane of t and b
uniform bool wrap;

const int LAYERS = (3 * BASIS_SIZE + 3) / 4;

struct Material {
    vec3 view;
    vec4[LAYERS] residual;
};

float coefficient(Material here, int function, int colour) {
    int number = 3 * function + colour;
    return here.residual[number / 4][number % 4];
}

Material material_at(vec2 uv, vec3 view) {
    Taps taps = bilinear_taps(uv, vec2(textureSize(residual, 0).xy), wrap);
    Material here;
    here.view = view;
    for (int layer = 0; layer < LAYERS; ++layer) {
        here.residual[layer] = bilinear(residual, layer, taps);
    }
    return here;
}

// The exponent in the direction of H: n_u cos^2 + n_v sin^2 of its azimuth from the lobe's axis.
float exponent_toward(vec2 h) {
#ifdef ANISOTROPIC
    float along = dot(h, lobe_axis);
    float total = dot(h, h);
    return total > 0.0 ? mix(exponents.y, exponents.x, along * along / total) : exponents.x;
#else
    return exponents.x;
#endif
}

vec3 outgoing(Material here, vec3 light) {
    vec3 between = light + here.view;
    float inverse_square = 1.0 / max(dot(between, between), 1e-37);
    vec3 half_vector = between * sqrt(inverse_square);
    vec3 total = diffuse * light.z + specular * lobe(between, inverse_square, exponent_toward(between.xy));
    float[BASIS_SIZE] functions = residual_basis(light, here.view, half_vector);
    for (int k = 0; k < BASIS_SIZE; ++k) {
        total += functions[k] * vec3(coefficient(here, k, 0), coefficient(here, k, 1), coefficient(here, k, 2));
    }
    return light.z > 0.0 ? total : vec3(0.0);
}

#include "surface.glsl"
