// (N.H)^n to float32's own accuracy. The driver's pow() loses some 1e-5 at n = 200, which is the whole value where
// the residual cancels the lobe: its logarithm is to blame, its exp2() is good.

// log2(h.z) of a unit vector with h.z > 0, through half the logarithm of h.z^2 = mantissa * 2^power.
float log2_cosine(vec3 h) {
    // The mantissa lies from sqrt(1/2) to sqrt(2), whose bits as a float are taken off and put on again.
    int bits = floatBitsToInt(h.z * h.z) - 0x3f3504f3;
    int power = bits >> 23;
    float mantissa = intBitsToFloat((bits & 0x007fffff) + 0x3f3504f3);
    // Near the pole from the sine: 1 - cos^2 keeps the digits that the cosine has lost.
    float z = (power == 0 ? -dot(h.xy, h.xy) : mantissa - 1.0) / (mantissa + 1.0);
    // atanh(z) = log(mantissa) / 2; for |z| < 0.172 the last term stands for all that follow, within 1e-8.
    float z2 = z * z;
    float series = z * (1.0 + z2 * (1.0 / 3.0 + z2 * (1.0 / 5.0 + z2 * 0.1459)));
    return float(power) * 0.5 + 1.44269504 * series;
}

float lobe(vec3 h, float exponent) {
    return h.z > 0.0 ? exp2(exponent * log2_cosine(h)) : float(exponent == 0.0);
}
