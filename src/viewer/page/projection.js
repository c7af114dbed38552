// Gaussians on the screen: where they are there and how opaque at a point, as splat.vert has them.

const LOW_PASS = 0.3; // square pixels
const ALPHA_MIN = 1 / 255;

class Projection {
  constructor(scene, state, camera) {
    this.geometry = scene.geometry;
    this.most = scene.alpha_max;
    this.partOf = state.partOf;
    this.camera = camera;
    const { fx, fy, cx, cy, width, height } = camera;
    this.u = [-(0.15 * width + cx) / fx, (1.15 * width - cx) / fx];
    this.v = [-(0.15 * height + cy) / fy, (1.15 * height - cy) / fy];
    // Each part's own coordinates to the camera's: a rotation row by row, then a shift.
    this.views = state.parts.map(({ pose }) => [
      ...multiply(camera.rotation, pose.rotation), ...apply(camera.rotation, minus(pose.shift, camera.center)),
    ]);
  }

  /** The centre of a Gaussian: x and y in pixels, and its depth. */
  place(i) {
    const view = this.views[this.partOf[i]];
    const at = FLOATS * i;
    const [mx, my, mz] = [this.geometry[at], this.geometry[at + 1], this.geometry[at + 2]];
    const { fx, fy, cx, cy } = this.camera;
    this.depth = view[6] * mx + view[7] * my + view[8] * mz + view[11];
    this.x = (fx * (view[0] * mx + view[1] * my + view[2] * mz + view[9])) / this.depth + cx;
    this.y = (fy * (view[3] * mx + view[4] * my + view[5] * mz + view[10])) / this.depth + cy;
  }

  /** The centre, and the ellipse: second moments `xx`, `xy`, `yy` and their determinant. */
  ellipse(i) {
    this.place(i);
    const view = this.views[this.partOf[i]];
    const at = FLOATS * i;
    const { fx, fy, cx, cy } = this.camera;
    const lu = Math.min(Math.max((this.x - cx) / fx, this.u[0]), this.u[1]);
    const lv = Math.min(Math.max((this.y - cy) / fy, this.v[0]), this.v[1]);
    // Sums over the axes of products of what they are on the screen, and the squared cross product, pair by pair.
    let xx = 0, xy = 0, yy = 0, across = 0, m0 = 0, n0 = 0, m1 = 0, n1 = 0;
    for (let a = at + 4; a < at + 16; a += 4) {
      const [ax, ay, az] = [this.geometry[a], this.geometry[a + 1], this.geometry[a + 2]];
      const along = view[6] * ax + view[7] * ay + view[8] * az;
      const m = (fx / this.depth) * (view[0] * ax + view[1] * ay + view[2] * az - lu * along);
      const n = (fy / this.depth) * (view[3] * ax + view[4] * ay + view[5] * az - lv * along);
      across += (m * n0 - n * m0) ** 2 + (m * n1 - n * m1) ** 2;
      [m1, n1, m0, n0] = [m0, n0, m, n];
      xx += m * m;
      xy += m * n;
      yy += n * n;
    }
    this.determinant = across + LOW_PASS * (xx + yy) + LOW_PASS * LOW_PASS;
    [this.xx, this.xy, this.yy] = [xx + LOW_PASS, xy, yy + LOW_PASS];
    this.opacity = this.geometry[at + OPACITY];
  }

  /** How opaque the Gaussian of the last `ellipse` is at a point; zero where it is not drawn. */
  alpha(x, y) {
    const [px, py] = [x - this.x, y - this.y];
    const power = 0.5 * ((this.yy * px - this.xy * py) ** 2 / (this.yy * this.determinant) + (py * py) / this.yy);
    const alpha = Math.min(this.most, this.opacity * Math.exp(-power));
    return alpha >= ALPHA_MIN ? alpha : 0;
  }
}
