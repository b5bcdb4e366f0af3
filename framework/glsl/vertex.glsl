// Vertices of what is shaded at its fragments, and of the geometry layers.
@transform@out vec3 shadelab_x;
out vec3 shadelab_n;
void main() {
    vec3 x = (shadelab_to_world * vec4(shadelab_position, 1.0)).xyz;
    vec3 n = normalize(shadelab_normal_to_world * shadelab_normal);
    gl_Position = shadelab_to_clip * vec4(shadelab_position, 1.0);
    shadelab_x = x;
    shadelab_n = n;
}
