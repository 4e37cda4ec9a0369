// One texture and a cosine (render/flat.py).
#include "bilinear.glsl"

uniform sampler2DArray albedo;

struct Material {
    vec3 colour;
};

Material material_at(vec2 uv, vec3 view) {
    return Material(bilinear(albedo, 0, bilinear_taps(uv, vec2(textureSize(albedo, 0).xy), true)).rgb);
}

vec3 outgoing(Material here, vec3 light) {
    return here.colour * (max(light.z, 0.0) * 0.31830988618);
}

#include "surface.glsl"
