// The panel beside the picture: objects, views, and the command that writes the changes.

/** An element with properties and children. */
function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

const called = (object) => object.name ?? (object.id === null ? "all Gaussians" : `label ${object.id}`);
const grouped = (count) => count.toString().replace(/\B(?=(\d{3})+$)/g, "\u202f");

class Panel {
  /** `page` is the page of main.js. */
  constructor(scene, page) {
    this.scene = scene;
    this.page = page;
    const at = (id) => document.getElementById(id);
    at("title").textContent = scene.title;
    document.title = `${scene.title} – coseg`;
    at("lead").textContent = `${grouped(scene.gaussians)} Gaussians`;
    this.rows = scene.objects.map((object, i) => this.row(object, i));
    at("objects").append(...this.rows.map(({ line }) => line));
    for (const id of ["labelled", "objects", "changes", "handling"]) at(id).hidden = !scene.labelled;
    this.list = at("objects");
    this.digits = digitsOf(scene.extent);
    this.details = at("details");
    this.described = -1;
    this.command = at("command");
    at("copy").onclick = () => this.copy(at("copy"));
    at("all").onclick = () => page.showOnly(null);
    at("reset").onclick = () => page.putBack();
    at("background").onclick = () => page.nextBackground();
    for (const button of document.querySelectorAll("[data-mode]")) button.onclick = () => page.setMode(button.dataset.mode);
    this.views(at("views"));
    at("fold").onclick = () => {
      const folded = document.body.classList.toggle("folded");
      at("fold").setAttribute("aria-expanded", String(!folded));
      page.resized();
    };
  }

  row(object, i) {
    const box = element("input", { type: "checkbox", checked: true, title: "show", ariaLabel: `show ${called(object)}` });
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

  /** Shows the state of the objects. */
  update() {
    const { objects, chosen, mode } = this.page;
    this.rows.forEach(({ line, box }, i) => {
      line.classList.toggle("chosen", i === chosen);
      line.ariaCurrent = i === chosen ? "true" : null;
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
    const line = this.rows[i]?.line;
    if (!line) return;
    const [top, bottom] = [line.offsetTop - this.list.offsetTop, line.offsetTop - this.list.offsetTop + line.offsetHeight];
    const { scrollTop, clientHeight } = this.list;
    this.list.scrollTop = Math.min(top, Math.max(scrollTop, bottom - clientHeight));
  }

  /** The chosen object. Its controls stay the same elements and keep the focus. */
  showChosen() {
    const { objects, chosen, moving } = this.page;
    this.details.hidden = chosen < 0;
    if (chosen < 0) return;
    if (this.described !== chosen) this.describe(chosen);
    const { hide, move, fields, turn } = this.controls;
    hide.textContent = objects[chosen].shown ? "Hide" : "Show";
    move.ariaPressed = String(moving);
    const set = (field, value) => Number(field.value) !== Number(value) && (field.value = value);
    fields.forEach((field, k) => set(field, rounded(objects[chosen].offset[k], this.digits)));
    set(turn, rounded(objects[chosen].degrees, 3));
  }

  describe(i) {
    const { page, scene } = this;
    const object = scene.objects[i];
    const size = minus(object.high, object.low).map((v) => rounded(v, this.digits)).join(" × ");
    const button = (textContent, onclick) => element("button", { type: "button", textContent, onclick });
    const hide = button("Hide", () => page.show(i, !page.objects[i].shown));
    const move = button("Move by dragging", () => page.setMoving(!page.moving));
    const field = (label, step, change) => {
      const input = element("input", { type: "number", step, value: 0, title: label, ariaLabel: label });
      input.oninput = () => change(Number(input.value) || 0);
      return input;
    };
    const along = (k) => (value) => page.moveTo(i, page.objects[i].offset.map((v, j) => (j === k ? value : v)));
    const fields = [0, 1, 2].map((k) => field(`shift along ${"xyz"[k]}, world units`, "any", along(k)));
    const turn = field(`turn about ${scene.upright.name}, degrees`, 15, (degrees) => page.turnTo(i, degrees));
    this.details.replaceChildren(
      element("b", { textContent: called(object) }),
      element("p", { textContent: `id ${object.id}, ${size} world units` }),
      element("div", { className: "buttons" }, button("Only this", () => page.showOnly(i)), hide, move),
      element("label", {}, "shift", element("span", { className: "fields" }, ...fields)),
      element("label", {}, `turn about ${scene.upright.name}`, element("span", { className: "fields" }, turn, "°")),
    );
    this.controls = { hide, move, fields, turn };
    this.described = i;
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
