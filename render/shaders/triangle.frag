// Which triangle is seen, counted from 1 through all bodies.
uniform uint first_triangle;

layout(location = 0) out uint triangle;

void main() {
    triangle = first_triangle + uint(gl_PrimitiveID) + 1u;
}
