// (N.H)^n to float32's own accuracy. The driver's pow() loses some 1e-5 at n = 200, which is the whole value where
// the residual cancels the lobe.

// atanh(z) for |z| < 0.18; the next term is under 1e-9.
float small_atanh(float z) {
    float z2 = z * z;
    return z * (1.0 + z2 * (1.0 / 3.0 + z2 * (1.0 / 5.0 + z2 * (1.0 / 7.0 + z2 * (1.0 / 9.0 + z2 / 11.0)))));
}

// log(h.z) of a unit vector with h.z > 0.
float log_cosine(vec3 h) {
    // Near the pole from the sine: 1 - cos^2 keeps the digits that the cosine has lost.
    float sine_squared = dot(h.xy, h.xy);
    if (sine_squared < 0.3) {
        return -small_atanh(sine_squared / (2.0 - sine_squared));
    }
    int bits = floatBitsToInt(h.z);
    int power = (bits >> 23) - 127;
    float mantissa = intBitsToFloat((bits & 0x007fffff) | 0x3f800000);
    if (mantissa > 1.41421356) {
        mantissa *= 0.5;
        power += 1;
    }
    return float(power) * 0.69314718 + 2.0 * small_atanh((mantissa - 1.0) / (mantissa + 1.0));
}

// exp(y) for y <= 0: powers of two by the exponent bits, the rest by its series (Cody and Waite's split of log 2).
float exp_falling(float y) {
    float power = floor(y * 1.44269504 + 0.5);
    float r = (y - power * 0.693359375) + power * 2.12194440e-4;
    float series = 1.0 + r * (1.0 + r * (0.5 + r * (1.0 / 6.0 + r * (1.0 / 24.0 + r * (1.0 / 120.0
                 + r * (1.0 / 720.0 + r / 5040.0))))));
    return y < -80.0 ? 0.0 : series * intBitsToFloat((int(power) + 127) << 23);
}

float lobe(vec3 half_vector, float exponent) {
    if (exponent == 0.0) {
        return 1.0;
    }
    return half_vector.z > 0.0 ? exp_falling(exponent * log_cosine(half_vector)) : 0.0;
}
