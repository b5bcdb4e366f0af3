uniform mat4 shadelab_to_clip;
in vec3 shadelab_position;
void main() {
    gl_Position = shadelab_to_clip * vec4(shadelab_position, 1.0);
}
