// The panel beside the picture: views, objects, what is chosen, and edits.

/** An element with properties and children. */
function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

const SETTLED = 300; // milliseconds after which what is chosen is spoken
const TOLD = 6000; // milliseconds that a line stays over the picture

class Panel {
  constructor(page) {
    this.page = page;
    const { scene } = page;
    const at = (id) => document.getElementById(id);
    at("title").textContent = scene.title;
    document.title = `${scene.title} – coseg`;
    this.count = at("lead");
    [this.notice, this.spoken, this.words, this.told] = [at("notice"), at("spoken"), NOTHING, ""];
    this.setReceived(scene.blocks ? 0 : scene.gaussians);
    at("then").textContent = scene.blocks ? "Then:" : "Then, beside edits.json:";
    this.list = new ObjectList(page);
    this.toolbar = new Toolbar(page);
    for (const id of ["labelled", "found", "handling"]) at(id).hidden = !scene.labelled;
    [this.box, this.summary, this.saves, this.drops] = [at("edits"), at("summary"), at("save"), at("discard")];
    this.command = at("command");
    at("copy").onclick = () => this.copy(at("copy"));
    at("all").onclick = () => page.showOnly(null);
    this.saves.onclick = () => page.edits.save();
    this.drops.onclick = () => (page.edits.isOutdated ? page.edits.takeSaved() : page.edits.discard());
    at("background").onclick = () => page.nextBackground();
    for (const button of document.querySelectorAll("[data-mode]")) button.onclick = () => page.setMode(button.dataset.mode);
    this.views(at("views"));
    at("fold").onclick = () => this.setFolded(!document.body.classList.contains("folded"));
  }

  /** Takes the panel away, or brings it back. */
  setFolded(folded) {
    document.body.classList.toggle("folded", folded);
    document.getElementById("fold").setAttribute("aria-expanded", String(!folded));
    this.page.resized();
  }

  /** Moves the focus to a field, if it is of use now; the panel is brought back for it. */
  lead(field) {
    if (field.disabled || field.closest("[hidden]")) return;
    this.setFolded(false);
    field.focus();
    field.select?.();
  }

  /** How many Gaussians are there. */
  setReceived(count) {
    const { gaussians } = this.page.scene;
    const part = count < gaussians ? `${grouped(count)} of ` : "";
    this.count.textContent = `${part}${grouped(gaussians)} Gaussians`;
    this.missing = part ? this.count.textContent : "";
    this.note();
  }

  /** Says over the picture why something was not done, for a while. */
  tell(words) {
    this.told = words;
    this.note();
    this.speak(words);
    clearTimeout(this.telling);
    this.telling = setTimeout(() => {
      this.told = "";
      this.note();
    }, TOLD);
  }

  /** Says over the picture what it does not show: Gaussians that are still to come, or the object that is to be moved. */
  note() {
    const { chosen, state, gizmo } = this.page;
    const lost = gizmo.isLost ? `${called(state.object([...chosen][0]))} is out of view: turn towards it to move it.` : "";
    const text = this.told || this.missing || lost;
    if (this.notice.textContent !== text) this.notice.textContent = text;
  }

  /** Tells screen readers, once it stays so. */
  speak(words) {
    if (words === this.words) return;
    this.words = words;
    clearTimeout(this.speaking);
    this.speaking = setTimeout(() => (this.spoken.textContent = words), SETTLED);
  }

  views(select) {
    const { cameras } = this.page.scene;
    select.parentElement.hidden = cameras.length === 0;
    const named = (camera, i) => element("option", { value: i }, `${camera.name}${camera.split === "test" ? " (held out)" : ""}`);
    select.append(element("option", { value: "" }, "free"), ...cameras.map(named));
    select.onchange = () => {
      if (select.value !== "") this.page.goTo(Number(select.value));
      // So that keys walk again.
      select.blur();
    };
    this.select = select;
    const step = (by) => () => {
      const now = select.value === "" ? -Math.max(by, 0) : Number(select.value);
      this.page.goTo((now + by + cameras.length) % cameras.length);
    };
    document.getElementById("before").onclick = step(-1);
    document.getElementById("after").onclick = step(1);
  }

  /** Selects the view that the camera is at, if any. */
  setView(i) {
    this.select.value = i ?? "";
  }

  /** Shows the state of the page. */
  update() {
    const { page } = this;
    for (const button of document.querySelectorAll("[data-mode]")) {
      button.setAttribute("aria-pressed", String(button.dataset.mode === page.mode));
    }
    this.list.update();
    this.toolbar.update();
    page.details.update();
    this.speak(page.details.words);
    page.hint?.clear();
    this.showEdits();
    // What has appeared may have taken the room of the chosen row.
    this.list.reveal();
  }

  showEdits() {
    const { edits, scene } = this.page;
    const { isOutdated, operations: { length } } = edits;
    // The file of a server changes also where all edits were undone.
    const differs = scene.blocks > 0 && !edits.isSaved;
    this.box.hidden = !edits.done.length && !edits.trouble && !differs && !isOutdated;
    const count = `${length} edit${length === 1 ? "" : "s"}`;
    const summary = edits.isSaved ? `${count}, saved` : `${count}, not saved`;
    const words = edits.trouble || (length || differs ? summary : "Only hidden: nothing to save");
    this.summary.textContent = isOutdated ? OUTDATED : words;
    this.saves.textContent = isOutdated ? "Download edits" : "Save edits";
    this.saves.disabled = edits.saving || !(length || differs);
    this.drops.textContent = isOutdated ? "Take saved edits" : "Discard edits";
    this.drops.title = isOutdated ? "these edits are dropped for good" : "undo everything; Redo brings it back";
    this.drops.disabled = !edits.done.length && !isOutdated;
    const line = editCommand(scene, edits);
    this.command.parentElement.hidden = !line;
    this.command.textContent = line;
  }

  async copy(button) {
    try {
      await navigator.clipboard.writeText(this.command.textContent);
      button.textContent = "Copied";
    } catch {
      // A page from a file may have no access to the clipboard: select the line for the user.
      getSelection().selectAllChildren(this.command);
      button.textContent = "Selected";
    }
    setTimeout(() => (button.textContent = "Copy"), 1500);
  }
}
