// The functions of light and half vector that residuals are sums of (processing.products.ResidualBasis, in its order).
// Each basis is a program of its own: loops over a number of functions that is known unroll.

#if defined(BASIS_HEMISPHERICAL)
const int BASIS_SIZE = 9;

float[BASIS_SIZE] residual_basis(vec3 light, vec3 view, vec3 half_vector) {
    float cosine = clamp(light.z, 0.0, 1.0);
    float level = sqrt(dot(light.xy, light.xy));
    vec2 cs = level > 0.0 ? light.xy / level : vec2(0.0);
    float x = 2.0 * cosine - 1.0;
    float root = 2.0 * sqrt(cosine * (1.0 - cosine));
    float about = 0.3989422804;    // sqrt(1 / 2 pi)
    float first = 1.7320508076 * about;
    float second = 3.8729833462 * about;
    return float[](
        about, first * root * cs.y, first * x, first * root * cs.x,
        second * root * root * cs.x * cs.y, second * x * root * cs.y, 2.2360679775 * about * (1.5 * x * x - 0.5),
        second * x * root * cs.x, 0.5 * second * root * root * (cs.x * cs.x - cs.y * cs.y)
    );
}

#elif defined(BASIS_BILINEAR)
const int BASIS_SIZE = 9;

float[BASIS_SIZE] residual_basis(vec3 light, vec3 view, vec3 half_vector) {
    return float[](
        light.x * view.x, light.x * view.y, light.x * view.z, light.y * view.x, light.y * view.y, light.y * view.z,
        light.z * view.x, light.z * view.y, light.z * view.z
    );
}

#elif defined(BASIS_BIQUADRATIC)
const int BASIS_SIZE = 6;

float[BASIS_SIZE] residual_basis(vec3 light, vec3 view, vec3 half_vector) {
    return float[](1.0, light.x, light.y, light.x * light.x, light.x * light.y, light.y * light.y);
}

#elif defined(BASIS_HALF_LIGHT)
const int BASIS_SIZE = 5;

float[BASIS_SIZE] residual_basis(vec3 light, vec3 view, vec3 half_vector) {
    return float[](half_vector.x, half_vector.y, half_vector.z, light.z, 1.0);
}

#elif defined(BASIS_HALF)
const int BASIS_SIZE = 3;

float[BASIS_SIZE] residual_basis(vec3 light, vec3 view, vec3 half_vector) {
    return float[](half_vector.x, half_vector.y, half_vector.z);
}

#else
#error no such basis: see processing.products.ResidualBasis
#endif
