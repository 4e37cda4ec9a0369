// How much of a light reaches a point, from the shadow maps of all lights side by side in one texture
// (render/shadows.py). A map holds how far along the light's rays everything is lit.

uniform sampler2D shadow_maps;
uniform vec4 shadow_rows[195];    // of each light: image point in pixels of the texture, and distance, of (x, y, z, 1)
uniform vec4 shadow_windows[65];  // of each light: the first and the last pixel that may be read

// Four neighbours answer, and count as in bilinear filtering.
float lit_share(int i, vec3 point) {
    vec4 at = vec4(point, 1.0);
    vec2 place = vec2(dot(shadow_rows[3 * i], at), dot(shadow_rows[3 * i + 1], at));
    float way = dot(shadow_rows[3 * i + 2], at);
    vec2 inside = clamp(place, shadow_windows[i].xy, shadow_windows[i].zw);
    if (inside != place) {
        return 1.0;
    }
    vec2 corner = floor(place);
    vec2 f = place - corner;
    vec2 scale = 1.0 / vec2(textureSize(shadow_maps, 0));
    vec2 low = (corner + 0.5) * scale, high = (corner + 1.5) * scale;
    vec4 reach = vec4(textureLod(shadow_maps, low, 0.0).r, textureLod(shadow_maps, vec2(high.x, low.y), 0.0).r,
                      textureLod(shadow_maps, vec2(low.x, high.y), 0.0).r, textureLod(shadow_maps, high, 0.0).r);
    vec4 lit = vec4(lessThanEqual(vec4(way), reach));
    vec2 rows = mix(lit.xz, lit.yw, f.x);
    return mix(rows.x, rows.y, f.y);
}
