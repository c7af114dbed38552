// What was done, in order: undone and done again, kept in the browser, and saved as edits.json.

const VERSION = 1; // of edits.json, as in src/objects/edits

/** Numbers as runs of successive ones: how many to skip, how many to take, and so on. */
function runsOf(rows) {
  const runs = [];
  for (let i = 0, next = 0; i < rows.length; ) {
    const first = rows[i];
    runs.push(first - next);
    for (next = first; rows[i] === next; i++) next++;
    runs.push(next - first);
  }
  return runs;
}

function rowsOf(runs) {
  const rows = [];
  for (let i = 0, next = 0; i < runs.length; i += 2) {
    next += runs[i];
    for (const end = next + runs[i + 1]; next < end; next++) rows.push(next);
  }
  return rows;
}

/** Operations as the browser keeps them: it has little room, and a selection may have a million Gaussians. */
const packed = (operations) => operations.map((o) => (o.gaussians ? { ...o, gaussians: { runs: runsOf(o.gaussians) } } : o));
const unpacked = (operations) => operations.map((o) => (o.gaussians?.runs ? { ...o, gaussians: rowsOf(o.gaussians.runs) } : o));

class Edits {
  /** `changed` is called after each change. With `kept`, the browser keeps the edits across a reload. */
  constructor(scene, kept, changed) {
    this.scene = scene;
    this.changed = changed;
    this.key = kept && scene.labelled ? `coseg edits ${scene.sha256}` : null;
    this.done = [];
    this.undone = [];
    /** What the last saved file holds. */
    this.saved = [];
    /** Whether a file is being saved. */
    this.saving = false;
    /** Why edits are not kept, if they are not. */
    this.trouble = "";
    this.state = new State(scene);
    this.restore();
  }

  /** Does one more thing. */
  push(operation) {
    this.state.apply(operation);
    this.done.push(operation);
    this.undone = [];
    this.finish();
  }

  /** Shifts further by `move`, which a drag began. False where it is not the last operation any more: a key undid it. */
  extend(move, shift) {
    if (this.done.at(-1) !== move || this.saved.includes(move)) return false;
    this.state.apply({ op: "move", object: move.object, shift });
    move.shift = add(move.shift, shift);
    return true;
  }

  undo() {
    if (!this.done.length) return;
    this.undone.push(this.done.pop());
    this.state = State.after(this.scene, this.done);
    this.finish();
  }

  redo() {
    if (!this.undone.length) return;
    const operation = this.undone.pop();
    this.state.apply(operation);
    this.done.push(operation);
    this.finish();
  }

  /** Undoes everything, which can be done again. */
  discard() {
    while (this.done.length) this.undone.push(this.done.pop());
    this.state = new State(this.scene);
    this.finish();
  }

  finish() {
    this.keep();
    this.changed();
  }

  /** What belongs into a file: hiding does not. */
  get operations() {
    return this.done.filter(({ op }) => op !== "view");
  }

  get isSaved() {
    const now = this.operations;
    return now.length === this.saved.length && now.every((operation, i) => operation === this.saved[i]);
  }

  /** The content of edits.json. */
  text() {
    const lines = this.operations.map((operation) => `    ${JSON.stringify(operation)}`).join(",\n");
    const list = lines ? `[\n${lines}\n  ]` : "[]";
    return `{\n  "version": ${VERSION},\n  "scene": "${this.scene.sha256}",\n  "operations": ${list}\n}\n`;
  }

  /** Saves edits.json: its server writes it, or the browser downloads it. */
  async save() {
    const { operations } = this;
    this.saving = true;
    this.changed();
    const trouble = this.scene.blocks ? await this.send() : this.download();
    this.saving = false;
    if (!trouble) {
      this.saved = operations;
      this.keep();
    }
    this.trouble = trouble || this.trouble;
    this.changed();
  }

  /** Why the server has not written them, if so. */
  async send() {
    try {
      return await saveEdits(this.scene, this.text());
    } catch {
      this.download();
      return "The server has ended: the browser downloads edits.json instead.";
    }
  }

  download() {
    const url = URL.createObjectURL(new Blob([this.text()], { type: "application/json" }));
    element("a", { href: url, download: "edits.json" }).click();
    setTimeout(() => URL.revokeObjectURL(url), 60_000);
    return "";
  }

  keep() {
    if (!this.key) return;
    try {
      const saved = this.isSaved;
      // Without edits a page differs from its server, too.
      const isKept = this.done.length || (this.scene.blocks && !saved);
      // An older entry must not stay where there is no room for this one.
      localStorage.removeItem(this.key);
      if (isKept) localStorage.setItem(this.key, JSON.stringify({ done: packed(this.done), saved }));
      this.trouble = "";
    } catch {
      // Private windows keep nothing, and a page keeps 5 MB at most.
      this.trouble = this.isSaved ? "" : "The browser does not keep these edits: save them before you leave.";
    }
  }

  /** Takes up what was kept, or what the server has saved since. What does not fit the scene is dropped. */
  restore() {
    if (!this.key) return;
    const servers = { done: this.scene.saved ?? [], saved: true };
    try {
      const kept = JSON.parse(localStorage.getItem(this.key)) ?? { done: [], saved: true };
      kept.done = unpacked(kept.done);
      // What is hidden is in no file.
      const hidden = kept.done.filter(({ op }) => op === "view");
      if (kept.saved && this.scene.blocks) this.startFrom({ done: [...servers.done, ...hidden], saved: true });
      else this.startFrom(kept);
    } catch {
      this.startFrom(servers);
      this.trouble = "Edits of an earlier visit could not be read.";
    }
  }

  /** Starts from operations, and from whether the saved file has them. */
  startFrom({ done, saved }) {
    this.state = State.after(this.scene, done);
    this.done = done;
    this.saved = saved ? this.operations : [null];
  }
}
