// A lobe plus s(P) . basis(L, V) (processing.products.Srf.evaluate; Ma et al. 2004, eq. 6).
#include "bilinear.glsl"
#include "lobe.glsl"
#include "residual_basis.glsl"

uniform sampler2DArray residual;   // a layer for each function of the basis; its channels are colours
uniform vec3 diffuse;
uniform vec3 specular;
uniform vec2 exponents;            // along lobe_axis and across it
uniform vec2 lobe_axis;            // unit vector in the plane of t and b
uniform bool wrap;

// The exponent in the direction of H: n_u cos^2 + n_v sin^2 of its azimuth from the lobe's axis.
float exponent_toward(vec2 h) {
    float along = dot(h, lobe_axis);
    float total = dot(h, h);
    return total > 0.0 ? mix(exponents.y, exponents.x, along * along / total) : exponents.x;
}

vec3 outgoing(vec2 uv, vec3 light, vec3 view) {
    if (light.z <= 0.0) {
        return vec3(0.0);
    }
    vec3 half_vector = light + view;
    half_vector /= max(sqrt(dot(half_vector, half_vector)), 1e-30);
    vec3 total = diffuse * light.z + specular * lobe(half_vector, exponent_toward(half_vector.xy));
    Taps taps = bilinear_taps(uv, textureSize(residual, 0).xy, wrap);
    float functions[BASIS_LARGEST];
    int count = residual_basis(light, half_vector, functions);
    for (int k = 0; k < count; ++k) {
        total += functions[k] * bilinear(residual, k, taps);
    }
    return total;
}

#include "surface.glsl"
