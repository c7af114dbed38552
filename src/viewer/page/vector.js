// Three numbers as a vector, nine as a matrix row by row.

const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const times = (s, a) => [s * a[0], s * a[1], s * a[2]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => times(1 / Math.max(Math.hypot(...a), 1e-30), a);

const row = (m, i) => m.slice(3 * i, 3 * i + 3);
const apply = (m, a) => [dot(row(m, 0), a), dot(row(m, 1), a), dot(row(m, 2), a)];
const transpose = (m) => [m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]];
const multiply = (a, b) => transpose([0, 1, 2].flatMap((j) => apply(a, row(transpose(b), j))));

/** The right-handed rotation about a unit axis, in radians. */
function rotationAbout([x, y, z], angle) {
  const [s, c] = [Math.sin(angle), Math.cos(angle)];
  const d = 1 - c;
  return [
    c + d * x * x, d * x * y - s * z, d * x * z + s * y,
    d * x * y + s * z, c + d * y * y, d * y * z - s * x,
    d * x * z - s * y, d * y * z + s * x, c + d * z * z,
  ];
}
