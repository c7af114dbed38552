// What clicks and drags do. Brush, lasso and box select Gaussians of the surface that the picture shows. With keys, arrows move a
// crosshair, and Enter is the pointer's button.

const DRAWING = ["brush", "lasso", "box"]; // the others leave drags to the camera: "objects" and "points"
const RADII = [4, 200]; // pixels of the brush
const NO_LIMIT = 100; // of the depth slider
const STRIDE = 8; // pixels that an arrow key moves the crosshair by; with Shift one

/** Sets attributes of an element. */
function setAll(part, values) {
  for (const [name, value] of Object.entries(values)) part.setAttribute(name, value);
}

/** A part of a drawing over the picture. */
function drawn(kind, values = {}) {
  const part = document.createElementNS(document.getElementById("overlay").namespaceURI, kind);
  setAll(part, values);
  return part;
}

class Tools {
  /** `page` is the page of main.js. */
  constructor(page) {
    this.page = page;
    this.tool = "objects";
    /** What a shape does without Shift and Alt: "new", "add" or "subtract". */
    this.how = "new";
    this.radius = 24;
    this.slider = 33;
    this.overlay = document.getElementById("overlay");
    this.shape = null;
    /** Where the crosshair is; null where a pointer is used. */
    this.aim = null;
    page.canvas.addEventListener("pointerleave", () => this.shape || this.clear());
  }

  /** Whether drags draw. */
  get isDrawing() {
    return DRAWING.includes(this.tool);
  }

  /** How far behind the surface Gaussians are taken, world units: 0.1 % to 100 % of the scene, or no limit. */
  get limit() {
    const { low, high } = this.page.scene.extent;
    if (this.slider >= NO_LIMIT) return Infinity;
    return Math.hypot(...minus(high, low)) * 10 ** (-3 + 0.03 * this.slider);
  }

  choose(tool) {
    this.aim = null;
    this.cancel();
    this.tool = tool;
    document.body.classList.toggle("aiming", tool !== "objects");
    this.page.refresh();
  }

  /** A larger brush, or a thing that grows by a level; or smaller. */
  scale(by) {
    if (this.tool === "points") this.page.growTo(this.page.selection.level + by);
    else this.resize(1.25 ** by);
  }

  resize(factor) {
    this.radius = Math.max(RADII[0], Math.min(RADII[1], Math.round(this.radius * factor)));
    this.page.refresh();
  }

  /** What a shape or a click does, with Shift or Alt. */
  howOf({ shiftKey, altKey }) {
    return altKey ? "subtract" : shiftKey ? "add" : this.how;
  }

  /** Begins a shape; without modifiers it replaces what is selected. */
  begin(at, event) {
    this.cancel();
    this.aim = null;
    const how = this.howOf(event);
    const { selection } = this.page;
    this.before = this.page.picked();
    if (how === "new") selection.clear();
    selection.endGrowth();
    this.flag = how === "subtract" ? 0 : 1;
    this.found = this.page.candidates(this.limit);
    this.shape = [at];
    if (this.tool === "brush") this.brush(at, at);
    this.draw(at);
  }

  drag(at) {
    if (!this.shape) return;
    if (this.tool === "brush") this.brush(this.shape.at(-1), at);
    this.shape = this.tool === "box" ? [this.shape[0], at] : [...this.shape, at];
    this.draw(at);
  }

  end() {
    if (!this.shape) return;
    const corners = this.corners();
    if (corners) this.take((spot) => insidePolygon(spot, corners));
    this.cancel();
    this.page.selected();
  }

  /** Takes a shape back: what was selected before it is selected again. */
  takeBack() {
    if (this.shape) this.page.selection.restore(this.before);
    this.cancel();
    this.page.selected();
  }

  /** Gives a shape up. What a brush has taken stays. */
  cancel() {
    if (this.shape) this.page.remember(this.before);
    this.shape = null;
    this.found = null;
    this.before = null;
    this.clear();
  }

  corners() {
    const [[x, y], [u, v]] = [this.shape[0], this.shape.at(-1)];
    if (this.tool === "box") return [[x, y], [u, y], [u, v], [x, v]];
    return this.tool === "lasso" ? this.shape : null;
  }

  brush(from, to) {
    this.take((spot) => nearLine(spot, from, to, this.radius));
    this.page.selected();
  }

  take(isInside) {
    for (const { row, x, y } of this.found) if (isInside([x, y])) this.page.selection.set(row, this.flag);
  }

  /** Whether arrow keys are for the crosshair. */
  takesArrows(target) {
    return this.tool !== "objects" && target === this.page.canvas;
  }

  get middle() {
    const { width, height } = this.page.fitted;
    return [width / 2, height / 2];
  }

  /** Moves the crosshair by `left` and `up` strides, and with it the end of a shape. */
  step([left, up], { shiftKey }) {
    if (this.page.navigation.drawing) return;
    const stride = shiftKey ? 1 : STRIDE;
    const { width, height } = this.page.fitted;
    const [x, y] = this.aim ?? this.middle;
    this.aim = [Math.max(0, Math.min(width, x - stride * left)), Math.max(0, Math.min(height, y - stride * up))];
    // What was its end goes along.
    if (this.shape && this.tool === "lasso") this.shape.pop();
    if (this.shape) this.drag(this.aim);
    else this.draw(this.aim);
  }

  /** Clicks at the crosshair, or else in the middle; begins a shape there, sets a corner of a lasso, or ends the shape. */
  press(event) {
    if (this.page.navigation.drawing) return;
    const at = this.aim ?? this.middle;
    if (!this.isDrawing) {
      this.page.clicked(...at, event);
      return;
    }
    if (!this.shape) {
      this.begin(at, event);
      this.shape.push(at);
    } else if (this.tool === "lasso" && String(at) !== String(this.shape.at(-2))) this.shape.push(at);
    else this.end();
    this.aim = at;
    this.draw(at);
  }

  /** Shows the brush at the pointer. */
  hover(at) {
    // A shape that keys draw goes on.
    if (this.shape) return;
    const { aim } = this;
    this.aim = null;
    if (aim) this.clear();
    if (this.tool === "brush") this.draw(at);
  }

  draw([x, y]) {
    const marks = [];
    if (this.tool === "brush") marks.push(["circle", { cx: x, cy: y, r: this.radius }]);
    const corners = this.shape && this.corners();
    if (corners) marks.push(["polygon", { points: corners.map((corner) => corner.join(",")).join(" ") }]);
    if (this.aim) marks.push(["path", { d: `M${x - 9} ${y}h18M${x} ${y - 9}v18` }]);
    this.overlay.replaceChildren(...marks.map(([kind, values]) => drawn(kind, values)));
  }

  /** The crosshair stays. */
  clear() {
    this.overlay.replaceChildren();
    if (this.aim) this.draw(this.aim);
  }

  /** The picture has another size: places in the old one mean nothing. */
  resized() {
    this.aim = null;
    this.cancel();
  }
}
