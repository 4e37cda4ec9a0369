// Interpolation between measured directions: the same as processing.products.DirectionMesh.weights.

struct Corners {
    ivec3 indices;
    vec3 weights;
};

// Two texels: place and slopes, three numbers of neighbours and of directions, of ten bits each, flags above them.
struct Region {
    vec3 tests;
    uint beyond;
    uint corners;
};

Region region_at(usampler2D regions, float row, vec2 place) {
    uvec4 first = textureLod(regions, vec2(0.25, row), 0.0);
    uvec4 second = textureLod(regions, vec2(0.75, row), 0.0);
    vec2 q = place - uintBitsToFloat(first.xy);
    Region region;
    region.beyond = second.z;
    region.corners = second.w;
    region.tests.yz = vec2(dot(uintBitsToFloat(first.zw), q), dot(uintBitsToFloat(second.xy), q));
    region.tests.x = 1.0 - dot(region.tests.yz, vec2(second.zw >> 30u));
    return region;
}

// STEPS lead from the region of a cell's middle to that of any of its points. The few are unrolled, as their number is
// compiled in: a loop that goes on as long as any pixel asks costs Mesa's software rasteriser more than all of them.
Corners direction_corners(sampler2D cells, usampler2D regions, vec3 direction) {
    float rows = 1.0 / float(textureSize(regions, 0).y);
    float row = (textureLod(cells, 0.5 * direction.xy + 0.5, 0.0).r + 0.5) * rows;
    Region region = region_at(regions, row, direction.xy);
    for (int i = 0; i < STEPS; ++i) {
        float worst = min(min(region.tests.x, region.tests.y), region.tests.z);
        uint shift = worst == region.tests.x ? 0u : worst == region.tests.y ? 10u : 20u;
        row = worst < 0.0 ? (float((region.beyond >> shift) & 1023u) + 0.5) * rows : row;
        region = region_at(regions, row, direction.xy);
    }
    vec3 weights = max(region.tests * vec3(1.0, uvec2(region.beyond, region.corners) >> 30u), 0.0);
    Corners corners;
    corners.indices = ivec3((uvec3(region.corners) >> uvec3(0u, 10u, 20u)) & 1023u);
    corners.weights = weights / (weights.x + weights.y + weights.z);
    return corners;
}
