// Interpolation between measured directions: the same as processing.products.DirectionMesh.weights.

struct Corners {
    ivec3 indices;
    vec3 weights;
};

float cross_2d(vec2 a, vec2 b) {
    return a.x * b.y - a.y * b.x;
}

Corners direction_corners(sampler2D cells, sampler2D triangles, vec3 direction) {
    int size = textureSize(cells, 0).x;
    // Halves of the table apart, so that the product is exact and the cell the same as in float64.
    ivec2 cell = ivec2(floor(direction.xy * (0.5 * float(size)))) + size / 2;
    int triangle = int(texelFetch(cells, clamp(cell, 0, size - 1), 0).r);
    vec3 a = texelFetch(triangles, ivec2(0, triangle), 0).xyz;
    vec3 b = texelFetch(triangles, ivec2(1, triangle), 0).xyz;
    vec3 c = texelFetch(triangles, ivec2(2, triangle), 0).xyz;
    float area = cross_2d(b.xy - a.xy, c.xy - a.xy);
    float second = cross_2d(direction.xy - a.xy, c.xy - a.xy) / area;
    float third = cross_2d(b.xy - a.xy, direction.xy - a.xy) / area;
    vec3 weights = max(vec3(1.0 - second - third, second, third), 0.0);
    Corners corners;
    corners.indices = ivec3(int(a.z), int(b.z), int(c.z));
    corners.weights = weights / (weights.x + weights.y + weights.z);
    return corners;
}
