// An image of whole numbers, cleared.
layout(location = 0) out uint triangle;

void main() {
    triangle = 0u;
}
