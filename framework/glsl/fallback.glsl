// Where vertex normals cancel, the face's. dFdx cross dFdy points to the viewer whichever way the triangle winds; facing and
// mirroring turn it to the mesh's outside.
uniform float shadelab_orientation;
vec3 shadelab_unit_normal(vec3 n, vec3 x) {
    vec3 face = cross(dFdx(x), dFdy(x)) * (gl_FrontFacing == (shadelab_orientation > 0.0) ? 1.0 : -1.0);
    return dot(n, n) >= 1e-8 ? normalize(n) : normalize(face);
}
