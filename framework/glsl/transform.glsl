uniform mat4 shadelab_to_clip;
uniform mat4 shadelab_to_world;
uniform mat3 shadelab_normal_to_world;
in vec3 shadelab_position;
in vec3 shadelab_normal;
