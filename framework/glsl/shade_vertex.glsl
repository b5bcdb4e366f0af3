// Gouraud: shades a vertex with the student's functions; the colours are interpolated.
@transform@@uniforms@@varyings@void main() {
    vec3 x = (shadelab_to_world * vec4(shadelab_position, 1.0)).xyz;
    vec3 n = normalize(shadelab_normal_to_world * shadelab_normal);
    gl_Position = shadelab_to_clip * vec4(shadelab_position, 1.0);
@shading@@writes@}
