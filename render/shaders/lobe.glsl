// (N.H)^n to float32's own accuracy. The driver's pow() loses some 1e-5 at n = 200, which is the whole value where
// the residual cancels the lobe: its logarithm is to blame, its exp2() is good.

// x = mantissa * 2^power for x > 0. The mantissa lies from sqrt(1/2) to sqrt(2), whose bits as a float are taken off and
// put on again.
float mantissa_of(float x, out int power) {
    int bits = floatBitsToInt(x) - 0x3f3504f3;
    power = bits >> 23;
    return intBitsToFloat((bits & 0x007fffff) + 0x3f3504f3);
}

// Half the binary logarithm of a mantissa: atanh(z) / log(2) for z = (mantissa - 1) / (mantissa + 1). |z| < 0.172, so
// that the last term stands for all that follow, within 1e-8.
float half_log2(float z) {
    float z2 = z * z;
    return 1.44269504 * (z * ((1.0 + z2 * (1.0 / 3.0)) + z2 * z2 * (1.0 / 5.0 + z2 * 0.1459)));
}

// log2(cosine) from squares of sine and cosine, through half the logarithm of cosine^2.
float log2_cosine(float sine_squared, float cosine_squared) {
    int power;
    float mantissa = mantissa_of(cosine_squared, power);
    // Near the pole from the sine: 1 - cos^2 keeps the digits that the cosine has lost.
    float z = (power == 0 ? -sine_squared : mantissa - 1.0) / (mantissa + 1.0);
    return float(power) * 0.5 + half_log2(z);
}

float log2_exact(float x) {
    int power;
    float mantissa = mantissa_of(x, power);
    return float(power) + 2.0 * half_log2((mantissa - 1.0) / (mantissa + 1.0));
}

// max(base, 0)^exponent.
float power_exact(float base, float exponent) {
    return base > 0.0 ? exp2(exponent * log2_exact(base)) : float(exponent == 0.0);
}

// H = between / |between|, of which one over the squared length is given: nothing waits for a root.
float lobe(vec3 between, float inverse_square, float exponent) {
    float sine_squared = dot(between.xy, between.xy) * inverse_square;
    float cosine_squared = between.z * between.z * inverse_square;
    return between.z > 0.0 ? exp2(exponent * log2_cosine(sine_squared, cosine_squared)) : float(exponent == 0.0);
}
