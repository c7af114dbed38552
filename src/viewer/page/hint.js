// The name of the object under the pointer, beside it.

const HOVERED = 500_000; // up to this number of Gaussians
const PAUSE = 60; // milliseconds between two checks

class Hint {
  constructor(page) {
    this.page = page;
    this.text = document.getElementById("hint");
    this.last = 0;
    page.canvas.addEventListener("pointermove", (e) => this.follow(e));
    page.canvas.addEventListener("pointerleave", () => this.clear());
  }

  /** What was under the pointer may be gone. */
  clear() {
    this.text.textContent = "";
  }

  follow(e) {
    const { page } = this;
    if (e.buttons || page.tools.isDrawing) this.clear();
    const isTooMuch = page.scene.gaussians > HOVERED || !page.scene.labelled;
    if (e.buttons || page.tools.isDrawing || isTooMuch || e.timeStamp - this.last < PAUSE) return;
    this.last = e.timeStamp;
    const [x, y] = page.navigation.place(e);
    const found = page.pickAt(x, y);
    this.text.textContent = found ? called(page.state.object(found.object)) : "";
    this.text.style.translate = `${x + 14}px ${y + 14}px`;
  }
}
