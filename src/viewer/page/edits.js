// What was done, in order: undone and done again, kept in the browser, and saved as edits.json.

const VERSION = 1; // of edits.json, as in src/objects/edits
const TAKEN = "Another window has edits that are not saved. The browser keeps those, but not these: save these before you leave.";
const OUTDATED = "Another window has saved edits since. Download these, or take the saved ones instead.";

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

/** Replaces what the browser keeps, in one step: another window that finds nothing in between keeps its own edits. */
function replaceKept(key, text) {
  try {
    if (text) localStorage.setItem(key, text);
    else localStorage.removeItem(key);
  } catch (error) {
    // An older entry must not stay where there is no room for this one.
    localStorage.removeItem(key);
    throw error;
  }
}

class Edits {
  /** Calls `edited` of `page` where the scene has changed, and else `refresh`. With `isKept`, edits outlive a reload. */
  constructor(scene, isKept, page) {
    this.scene = scene;
    this.page = page;
    // Another server may have the same port later.
    const server = scene.blocks ? ` ${location.pathname}` : "";
    this.key = isKept && scene.labelled ? `coseg edits ${scene.sha256}${server}` : null;
    /** What this window has kept last, or found, as a text. */
    this.kept = null;
    /** How often the server had saved edits when these began. */
    this.saves = scene.saves;
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
    if (this.key) window.addEventListener("storage", (e) => this.hear(e));
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

  /** Gives these edits up for those that another window has saved. */
  takeSaved() {
    this.undone = [];
    this.saves = this.scene.saves;
    this.startFrom({ done: this.scene.saved, saved: true });
    this.finish();
  }

  finish() {
    this.keep();
    this.page.edited();
  }

  /** What belongs into a file: hiding does not. */
  get operations() {
    return this.done.filter(({ op }) => op !== "view");
  }

  get isSaved() {
    const now = this.operations;
    return now.length === this.saved.length && now.every((operation, i) => operation === this.saved[i]);
  }

  /** Whether another window has saved since these began: the server must not write over that. */
  get isOutdated() {
    return this.saves !== this.scene.saves;
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
    this.page.refresh();
    const trouble = this.scene.blocks && !this.isOutdated ? await this.send() : this.download();
    this.saving = false;
    if (!trouble) {
      this.saved = operations;
      this.keep();
    }
    this.trouble = trouble || this.trouble;
    this.page.refresh();
  }

  /** Why the server has not written them, if so. */
  async send() {
    try {
      const trouble = await saveEdits(this.scene, this.text());
      if (!trouble) this.saves = this.scene.saves;
      return trouble;
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

  /** Whether the browser keeps edits of another window that are not saved. */
  get isTaken() {
    const there = localStorage.getItem(this.key);
    if (there === null || there === this.kept) return false;
    try {
      return !JSON.parse(there).saved;
    } catch {
      return false;
    }
  }

  keep() {
    if (!this.key) return;
    try {
      const saved = this.isSaved;
      const isTaken = this.isTaken;
      this.trouble = isTaken && !saved ? TAKEN : "";
      if (isTaken) return;
      // Without edits a page differs from its server, too.
      const isKept = this.done.length || (this.scene.blocks && !saved);
      this.kept = isKept ? JSON.stringify({ saved, saves: this.saves, done: packed(this.done) }) : null;
      replaceKept(this.key, this.kept);
    } catch {
      // Private windows keep nothing, and a page keeps 5 MB at most.
      this.trouble = this.isSaved ? "" : "The browser does not keep these edits: save them before you leave.";
    }
  }

  /** Another window has kept edits, or dropped them; `key` is null where it has dropped everything. */
  hear({ key }) {
    if ((key !== null && key !== this.key) || this.isSaved) return;
    this.keep();
    this.page.refresh();
  }

  /** Takes up what was kept, or what the server has saved since. What does not fit the scene is dropped. */
  restore() {
    if (!this.key) return;
    const servers = { done: this.scene.saved ?? [], saved: true };
    try {
      this.kept = localStorage.getItem(this.key);
      const kept = JSON.parse(this.kept) ?? { done: [], saved: true };
      kept.done = unpacked(kept.done);
      // What is hidden is in no file.
      const hidden = kept.done.filter(({ op }) => op === "view");
      if (kept.saved && this.scene.blocks) this.startFrom({ done: [...servers.done, ...hidden], saved: true });
      else this.startFrom(kept);
      if (!kept.saved) this.saves = kept.saves;
    } catch {
      this.startFrom(servers);
      this.trouble = "Edits of an earlier visit could not be read.";
    }
  }

  /** Starts from operations, and from whether the saved file has them. */
  startFrom({ done, saved }) {
    this.state = State.after(this.scene, done);
    this.done = [...done];
    this.saved = saved ? this.operations : [null];
  }
}
