#version 300 es
// One corner of the ellipse that a Gaussian covers: Eq. 1-2 as the library has them, in pixels with y down.
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp usampler2D;

uniform sampler2D geometry;
uniform usampler2D colours;
uniform sampler2D parts;    // of each a rotation row by row with a shift, and its label's colour with 1 for chosen ones
uniform usampler2D partOf;  // of each Gaussian; the highest bit is set where it is selected
uniform usampler2D order;   // Gaussians in the order in which they are drawn
uniform int count;          // of them
uniform mat3 rotation;
uniform vec3 center;
uniform vec2 focal;
uniform vec2 principal;
uniform vec2 size;
uniform ivec2 blocks;       // their number B, and the capacity of each: block k has the Gaussians k, k + B and so on
uniform int degree;
uniform float painted;      // share of the label's colour
uniform vec3 chosen;        // what chosen objects are tinted with
uniform vec3 selected;      // and selected Gaussians

flat out vec2 middle;
flat out vec3 conic;        // slope, and the reciprocals of the spread along x at a given y, and along y
flat out vec4 shade;        // colour and opacity

const int BATCH = 256;      // Gaussians of an instance, as in renderer.js
const int WIDTH = 2048;
const int PARTS_WIDE = 256;
const float LOW_PASS = 0.3;
const float ALPHA_MIN = 1.0 / 255.0;

vec4 ofPart(int part, int k) {
    return texelFetch(parts, ivec2(4 * (part % PARTS_WIDE) + k, part / PARTS_WIDE), 0);
}

ivec2 at(int texel) {
    return ivec2(texel % WIDTH, texel / WIDTH);
}

// The first of a Gaussian's four texels of geometry and colours.
int firstTexel(int splat) {
    return 4 * (splat % blocks.x * blocks.y + splat / blocks.x);
}

// Basis functions of degrees 1 to 3, in 3DGS's sign and order.
void harmonics(vec3 d, out float b[15]) {
    float x = d.x, y = d.y, z = d.z;
    float xx = x * x, yy = y * y, zz = z * z;
    b[0] = -0.4886025 * y;
    b[1] = 0.4886025 * z;
    b[2] = -0.4886025 * x;
    b[3] = 1.0925484 * x * y;
    b[4] = -1.0925484 * y * z;
    b[5] = 0.31539157 * (2.0 * zz - xx - yy);
    b[6] = -1.0925484 * x * z;
    b[7] = 0.54627422 * (xx - yy);
    b[8] = -0.59004359 * y * (3.0 * xx - yy);
    b[9] = 2.8906114 * x * y * z;
    b[10] = -0.4570458 * y * (4.0 * zz - xx - yy);
    b[11] = 0.37317633 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
    b[12] = -0.4570458 * x * (4.0 * zz - xx - yy);
    b[13] = 1.4453057 * z * (xx - yy);
    b[14] = -0.59004359 * x * (xx - 3.0 * yy);
}

vec3 colourFrom(int first, vec3 direction, float scale) {
    vec3 base = uintBitsToFloat(texelFetch(colours, at(first + 3), 0).xyz);
    vec3 sum = vec3(0.0);
    if (degree > 0) {
        uint words[12];
        for (int k = 0; k < 3; k++) {
            uvec4 four = texelFetch(colours, at(first + k), 0);
            words[4 * k] = four.x;
            words[4 * k + 1] = four.y;
            words[4 * k + 2] = four.z;
            words[4 * k + 3] = four.w;
        }
        float b[15];
        harmonics(direction, b);
        int terms = (degree + 1) * (degree + 1) - 1;
        for (int k = 0; k < terms; k++) {
            for (int c = 0; c < 3; c++) {
                int place = 3 * k + c;
                // The sign comes with the highest bit of the byte.
                int value = int(words[place >> 2] << (24 - 8 * (place & 3))) >> 24;
                sum[c] += b[k] * float(value);
            }
        }
    }
    return max(vec3(0.0), 0.2820948 * base + 0.5 + scale * sum);
}

void main() {
    gl_Position = vec4(2.0, 2.0, 0.0, 1.0);  // nowhere
    int rank = BATCH * gl_InstanceID + gl_VertexID / 4;
    if (rank >= count) return;
    int splat = int(texelFetch(order, at(rank), 0).x);
    int first = firstTexel(splat);
    vec4 centre = texelFetch(geometry, at(first), 0);
    vec4 axes[3] = vec4[3](
        texelFetch(geometry, at(first + 1), 0), texelFetch(geometry, at(first + 2), 0), texelFetch(geometry, at(first + 3), 0));
    uint word = texelFetch(partOf, at(splat), 0).x;
    int part = int(word & 0x7fffffffu);
    vec4 rows[3] = vec4[3](ofPart(part, 0), ofPart(part, 1), ofPart(part, 2));
    vec4 label = ofPart(part, 3);
    mat3 back = mat3(rows[0].xyz, rows[1].xyz, rows[2].xyz);  // columns: the part's turn undone
    vec3 toward = centre.xyz * back + vec3(rows[0].w, rows[1].w, rows[2].w) - center;
    vec3 p = rotation * toward;
    mat3 turned = rotation * transpose(back);
    float opacity = centre.w;

    vec2 low = -(0.15 * size + principal) / focal;
    vec2 high = (1.15 * size - principal) / focal;
    vec2 bent = clamp(p.xy / p.z, low, high);
    vec3 m1, m2;
    for (int j = 0; j < 3; j++) {
        vec3 a = turned * axes[j].xyz;
        m1[j] = focal.x / p.z * (a.x - bent.x * a.z);
        m2[j] = focal.y / p.z * (a.y - bent.y * a.z);
    }
    float X = dot(m1, m1) + LOW_PASS;
    float Y = dot(m2, m2) + LOW_PASS;
    float B = dot(m1, m2);
    // The determinant by Y, which does not overflow.
    vec3 thin = cross(m1, m2 * inversesqrt(Y));
    float given = dot(thin, thin) + LOW_PASS * (X / Y + 1.0) - LOW_PASS * LOW_PASS / Y;

    // Where alpha falls to ALPHA_MIN.
    float reach = 2.0 * log(opacity / ALPHA_MIN);
    if (!(reach > 0.0) || p.z <= 0.0) return;
    float spread = length(vec2(0.5 * (X - Y), B));
    float longest = 0.5 * (X + Y) + spread;
    float shortest = given * (Y / longest);
    vec2 along = X >= Y ? vec2(longest - Y, B) : vec2(B, longest - X);
    along = spread > 1e-6 * longest ? normalize(along) : vec2(1.0, 0.0);
    vec2 corner = vec2(float(gl_VertexID & 1), float(gl_VertexID >> 1 & 1)) * 2.0 - 1.0;
    vec2 lengths = sqrt(reach * vec2(longest, shortest)) + 0.5;
    middle = focal * p.xy / p.z + principal;
    vec2 place = middle + corner.x * lengths.x * along + corner.y * lengths.y * vec2(-along.y, along.x);
    gl_Position = vec4((2.0 * place / size - 1.0) * vec2(1.0, -1.0), 0.0, 1.0);

    conic = vec3(B / Y, inversesqrt(given), inversesqrt(Y));
    vec3 colour = painted < 1.0 ? colourFrom(first, back * normalize(toward), axes[1].w) : vec3(0.0);
    colour = mix(colour, label.rgb, painted);
    colour = mix(colour, chosen, 0.4 * label.w);
    shade = vec4(mix(colour, selected, (word >> 31) > 0u ? 0.65 : 0.0), opacity);
}
