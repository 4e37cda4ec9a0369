// One texture and a cosine (render/flat.py).
#include "bilinear.glsl"

uniform sampler2DArray albedo;

vec3 outgoing(vec2 uv, vec3 light, vec3 view) {
    Taps taps = bilinear_taps(uv, textureSize(albedo, 0).xy, true);
    return bilinear(albedo, 0, taps) * (max(light.z, 0.0) * 0.31830988618);
}

#include "surface.glsl"
