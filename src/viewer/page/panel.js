// The panel beside the picture: views, objects, what is chosen, and edits.

/** An element with properties and children. */
function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

class Panel {
  constructor(page) {
    this.page = page;
    const { scene } = page;
    const at = (id) => document.getElementById(id);
    at("title").textContent = scene.title;
    document.title = `${scene.title} – coseg`;
    this.lead = at("lead");
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
    this.drops.onclick = () => page.edits.discard();
    at("background").onclick = () => page.nextBackground();
    for (const button of document.querySelectorAll("[data-mode]")) button.onclick = () => page.setMode(button.dataset.mode);
    this.views(at("views"));
    at("fold").onclick = () => {
      const folded = document.body.classList.toggle("folded");
      at("fold").setAttribute("aria-expanded", String(!folded));
      page.resized();
    };
  }

  /** How many Gaussians are there. */
  setReceived(count) {
    const { gaussians } = this.page.scene;
    const part = count < gaussians ? `${grouped(count)} of ` : "";
    this.lead.textContent = `${part}${grouped(gaussians)} Gaussians`;
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
    page.hint?.clear();
    this.showEdits();
    // What has appeared may have taken the room of the chosen row.
    this.list.reveal();
  }

  showEdits() {
    const { edits, scene } = this.page;
    const { length } = edits.operations;
    // The file of a server changes also where all edits were undone.
    const isBehind = scene.blocks > 0 && !edits.isSaved;
    this.box.hidden = !edits.done.length && !edits.trouble && !isBehind;
    const count = `${length} edit${length === 1 ? "" : "s"}`;
    const summary = edits.isSaved ? `${count}, saved` : `${count}, not saved`;
    this.summary.textContent = edits.trouble || (length || isBehind ? summary : "Only hidden: nothing to save");
    this.saves.disabled = edits.saving || !(length || isBehind);
    this.drops.disabled = !edits.done.length;
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
