// The page of a run: asks for its figures every second, and for its scene when there is a new one.

const SECOND = 1000;
const MISSED = 3; // answers in a row after which the page says so
const PATIENCE = 10; // seconds until an answer is missed
const RETRY = 5; // seconds between questions then
const GLANCE = 200; // milliseconds between looks at what the person does
const FIGURES = {
  "PSNR, dB": [(point) => point.held_out.psnr, (v) => v.toFixed(2)],
  SSIM: [(point) => point.held_out.ssim, (v) => v.toFixed(3)],
  loss: [(point) => point.loss, (v) => v.toFixed(4)],
  Gaussians: [(point) => point.gaussians, (v) => v.toLocaleString("en")],
};

const at = (id) => document.getElementById(id);

/** The program in a frame; none where it could not be loaded. */
function pageOf(frame) {
  try {
    return frame?.contentWindow.page;
  } catch {
    return undefined;
  }
}

const moment = () => new Promise((done) => setTimeout(done, GLANCE));

/** Why a frame has no program: what the scene's page or the server says. */
function troubleOf(frame) {
  const shown = frame.contentDocument;
  const said = (shown?.getElementById("trouble") ?? shown?.body)?.textContent;
  return said || "The scene could not be loaded.";
}

class Watch {
  constructor() {
    /** Number of the copy of the Gaussians in the picture. */
    this.shown = 0;
    this.frame = null;
    this.loading = false;
    this.missed = 0;
    this.ended = false;
    /** Whether the person asked the run to stop. */
    this.stopping = false;
    this.mode = "colour";
    this.charted = "";
    at("stop").addEventListener("click", () => this.stop());
    at("back").addEventListener("click", () => this.goBack());
    at("views").addEventListener("change", () => this.goTo(Number(at("views").value)));
    for (const button of at("modes").children) button.addEventListener("click", () => this.setMode(button.dataset.mode));
    document.addEventListener("visibilitychange", () => this.look());
    setInterval(() => this.compare(), GLANCE);
    this.look();
  }

  /** Asks until the run has ended; not while nobody sees the page. */
  async look() {
    clearTimeout(this.timer);
    if (document.hidden || this.ended) return;
    try {
      const answer = await fetch("status", { signal: AbortSignal.timeout(PATIENCE * SECOND) });
      if (!answer.ok) throw new Error(answer.statusText);
      const status = await answer.json();
      this.missed = 0;
      this.show(status);
      if (status.ended) this.end();
    } catch {
      this.missed++;
      if (this.missed === MISSED) this.miss();
    }
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.look(), (this.missed < MISSED ? 1 : RETRY) * SECOND);
  }

  /** The run has ended, or the computer slept, or a tunnel broke off. */
  miss() {
    at("stage").textContent = `No answer: the connection is broken, or the run has ended. Asking again every ${RETRY} s.`;
    at("stop").disabled = true;
    document.title = `no answer \u2013 ${at("title").textContent}`;
  }

  show(status) {
    at("title").textContent = status.title;
    const share = status.iterations ? status.done / status.iterations : 0;
    document.title = `${Math.floor(100 * share)} % ${status.stage} – ${status.title}`;
    at("stage").textContent = status.stage ? `${status.stage}, ${status.done} of ${status.iterations}` : "The photos are being read.";
    at("bar").value = share;
    this.showStop(status.stopping || this.stopping);
    this.list({
      loss: status.loss?.toFixed(4),
      Gaussians: status.gaussians ? status.gaussians.toLocaleString("en") : undefined,
      shown: status.every > 1 ? `one in ${status.every}: the page has no room for more` : undefined,
      time: `${Math.floor(status.seconds / 60)} min ${Math.floor(status.seconds % 60)} s`,
    });
    this.chart(status);
    if (at("views").length !== status.views.length) this.listViews(status.views);
    at("modes").hidden = !status.labelled;
    if (status.copy > this.shown && !this.loading) this.load(status.copy);
  }

  showStop(stopping) {
    at("stop").disabled = stopping;
    at("stop").textContent = stopping ? "Stopping" : "Stop and save";
  }

  list(figures) {
    const known = Object.entries(figures).filter(([, text]) => text !== undefined);
    at("figures").replaceChildren(
      ...known.map(([name, text]) => {
        const row = element("div", null);
        row.append(element("dt", name), element("dd", text));
        return row;
      }),
    );
  }

  /** Curves of the stage that makes pictures, and the scores of labels; of those in training too. */
  chart({ curves, rows, stage }) {
    const text = JSON.stringify([curves, rows, stage]);
    if (text === this.charted) return;
    this.charted = text;
    const pictures = curves.find((curve) => curve.stage === "building" && curve.points.length);
    const charts = pictures ? Object.entries(FIGURES) : [];
    const drawn = charts.map(([name, [value, written]]) => {
      const points = pictures.points.map((point) => [point.iteration, value(point)]);
      const known = points.filter(([, y]) => y !== null);
      return known.length ? chart(name, known, written) : null;
    });
    at("charts").replaceChildren(...drawn.filter((box) => box));
    const training = curves.find((curve) => curve.stage === stage && curve !== pictures && !curve.finished)?.points.at(-1);
    const scored = rows.map(({ variant, miou }) => [variant, miou]);
    if (training && !this.ended) scored.push([`in training, ${training.iteration} steps`, training.miou]);
    const shown = scored.map(([name, miou]) => {
      const row = element("tr", null);
      row.append(element("td", name), element("td", miou === null ? "\u2013" : (100 * miou).toFixed(1)));
      return row;
    });
    at("rows").tBodies[0].replaceChildren(...shown);
    at("rows").hidden = !shown.length;
  }

  listViews(views) {
    this.views = views;
    at("views").replaceChildren(...views.map(({ name, split }, i) => element("option", split === "test" ? `${name} (held out)` : name, { value: i })));
    const heldOut = views.findIndex(({ split }) => split === "test");
    at("views").value = Math.max(heldOut, 0);
    this.goTo(Math.max(heldOut, 0));
  }

  /** The view and its photo beside it. */
  goTo(index) {
    pageOf(this.frame)?.goTo(index);
    const view = this.views[index];
    at("photo").src = `photo/${index}`;
    at("photo").alt = `photo ${view.name}`;
    at("caption").textContent = view.split === "test" ? "Its photo, which is not trained on" : "Its photo";
    at("photo").parentElement.hidden = false;
  }

  setMode(mode) {
    this.mode = mode;
    for (const button of at("modes").children) button.setAttribute("aria-pressed", button.dataset.mode === mode);
    pageOf(this.frame)?.setMode(mode);
  }

  /** Loads the scene behind the picture. */
  load(copy) {
    this.loading = true;
    const next = element("iframe", null, { title: "scene", className: "next", src: "scene.html#watch" });
    next.addEventListener("load", () => this.loaded(next, copy));
    at("picture").append(next);
  }

  /** Shows a frame from where the picture was, once nobody holds that with pointer or keys. */
  async loaded(next, copy) {
    const page = pageOf(next);
    while (page && this.isHeld()) await moment();
    this.loading = false;
    // A copy that cannot be shown is not asked for again.
    this.shown = copy;
    if (!page) {
      at("waiting").textContent = troubleOf(next);
      at("waiting").hidden = this.frame !== null;
      next.remove();
      return;
    }
    const before = pageOf(this.frame);
    if (before) page.lookAs(before);
    else page.goTo(Number(at("views").value));
    page.setMode(this.mode);
    next.className = "";
    if (this.frame && document.activeElement === this.frame) {
      next.focus();
      page.canvas.focus({ preventScroll: true });
    }
    this.frame?.remove();
    this.frame = next;
    at("waiting").hidden = true;
  }

  isHeld() {
    const navigation = pageOf(this.frame)?.navigation;
    return navigation !== undefined && navigation.pointers.size + navigation.keys.size > 0;
  }

  /** Whether the picture still shows the view that the photo is of. */
  compare() {
    const page = pageOf(this.frame);
    const view = page?.scene.cameras[Number(at("views").value)];
    const is = (name) => page.fitted[name].every((value, k) => value === view[name][k]);
    at("back").hidden = !view || (is("center") && is("rotation"));
  }

  goBack() {
    this.goTo(Number(at("views").value));
    at("views").focus();
  }

  async stop() {
    this.stopping = true;
    this.showStop(true);
    const answer = await fetch("stop", { method: "POST" }).catch(() => null);
    // It can be asked again.
    this.stopping = answer?.ok === true;
    this.showStop(this.stopping);
  }

  end() {
    this.ended = true;
    at("stop").hidden = true;
    at("bar").hidden = true;
    at("stage").textContent = "The run has ended. The terminal says where its results are.";
    document.title = `ended – ${at("title").textContent}`;
  }
}

window.watch = new Watch();
