// Mouse, touch and keys. A drag holds on to the point under the pointer.

const KEYS_OF_MOVES = {
  KeyW: [0, 0, 1], KeyS: [0, 0, -1], KeyA: [-1, 0, 0], KeyD: [1, 0, 0], KeyE: [0, -1, 0], KeyQ: [0, 1, 0],
};
const KEYS_OF_TURNS = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }; // yaw, rise
const STILL = 4; // pixels that a pointer may move in a click

/** Whether keys are typed into an element. */
const takesText = (target) => target.matches?.("select, textarea, input:not([type=checkbox])") ?? false;

class Navigation {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {object} view what is moved: camera(), changed() where the camera has moved, pickAt(x, y), clicked(x, y, event),
   *   dragged(held, from, to, event), whether it moved what is held instead of the camera; released(held); up, reach, speed; tools,
   *   which take the first button, or one finger, while they are active
   */
  constructor(canvas, view) {
    this.canvas = canvas;
    this.view = view;
    this.pointers = new Map();
    this.keys = new Set();
    this.pivot = null;
    canvas.addEventListener("pointerdown", (e) => this.press(e));
    canvas.addEventListener("pointermove", (e) => this.drag(e));
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (e) => this.release(e));
    canvas.addEventListener("wheel", (e) => this.wheel(e), { passive: false });
    canvas.addEventListener("contextmenu", (e) => e.preventDefault());
    window.addEventListener("keydown", (e) => this.key(e, true));
    window.addEventListener("keyup", (e) => this.key(e, false));
    // The page does not see when keys are released elsewhere.
    for (const leaving of ["blur", "focusin"]) window.addEventListener(leaving, (e) => this.leave(e));
    document.addEventListener("visibilitychange", () => this.keys.clear());
  }

  leave(e) {
    if (e.type === "blur" || takesText(e.target)) this.keys.clear();
  }

  place(e) {
    const box = this.canvas.getBoundingClientRect();
    return [e.clientX - box.left, e.clientY - box.top];
  }

  /** What is at a place, or else a point on its ray as far off as the last one. */
  hold([x, y]) {
    const camera = this.view.camera();
    this.held = this.view.pickAt(x, y);
    if (this.held) this.view.reach = Math.max(camera.depth(this.held.point), 10 * NEAR);
    return this.held?.point ?? add(camera.center, times(this.view.reach, camera.ray(x, y)));
  }

  press(e) {
    this.canvas.setPointerCapture(e.pointerId);
    const at = this.place(e);
    this.pointers.set(e.pointerId, at);
    // A second finger moves the camera instead.
    this.drawing = this.view.tools.isDrawing && this.pointers.size === 1 && e.button <= 0;
    if (this.drawing) {
      this.view.tools.begin(at, e);
      return;
    }
    this.view.tools.cancel();
    this.start = at;
    this.moved = this.pointers.size > 1 || e.button > 0;
    this.pivot = this.hold(at);
  }

  drag(e) {
    const before = this.pointers.get(e.pointerId);
    const at = this.place(e);
    if (!before) {
      this.view.tools.hover(at);
      return;
    }
    if (this.drawing) {
      this.pointers.set(e.pointerId, at);
      this.view.tools.drag(at);
      return;
    }
    this.moved ||= Math.hypot(at[0] - this.start[0], at[1] - this.start[1]) > STILL;
    if (!this.moved) return;
    if (this.pointers.size === 2) {
      this.pinch(e.pointerId, before, at);
      this.view.changed();
    } else if (!this.view.dragged(this.held, before, at, e)) {
      if (e.buttons & 2 || e.buttons & 4 || e.shiftKey) this.pan(before, at);
      else this.orbit(at[0] - before[0], at[1] - before[1]);
      this.view.changed();
    }
    this.pointers.set(e.pointerId, at);
  }

  release(e) {
    const at = this.pointers.get(e.pointerId);
    this.pointers.delete(e.pointerId);
    if (!at) return;
    if (this.drawing) {
      this.drawing = false;
      if (e.type === "pointerup") this.view.tools.end();
      else this.view.tools.cancel();
    } else if (!this.moved && e.type === "pointerup") this.view.clicked(...at, e);
    else this.view.released(this.held);
  }

  orbit(dx, dy) {
    const turn = Math.PI / Math.min(this.canvas.clientWidth, this.canvas.clientHeight);
    this.view.camera().orbit(this.view.up, this.pivot, -dx * turn, -dy * turn);
  }

  pan(from, to) {
    const camera = this.view.camera();
    camera.move(times(camera.depth(this.pivot), minus(camera.ray(...from), camera.ray(...to))));
  }

  pinch(id, before, at) {
    const [other] = [...this.pointers].filter(([key]) => key !== id).map(([, place]) => place);
    const apart = (place) => Math.max(Math.hypot(place[0] - other[0], place[1] - other[1]), 1);
    const middle = (place) => [0.5 * (place[0] + other[0]), 0.5 * (place[1] + other[1])];
    this.pan(middle(before), middle(at));
    this.approach(1 - apart(before) / apart(at));
  }

  /** Moves by a share of the way to what is held on to. */
  approach(share) {
    const camera = this.view.camera();
    camera.move(times(share, minus(this.pivot, camera.center)));
  }

  wheel(e) {
    e.preventDefault();
    // Two fingers that spread on a trackpad come as a wheel with ctrl, in small steps.
    const lines = e.ctrlKey ? e.deltaY / 16 : e.deltaMode === 0 ? e.deltaY / 100 : e.deltaY / 3;
    this.rolled = e.timeStamp;
    this.pivot = this.hold(this.place(e));
    this.approach(1 - Math.exp(Math.max(-3, Math.min(3, lines)) * 0.16));
    this.view.changed();
  }

  key(e, down) {
    if (!down) this.keys.delete(e.code);
    if (!down || e.ctrlKey || e.metaKey || e.altKey || takesText(e.target)) return;
    if (!(e.code in KEYS_OF_MOVES) && !(e.code in KEYS_OF_TURNS)) return;
    e.preventDefault();
    this.keys.add(e.code);
    this.view.changed();
  }

  /** Whether the picture is about to change again. */
  isMoving(now) {
    return (this.pointers.size > 0 && this.moved && !this.drawing) || now - (this.rolled ?? -Infinity) < 150;
  }

  /** Moves for `seconds` by the keys that are held; returns whether any are. */
  step(seconds) {
    const camera = this.view.camera();
    for (const code of this.keys) {
      const [x, y, z] = KEYS_OF_MOVES[code] ?? [0, 0, 0];
      const way = add(add(times(x, camera.right), times(y, camera.down)), times(z, camera.forward));
      camera.move(times(this.view.speed * seconds, way));
      const [yaw, rise] = KEYS_OF_TURNS[code] ?? [0, 0];
      if (yaw || rise) camera.orbit(this.view.up, camera.center, 1.2 * yaw * seconds, 1.2 * rise * seconds);
    }
    return this.keys.size > 0;
  }
}
