// Tangent frames per pixel: the same as render/frames.py. Columns of the matrix are t, b, n in the world frame.

vec3 unit(vec3 v) {
    return v * inversesqrt(max(dot(v, v), 1e-37));
}

mat3 tangent_frame(vec3 normal, vec4 tangent) {
    vec3 n = unit(normal);
    vec3 t = unit(tangent.xyz - dot(tangent.xyz, n) * n);
    return mat3(t, (tangent.w < 0.0 ? -1.0 : 1.0) * cross(n, t), n);
}

// A captured sphere: p = -n_x / n_z, q = -n_y / n_z in the frame of the capture's camera (Ma et al. 2004, 6.2), whose colours
// are mirrored once beyond the map.
mat3 gradient_frame(vec3 normal, mat3 map_from_world, out vec2 uv) {
    vec3 n = map_from_world * unit(normal);
    vec2 endless = clamp(0.5 - 0.5 * n.xy / min(n.z, -1e-4), -1.0, 2.0);
    uv = 1.0 - abs(1.0 - abs(endless));
    vec3 t = vec3(-n.z, 0.0, n.x) / sqrt(max(n.x * n.x + n.z * n.z, 1e-12));
    return transpose(map_from_world) * mat3(t, cross(n, t), n);
}
