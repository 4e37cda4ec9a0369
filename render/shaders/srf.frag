// Blinn-Phong plus s(P) . H (processing.products.Srf.evaluate; Ma et al. 2004, eq. 6).
#include "bilinear.glsl"
#include "lobe.glsl"

uniform sampler2DArray residual;   // layers: s_t, s_b, s_n; their channels are colours
uniform vec3 diffuse;
uniform vec3 specular;
uniform float exponent;
uniform bool wrap;

vec3 outgoing(vec2 uv, vec3 light, vec3 view) {
    if (light.z <= 0.0) {
        return vec3(0.0);
    }
    vec3 half_vector = light + view;
    half_vector /= max(sqrt(dot(half_vector, half_vector)), 1e-30);
    Taps taps = bilinear_taps(uv, textureSize(residual, 0).xy, wrap);
    return diffuse * light.z + specular * lobe(half_vector, exponent)
         + half_vector.x * bilinear(residual, 0, taps)
         + half_vector.y * bilinear(residual, 1, taps)
         + half_vector.z * bilinear(residual, 2, taps);
}

#include "surface.glsl"
