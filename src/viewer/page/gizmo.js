// Arrows along the axes of the world, by which the chosen object is moved.

const AXIS_COLORS = { x: "#ff5a52", y: "#56c443", z: "#5b9bff" };
const ARROW = 80; // pixels of an arrow that lies across the view
const GAP = 18; // pixels around the middle that are free to drag the object itself
const SHORTEST = 2 * GAP; // pixels below which an arrow points at the camera and cannot be dragged

/** How far from `point` along `axis` the line comes nearest to a ray from `origin`. */
function nearestAlong(axis, point, origin, ray) {
  const away = minus(point, origin);
  const [cosine, square] = [dot(axis, ray), dot(ray, ray)];
  return (cosine * dot(ray, away) - square * dot(axis, away)) / (square - cosine * cosine);
}

class Gizmo {
  /** `page` is the page of main.js. */
  constructor(page) {
    this.page = page;
    this.drawing = document.getElementById("gizmo");
    this.arrows = Object.entries(AXES).map(([name, axis]) => {
      const [line, grip, tip, label] = [drawn("line"), drawn("line", { class: "grip" }), drawn("circle", { r: 5 }), drawn("text")];
      label.textContent = name;
      const arrow = drawn("g", { color: AXIS_COLORS[name] });
      arrow.append(grip, line, tip, label);
      arrow.addEventListener("pointerdown", (e) => this.press(e, axis));
      arrow.addEventListener("pointermove", (e) => this.drag(e));
      for (const end of ["pointerup", "pointercancel"]) arrow.addEventListener(end, () => this.release());
      return { axis, arrow, lines: [line, grip], tip, label };
    });
    this.drawing.append(...this.arrows.map(({ arrow }) => arrow));
  }

  /** Where the arrows of the object that is moved meet: in its middle, or else where it is seen; null where it is not. */
  place() {
    const { page } = this;
    if (!page.moving) return null;
    const id = [...page.chosen][0];
    const middle = page.state.middle(id);
    return this.isInside(middle, GAP) ? middle : this.seen(id);
  }

  /** Whether a point is in the picture, at least `margin` pixels from its edges. */
  isInside(point, margin) {
    const { fitted } = this.page;
    if (!(fitted.depth(point) > NEAR)) return false;
    const [x, y] = fitted.project(point);
    return x >= margin && y >= margin && x <= fitted.width - margin && y <= fitted.height - margin;
  }

  /** The middle of what the picture shows of an object, with room for arrows around it. */
  seen(id) {
    const { state, order, fitted, scene } = this.page;
    const projection = new Projection(scene, state, fitted);
    const sum = [0, 0, 0];
    let count = 0;
    for (let k = 0; k < order.length; k++) {
      if (state.objectOf(order.drawn[k]) !== id) continue;
      projection.place(order.drawn[k]);
      const { x, y, depth } = projection;
      if (x < 0 || y < 0 || x > fitted.width || y > fitted.height || depth <= NEAR) continue;
      [x, y, depth].forEach((v, i) => (sum[i] += v));
      count++;
    }
    if (!count) return null;
    const [x, y] = [fitted.width, fitted.height].map((most, i) => {
      const margin = Math.min(1.5 * ARROW, most / 3);
      return Math.max(margin, Math.min(most - margin, sum[i] / count));
    });
    return add(fitted.center, times(sum[2] / count, fitted.ray(x, y)));
  }

  /** Shows the arrows where the object is. */
  update() {
    const { fitted: camera, moving, panel } = this.page;
    const middle = this.held ? this.held.at : this.place();
    /** Whether nothing of the object that is to be moved is in the picture. */
    this.isLost = moving && !middle;
    panel?.note();
    const isShown = middle && camera.depth(middle) > NEAR;
    this.at = isShown ? middle : null;
    this.drawing.toggleAttribute("hidden", !isShown);
    if (!isShown) return;
    const from = camera.project(middle);
    const length = (ARROW * camera.depth(middle)) / camera.fx;
    for (const { axis, arrow, lines, tip, label } of this.arrows) {
      const to = camera.project(add(middle, times(length, axis)));
      const pixels = Math.hypot(to[0] - from[0], to[1] - from[1]);
      arrow.toggleAttribute("hidden", pixels < SHORTEST);
      const at = (distance) => from.map((v, k) => v + ((to[k] - v) * distance) / pixels);
      const [[x1, y1], [x2, y2], [x, y]] = [at(GAP), to, at(pixels + 12)];
      for (const line of lines) setAll(line, { x1, y1, x2, y2 });
      setAll(tip, { cx: x2, cy: y2 });
      setAll(label, { x, y });
    }
  }

  /** How far along an axis from `point` the pointer is. */
  along(e, axis, point) {
    const { fitted, navigation } = this.page;
    return nearestAlong(axis, point, fitted.center, fitted.ray(...navigation.place(e)));
  }

  press(e, axis) {
    if (e.button > 0 || !this.at) return;
    e.currentTarget.setPointerCapture(e.pointerId);
    this.held = { object: [...this.page.chosen][0], axis, at: this.at, grip: this.along(e, axis, this.at) };
  }

  drag(e) {
    if (!this.held) return;
    const { axis, grip, at } = this.held;
    const way = this.along(e, axis, at) - grip;
    if (!Number.isFinite(way) || way === 0) return;
    if (this.page.moveHeld(this.held, times(way, axis))) this.held.at = add(at, times(way, axis));
  }

  release() {
    this.page.released(this.held);
    this.held = null;
    // Where it is seen now.
    this.page.ask();
  }
}
