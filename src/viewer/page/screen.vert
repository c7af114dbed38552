#version 300 es
// One triangle over the whole picture.
void main() {
    vec2 at = vec2(float(gl_VertexID & 1), float(gl_VertexID >> 1));
    gl_Position = vec4(4.0 * at - 1.0, 0.0, 1.0);
}
