// The buttons over the picture: tools, their options, undo and redo.

class Toolbar {
  constructor(page) {
    this.page = page;
    const at = (id) => document.getElementById(id);
    this.buttons = [...document.querySelectorAll("[data-tool]")];
    for (const button of this.buttons) button.onclick = () => page.tools.choose(button.dataset.tool);
    this.ways = [...document.querySelectorAll("[data-how]")];
    for (const button of this.ways) {
      button.onclick = () => {
        page.tools.how = button.dataset.how;
        page.refresh();
      };
    }
    [this.undo, this.redo] = [at("undo"), at("redo")];
    this.undo.onclick = () => page.undo();
    this.redo.onclick = () => page.redo();
    [this.options, this.radius, this.depth, this.depthText] = [at("options"), at("radius"), at("depth"), at("depth-text")];
    this.radius.oninput = () => {
      page.tools.radius = Number(this.radius.value);
      page.refresh();
    };
    this.depth.oninput = () => {
      page.tools.slider = Number(this.depth.value);
      page.refresh();
    };
    [this.ask, this.reach, this.reachText, this.how] = [at("ask"), at("reach"), at("reach-text"), at("how")];
    this.reach.oninput = () => page.growTo(Number(this.reach.value));
    this.within = at("within");
    at("toolbar").hidden = !page.scene.labelled;
    this.digits = digitsOf(page.scene.extent);
  }

  update() {
    const { tools, edits, selection, earlier, later } = this.page;
    for (const button of this.buttons) button.setAttribute("aria-pressed", String(button.dataset.tool === tools.tool));
    for (const button of this.ways) button.setAttribute("aria-pressed", String(button.dataset.how === tools.how));
    this.undo.disabled = !edits.done.length && !earlier.length;
    this.redo.disabled = !edits.undone.length && !later.length;
    this.options.hidden = tools.tool === "objects";
    const { growth, level } = selection;
    this.ask.hidden = tools.isDrawing || growth !== null;
    this.ask.textContent = this.page.scene.superpoints ? "Click a thing, once or from several sides" : "The scene is still loading";
    this.reach.parentElement.hidden = tools.isDrawing || growth === null;
    if (growth) {
      this.reach.max = growth.levels.length - 1;
      this.reach.value = level;
      this.reachText.textContent = `${level + 1} of ${growth.levels.length}`;
      this.reach.setAttribute("aria-valuetext", `${this.reachText.textContent}, ${selection.count} Gaussians`);
    }
    this.depth.parentElement.hidden = !tools.isDrawing;
    this.radius.parentElement.hidden = tools.tool !== "brush";
    this.radius.value = tools.radius;
    this.depth.value = tools.slider;
    const limit = tools.limit === Infinity ? "no limit" : rounded(tools.limit, this.digits);
    this.depthText.textContent = limit;
    const names = [...this.page.chosen].map((id) => called(this.page.state.object(id)));
    this.within.textContent = names.length ? `within ${names.join(", ")}` : "";
    this.within.hidden = !names.length;
    this.depth.setAttribute("aria-valuetext", `${limit} behind the surface`);
  }
}
