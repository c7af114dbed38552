#version 300 es
// What was blended, over the background, at the size of the canvas.
precision highp float;

uniform sampler2D picture;
uniform vec2 size;
uniform vec3 background;
out vec4 colour;

void main() {
    vec4 over = texture(picture, gl_FragCoord.xy / size);
    colour = vec4(over.rgb + (1.0 - over.a) * background, 1.0);
}
