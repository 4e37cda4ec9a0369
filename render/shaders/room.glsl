// How much farther from a light a surface may lie at the far end of the pixels around a point: shadow_map._room.

uniform float pixel;    // of the shadow map, in world units

const float STEEPEST = 8.0;    // as in render/shadow_map.py

float room(float cosine) {
    float slope = sqrt(max(1.0 - cosine * cosine, 0.0)) / max(cosine, 1e-6);
    return pixel * (0.5 + 1.5 * min(slope, STEEPEST));
}
