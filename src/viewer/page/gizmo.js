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

  /** The middle of the object that is moved; null where none is, or where it is not before the camera. */
  middle() {
    const { page } = this;
    if (!page.moving) return null;
    const middle = page.state.middle([...page.chosen][0]);
    return page.fitted.depth(middle) > NEAR ? middle : null;
  }

  /** Shows the arrows where the object is. */
  update() {
    const camera = this.page.fitted;
    const middle = this.middle();
    this.drawing.toggleAttribute("hidden", !middle);
    if (!middle) return;
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

  /** How far along the axis that is dragged the pointer is. */
  along(e, axis) {
    const { fitted, navigation } = this.page;
    return nearestAlong(axis, this.middle(), fitted.center, fitted.ray(...navigation.place(e)));
  }

  press(e, axis) {
    if (e.button > 0) return;
    e.currentTarget.setPointerCapture(e.pointerId);
    this.held = { object: [...this.page.chosen][0], axis, grip: this.along(e, axis) };
  }

  drag(e) {
    if (!this.held || !this.middle()) return;
    const { axis, grip } = this.held;
    const way = this.along(e, axis) - grip;
    if (Number.isFinite(way) && way !== 0) this.page.moveHeld(this.held, times(way, axis));
  }

  release() {
    this.page.released(this.held);
    this.held = null;
  }
}
