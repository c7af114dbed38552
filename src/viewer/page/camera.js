// The camera: world to camera axes (x right, y down, z forward), as in the library, and its motions.

const NEAR = 0.01;
const STEEPEST = 1.5; // radians

class Camera {
  constructor({ rotation, center, fx, fy, cx, cy, width, height }) {
    Object.assign(this, { rotation: [...rotation], center: [...center], fx, fy, cx, cy, width, height });
  }

  /** The same view in an image of this size, with more at two sides where the proportions differ. */
  fitted(width, height) {
    const scale = Math.min(width / this.width, height / this.height);
    const [left, top] = [(width - scale * this.width) / 2, (height - scale * this.height) / 2];
    const { fx, fy, cx, cy } = this;
    return new Camera({
      ...this, fx: scale * fx, fy: scale * fy, cx: scale * cx + left, cy: scale * cy + top, width, height,
    });
  }

  get right() {
    return row(this.rotation, 0);
  }

  get down() {
    return row(this.rotation, 1);
  }

  get forward() {
    return row(this.rotation, 2);
  }

  /** The direction through a point of the image, one unit deep. */
  ray(x, y) {
    return apply(transpose(this.rotation), [(x - this.cx) / this.fx, (y - this.cy) / this.fy, 1]);
  }

  /** Where a point before the camera is in the image. */
  project(point) {
    const [x, y, z] = apply(this.rotation, minus(point, this.center));
    return [(this.fx * x) / z + this.cx, (this.fy * y) / z + this.cy];
  }

  depth(point) {
    return dot(this.forward, minus(point, this.center));
  }

  move(offset) {
    this.center = add(this.center, offset);
  }

  /** Turns the camera about an axis through `pivot`. */
  turn(axis, angle, pivot = this.center) {
    const turn = rotationAbout(unit(axis), angle);
    this.center = add(pivot, apply(turn, minus(this.center, pivot)));
    const rotation = multiply(this.rotation, transpose(turn));
    // Rounding must not add up over a long visit.
    const forward = unit(row(rotation, 2));
    const right = unit(cross(row(rotation, 1), forward));
    this.rotation = [...right, ...cross(forward, right), ...forward];
  }

  /** Yaw about `up`, and `rise` of what is looked at; stops short of the poles, where the picture would turn over. */
  orbit(up, pivot, yaw, rise) {
    this.turn(up, yaw, pivot);
    const elevation = Math.asin(Math.max(-1, Math.min(1, dot(this.forward, up))));
    // A photo may look steeper than that: then it goes back only.
    const [least, most] = [Math.min(-STEEPEST - elevation, 0), Math.max(STEEPEST - elevation, 0)];
    this.turn(this.right, Math.max(least, Math.min(most, rise)), pivot);
  }

  /** Takes the roll out, if there is a horizon. */
  level(up) {
    const right = cross(this.forward, up);
    if (Math.hypot(...right) < 0.05) return;
    const across = unit(right);
    this.rotation = [...across, ...cross(this.forward, across), ...this.forward];
  }
}
