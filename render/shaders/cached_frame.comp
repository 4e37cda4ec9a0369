// Radiance of vertices whose visibility is a known step function over the leaves of a tree of directions.
// As processing/lighting/cached_kernel.py and the nodes of moving_kernel.py, a vertex to each invocation.
#include "reflectance.glsl"

layout(local_size_x = 64) in;

layout(std430, binding = 0) readonly buffer Ranges { ivec2 ranges[]; };          // of steps, for each vertex
layout(std430, binding = 1) readonly buffer Starts { uint starts[]; };           // first leaves of steps, two in a word
layout(std430, binding = 2) readonly buffer Values { float values[]; };
layout(std430, binding = 3) readonly buffer Sums { vec4 sums[]; };               // of light before a leaf; what float32 leaves of it
layout(std430, binding = 4) readonly buffer Surface { vec4 surface[]; };         // normal and direction to the eye
layout(std430, binding = 5) readonly buffer Means { float means[]; };            // mean directions of nodes
layout(std430, binding = 7) writeonly buffer Radiance { float radiance[]; };

uniform int vertices;
uniform int leaves;
uniform int highest;            // no node is higher
uniform float least[16];        // squared sine of the half angle from which a node of a height serves
uniform float below[16];        // cosine under which all of a node of a height is under the horizon

const float LOWEST = 1e-3;      // cosine to the horizon of an eye or a node's middle that lies under it

struct Walk {
    int step;
    int end;
    int leaf;
    vec3 before;      // light before the leaf
    vec3 remainder;
};

int start_of(int step) {
    return int((starts[step >> 1] >> (16 * (step & 1))) & 0xffffu);
}

// Light from the leaf of the walk to another one, by what is visible of it.
vec3 light_until(inout Walk walk, int stop) {
    vec3 light = vec3(0.0);
    while (walk.leaf < stop) {
        int after = walk.step + 1 < walk.end ? start_of(walk.step + 1) : leaves;
        int until = min(after, stop);
        vec3 sum = sums[2 * until].xyz;
        vec3 remainder = sums[2 * until + 1].xyz;
        precise vec3 between = (sum - walk.before) + (remainder - walk.remainder);
        light += values[walk.step] * between;
        walk.leaf = until;
        walk.before = sum;
        walk.remainder = remainder;
        if (after <= stop) {
            walk.step += 1;
        }
    }
    return light;
}

bool serves(int height, vec3 light, vec3 view) {
    vec3 between = light + view;
    return dot(between.xy, between.xy) >= least[height] * dot(between, between);
}

#if KIND == LAMBERT

vec3 radiance_toward_eye(inout Walk walk, int vertex) {
    return light_until(walk, leaves) * diffuse();
}

#else

vec3 radiance_toward_eye(inout Walk walk, int vertex) {
    vec3 n = surface[2 * vertex].xyz;
    float level = length(n.xy);
    vec3 t = level > 1e-6 ? vec3(-n.y, n.x, 0.0) / level : vec3(1.0, 0.0, 0.0);
    mat3 local_from_frame = transpose(mat3(t, cross(n, t), n));
    vec3 view = local_from_frame * surface[2 * vertex + 1].xyz;
    view.z = max(view.z, LOWEST);
    vec3 total = vec3(0.0);
    while (walk.leaf < leaves) {
        int height = walk.leaf == 0 ? highest : min(findLSB(walk.leaf), highest);
        vec3 f = vec3(0.0);
        while (true) {
            int node = 3 * ((leaves >> height) + (walk.leaf >> height));
            vec3 light = local_from_frame * vec3(means[node], means[node + 1], means[node + 2]);
            if (light.z < below[height]) {
                break;
            }
            light.z = max(light.z, LOWEST);
            if (serves(height, light, view)) {
                f = reflectance(light, view);
                break;
            }
            height -= 1;
        }
        total += f * light_until(walk, walk.leaf + (1 << height));
    }
    return total;
}

#endif

void main() {
    int vertex = int(gl_GlobalInvocationID.x);
    if (vertex >= vertices) {
        return;
    }
    ivec2 range = ranges[vertex];
    Walk walk = Walk(range.x, range.y, 0, vec3(0.0), vec3(0.0));
    vec3 found = radiance_toward_eye(walk, vertex);
    for (int channel = 0; channel < 3; ++channel) {
        radiance[3 * vertex + channel] = found[channel];
    }
}
