// Evaluates @function@ over a table. shadelab_rows holds it, one line of texels per 1024 rows; a row takes @texels@
// neighbouring texels. Row 1024 y + x is evaluated at pixel (x, y) of a float framebuffer; its result fills as many RGBA
// targets as it needs.
uniform sampler2D shadelab_rows;
@outputs@
void main() {
    ivec2 at = ivec2(gl_FragCoord.xy) * ivec2(@texels@, 1);
@fetches@    @returns@ result = @call@;
@writes@}
