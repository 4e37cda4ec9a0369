// A surface with a factored bidirectional texture function.
#include "btf.glsl"
#include "surface.glsl"
