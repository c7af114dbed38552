// The page: one picture, redrawn when something changes.

const MODES = { colour: 0, both: 0.6, labels: 1 };
const BACKGROUNDS = [[0, 0, 0], [0.5, 0.5, 0.5], [1, 1, 1]];
const FRAME = 1000 / 60; // milliseconds of a step without a frame before it
const COVERED = 0.5; // least coverage of a point that shows a thing, as in select.rs
const BYTES_OF_REGION = 12; // in the tree
const SLOW = 60; // milliseconds of a frame above which moving pictures are drawn smaller

/** The decoded text, or the text itself where its percent signs encode nothing. */
function plain(text) {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
}

class Page extends Editor {
  constructor(scene) {
    const bare = /[#&]bare\b/.test(location.hash);
    const watched = /[#&]watch\b/.test(location.hash);
    super(scene, !bare && !watched);
    this.bare = bare;
    /** Whether the page is part of that of a run, which has controls of its own. */
    this.watched = watched;
    this.canvas = document.getElementById("picture");
    this.shaders = JSON.parse(document.getElementById("shaders").textContent);
    this.renderer = new Renderer(this.canvas, this.scene, this.shaders);
    this.outliveContext();
    this.order = new DepthOrder(this.scene);
    this.mode = "colour";
    this.background = BACKGROUNDS[0];
    this.coarse = 1;
    /** Whether the order belongs to another picture, and until when such an order will do while the view moves. */
    this.stale = true;
    this.rested = 0;
    /** Whether the renderer has yet to see what is edited, chosen or selected. */
    this.partsStale = true;
    this.up = this.scene.up;
    const { low, high } = this.scene.extent;
    /** World units a second, and how far off the middle of things is until something is picked. */
    this.speed = Math.max(Math.hypot(...minus(high, low)) / 6, 1e-3);
    this.reach = 2 * this.speed;
    document.body.classList.toggle("bare", this.bare);
    document.body.classList.toggle("watched", this.watched);
    this.tools = new Tools(this);
    this.gizmo = new Gizmo(this);
    this.details = new Details(this);
    this.panel = new Panel(this);
    new ResizeObserver(() => this.resized()).observe(this.canvas.parentElement);
    window.addEventListener("hashchange", () => location.reload());
    this.fromAddress();
    if (this.bare) this.draw();
    else this.listen();
    this.panel.update();
  }

  /** Takes what Gaussians look like from the server, and draws whenever twice as much is there. */
  async receive() {
    try {
      await this.receiveAll();
    } catch (error) {
      const lead = document.getElementById("lead").textContent;
      document.getElementById("trouble").textContent = `Not everything has arrived (${lead}): ${error.message}. Load the page again.`;
      throw error;
    }
  }

  async receiveAll() {
    const { blocks, gaussians, labelled } = this.scene;
    for (let block = 0, drawn = 0; block < blocks; block++) {
      this.scene.setLooks(await fetched(`looks/${block}`), block, blocks);
      this.renderer?.upload(block);
      const received = block + 1;
      this.panel.setReceived(Math.min(gaussians, received * Math.ceil(gaussians / blocks)));
      if (received < blocks && received < 2 * drawn) continue;
      drawn = received;
      this.stale = true;
      if (this.bare) this.draw();
      else this.ask();
    }
    if (!labelled) return;
    const tree = await fetched("tree");
    this.scene.setTree(tree, (tree.buffer.byteLength - 4 * gaussians) / BYTES_OF_REGION);
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
      this.partsStale = this.stale = true;
      this.draw();
    });
  }

  /** `#view=NAME&mode=labels`, and `&bare` for the picture alone, of the camera's own size. `#watch` is for the page of a run. */
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
    if (this.watched) {
      this.resized();
      return;
    }
    this.keys = new Keys(this);
    this.hint = new Hint(this);
    window.addEventListener("beforeunload", (e) => {
      if (!this.edits.isSaved) e.preventDefault();
    });
    this.resized();
  }

  /** The camera in CSS pixels of the picture. */
  camera() {
    return this.fitted;
  }

  /** The camera has moved, or what it looks at has. A shape is of the picture before: it is given up. */
  changed() {
    if (this.tools.shape) this.tools.cancel();
    this.panel.setView(null);
    this.stale = true;
    this.ask();
  }

  /** Draws in the next frame. */
  ask() {
    if (this.asked || this.bare || !this.navigation) return;
    this.asked = true;
    requestAnimationFrame((now) => {
      this.asked = false;
      const walking = this.navigation.step(Math.min(this.last === undefined ? FRAME : now - this.last, 100) / 1000);
      if (walking) this.panel.setView(null);
      this.stale ||= walking;
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
    if (this.stale && !(moving && performance.now() < this.rested)) this.sort();
    if (this.partsStale) this.renderer.setParts(this.state, this.selection, this.bare ? new Set() : this.chosen);
    this.partsStale = false;
    this.gizmo.update();
    const scale = moving ? this.coarse : 1;
    const [w, h] = [width, height].map((v) => Math.max(1, Math.round(v * scale)));
    this.renderer.draw(camera.fitted(w, h), MODES[this.mode], this.background);
  }

  resized() {
    if (this.bare || !this.navigation) return;
    this.tools.resized();
    const { rotation, center } = this.fitted;
    this.fitted = new Camera({ ...this.source, rotation, center }).fitted(...this.room());
    this.stale = true;
    this.ask();
  }

  goTo(i) {
    if (this.tools.shape) this.tools.cancel();
    this.source = new Camera(this.scene.cameras[i]);
    this.fitted = this.source.fitted(...this.room());
    this.panel.setView(i);
    this.stale = true;
    if (this.navigation) this.ask();
  }

  /** Takes over camera and background of another page of the scene. */
  lookAs({ source, fitted, background }) {
    const { rotation, center } = fitted;
    this.source = new Camera({ ...source, rotation, center });
    this.fitted = this.source.fitted(...this.room());
    this.background = background;
    this.changed();
  }

  /** Sorts for the picture as it is now. It takes a third of the time at most while the view moves. */
  sort() {
    const begun = performance.now();
    this.order.sort(this.fitted, this.state);
    this.renderer?.setOrder(this.order);
    this.surface = null;
    this.stale = false;
    const now = performance.now();
    this.rested = now + 2 * (now - begun);
  }

  /** Another order of the Gaussians, or others of them, at once. */
  edited() {
    this.stale = true;
    this.rested = 0;
    super.edited();
  }

  /** Gaussians that a shape can take, see `candidates` of selection.js. */
  candidates(limit) {
    if (this.stale) this.sort();
    this.surface ??= new DepthGrid(this.scene, this.order, this.state, this.fitted);
    return candidates(this.scene, this.order, this.state, this.fitted, this.surface, limit, this.chosen);
  }

  pickAt(x, y) {
    if (this.stale) this.sort();
    return pick(this.scene, this.order, this.state, this.fitted, x, y);
  }

  /** Chooses what is at a point; with Shift too, with Alt no longer. The wand selects the thing that is there. */
  clicked(x, y, { shiftKey, altKey }) {
    if (!this.scene.labelled || this.watched) return;
    const picked = this.pickAt(x, y);
    if (this.tools.tool === "points") {
      const isThing = this.scene.superpoints && picked?.coverage >= COVERED && this.isFree(picked.row);
      if (isThing) this.point(picked.row, this.tools.howOf({ shiftKey, altKey }));
      return;
    }
    const found = picked?.object ?? null;
    const how = altKey ? "subtract" : shiftKey || this.several ? "add" : "new";
    const isAlone = this.chosen.size === 1 && this.chosen.has(found);
    if (how !== "new") this.choose(found, how);
    else this.choose(isAlone ? null : found);
  }

  /** Moves the chosen object with the pointer, if it is what is held: along the floor, with shift up and down. */
  dragged(held, from, to, e) {
    if (!this.moving || !held || !this.chosen.has(held.object) || e.buttons !== 1) return false;
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
    if (this.moveHeld(held, way)) held.point = add(point, way);
    return true;
  }

  /** Moves the object that a drag holds, if it may go that far. All of a drag is one edit. */
  moveHeld(held, way) {
    if (!this.isNear(held.move ? add(held.move.shift, way) : way)) return false;
    this.stale = true;
    if (!held.move || !this.edits.extend(held.move, way)) {
      held.move = { op: "move", object: held.object, shift: way };
      this.push(held.move);
    }
    this.refresh();
    return true;
  }

  /** A drag has ended. */
  released(held) {
    if (held?.move) this.edits.finish();
  }

  /** The selection has changed. */
  selected() {
    this.refresh();
  }

  setMode(mode) {
    if (!this.scene.labelled) return;
    this.mode = mode;
    this.refresh();
  }

  nextBackground() {
    this.background = BACKGROUNDS[(BACKGROUNDS.indexOf(this.background) + 1) % BACKGROUNDS.length];
    this.ask();
  }

  level() {
    this.fitted.level(this.up);
    this.changed();
  }

  refresh() {
    this.partsStale = true;
    this.panel?.update();
    this.ask();
  }
}

/** Shows the scene that the page carries, or that its server has. */
async function start() {
  const scene = new Scene(JSON.parse(document.getElementById("header").textContent));
  if (scene.blocks) {
    scene.setPlaces(await fetched("places"));
    Object.assign(scene, await savedEdits());
  } else scene.setEmbedded();
  window.page = new Page(scene);
}

try {
  await start();
} catch (error) {
  document.getElementById("trouble").textContent = `This scene cannot be shown: ${error.message}`;
  throw error;
}
if (window.page.scene.blocks) await window.page.receive();
document.body.dataset.ready = "yes";
