// The scene as edits leave it: objects by id, and parts. A part is the Gaussians of one object that were moved alike.

const UNMOVED = { rotation: [1, 0, 0, 0, 1, 0, 0, 0, 1], shift: [0, 0, 0] };
const DELETED = 0; // the part of deleted Gaussians
const CLOSE = 0.02; // of the scene's size: objects that are as close lie side by side
const CLIPPED = 0.01; // share of Gaussians beyond a box on each side, as in inventory.rs

/** Points go to rotation (x - pivot) + pivot + shift. */
function motionOf({ turn, shift }, origin) {
  if (!turn) return { rotation: UNMOVED.rotation, shift };
  const rotation = rotationAbout(unit(turn.axis), (turn.degrees * Math.PI) / 180);
  const pivot = minus(turn.pivot, origin);
  return { rotation, shift: add(shift, minus(pivot, apply(rotation, pivot))) };
}

/** The motion `after` after the motion `before`. */
const composed = (after, before) => ({
  rotation: multiply(after.rotation, before.rotation),
  shift: add(apply(after.rotation, before.shift), after.shift),
});

class State {
  constructor(scene) {
    this.scene = scene;
    /** Objects by id, those without Gaussians too. */
    this.objects = new Map();
    /** Each with the id of its object and a pose; the object of deleted Gaussians is null. */
    this.parts = [{ object: null, pose: UNMOVED }];
    this.partOf = new Uint32Array(scene.places);
    for (let row = 0; row < this.partOf.length; row++) this.partOf[row]++;
    for (const { id, name, color, gaussians, low, high } of scene.objects) {
      this.objects.set(id, { ...this.entry(id, name, color), count: gaussians, box: { low, high } });
      this.parts.push({ object: id, pose: UNMOVED });
    }
    for (const { id, name, color } of scene.absent) this.objects.set(id, this.entry(id, name, color));
    const { ignore, labelled } = scene;
    if (labelled && !this.objects.has(ignore)) this.objects.set(ignore, this.entry(ignore, "unlabelled", UNLABELLED));
  }

  entry(id, name, color) {
    return { id, name, color, count: 0, shown: true, offset: [0, 0, 0], degrees: 0, box: null, middle: null };
  }

  /** The scene after operations. */
  static after(scene, operations) {
    const state = new State(scene);
    for (const operation of operations) state.apply(operation);
    return state;
  }

  /** One operation, as `docs/edits.md` has them, or `view`, which shows and hides. */
  apply(operation) {
    const { op, object, objects } = operation;
    if (op === "view") this.view(operation);
    else if (op === "rename") this.object(object).name = operation.name;
    else if (op === "recolor") this.object(object).color = operation.color;
    else if (op === "merge") for (const id of objects) this.relabel(id, operation.into);
    else if (op === "delete_objects") for (const id of objects) this.relabel(id, null);
    else if (op === "delete_gaussians") this.assign(operation.gaussians, null);
    else if (op === "move") this.move(this.object(object), operation);
    else if (op === "assign") {
      if (operation.new) this.objects.set(object, this.entry(object, operation.new.name, operation.new.color));
      this.assign(operation.gaussians, object);
    } else throw new Error(`no such operation: ${op}`);
  }

  object(id) {
    const found = this.objects.get(id);
    if (!found) throw new Error(`no such object: ${id}`);
    return found;
  }

  view({ shown, hidden }) {
    for (const id of shown) this.object(id).shown = true;
    for (const id of hidden) this.object(id).shown = false;
  }

  /** All Gaussians of an object become those of another, or are deleted. */
  relabel(from, to) {
    if (from === to) return;
    const source = this.object(from);
    const target = to === null ? null : this.object(to);
    for (const part of this.parts) if (part.object === from) part.object = to;
    if (target) Object.assign(target, { count: target.count + source.count, box: null });
    Object.assign(source, { count: 0, box: null });
  }

  assign(rows, id) {
    const target = id === null ? null : this.object(id);
    const parts = new Map();
    for (const row of rows) {
      const from = this.partOf[row];
      if (from === undefined) throw new Error(`no such Gaussian: ${row}`);
      const part = this.parts[from];
      if (part.object === id) continue;
      if (!parts.has(from)) parts.set(from, this.partLike(part.pose, id));
      this.partOf[row] = parts.get(from);
      const source = this.objects.get(part.object);
      if (source) Object.assign(source, { count: source.count - 1, box: null });
      if (target) target.count++;
    }
    if (target) target.box = null;
  }

  /** The part of an object with this pose. */
  partLike(pose, id) {
    if (id === null) return DELETED;
    const there = this.parts.findIndex((part) => part.object === id && part.pose === pose);
    return there >= 0 ? there : this.parts.push({ object: id, pose }) - 1;
  }

  move(object, operation) {
    const motion = motionOf(operation, this.scene.origin);
    const middle = this.middle(object.id);
    for (const part of this.parts) if (part.object === object.id) part.pose = composed(motion, part.pose);
    object.middle = add(apply(motion.rotation, middle), motion.shift);
    object.offset = add(object.offset, operation.shift);
    object.degrees += operation.turn?.degrees ?? 0;
    object.box = null;
  }

  /** What an object turns about: the middle of its box when it first moved. */
  middle(id) {
    const object = this.object(id);
    const { low, high } = this.box(id);
    return object.middle ?? times(0.5, add(low, high));
  }

  /** A box around an object's centres without the outermost on each side. */
  box(id) {
    const object = this.object(id);
    object.box ??= this.boxAround(id);
    return object.box;
  }

  /** Where a Gaussian is. */
  place(row) {
    const { geometry } = this.scene;
    const { pose } = this.parts[this.partOf[row]];
    const mean = [0, 1, 2].map((k) => geometry[FLOATS * row + k]);
    return pose === UNMOVED ? mean : add(apply(pose.rotation, mean), pose.shift);
  }

  /** Objects that have some of these Gaussians, or others that lie among them or close by. */
  objectsNear(rows) {
    const { low, high } = this.scene.extent;
    const places = rows.map((row) => this.place(row));
    const edge = (most) => [0, 1, 2].map((k) => places.reduce((edge, place) => most(edge, place[k]), places[0][k]));
    const [least, greatest] = [edge(Math.min), edge(Math.max)];
    const margin = CLOSE * Math.hypot(...minus(high, low));
    const found = new Set();
    for (let row = 0; row < this.partOf.length; row++) {
      const id = this.objectOf(row);
      if (id === null || found.has(id)) continue;
      const place = this.place(row);
      if (place.every((v, k) => v >= least[k] - margin && v <= greatest[k] + margin)) found.add(id);
    }
    return [...found].map((id) => this.object(id));
  }

  boxAround(id) {
    const along = [0, 1, 2].map(() => new Float32Array(this.object(id).count));
    let count = 0;
    for (let i = 0; i < this.partOf.length && count < along[0].length; i++) {
      if (this.objectOf(i) !== id) continue;
      const place = this.place(i);
      along.forEach((values, k) => (values[count] = place[k]));
      count++;
    }
    if (!count) return { low: [0, 0, 0], high: [0, 0, 0] };
    const beyond = Math.min(Math.ceil(CLIPPED * count), Math.floor((count - 1) / 2));
    for (const values of along) values.sort();
    return { low: along.map((v) => v[beyond]), high: along.map((v) => v[count - 1 - beyond]) };
  }

  /** Objects that have Gaussians. */
  get present() {
    return [...this.objects.values()].filter(({ count }) => count > 0);
  }

  /** Whether the Gaussians of a part are drawn. */
  isShown({ object }) {
    return object !== null && this.objects.get(object).shown;
  }

  /** The object of a Gaussian; null where it is deleted. */
  objectOf(row) {
    return this.parts[this.partOf[row]].object;
  }

  /** Label ids of the Gaussians that are left, in the order of the file. */
  labels() {
    const all = Array.from(this.partOf, (part) => this.parts[part].object);
    return Uint16Array.from(all.filter((id) => id !== null));
  }

  /** The lowest id above all that are in use, or else the lowest free one. */
  freeId() {
    const used = new Set([...this.objects.keys(), this.scene.ignore, 0]);
    const most = [...used].reduce((a, b) => (b === this.scene.ignore ? a : Math.max(a, b)), 0);
    for (let id = most + 1; id < 65536; id++) if (!used.has(id)) return id;
    for (let id = 1; id < most; id++) if (!used.has(id)) return id;
    return null;
  }
}
