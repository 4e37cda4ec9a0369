// Interpolation between measured directions: the same as processing.products.DirectionMesh.weights.

struct Corners {
    ivec3 indices;
    vec3 weights;
};

// Those below the lowest measured one raised to its height: DirectionMesh.raised.
vec3 raised(vec3 direction, float lowest) {
    float scale = sqrt(1.0 - lowest * lowest) / max(length(direction.xy), 1e-9);
    return direction.z < lowest ? vec3(direction.xy * scale, lowest) : direction;
}

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

const int MOST_STEPS = 64;

// From the region of a cell's middle it is a step or two to that of any of its points. Software rasterisers go on as long
// as one of the pixels that they shade at once asks, and look at that only where a loop ends.
Corners direction_corners(sampler2D cells, usampler2D regions, vec3 direction) {
    float rows = 1.0 / float(textureSize(regions, 0).y);
    float row = (textureLod(cells, 0.5 * direction.xy + 0.5, 0.0).r + 0.5) * rows;
    Region region;
    bool outside;
    int steps = 0;
    do {
        region = region_at(regions, row, direction.xy);
        float worst = min(min(region.tests.x, region.tests.y), region.tests.z);
        uint shift = worst == region.tests.x ? 0u : worst == region.tests.y ? 10u : 20u;
        // On a border rounding would send a point to and fro.
        outside = worst < -2e-7;
        // Mesa goes on computing for pixels that have left the loop: a further turn must leave them as they are.
        row = outside ? (float((region.beyond >> shift) & 1023u) + 0.5) * rows : row;
    } while (outside && ++steps < MOST_STEPS);
    vec3 weights = max(region.tests * vec3(1.0, uvec2(region.beyond, region.corners) >> 30u), 0.0);
    Corners corners;
    corners.indices = ivec3((uvec3(region.corners) >> uvec3(0u, 10u, 20u)) & 1023u);
    corners.weights = weights / (weights.x + weights.y + weights.z);
    return corners;
}
