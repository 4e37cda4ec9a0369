// The depth buffer alone.
void main() {
}
