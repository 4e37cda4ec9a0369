// Interpolation between measured directions: the same as processing.products.DirectionMesh.weights.

struct Corners {
    ivec3 indices;
    vec3 weights;
};

// Steps from the region of a cell's middle to that of a point of the cell; few sets of directions ask for three.
const int STEPS = 12;

Corners direction_corners(sampler2D cells, sampler2D regions, vec3 direction) {
    int size = textureSize(cells, 0).x;
    ivec2 cell = ivec2(floor((direction.xy + 1.0) * (0.5 * float(size))));
    int region = int(texelFetch(cells, clamp(cell, 0, size - 1), 0).r);
    vec3 tests;
    vec2 counted;
    for (int i = 0; i < STEPS; ++i) {
        vec4 place = texelFetch(regions, ivec2(0, region), 0);
        vec4 slopes = texelFetch(regions, ivec2(1, region), 0);
        vec2 q = direction.xy - place.xy;
        counted = place.zw;
        tests.yz = vec2(dot(slopes.xy, q), dot(slopes.zw, q));
        tests.x = 1.0 - dot(tests.yz, counted);
        // On a border rounding would send a point to and fro.
        float worst = min(min(tests.x, tests.y), tests.z);
        if (worst >= -1e-6) {
            break;
        }
        vec4 beyond = texelFetch(regions, ivec2(3, region), 0);
        region = int(worst == tests.x ? beyond.x : worst == tests.y ? beyond.y : beyond.z);
    }
    vec3 weights = max(tests * vec3(1.0, counted), 0.0);
    Corners corners;
    corners.indices = ivec3(texelFetch(regions, ivec2(2, region), 0).xyz);
    corners.weights = weights / (weights.x + weights.y + weights.z);
    return corners;
}
