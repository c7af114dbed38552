#version 300 es
// alpha' of one Gaussian at one pixel, to be blended over what lies behind it.
precision highp float;

uniform vec2 size;
uniform float alphaMax;

flat in vec2 middle;
flat in vec3 conic;
flat in vec4 shade;
out vec4 blended;

void main() {
    vec2 d = vec2(gl_FragCoord.x, size.y - gl_FragCoord.y) - middle;
    float B = conic.x, Y = conic.y, determinant = conic.z;
    float e = Y * d.x - B * d.y;
    float power = 0.5 * (e * e / (Y * determinant) + d.y * d.y / Y);
    float alpha = min(alphaMax, shade.a * exp(-power));
    if (!(alpha >= 1.0 / 255.0)) discard;
    blended = vec4(shade.rgb * alpha, alpha);
}
