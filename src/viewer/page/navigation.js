// Mouse, touch and keys. A drag holds on to the point under the pointer. One finger turns the view, or draws; two turn and zoom it,
// whether or not a tool draws; three pan.

const KEYS_OF_MOVES = {
  KeyW: [0, 0, 1], KeyS: [0, 0, -1], KeyA: [-1, 0, 0], KeyD: [1, 0, 0], KeyE: [0, -1, 0], KeyQ: [0, 1, 0],
};
const KEYS_OF_TURNS = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }; // yaw, rise
const STILL = 4; // pixels that a pointer may move in a click
const STILL_FINGER = 10; // and a finger in a tap
const ROLL = 150; // milliseconds between two steps of the same roll of a wheel

/** Whether keys are typed into an element. */
const takesText = (target) => target.matches?.("select, textarea, input:not([type=checkbox], [type=range], [type=color])") ?? false;

/** Whether a key is for the element that has the focus, and not for the page. Sliders take those that move them. */
const isForField = ({ target, code }) => takesText(target) || (target.type === "range" && /^(Arrow|Home|End|Page)/.test(code));

/** The middle of places. */
const middleOf = (places) => [0, 1].map((k) => places.reduce((sum, place) => sum + place[k], 0) / places.length);

/** From the first of two fingers to the second: how far, pixels, and at which angle, clockwise. */
function reachOf([[x, y], [u, v]]) {
  return { apart: Math.max(Math.hypot(u - x, v - y), 1), angle: Math.atan2(v - y, u - x) };
}

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
    const { tools } = this.view;
    // A second finger moves the camera instead.
    if (this.drawing) tools.takeBack();
    this.drawing = tools.isDrawing && this.pointers.size === 1 && e.button <= 0;
    if (this.drawing) {
      tools.begin(at, e);
      return;
    }
    tools.cancel();
    this.view.released(this.held);
    this.start = at;
    this.moved = this.pointers.size > 1 || e.button > 0;
    this.pivot = this.hold(middleOf([...this.pointers.values()]));
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
    const still = e.pointerType === "touch" ? STILL_FINGER : STILL;
    this.moved ||= Math.hypot(at[0] - this.start[0], at[1] - this.start[1]) > still;
    if (!this.moved) return;
    if (this.pointers.size > 1) {
      this.follow(e.pointerId, at);
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
    this.held = null;
  }

  /** Turns by pixels, and by a further angle about up. */
  orbit(dx, dy, yaw = 0) {
    const turn = Math.PI / Math.min(this.canvas.clientWidth, this.canvas.clientHeight);
    this.view.camera().orbit(this.view.up, this.pivot, yaw - dx * turn, -dy * turn);
  }

  pan(from, to) {
    const camera = this.view.camera();
    camera.move(times(camera.depth(this.pivot), minus(camera.ray(...from), camera.ray(...to))));
  }

  /** One of several fingers goes to a place. Seen from above, what lies there turns as two fingers twist. */
  follow(id, at) {
    const before = [...this.pointers.values()];
    this.pointers.set(id, at);
    const after = [...this.pointers.values()];
    const [from, to] = [middleOf(before), middleOf(after)];
    if (before.length > 2) {
      this.pan(from, to);
      return;
    }
    const [was, is] = [reachOf(before), reachOf(after)];
    const twist = Math.atan2(Math.sin(is.angle - was.angle), Math.cos(is.angle - was.angle));
    this.orbit(to[0] - from[0], to[1] - from[1], -twist * dot(this.view.camera().forward, this.view.up));
    this.approach(1 - was.apart / is.apart);
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
    // Looking up what is there takes long in a large scene: a roll goes on towards what it began with.
    if (!this.isRolling(e.timeStamp)) this.pivot = this.hold(this.place(e));
    this.rolled = e.timeStamp;
    this.approach(1 - Math.exp(Math.max(-3, Math.min(3, lines)) * 0.16));
    this.view.changed();
  }

  key(e, down) {
    if (!down) this.keys.delete(e.code);
    if (!down || e.ctrlKey || e.metaKey || e.altKey || isForField(e)) return;
    const isTurn = e.code in KEYS_OF_TURNS && !this.view.tools.takesArrows(e.target);
    if (!(e.code in KEYS_OF_MOVES) && !isTurn) return;
    e.preventDefault();
    this.keys.add(e.code);
    this.view.changed();
  }

  isRolling(now) {
    return now - (this.rolled ?? -Infinity) < ROLL;
  }

  /** Whether the picture is about to change again. */
  isMoving(now) {
    return (this.pointers.size > 0 && this.moved && !this.drawing) || this.isRolling(now);
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
