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
    vec2 deviations = vec2((d.x - conic.x * d.y) * conic.y, d.y * conic.z);
    float power = 0.5 * dot(deviations, deviations);
    float alpha = min(alphaMax, shade.a * exp(-power));
    if (!(alpha >= 1.0 / 255.0)) discard;
    blended = vec4(shade.rgb * alpha, alpha);
}
