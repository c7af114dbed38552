// Keys. Every action has one, and none is taken from a field that takes text.

const KEYS = {
  Digit1: (page) => page.setMode("colour"),
  Digit2: (page) => page.setMode("both"),
  Digit3: (page) => page.setMode("labels"),
  KeyB: (page) => page.nextBackground(),
  KeyL: (page) => page.level(),
  Escape: (page) => page.back(),
};

/** Those of a scene with labels. */
const EDITING_KEYS = {
  KeyV: (page) => page.tools.choose("objects"),
  KeyC: (page) => page.tools.choose("points"),
  KeyP: (page) => page.tools.choose("brush"),
  KeyO: (page) => page.tools.choose("lasso"),
  KeyX: (page) => page.tools.choose("box"),
  BracketLeft: (page) => page.tools.scale(-1),
  BracketRight: (page) => page.tools.scale(1),
  KeyF: (page) => page.panel.lead(page.panel.list.search),
  F2: (page) => page.panel.lead(page.details.name),
  KeyT: (page) => page.panel.lead(page.details.target),
  KeyH: (page) => page.toggle(),
  KeyM: (page) => page.setMoving(!page.moving),
  KeyU: (page) => page.raise(1),
  KeyJ: (page) => page.raise(-1),
  KeyN: (page) => page.split(),
  KeyG: (page) => page.grow(),
  Delete: (page) => page.remove(),
  Backspace: (page) => page.remove(),
};

/** A key by what it types, as layouts differ; by its place in the row of digits, and where letters are not Latin ones. */
function keyOf({ key, code }) {
  if (/^[a-z]$/i.test(key)) return `Key${key.toUpperCase()}`;
  if (key === "[" || key === "]") return key === "[" ? "BracketLeft" : "BracketRight";
  return code.startsWith("Key") && /^[!-~]$/.test(key) ? key : code;
}

class Keys {
  constructor(page) {
    this.page = page;
    window.addEventListener("keydown", (e) => this.press(e));
  }

  press(e) {
    const { page } = this;
    if (isForField(e)) {
      if (e.code === "Escape") this.leave(e.target);
      // Enter ends a name or a choice, and the keys of the page work again.
      if (e.code === "Enter" && e.target === page.details.target) page.details.put.click();
      if (e.code === "Enter" && (e.target.type === "text" || e.target === page.details.target)) page.canvas.focus();
      return;
    }
    const key = keyOf(e);
    // AltGr comes as both; brackets may need it.
    const isCommand = (e.ctrlKey || e.metaKey) && !e.altKey;
    if (isCommand && (key === "KeyZ" || key === "KeyY")) {
      e.preventDefault();
      if (e.shiftKey || key === "KeyY") page.redo();
      else page.undo();
      return;
    }
    if (isCommand) return;
    if (e.target === page.canvas && (e.key === " " || e.key === "Enter")) {
      e.preventDefault();
      if (!e.repeat) page.tools.press(e);
      return;
    }
    if (e.altKey && !key.startsWith("Bracket")) return;
    if (key in KEYS_OF_TURNS && page.tools.takesArrows(e.target)) {
      e.preventDefault();
      page.tools.step(KEYS_OF_TURNS[key], e);
      return;
    }
    const action = KEYS[key] ?? (page.scene.labelled ? EDITING_KEYS[key] : undefined);
    // Keys that walk do so by their place.
    if (!action || e.code in KEYS_OF_MOVES) return;
    // The key is not typed into what it leads to.
    e.preventDefault();
    action(page);
  }

  /** A field that is left by Esc has what it had before. */
  leave(field) {
    if (field.id === "search") field.value = "";
    this.page.details.typed = null;
    this.page.panel.update();
    field.blur();
    this.page.canvas.focus({ preventScroll: true });
  }
}
