// Shades a fragment with the student's functions.
@uniforms@in vec3 shadelab_x;
in vec3 shadelab_n;
@outputs@@fallback@void main() {
    vec3 x = shadelab_x;
    vec3 n = @unit_normal@;
@shading@@writes@}
