// The page: one picture, redrawn when something changes.

const MODES = { colour: 0, both: 0.6, labels: 1 };
const BACKGROUNDS = [[0, 0, 0], [0.5, 0.5, 0.5], [1, 1, 1]];
const HOVERED = 500_000; // up to this number of Gaussians, the object under the pointer is shown all the time
const FRAME = 1000 / 60; // milliseconds of a step without a frame before it
const SLOW = 60; // milliseconds of a frame above which moving pictures are drawn smaller

/** The decoded text, or the text itself where its percent signs encode nothing. */
function plain(text) {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
}

class Page {
  constructor() {
    this.scene = Scene.embedded();
    this.canvas = document.getElementById("picture");
    this.shaders = JSON.parse(document.getElementById("shaders").textContent);
    this.renderer = new Renderer(this.canvas, this.scene, this.shaders);
    this.outliveContext();
    this.order = new DepthOrder(this.scene);
    this.objects = this.scene.untouched();
    this.chosen = -1;
    this.moving = false;
    this.mode = "colour";
    this.background = BACKGROUNDS[0];
    this.coarse = 1;
    /** Whether the order belongs to another picture. */
    this.stale = true;
    this.up = this.scene.up;
    const { low, high } = this.scene.extent;
    /** World units a second, and how far off the middle of things is until something is picked. */
    this.speed = Math.max(Math.hypot(...minus(high, low)) / 6, 1e-3);
    this.reach = 2 * this.speed;
    this.bare = /[#&]bare\b/.test(location.hash);
    document.body.classList.toggle("bare", this.bare);
    this.panel = new Panel(this.scene, this);
    new ResizeObserver(() => this.resized()).observe(this.canvas.parentElement);
    window.addEventListener("hashchange", () => location.reload());
    this.fromAddress();
    if (this.bare) this.draw();
    else this.listen();
    this.panel.update();
  }

  /** A browser may take the graphics back, and gives them again empty. */
  outliveContext() {
    this.canvas.addEventListener("webglcontextlost", (e) => {
      e.preventDefault();
      this.renderer = null;
    });
    this.canvas.addEventListener("webglcontextrestored", () => {
      this.renderer = new Renderer(this.canvas, this.scene, this.shaders);
      this.draw();
    });
  }

  /** `#view=NAME&mode=labels`, and `&bare` for the picture alone, of the camera's own size. */
  fromAddress() {
    const pairs = location.hash.slice(1).split("&").map((pair) => pair.split("=").map(plain));
    const asked = new Map(pairs);
    if (asked.get("mode") in MODES && this.scene.labelled) this.mode = asked.get("mode");
    const { cameras } = this.scene;
    const named = cameras.findIndex((camera) => camera.name === asked.get("view"));
    const heldOut = cameras.findIndex((camera) => camera.split === "test");
    this.source = new Camera(this.scene.start);
    if (cameras.length) this.goTo(named >= 0 ? named : Math.max(heldOut, 0));
    else this.fitted = this.source.fitted(...this.room());
  }

  /** Width and height that there are for the picture. */
  room() {
    const { clientWidth, clientHeight } = this.canvas.parentElement;
    return this.bare ? [this.source.width, this.source.height] : [Math.max(clientWidth, 1), Math.max(clientHeight, 1)];
  }

  listen() {
    this.navigation = new Navigation(this.canvas, this);
    const hint = document.getElementById("hint");
    let last = 0;
    this.canvas.addEventListener("pointermove", (e) => {
      if (e.buttons) hint.textContent = "";
      if (e.buttons || this.scene.gaussians > HOVERED || !this.scene.labelled || e.timeStamp - last < 60) return;
      last = e.timeStamp;
      const [x, y] = this.navigation.place(e);
      const found = this.pickAt(x, y);
      hint.textContent = found ? called(this.scene.objects[found.object]) : "";
      hint.style.translate = `${x + 14}px ${y + 14}px`;
    });
    this.canvas.addEventListener("pointerleave", () => (hint.textContent = ""));
    const keys = { Digit1: "colour", Digit2: "both", Digit3: "labels" };
    window.addEventListener("keydown", (e) => {
      if (takesText(e.target) || e.ctrlKey || e.metaKey || e.altKey) return;
      if (keys[e.code]) this.setMode(keys[e.code]);
      if (e.code === "Escape") this.choose(-1);
      if (e.code === "KeyH" && this.chosen >= 0) this.show(this.chosen, !this.objects[this.chosen].shown);
      if (e.code === "KeyB") this.nextBackground();
      if (e.code === "KeyL") {
        this.fitted.level(this.up);
        this.changed();
      }
    });
    this.resized();
  }

  /** The camera in CSS pixels of the picture. */
  camera() {
    return this.fitted;
  }

  /** The camera has moved, or what it looks at has. */
  changed() {
    this.panel.setView(null);
    this.ask();
  }

  /** Draws in the next frame. */
  ask() {
    this.stale = true;
    if (this.asked || this.bare) return;
    this.asked = true;
    requestAnimationFrame((now) => {
      this.asked = false;
      const walking = this.navigation.step(Math.min(this.last === undefined ? FRAME : now - this.last, 100) / 1000);
      if (walking) this.panel.setView(null);
      const moving = walking || this.navigation.isMoving(now);
      this.adapt(moving && this.last !== undefined ? now - this.last : null);
      this.last = moving ? now : undefined;
      this.draw(moving);
      // Without a pause, so that the time between frames is what a frame takes.
      if (moving) this.ask();
    });
  }

  /** Makes moving pictures smaller where frames come slowly; `took` is milliseconds since the last, if they follow each other. */
  adapt(took) {
    if (took === null) return;
    if (took > SLOW) this.coarse = Math.max(0.25, this.coarse * 0.8);
    else if (took < SLOW / 3) this.coarse = Math.min(1, this.coarse * 1.1);
  }

  draw(moving = false) {
    if (!this.renderer) return;
    const ratio = this.bare ? 1 : Math.min(window.devicePixelRatio || 1, 2);
    const camera = this.fitted;
    const [width, height] = [camera.width, camera.height].map((v) => Math.max(1, Math.round(v * ratio)));
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    this.sort();
    this.renderer.setOrder(this.order);
    this.renderer.setObjects(this.objects, this.bare ? -1 : this.chosen);
    const scale = moving ? this.coarse : 1;
    const [w, h] = [width, height].map((v) => Math.max(1, Math.round(v * scale)));
    this.renderer.draw(camera.fitted(w, h), MODES[this.mode], this.background);
  }

  resized() {
    if (this.bare || !this.navigation) return;
    const { rotation, center } = this.fitted;
    this.fitted = new Camera({ ...this.source, rotation, center }).fitted(...this.room());
    this.ask();
  }

  goTo(i) {
    this.source = new Camera(this.scene.cameras[i]);
    this.fitted = this.source.fitted(...this.room());
    this.panel.setView(i);
    if (this.navigation) this.ask();
  }

  sort() {
    this.order.sort(this.fitted, this.objects);
    this.stale = false;
  }

  pickAt(x, y) {
    if (this.stale) this.sort();
    return pick(this.scene, this.order, this.objects, this.fitted, x, y);
  }

  clicked(x, y) {
    if (!this.scene.labelled) return;
    const found = this.pickAt(x, y);
    this.choose(found && found.object !== this.chosen ? found.object : -1);
  }

  /** Moves the chosen object with the pointer, if it is what is held: along the floor, with shift up and down. */
  dragged(held, from, to, e) {
    if (!this.moving || held?.object !== this.chosen || e.buttons !== 1) return false;
    const camera = this.fitted;
    const { point } = held;
    const depth = camera.depth(point);
    let way = times(depth, minus(camera.ray(...to), camera.ray(...from)));
    const along = times(dot(way, this.up), this.up);
    if (e.shiftKey) {
      way = along;
    } else {
      // Up and down on the screen is to and fro on the floor.
      const ahead = unit(minus(camera.forward, times(dot(camera.forward, this.up), this.up)));
      const steep = Math.max(Math.abs(dot(camera.forward, this.up)), 0.3);
      const screen = ((from[1] - to[1]) * depth) / camera.fy / steep;
      way = add(times(((to[0] - from[0]) * depth) / camera.fx, unit(camera.right)), times(screen, ahead));
    }
    const state = this.objects[this.chosen];
    state.offset = add(state.offset, way);
    held.point = add(point, way);
    this.panel.update();
    this.ask();
    return true;
  }

  choose(i) {
    if (i !== this.chosen) this.moving = false;
    this.chosen = i;
    this.refresh();
    this.panel.reveal(i);
  }

  setMoving(moving) {
    this.moving = moving;
    this.refresh();
  }

  setMode(mode) {
    if (!this.scene.labelled) return;
    this.mode = mode;
    this.refresh();
  }

  show(i, shown) {
    this.objects[i].shown = shown;
    this.refresh();
  }

  /** One object alone, or all. */
  showOnly(i) {
    this.objects.forEach((object, j) => (object.shown = i === null || i === j));
    this.refresh();
  }

  moveTo(i, offset) {
    this.objects[i].offset = offset;
    this.refresh();
  }

  turnTo(i, degrees) {
    this.objects[i].degrees = degrees;
    this.refresh();
  }

  /** Everything as it was. */
  putBack() {
    this.objects = this.scene.untouched();
    this.refresh();
  }

  nextBackground() {
    this.background = BACKGROUNDS[(BACKGROUNDS.indexOf(this.background) + 1) % BACKGROUNDS.length];
    this.ask();
  }

  refresh() {
    this.panel.update();
    this.ask();
  }
}

try {
  window.page = new Page();
  document.body.dataset.ready = "yes";
} catch (error) {
  document.getElementById("trouble").textContent = `This scene cannot be shown: ${error.message}`;
  throw error;
}
