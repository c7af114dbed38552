// The scene that the page carries: a header, and columns of numbers as `packing.rs` writes them.

const LOG_STEP = 1 / 1024; // of logarithms of lengths and of colour scales
const BASE_STEP = 1 / 4096; // of the constant term of a colour
const TEXELS = 4; // that a Gaussian takes in each texture
const FLOATS = 4 * TEXELS;

/** A Gaussian's row in `geometry`: centre and opacity, then three axes as long as their standard deviations. */
const OPACITY = 3;
const OBJECT = 7;

class Scene {
  /**
   * @param {object} header what `Header` of mod.rs is
   * @param {ArrayBuffer} buffer the columns
   */
  constructor(header, buffer) {
    Object.assign(this, header);
    const n = this.gaussians;
    const terms = (this.degree + 1) ** 2 - 1;
    let at = 0;
    const take = (Type, width) => {
      const column = new Type(buffer, at, width * n);
      at += column.byteLength;
      return column;
    };
    const means = take(Float32Array, 3);
    const scales = take(Int16Array, 3);
    const base = take(Int16Array, 3);
    const rotations = take(Int16Array, 4);
    const opacities = take(Uint16Array, 1);
    const labels = take(Uint16Array, 1);
    const spread = take(Int16Array, 1);
    const rest = take(Int8Array, 3 * terms);

    /** Rows of 16 floats, see above; the texture of the same name. */
    this.geometry = new Float32Array(FLOATS * n);
    /** Rows of 16 words: 45 signed bytes of view-dependent colour, then the base colour as three floats. */
    this.colours = new Uint32Array(FLOATS * n);
    const bytes = new Int8Array(this.colours.buffer);
    const floats = new Float32Array(this.colours.buffer);
    for (let i = 0; i < n; i++) {
      const row = FLOATS * i;
      for (let k = 0; k < 3; k++) {
        this.geometry[row + k] = means[3 * i + k];
        floats[row + 12 + k] = base[3 * i + k] * BASE_STEP;
      }
      this.geometry[row + OPACITY] = opacities[i] / 65535;
      this.axes(row, rotations.subarray(4 * i, 4 * i + 4), scales.subarray(3 * i, 3 * i + 3));
      this.geometry[row + OBJECT] = labels[i];
      this.geometry[row + 11] = terms ? Math.exp(spread[i] * LOG_STEP) / 127 : 0;
      bytes.set(rest.subarray(3 * terms * i, 3 * terms * (i + 1)), 4 * row);
    }
  }

  /** Columns of the rotation (w, x, y, z), each as long as its standard deviation. */
  axes(row, [w, x, y, z], scales) {
    const s = 2 / Math.max(w * w + x * x + y * y + z * z, 1);
    const columns = [
      [1 - s * (y * y + z * z), s * (x * y + w * z), s * (x * z - w * y)],
      [s * (x * y - w * z), 1 - s * (x * x + z * z), s * (y * z + w * x)],
      [s * (x * z + w * y), s * (y * z - w * x), 1 - s * (x * x + y * y)],
    ];
    columns.forEach((column, j) => {
      const length = Math.exp(scales[j] * LOG_STEP);
      column.forEach((v, k) => (this.geometry[row + 4 + 4 * j + k] = length * v));
    });
  }

  objectOf(i) {
    return this.geometry[FLOATS * i + OBJECT];
  }

  /** The scene in the page. */
  static embedded() {
    const header = JSON.parse(document.getElementById("header").textContent);
    const text = document.getElementById("columns").textContent.trim();
    const decoded = Uint8Array.fromBase64
      ? Uint8Array.fromBase64(text)
      : Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    return new Scene(header, decoded.buffer);
  }
}

/** What the user has done to an object. */
class ObjectState {
  constructor() {
    this.shown = true;
    this.offset = [0, 0, 0];
  }

  get moved() {
    return this.offset.some((v) => v !== 0);
  }
}
