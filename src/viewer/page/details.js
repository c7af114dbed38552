// What is chosen, objects or Gaussians, and what can be done with it. Controls stay the same elements and keep the focus.

const hexOf = (color) => `#${color.map((v) => v.toString(16).padStart(2, "0")).join("")}`;
const colorOf = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));

const NOTHING = "nothing chosen";

class Details {
  constructor(page) {
    this.page = page;
    const { scene } = page;
    this.box = document.getElementById("details");
    this.digits = digitsOf(scene.extent);
    const button = (textContent, title, onclick) => element("button", { type: "button", textContent, title, onclick });
    this.color = element("input", { type: "color", title: "colour", ariaLabel: "colour" });
    this.color.onchange = () => page.recolor(this.one, colorOf(this.color.value));
    this.name = element("input", { type: "text", maxLength: 200, title: "name (F2)", ariaLabel: "name", spellcheck: false });
    this.name.onchange = () => page.rename(this.one, this.name.value);
    this.title = element("b");
    this.facts = element("p");
    this.hide = button("Hide", "key H", () => page.toggle());
    this.only = button("Only", "hide all others", () => page.showOnly(page.chosen));
    this.move = button("Move", "move by dragging it or its arrows (key M)", () => page.setMoving(!page.moving));
    this.split = button("Split off", "make the selected Gaussians an object of their own (key N)", () => page.split());
    this.grow = button("Grow", "take the whole superpoints that are touched (key G)", () => page.grow());
    this.remove = button("Delete", "key Delete", () => page.remove());
    this.drop = button("Clear", "deselect (key Esc)", () => page.back());
    this.target = element("select", { title: "object (key T)", ariaLabel: "object to merge into" });
    this.put = button("Merge into", "", () => page.putInto(Number(this.target.value)));
    const field = (label, step, change) => {
      const input = element("input", { type: "number", step, value: 0, title: label, ariaLabel: label });
      input.onchange = () => change(Number(input.value) || 0);
      return input;
    };
    const along = (k) => (value) => page.moveTo(this.one, page.state.object(this.one).offset.map((v, j) => (j === k ? value : v)));
    this.shift = [0, 1, 2].map((k) => field(`shift along ${"xyz"[k]}, world units`, "any", along(k)));
    const { name } = scene.upright;
    this.turn = field(`turn about ${name}, degrees`, 15, (degrees) => page.turnTo(this.one, degrees));
    const lifts = [["Raise", 1, "U"], ["Lower", -1, "J"]].map(([text, by, key]) =>
      button(text, `by a hundredth of the scene (key ${key})`, () => page.raise(by)));
    this.places = element("div", { className: "places" },
      element("div", { className: "shift" }, "shift", ...this.shift.map((input, k) => element("label", {}, "xyz"[k], input))),
      element("label", {}, `turn about ${name}`, element("span", { className: "fields" }, this.turn, "°")),
      element("div", { className: "buttons touch" }, ...lifts));
    this.heading = element("div", { className: "heading" }, this.color, this.name);
    this.box.append(
      this.heading, this.title, this.facts,
      element("div", { className: "buttons" }, this.hide, this.only, this.move, this.split, this.grow, this.remove, this.drop),
      element("div", { className: "buttons put" }, this.put, this.target),
      this.places,
    );
    /** The field that someone types in, until it is left or what is typed counts. */
    this.typed = null;
    this.box.addEventListener("input", (e) => (this.typed = e.target));
    for (const end of ["change", "focusout"]) this.box.addEventListener(end, () => (this.typed = null), true);
  }

  /** What is chosen or selected, in a few words. */
  get words() {
    if (this.box.hidden) return NOTHING;
    if (this.one !== null) return `${this.name.value} chosen`;
    return `${this.title.textContent} ${this.facts.textContent}`;
  }

  update() {
    const { chosen, selection, state, scene } = this.page;
    const hasGaussians = selection.count > 0;
    this.box.hidden = !scene.labelled || (!chosen.size && !hasGaussians);
    if (this.box.hidden) return;
    this.one = chosen.size === 1 && !hasGaussians ? [...chosen][0] : null;
    const isOne = this.one !== null;
    for (const part of [this.heading, this.places, this.move]) part.hidden = !isOne;
    this.title.hidden = isOne;
    for (const part of [this.hide, this.only]) part.hidden = hasGaussians;
    this.split.hidden = !hasGaussians;
    this.grow.hidden = !hasGaussians || !scene.superpoints;
    if (isOne) this.describe(state.object(this.one));
    else this.summarize();
    this.list();
  }

  describe(object) {
    const { state, moving, scene } = this.page;
    const { low, high } = state.box(object.id);
    const size = minus(high, low).map((v) => rounded(v, this.digits)).join(" × ");
    const isNamed = object.id !== scene.ignore;
    this.set(this.name, called(object));
    this.set(this.color, hexOf(object.color));
    for (const input of [this.name, this.color]) input.disabled = !isNamed;
    this.facts.textContent = `id ${object.id} \u00b7 ${size}`;
    this.facts.title = "size in world units";
    this.hide.textContent = object.shown ? "Hide" : "Show";
    this.move.ariaPressed = String(moving);
    this.shift.forEach((input, k) => this.set(input, rounded(object.offset[k], this.digits)));
    this.set(this.turn, rounded(object.degrees, 3));
  }

  summarize() {
    const { chosen, selection, state } = this.page;
    const ids = selection.count ? selection.objects(state) : [...chosen];
    const names = ids.slice(0, 3).map((id) => called(state.object(id)));
    if (ids.length > 3) names.push(`${ids.length - 3} more`);
    this.title.textContent = selection.count ? `${grouped(selection.count)} Gaussian${selection.count === 1 ? "" : "s"} selected` : `${chosen.size} objects chosen`;
    this.facts.textContent = `${selection.count ? "of " : ""}${names.join(", ")}`;
    this.facts.title = "";
    this.hide.textContent = ids.some((id) => state.object(id).shown) ? "Hide" : "Show";
  }

  /** Objects that others, or Gaussians, can be put into. */
  list() {
    const { chosen, selection, state } = this.page;
    const isMany = chosen.size > 1 && !selection.count;
    const objects = [...state.objects.values()].filter(({ id }) => id !== this.one && (!isMany || chosen.has(id)));
    const entries = objects.sort(byName).map((object) => [String(object.id), called(object)]);
    const before = this.target.value;
    if (JSON.stringify(entries) !== this.entries) {
      this.entries = JSON.stringify(entries);
      this.target.replaceChildren(...entries.map(([value, name]) => element("option", { value }, name)));
      this.target.value = entries.some(([value]) => value === before) ? before : entries[0]?.[0];
    }
    this.put.textContent = selection.count ? "Assign to" : "Merge into";
    this.target.ariaLabel = selection.count ? "object to assign to" : "object to merge into";
    this.put.parentElement.hidden = !entries.length;
  }

  /** A field that someone types in keeps what it has, and a number the form that it has. */
  set(input, value) {
    if (input === this.typed) return;
    const isSame = input.type === "number" ? Number(input.value) === Number(value) : input.value === value;
    if (!isSame) input.value = value;
  }
}
