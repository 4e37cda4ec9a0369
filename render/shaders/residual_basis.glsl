// The functions of light and half vector that residuals are sums of (processing.products.ResidualBasis, in its order).

const int BASIS_LARGEST = 9;
uniform int basis;

int hemispherical(vec3 light, out float functions[BASIS_LARGEST]) {
    float cosine = clamp(light.z, 0.0, 1.0);
    float level = sqrt(dot(light.xy, light.xy));
    vec2 cs = level > 0.0 ? light.xy / level : vec2(0.0);
    float x = 2.0 * cosine - 1.0;
    float root = 2.0 * sqrt(cosine * (1.0 - cosine));
    float about = 0.3989422804;    // sqrt(1 / 2 pi)
    float first = 1.7320508076 * about;
    float second = 3.8729833462 * about;
    functions[0] = about;
    functions[1] = first * root * cs.y;
    functions[2] = first * x;
    functions[3] = first * root * cs.x;
    functions[4] = second * root * root * cs.x * cs.y;
    functions[5] = second * x * root * cs.y;
    functions[6] = 2.2360679775 * about * (1.5 * x * x - 0.5);
    functions[7] = second * x * root * cs.x;
    functions[8] = 0.5 * second * root * root * (cs.x * cs.x - cs.y * cs.y);
    return 9;
}

// Fills the first of `functions` and says how many.
int residual_basis(vec3 light, vec3 half_vector, out float functions[BASIS_LARGEST]) {
    if (basis == 3) {
        return hemispherical(light, functions);
    }
    if (basis == 2) {
        functions[0] = 1.0;
        functions[1] = light.x;
        functions[2] = light.y;
        functions[3] = light.x * light.x;
        functions[4] = light.x * light.y;
        functions[5] = light.y * light.y;
        return 6;
    }
    functions[0] = half_vector.x;
    functions[1] = half_vector.y;
    functions[2] = half_vector.z;
    functions[3] = light.z;
    functions[4] = 1.0;
    return basis == 1 ? 5 : 3;
}
