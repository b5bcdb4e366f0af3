// The interpolated colours of vertices.
@varyings@@outputs@void main() {
@writes@}
