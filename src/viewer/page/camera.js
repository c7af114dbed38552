// The camera: world to camera axes (x right, y down, z forward), as in the library, and how it is moved about.

const NEAR = 0.01;

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

  /** About `up`, then up and down; stops short of the poles, where the picture would turn over. */
  orbit(up, pivot, yaw, pitch) {
    this.turn(up, yaw, pivot);
    const height = Math.asin(Math.max(-1, Math.min(1, -dot(this.forward, up))));
    const most = 1.5;
    const bounded = Math.max(-most - height, Math.min(most - height, pitch));
    // Beyond the poles already, as a photo taken upside down is: any way back is good.
    this.turn(this.right, -(Math.abs(height) > most ? pitch : bounded), pivot);
  }
}
