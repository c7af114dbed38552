// The list of objects: sorted by name, searched, chosen, shown and hidden.

/** chair 2 stands before chair 10. */
const natural = new Intl.Collator("en", { numeric: true, sensitivity: "base" });

const called = ({ id, name }) => name ?? (id === WHOLE ? "all Gaussians" : `label ${id}`);
const byName = (a, b) => natural.compare(called(a), called(b)) || a.id - b.id;
const grouped = (count) => count.toString().replace(/\B(?=(\d{3})+$)/g, "\u202f");

class ObjectList {
  constructor(page) {
    this.page = page;
    this.list = document.getElementById("objects");
    this.search = document.getElementById("search");
    this.search.oninput = () => this.update();
    this.several = document.getElementById("several");
    this.several.onclick = () => {
      page.several = !page.several;
      page.refresh();
    };
    this.rows = new Map();
    // What appears below takes room from the list.
    new ResizeObserver(() => this.reveal()).observe(this.list);
  }

  row(id) {
    const box = element("input", { type: "checkbox", title: "show" });
    box.onchange = () => this.page.show([id], box.checked);
    const mark = element("i");
    const text = element("span");
    const name = element("button", { className: "name", type: "button" }, mark, text);
    name.onclick = (e) => this.page.choose(id, e.shiftKey || e.ctrlKey || e.metaKey || this.page.several ? "add" : "new");
    const count = element("small");
    return { line: element("li", {}, element("label", {}, box), name, count), box, mark, text, name, count };
  }

  update() {
    const { state, chosen } = this.page;
    this.several.setAttribute("aria-pressed", String(this.page.several));
    const words = this.search.value.trim().toLowerCase();
    const isFound = (object) => called(object).toLowerCase().includes(words) || String(object.id) === words;
    const objects = state.present.filter(isFound).sort(byName);
    const lines = objects.map((object) => {
      if (!this.rows.has(object.id)) this.rows.set(object.id, this.row(object.id));
      const row = this.rows.get(object.id);
      row.box.checked = object.shown;
      row.box.ariaLabel = `show ${called(object)}`;
      row.mark.style.background = `rgb(${object.color.join(" ")})`;
      row.text.textContent = called(object);
      row.count.textContent = grouped(object.count);
      row.line.classList.toggle("chosen", chosen.has(object.id));
      row.line.classList.toggle("off", !object.shown);
      row.name.setAttribute("aria-pressed", String(chosen.has(object.id)));
      return row.line;
    });
    // Elements that stay in place keep the focus.
    const isSame = lines.length === this.list.children.length && lines.every((line, i) => line === this.list.children[i]);
    if (!isSame) this.list.replaceChildren(...lines);
    document.getElementById("none").hidden = lines.length > 0;
  }

  /** Scrolls to the object that was chosen last. */
  reveal() {
    const line = this.rows.get([...this.page.chosen].at(-1))?.line;
    if (!line?.isConnected) return;
    const top = line.offsetTop - this.list.offsetTop;
    const { scrollTop, clientHeight } = this.list;
    this.list.scrollTop = Math.min(top, Math.max(scrollTop, top + line.offsetHeight - clientHeight));
  }
}
