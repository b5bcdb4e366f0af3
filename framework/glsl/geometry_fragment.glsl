// The layers id, depth, normal and position; no student code is in them.
uniform float shadelab_id;
in vec3 shadelab_x;
in vec3 shadelab_n;
layout(location = 0) out vec4 shadelab_normal_id;
layout(location = 1) out vec4 shadelab_position_depth;
@fallback@void main() {
    vec3 n = @unit_normal@;
    shadelab_normal_id = vec4(n, shadelab_id);
    shadelab_position_depth = vec4(shadelab_x, gl_FragCoord.z);
}
