// Lights from a texture. The kind is compiled in. The ends are where each kind's lights end in the list; they are uniforms, so
// that no driver can unroll the loops, and floats, as all numbers of a packet.
uniform sampler2D shadelab_lights;
@ends@Light shadelab_light(int kind, int i) {
    ivec2 at = ivec2(i % @lights_per_line@ * @texels_per_light@, i / @lights_per_line@);
@fetches@    return @light@;
}
