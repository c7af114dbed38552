// The panel beside the picture: objects, views, and what the changes are as a command.

/** An element with properties and children. */
function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

const called = (object) => object.name ?? (object.id === null ? "all Gaussians" : `label ${object.id}`);
const grouped = (count) => count.toString().replace(/\B(?=(\d{3})+$)/g, "\u202f");

class Panel {
  /** `page` is what the panel acts on: main.js. */
  constructor(scene, page) {
    this.scene = scene;
    this.page = page;
    const at = (id) => document.getElementById(id);
    at("title").textContent = scene.title;
    document.title = `${scene.title} – coseg`;
    at("lead").textContent = `${grouped(scene.gaussians)} Gaussians`;
    this.rows = scene.objects.map((object, i) => this.row(object, i));
    at("objects").append(...this.rows.map(({ line }) => line));
    at("labelled").hidden = scene.objects.length < 2;
    this.details = at("details");
    this.command = at("command");
    at("copy").onclick = () => this.copy(at("copy"));
    at("all").onclick = () => page.showOnly(null);
    at("reset").onclick = () => page.putBack();
    at("background").onclick = () => page.nextBackground();
    for (const button of document.querySelectorAll("[data-mode]")) button.onclick = () => page.setMode(button.dataset.mode);
    this.views(at("views"));
    at("fold").onclick = () => {
      document.body.classList.toggle("folded");
      page.resized();
    };
  }

  row(object, i) {
    const box = element("input", { type: "checkbox", checked: true, title: "shown" });
    box.onchange = () => this.page.show(i, box.checked);
    const mark = element("i");
    mark.style.background = `rgb(${object.color.join(" ")})`;
    const name = element("button", { className: "name", type: "button" }, mark, called(object));
    name.onclick = () => this.page.choose(i);
    const line = element("li", {}, box, name, element("small", {}, grouped(object.gaussians)));
    return { line, box };
  }

  views(select) {
    const { cameras } = this.scene;
    select.parentElement.hidden = cameras.length === 0;
    const named = (camera, i) => element("option", { value: i }, `${camera.name}${camera.split === "test" ? " (held out)" : ""}`);
    select.append(element("option", { value: "" }, "free"), ...cameras.map(named));
    select.onchange = () => select.value !== "" && this.page.goTo(Number(select.value));
    this.select = select;
    const step = (by) => () => {
      const now = select.value === "" ? -Math.max(by, 0) : Number(select.value);
      this.page.goTo((now + by + cameras.length) % cameras.length);
    };
    document.getElementById("before").onclick = step(-1);
    document.getElementById("after").onclick = step(1);
  }

  /** Which view the camera is at; none where it has moved on. */
  setView(i) {
    this.select.value = i ?? "";
  }

  /** Shows the state of the objects. */
  update() {
    const { objects, chosen, mode } = this.page;
    this.rows.forEach(({ line, box }, i) => {
      line.classList.toggle("chosen", i === chosen);
      box.checked = objects[i].shown;
    });
    for (const button of document.querySelectorAll("[data-mode]")) {
      button.setAttribute("aria-pressed", String(button.dataset.mode === mode));
    }
    this.showChosen();
    const line = editCommand(this.scene, objects);
    this.command.parentElement.hidden = !line;
    this.command.textContent = line;
  }

  /** Scrolls the list to an object. */
  reveal(i) {
    this.rows[i]?.line.scrollIntoView({ block: "nearest" });
  }

  showChosen() {
    const { objects, chosen, moving } = this.page;
    this.details.hidden = chosen < 0;
    if (chosen < 0) return;
    const [object, state] = [this.scene.objects[chosen], objects[chosen]];
    const size = minus(object.high, object.low).map((v) => rounded(v, 2)).join(" × ");
    const button = (text, onclick, pressed) => {
      const made = element("button", { type: "button", textContent: text, onclick });
      if (pressed !== undefined) made.setAttribute("aria-pressed", String(pressed));
      return made;
    };
    const field = (k) => {
      const input = element("input", { type: "number", step: "any", value: rounded(state.offset[k]), title: `moved along ${"xyz"[k]}` });
      input.onchange = () => this.page.moveTo(chosen, state.offset.map((v, j) => (j === k ? Number(input.value) || 0 : v)));
      return input;
    };
    this.details.replaceChildren(
      element("b", { textContent: called(object) }),
      element("p", { textContent: `id ${object.id}, ${size} world units` }),
      element(
        "div",
        { className: "buttons" },
        button("Only this", () => this.page.showOnly(chosen)),
        button(state.shown ? "Hide" : "Show", () => this.page.show(chosen, !state.shown)),
        button("Move by dragging", () => this.page.setMoving(!moving), moving),
      ),
      element("div", { className: "fields" }, ...[0, 1, 2].map(field)),
    );
  }

  async copy(button) {
    try {
      await navigator.clipboard.writeText(this.command.textContent);
      button.textContent = "Copied";
    } catch {
      // A page from a file may not be let at the clipboard: then the line is marked for the user's own keys.
      getSelection().selectAllChildren(this.command);
      button.textContent = "Marked";
    }
    setTimeout(() => (button.textContent = "Copy"), 1500);
  }
}
