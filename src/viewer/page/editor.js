// What is chosen in the scene, and what is done to it. The page below draws it.

const REMEMBERED = 20; // selections that can be undone

class Editor {
  /** `isKept`: whether the browser keeps edits across a reload. */
  constructor(scene, isKept) {
    this.scene = scene;
    this.edits = new Edits(scene, isKept, this);
    /** Ids of chosen objects, in the order in which they were chosen. */
    this.chosen = new Set();
    this.selection = new Selection(scene.gaussians);
    /** What was selected before, since the last edit, and what was selected after where that was undone. */
    this.earlier = [];
    this.later = [];
    /** Whether a click or a tap chooses one more object, as with Shift. */
    this.several = false;
    /** Whether the chosen object moves with the pointer. */
    this.moving = false;
  }

  get state() {
    return this.edits.state;
  }

  /** Objects that are gone are no longer chosen, nor deleted Gaussians selected. A shape may have found those: it is given up. */
  edited() {
    if (this.tools.shape) this.tools.cancel();
    this.earlier = [];
    this.later = [];
    for (const id of this.chosen) if (!this.state.objects.get(id)?.count) this.chosen.delete(id);
    this.selection.restrict(this.state);
    if (this.chosen.size !== 1) this.moving = false;
    this.refresh();
  }

  /** What is selected, within which objects. */
  picked() {
    return { ...this.selection.copy(), chosen: [...this.chosen] };
  }

  /** Keeps what was picked before, if other Gaussians are selected now. */
  remember(picked) {
    if (String(picked.runs) === String(runsOf(this.selection.rows()))) return;
    this.earlier.push(picked);
    if (this.earlier.length > REMEMBERED) this.earlier.shift();
    this.later = [];
  }

  /** Selects what was selected last in `from`; `to` gets what is selected now. False if there is nothing. */
  pickFrom(from, to) {
    const picked = from.pop();
    if (!picked) return false;
    to.push(this.picked());
    this.chosen = new Set(picked.chosen);
    this.moving = false;
    this.selection.restore(picked);
    this.refresh();
    return true;
  }

  /** A shape, then selections since the last edit, then edits. */
  undo() {
    if (this.tools.shape) this.tools.takeBack();
    else if (!this.pickFrom(this.earlier, this.later)) this.edits.undo();
  }

  redo() {
    if (this.tools.shape) this.tools.takeBack();
    else if (!this.pickFrom(this.later, this.earlier)) this.edits.redo();
  }

  /** Chooses an object alone, adds it ("add"; again drops it), or takes it out ("subtract"). Null means nothing. */
  choose(id, how = "new") {
    const had = this.chosen.has(id);
    const picked = this.picked();
    if (how === "new") this.chosen.clear();
    if (how === "subtract" || (how === "add" && had)) this.chosen.delete(id);
    else if (id !== null) this.chosen.add(id);
    this.selection.clear();
    this.remember(picked);
    this.moving = false;
    this.refresh();
    this.panel.list.reveal();
  }

  /** Esc: the selection goes first, then the tool, then what is chosen. */
  back() {
    const picked = this.picked();
    if (this.tools.shape) this.tools.cancel();
    else if (this.selection.count || this.selection.growth) {
      this.selection.clear();
      this.remember(picked);
    } else if (this.tools.tool !== "objects") this.tools.choose("objects");
    else this.choose(null);
    this.refresh();
  }

  setMoving(moving) {
    this.moving = moving && this.chosen.size === 1;
    this.refresh();
  }

  /** Does one more thing, if it changes anything. */
  push(operation) {
    if (this.scene.labelled) this.edits.push(operation);
  }

  /** Shows or hides objects. */
  show(ids, shown) {
    const changed = ids.filter((id) => this.state.object(id).shown !== shown);
    if (changed.length) this.push({ op: "view", shown: shown ? changed : [], hidden: shown ? [] : changed });
  }

  /** Hides what is chosen, or shows it where all of it is hidden. */
  toggle() {
    const ids = [...this.chosen];
    this.show(ids, !ids.some((id) => this.state.object(id).shown));
  }

  /** These objects alone, or all. */
  showOnly(ids) {
    const wanted = ({ id }) => ids === null || ids.has(id);
    const shown = this.state.present.filter((object) => wanted(object) && !object.shown);
    const hidden = this.state.present.filter((object) => !wanted(object) && object.shown);
    const idsOf = (objects) => objects.map(({ id }) => id);
    if (shown.length + hidden.length) this.push({ op: "view", shown: idsOf(shown), hidden: idsOf(hidden) });
  }

  /** An empty name changes nothing. `coseg edit` refuses control characters. */
  rename(object, text) {
    const name = text.replace(/\p{Cc}/gu, " ").trim();
    if (name && name !== called(this.state.object(object))) this.push({ op: "rename", object, name });
    else this.refresh();
  }

  recolor(object, color) {
    this.push({ op: "recolor", object, color });
  }

  /** The selected Gaussians, or else the chosen objects, become part of the object `id`. */
  putInto(id) {
    if (!this.state.objects.has(id)) return;
    const objects = [...this.chosen].filter((other) => other !== id);
    const gaussians = this.takeRows();
    if (gaussians.length) this.push({ op: "assign", gaussians, object: id });
    else if (objects.length) this.push({ op: "merge", objects, into: id });
    else return;
    this.choose(id);
  }

  /** The selected Gaussians, for an edit that they are not selected after. */
  takeRows() {
    const rows = this.selection.rows();
    this.selection.clear();
    return rows;
  }

  /** The selected Gaussians become an object of their own, to be named. */
  split() {
    const object = this.state.freeId();
    if (!this.selection.count || object === null) return;
    const taken = new Set([...this.state.objects.values()].map(({ name }) => name));
    let number = 1;
    while (taken.has(`object ${number}`)) number++;
    const gaussians = this.takeRows();
    const [used, near] = [this.state.present, this.state.objectsNear(gaussians)].map((some) => some.map(({ color }) => color));
    const made = { name: `object ${number}`, color: freshColor(used, near) };
    this.push({ op: "assign", gaussians, object, new: made });
    this.tools.choose("objects");
    this.choose(object);
    this.panel.lead(this.details.name);
  }

  /** Deletes the selected Gaussians, or else the chosen objects; the last Gaussian stays. */
  remove() {
    const left = this.state.present.filter(({ id }) => !this.chosen.has(id)).length;
    if (this.selection.count) {
      const total = this.state.present.reduce((sum, { count }) => sum + count, 0);
      if (this.selection.count < total) this.push({ op: "delete_gaussians", gaussians: this.selection.rows() });
    } else if (this.chosen.size && left) this.push({ op: "delete_objects", objects: [...this.chosen] });
  }

  /** Whether a Gaussian can be selected: it is shown, and of a chosen object if there are any. */
  isFree(row) {
    const part = this.state.parts[this.state.partOf[row]];
    return this.state.isShown(part) && (!this.chosen.size || this.chosen.has(part.object));
  }

  /** Selects the thing that the Gaussian `row` is part of, with that of earlier points, or adds or subtracts it. */
  point(row, how) {
    const picked = this.picked();
    this.selection.plant(row, this.scene, how);
    this.growTo(this.selection.growth.proposed);
    this.remember(picked);
    this.refresh();
  }

  /** Lets what points selected grow to a level of its growth. */
  growTo(level) {
    const { growth, base, flag } = this.selection;
    if (!growth) return;
    this.selection.level = Math.max(0, Math.min(growth.levels.length - 1, level));
    this.state.partOf.forEach((_, row) => {
      const isTaken = growth.holds(row, this.selection.level) && this.isFree(row);
      this.selection.set(row, isTaken ? flag : (base?.[row] ?? 0));
    });
    this.refresh();
  }

  /** Takes the whole of each superpoint that is touched, of objects that are chosen if any are. */
  grow() {
    const { superpoints } = this.scene;
    if (!superpoints || !this.selection.count) return;
    const picked = this.picked();
    const touched = new Set(this.selection.rows().map((row) => superpoints[row]));
    this.selection.endGrowth();
    superpoints.forEach((superpoint, row) => {
      if (touched.has(superpoint) && this.isFree(row)) this.selection.set(row, 1);
    });
    this.remember(picked);
    this.refresh();
  }

  /** Whether `coseg edit` takes a move, or a turn about a point, that is so far off; says so where it does not. */
  isNear(offset) {
    const { farthest } = this.scene;
    if (!farthest || Math.hypot(...offset) <= farthest) return true;
    this.refresh();
    this.panel.tell("Not moved: that is more than 100 times the size of the scene.");
    return false;
  }

  /** Shifts an object to an offset from where it was at first. */
  moveTo(object, offset) {
    const shift = minus(offset, this.state.object(object).offset);
    if (shift.some((v) => v !== 0) && this.isNear(shift)) this.push({ op: "move", object, shift });
  }

  /** Raises the chosen object by hundredths of the scene, or lowers it. */
  raise(hundredths) {
    if (this.chosen.size !== 1 || this.selection.count) return;
    const [object] = this.chosen;
    const { extent, upright } = this.scene;
    const step = (hundredths / 100) * Math.hypot(...minus(extent.high, extent.low));
    this.moveTo(object, add(this.state.object(object).offset, times(step, upright.direction)));
  }

  /** Turns an object to an angle from how it was at first. */
  turnTo(object, angle) {
    const degrees = angle - this.state.object(object).degrees;
    const middle = this.state.middle(object);
    const turn = { axis: this.scene.upright.direction, degrees, pivot: add(middle, this.scene.origin) };
    if (degrees && this.isNear(middle)) this.push({ op: "move", object, turn, shift: [0, 0, 0] });
  }
}
